"""The pytest plugin, as its users have it: in runs of pytest of their own."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from waiting import eventually

from slidectl.extensions.recording.recording_files import opened

pytest_plugins = ["pytester"]

ROOT = Path(__file__).parent.parent
BLOCK = re.compile(r"^```(?:python|ini)\n# (\S+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
WORLD = """
import pytest

START = ["joint_state_controller", "joint1_position_controller"]


@pytest.fixture
def slider(slidectl_client):
    slidectl_client.spawn("slider", controllers="config/slider_control.yaml", start=START)
    slidectl_client.publish("command", {"data": 0.5})
    slidectl_client.sleep(1)
    return slidectl_client
"""


@pytest.fixture
def run(pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch):
    """Runs pytest in a process of its own, with this plugin and no other but xdist."""
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}:{os.environ['PATH']}")

    def run_pytest(*words: str) -> pytest.RunResult:
        plugins = ("-p", "slidectl.extensions.scenarios.pytest_plugin", "-p", "xdist")
        return pytester.runpytest_subprocess(*plugins, "-W", "error", "-rA", *words, timeout=300)

    return run_pytest


def kept(folder: Path) -> set[str]:
    return {file.name for file in folder.iterdir()} if folder.exists() else set()


def test_it_imports_next_to_nothing_before_a_fixture_is_used(pytester: pytest.Pytester, run) -> None:
    pytester.makepyfile("""
        import sys

        def test_what_is_imported():
            heavy = {"mujoco", "numpy", "click", "yaml", "slidectl.client", "slidectl.daemon"}
            assert not heavy & sys.modules.keys()
    """)
    run("--slidectl-keep", "kept").assert_outcomes(passed=1)
    assert not (pytester.path / "kept").exists()


def test_the_examples_of_its_page_pass(pytester: pytest.Pytester, run) -> None:
    for name, text in BLOCK.findall((ROOT / "docs" / "pytest.md").read_text("utf-8")):
        (pytester.path / name).write_text(text, "utf-8")
    scenarios = pytester.mkdir("scenarios")
    (scenarios / "slider.yaml").write_text((ROOT / "examples" / "scenarios" / "slider.yaml").read_text("utf-8"))
    result = run()
    assert result.ret == 0
    assert "scenarios/slider.yaml" in result.stdout.str()


def test_failures_keep_recordings_and_journals_in_several_processes_too(pytester: pytest.Pytester, run) -> None:
    pytester.makepyfile(WORLD + """

@pytest.fixture
def broken(slider):
    slider.sleep(1)
    raise RuntimeError("in the setup")

@pytest.fixture
def breaks_later(slider):
    yield slider
    raise RuntimeError("in the teardown")

@pytest.mark.parametrize("goal", [0.5, "a/b", "a_b"])
def test_goals(slider, goal):
    assert goal == 0.5

def test_setup(broken):
    pass

def test_teardown(breaks_later):
    pass
