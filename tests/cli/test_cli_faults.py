"""`slidectl fault` with a real daemon, whose world stands still but for `sim step`."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator
from typing import Any

import pytest
from command_line import ROOT, CommandLine

from slidectl.cli.fault import fault
from slidectl.fault_kinds import KINDS, OPTIONS


@pytest.fixture(autouse=True)
def _slider(world: CommandLine) -> Iterator[None]:
    start = "--start joint_state_controller joint1_position_controller"
    world.ok("spawn", "slider", *shlex.split(f"--controllers config/slider_control.yaml {start}"))
    yield
    world.ok("fault", "clear")
    world.ok("delete", "slider")
    world.ok("sim", "reset", "--time")


def listed(world: CommandLine) -> list[dict[str, Any]]:
    return [json.loads(line) for line in world.ok("fault", "list", "--json").splitlines()]


def position(world: CommandLine) -> float:
    found: float = json.loads(world.ok("robots", "slider", "--json"))["joints"][1]["position"]
    return found


def test_the_joint_is_stuck_from_one_time_to_another_and_the_list_says_so(world: CommandLine) -> None:
    words = "fault add joint1 --kind joint-stuck --from 0.5 --to 1.5 --name jam"
    assert world.ok(*words.split()) == "jam: joint-stuck on /slider/joint1 from 0.5 s to 1.5 s\n"
    world.ok("pub", "command", "1.0")
    states = []
    for until in ("0.4", "1.0", "1.4", "2.0"):
        world.ok("sim", "step", "--until", until)
        [record] = listed(world)
        states.append((record["state"], record["count"], position(world)))
        names = json.loads(world.ok("sim", "status", "--json"))["faults"]
        assert names == ([] if record["state"] == "over" else ["jam"])
    assert [state[:2] for state in states] == [("waiting", 0), ("active", 501), ("active", 901), ("over", 1000)]
    assert states[1][2] == states[2][2] > 0.0
    assert states[3][2] > states[2][2] + 0.01
    assert world.ok("fault", "remove", "jam", "--json") == '{"name": "jam"}\n'
    assert listed(world) == []


def test_options_come_back_as_they_count(world: CommandLine) -> None:
    world.ok("fault", "add", "link2", "--kind", "push", "--force", "0", "-1.5", "2e1", "--seed", "9")
    [record] = listed(world)
    assert record == {
        "name": "push_1", "kind": "push", "target": "/slider/link2", "from": 0.0, "to": None, "seed": 9,
        "options": {"force": [0.0, -1.5, 20.0], "torque": [0.0, 0.0, 0.0]}, "state": "active", "count": 0,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("words", "code", "texts"),
    [
        ("add joint9 --kind joint-stuck", 1, ["no moving joint 'joint9'", "moving joints: /slider/joint1"]),
        ("add joint1 --kind sensor-nois", 2, ["no kind of fault", "Did you mean 'sensor-noise'?"]),
        ("add joint1 --kind sensor-noise", 2, ["needs sd", "sensor-noise takes sd, of"]),
        ("add joint1 --kind sensor-noise --sd 1 --mass 2", 2, ["no option mass"]),
        ("add joint1 --kind command-loss --probability 7", 2, ["is 0 to 1, not 7"]),
        ("add joint1 --kind sensor-bias --bias nan", 2, ["is a finite number"]),
        ("add joint1 --kind joint-stuck --from -1", 1, ["it is 0 s already"]),
        ("add joint1 --kind joint-stuck --from 3 --to 2", 1, ["never acts"]),
        ("add joint1", 2, ["Missing option '--kind'"]),
        ("remove nothing", 1, ["no fault 'nothing'", "faults: none"]),
    ],
)
def test_what_is_wrong_is_said_with_what_exists(world: CommandLine, words: str, code: int, texts: list[str]) -> None:
    done = world("fault", *words.split())
    assert done.returncode == code, done.stderr
    for text in texts:
        assert text in done.stderr
    assert listed(world) == []


def test_the_command_the_service_and_the_page_have_the_same_kinds(world: CommandLine) -> None:
    shown = {record["name"]: record for record in map(json.loads, world.ok("fault", "kinds", "--json").splitlines())}
    served = {kind["name"]: kind for kind in world.client().call("/slidectl/fault/kinds")["kinds"]}
    page = (ROOT / "docs" / "faults.md").read_text()
    assert list(shown) == list(served) == list(KINDS)
    for name, kind in KINDS.items():
        assert [text.partition(" ")[0] for text in served[name]["options"]] == list(shown[name]["options"])
        [row] = [line for line in page.splitlines() if line.startswith(f"| `{name}` |")]
        _, _, target, options, _, _ = row.split("|")
        assert target.strip() == kind.target
        assert [option.split()[0] for option in options.split(",") if option.strip()] == list(kind.options)
    options = {name for param in fault.commands["add"].params for name in param.opts}
    assert {f"--{name}" for name in OPTIONS} <= options


def test_a_raw_call_needs_the_kind_and_the_target_alone(world: CommandLine) -> None:
    answer = world.client().call("/slidectl/fault/add", {"kind": "command-reversed", "target": "slider/joint1"})
    assert (answer["fault"]["name"], answer["fault"]["state"]) == ("command_reversed_1", "active")
    for request, text in (
        ({"options": "[1]"}, "options is a JSON object"),
        ({"options": "{"}, "options is a JSON object"),
        ({"options": "[" * 10_000}, "options is a JSON object"),
        ({"kind": "sensor-noise", "options": f'{{"sd": {10**400}}}'}, "is a finite number"),
        ({"start": [1.0, 2.0]}, "start is one time"),
        ({"options": '{"start": 3}'}, "has no option start"),
        ({"name": "a name"}, "is not a name for a fault"),
    ):
        done = world(
            "service", "call", "/slidectl/fault/add", json.dumps({"kind": "joint-stuck", "target": "joint1"} | request)
        )
        assert done.returncode == 2
        assert text in done.stderr
