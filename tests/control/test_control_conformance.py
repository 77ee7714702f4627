"""Recorded numbers: every vector agrees to the bit, and the runner notices one that does not."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

TESTS = Path(__file__).resolve().parent.parent
DATA = TESTS / "data"
FILES = ["pid_vectors.json", "joint_limits_vectors.json", "transmission_vectors.json"]
RUNS = sorted((DATA / "controllers").glob("*.json"))


def run(*paths):
    return subprocess.run(
        [sys.executable, str(TESTS / "conformance.py"), *map(str, paths)], capture_output=True, text=True, check=False
    )


def changed(tmp_path, name, change):
    """A copy of a file in which `change` was made to its vectors."""
    vectors = json.loads((DATA / name).read_text())
    change(vectors)
    path = tmp_path / Path(name).name
    path.write_text(json.dumps(vectors))
    return path


def test_all_vectors_agree_to_the_bit():
    result = run(*(DATA / name for name in FILES))
    assert result.returncode == 0, result.stdout + result.stderr
    assert result.stdout.count("0 mismatches, worst deviation 0.0") == len(FILES)


@pytest.mark.parametrize("path", RUNS, ids=lambda path: path.stem)
def test_recorded_runs_of_controllers_agree_to_the_bit(path):
    result = run(path)
    assert result.returncode == 0, result.stdout + result.stderr
    assert "0 mismatches, worst deviation 0.0" in result.stdout


def nudge_pid(vectors):
    vectors["cases"][0]["outputs"][3] *= 1.0 + 2.3e-16


def nudge_state(vectors):
    vectors["cases"][0]["state_after"][3][1] += 1e-12


def nudge_limits(vectors):
    vectors["cases"][0]["outputs"][0] += 1e-9


def nudge_transmission(vectors):
    vectors["cases"][0]["actuator_out"]["velocity"][0] += 1e-9


def turn_zero_round(vectors):
    case = next(case for case in vectors["cases"] if 0.0 in case["outputs"])
    position = case["outputs"].index(0.0)
    case["outputs"][position] = -float(case["outputs"][position])


def accept_all_limits(vectors):
    vectors["constructor_errors"][0]["raises"] = False


def refuse_a_good_reduction(vectors):
    vectors["constructor_errors"][0]["case"] = "simple reduction 2"


def nudge_row(vectors):
    vectors["cases"][0]["rows"][10][3] += 2e-9


def nudge_result(vectors):
    vectors["cases"][0]["results"][0]["error_string"] = "j1 goal error 0.000115"


def delay_state(vectors):
    vectors["cases"][0]["published"]["/ctrl/state"]["cycles"][0] += 1


ACTIONS = "controllers/joint_trajectory_position_actions.json"


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("controllers/simple_controllers.json", nudge_row),
        (ACTIONS, nudge_result),
        (ACTIONS, delay_state),
        ("pid_vectors.json", nudge_pid),
        ("pid_vectors.json", nudge_state),
        ("joint_limits_vectors.json", nudge_limits),
        ("joint_limits_vectors.json", turn_zero_round),
        ("joint_limits_vectors.json", accept_all_limits),
        ("transmission_vectors.json", nudge_transmission),
        ("transmission_vectors.json", refuse_a_good_reduction),
    ],
)
def test_a_changed_vector_is_a_mismatch(tmp_path, name, change):
    result = run(changed(tmp_path, name, change))
    assert result.returncode == 1
    assert "1 mismatches" in result.stdout


@pytest.mark.parametrize(
    "text", ["", "{", "[]", '{"cases": []}', '{"cases": [{"what": 1}]}', '{"cases": [{"mode": "error"}]}']
)
def test_a_file_that_is_none_of_these_formats_is_unreadable(tmp_path, text):
    path = tmp_path / "broken.json"
    path.write_text(text)
    result = run(path)
    assert result.returncode == 2
    assert str(path) in result.stderr
    assert "Traceback" not in result.stderr


def test_a_missing_file_and_no_file_at_all_are_unreadable(tmp_path):
    assert run(tmp_path / "nothing.json").returncode == 2
    assert run().returncode == 2