""")  # fmt: skip
    name = "test_failures_keep_recordings_and_journals_in_several_processes_too.py"
    result = run("-n", "2", "--slidectl-keep", "kept")
    result.assert_outcomes(passed=2, failed=2, errors=2)
    stems = {file.stem for file in (pytester.path / "kept").iterdir()}
    assert kept(pytester.path / "kept") == {f"{stem}{suffix}" for stem in stems for suffix in (".mcap", ".journal")}
    ends = [re.sub("-[0-9a-f]{8}$", "-#", stem.removeprefix(f"{name}-")) for stem in stems]
    assert sorted(ends) == ["test_goals-a_b", "test_goals-a_b-#", "test_setup", "test_teardown"]
    told = result.stdout.str()
    for file in kept(pytester.path / "kept"):
        assert str(pytester.path / "kept" / file) in told
    with opened(next((pytester.path / "kept").glob("*test_setup.mcap"))) as recording:
        summary = recording.summary()
        assert summary.counts["/slider/joint_states"] == 100  # at 50 Hz
        assert summary.counts["/slider/joint1_position_controller/command"] == 1
        assert summary.end_ns == 2_001_000_000
    again = run("-k", "0.5 or a_b", "--slidectl-keep", "kept", "--slidectl-record=none")
    again.assert_outcomes(passed=1, failed=1)
    assert "i = 0.01 has no effect without i_clamp" in again.stdout.str()
    assert kept(pytester.path / "kept") == {f"{stem}{suffix}" for stem in stems for suffix in (".mcap", ".journal")}


def test_all_tests_are_recorded_when_that_is_asked_for(pytester: pytest.Pytester, run) -> None:
    pytester.makepyfile(test_one=WORLD + "\ndef test_one(slider):\n    slider.sleep(69)\n")
    result = run("--slidectl-record=all")
    result.assert_outcomes(passed=1)
    [file] = re.findall(r"^recording: (\S+), up to 70\.\d+ s$", result.stdout.str(), re.MULTILINE)
    with opened(Path(file)) as recording:
        summary = recording.summary()
        assert summary.begin_ns is not None
        assert 9_900_000_000 < summary.begin_ns < 10_100_000_000
    journal = Path(file).with_suffix(".journal")
    done = subprocess.run([sys.executable, "-m", "slidectl", "replay", "--check", journal], cwd=ROOT)
    assert done.returncode == 0


def test_the_marker_makes_the_world(pytester: pytest.Pytester, run) -> None:
    pytester.makepyfile(
        my_laws="""
        from slidectl.control import Controller, EffortJointInterface

        class Push(Controller):
            interface_type = EffortJointInterface

            def init(self, interface, node):
                self.joint = interface.get_handle(node.get_param("joint"))
                return True

            def update(self, time_ns, period_s):
                self.joint.command = 3.0
    """
    )
    pytester.makepyfile(
        test_marked="""
        import pytest
        from slidectl import traces

        pytestmark = pytest.mark.slidectl(timestep=0.01, sim_timeout=2)

        def test_module(slidectl_client):
            assert slidectl_client.call("/slidectl/status")["timestep"] == 0.01
            slidectl_client.sleep(3)

        @pytest.mark.slidectl(timestep=0.002, gravity=[0, 0, -1])
        def test_nearest(slidectl_client):
            assert slidectl_client.call("/slidectl/status")["timestep"] == 0.002
            assert slidectl_client.call("/gazebo/get_physics_properties")["gravity"]["z"] == -1
            slidectl_client.sleep(1.9)

        @pytest.mark.parametrize("run", [1, 2])
        @pytest.mark.slidectl(imports=["my_laws.py"])
        def test_laws(slidectl_client, run):
            slidectl_client.spawn("slider")
            slidectl_client.params["/slider/push"] = {"type": "my_laws/Push", "joint": "joint1"}
            slidectl_client.controllers("/slider").bring_up(["push"])
            slidectl_client.sleep(1)
            effort = traces.live(slidectl_client, "joint1/effort").values[-1]
            assert effort == 4.0, run

        @pytest.mark.slidectl(timestp=1)
        def test_argument(slidectl_client):
            pass

        @pytest.mark.slidectl(engine="steam")
        def test_value(slidectl_daemon):
            pass

        @pytest.mark.slidectl(gravity=[0, 0])
        def test_gravity(slidectl_world):
            pass

        @pytest.mark.slidectl(sim_timeout="long")
        def test_timeout(slidectl_world):
            pass

        @pytest.mark.slidectl(imports=["no_such_module"])
        def test_world(slidectl_world):
            pass

        @pytest.mark.slidectl(imports=["no_such_module"])
        def test_daemon(slidectl_daemon):
            pass
    """
    )
    (pytester.mkdir("below") / "sub_laws.py").write_text((pytester.path / "my_laws.py").read_text())
    (pytester.path / "below" / "test_below.py").write_text("""
import pytest

@pytest.mark.slidectl(imports=["sub_laws.py"])
def test_file(slidectl_daemon):
    slidectl_daemon.run("spawn", "slider")
    assert "sub_laws/Push" in slidectl_daemon.run("controller", "types").stdout

@pytest.mark.slidectl(imports=["sub_laws"])
def test_module(slidectl_daemon):
    slidectl_daemon.run("spawn", "slider")
    assert "sub_laws/Push" in slidectl_daemon.run("controller", "types").stdout
""")
    result = run("--strict-markers")
    result.assert_outcomes(passed=3, failed=3, errors=6)
    said = result.stdout.str()
    assert "gravity must be three finite numbers in m/s²" in said
    assert "could not convert string to float: 'long'" in said
    assert said.count("no module 'no_such_module' is installed") >= 2
    assert "fixturedef" not in said, "an error of a fixture shows no code of pytest"
    assert "TimedOut: the simulated time is up: 2 s" in said
    assert "sim_timeout=4" in said
    assert len(re.findall(r"^E +assert np\.float64\(3\.0\) == 4\.0$", said, re.M)) == 2
    assert "which differs from the test" not in said
    assert "takes timestep, gravity, ground, engine, imports, paused, rtf, sim_timeout by name, not timestp" in said
    assert "unknown engine 'steam'" in said
    assert "client.py" not in said, "the traceback ends with the test's own line"


def test_a_daemon_is_gone_after_its_test_and_its_failure_is_recorded(
    pytester: pytest.Pytester, run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(pytester.path))
    pytester.makepyfile(
        test_daemon="""
        import os
        from pathlib import Path
        import pytest

        @pytest.mark.slidectl(paused=True)
        def test_command(slidectl_daemon):
            Path("daemon").write_text(f"{slidectl_daemon.pid} {os.environ['XDG_RUNTIME_DIR']}")
            slidectl_daemon.run("-i", "other", "daemon", "start")
            slidectl_daemon.run("spawn", "slider")
            slidectl_daemon.run("shell", input="sim step 2s\\n")
            slidectl_daemon.run("spawn", "nonsense")

        def test_killed(slidectl_daemon):
            os.kill(slidectl_daemon.pid, 9)

        def test_environment():
            assert os.environ["XDG_RUNTIME_DIR"] == os.getcwd()
    """
    )
    result = run("--slidectl-keep", str(pytester.path / "deep" / "kept"))
    result.assert_outcomes(passed=2, failed=1)
    said = result.stdout.str()
    assert re.search(r"Failed: slidectl spawn nonsense: exit code 1\n.*no shipped model 'nonsense'", said)
    stem = "test_daemon.py-test_command-daemon"
    assert kept(pytester.path / "deep" / "kept") == {f"{stem}.mcap", f"{stem}.journal"}
    assert f"{stem}.mcap, up to 2.000 s" in said
    pid, folder = (pytester.path / "daemon").read_text().split()
    eventually(lambda: not Path(f"/proc/{pid}").exists(), "the daemon is there")
    assert not Path(folder).exists()


def test_scenarios_are_tests_where_pytest_is_told_so(pytester: pytest.Pytester, run) -> None:
    scenarios = pytester.mkdir("robots")
    (scenarios / "goals.yaml").write_text("""
cases:
  - {name: up, goal: 0.5, tags: [quick]}
  - {name: far, goal: 3.0}
  - {name: known, goal: 3.0, xfail: it is too far}
world: {engine: plain}
setup:
  - spawn: slider --controllers config/slider_control.yaml --start joint_state_controller joint1_position_controller
steps:
  - pub: command ${goal}
  - wait: joint_states/position[0] --near ${goal} --tol 0.05
    within: 10
""")
    (scenarios / "other.yml").write_text("some: [other, file]\n")
    run().assert_outcomes()
    pytester.makeini("[pytest]\nslidectl_scenarios = robots/*.yaml\n")
    result = run("--slidectl-keep", "kept")
    result.assert_outcomes(passed=1, failed=1, xfailed=1)
    assert re.search(r"expected near 3.*closest", result.stdout.str())
    assert {name.rpartition(".")[2] for name in kept(pytester.path / "kept")} == {"mcap", "journal"}
    run("-k", "quick").assert_outcomes(passed=1, deselected=2)
    (scenarios / "goals.yaml").write_text("steps:\n  - fly: away\n")
    assert re.search(r"goals\.yaml:2: .*fly", run().stdout.str())
