"""`controller stop --zero | --hold` and `estop`, in a real daemon with a paused world."""

from __future__ import annotations

import json
from collections.abc import Iterator

import pytest
from command_line import CommandLine
from daemon_fixture import running_daemon

CONTROLLERS = "config/slider_control.yaml"
GOAL = "joint1_position_controller"


@pytest.fixture
def world() -> Iterator[CommandLine]:
    """The tutorial's slider, held at a height against gravity."""
    with running_daemon(paused=True) as runtime:
        line = CommandLine(runtime.folder)
        line.ok("spawn", "slider", "--controllers", CONTROLLERS, "--start", "joint_state_controller", GOAL)
        line.ok("pub", "command", "0.3")
        line.ok("sim", "step", "15000")
        yield line


def efforts(world: CommandLine, cycles: int = 30) -> set[float]:
    """The efforts on the joint in the cycles to come. At its velocity limit the joint is not pushed on."""
    found = set()
    with world.client() as client:
        for _ in range(cycles):
            client.call("/slidectl/step", {"cycles": 1})
            robot = client.call("/slidectl/list_robots", {"name": "slider"})["robots"][0]
            found.add(next(joint["effort"] for joint in robot["joints"] if joint["name"] == "joint1"))
    return found


def test_a_stopped_controller_leaves_its_effort_and_zero_takes_it_away(world: CommandLine) -> None:
    world.ok("controller", "stop", GOAL)
    assert efforts(world) != {0.0}
    done = world("controller", "stop", GOAL, "--best-effort", "--zero")
    assert (done.returncode, done.stderr) == (0, "joint1 keeps an effort of 0\n")
    assert efforts(world) == {0.0}


@pytest.mark.parametrize("words", [("stop", GOAL), ("switch", "--stop", GOAL), ("unspawn", GOAL)])
def test_zero_goes_with_whatever_stops_a_controller(world: CommandLine, words: tuple[str, ...]) -> None:
    world.ok("controller", *words, "--zero")
    assert efforts(world) == {0.0}


@pytest.mark.parametrize("words", [("stop", GOAL), ("switch", "--stop", GOAL), ("unspawn", GOAL)])
def test_hold_is_refused_for_an_effort_before_anything_stops(world: CommandLine, words: tuple[str, ...]) -> None:
    done = world("controller", *words, "--hold")
    assert done.returncode == 1
    assert done.stderr.startswith("error: joint1 is commanded by its effort")
    assert "--zero" in done.stderr
    states = {
        row["name"]: row["state"] for row in map(json.loads, world.ok("controller", "list", "--json").split("\n")[:-1])
    }
    assert states[GOAL] == "running"


def test_a_switch_that_stops_nothing_has_no_joint_to_let_go(world: CommandLine) -> None:
    done = world("controller", "switch", "--start", GOAL, "--zero")
    assert done.returncode == 2
    assert "--zero is for joints of controllers that are stopped" in done.stderr


def test_zero_and_hold_exclude_each_other(world: CommandLine) -> None:
    for words in (("stop", GOAL), ("switch", "--stop", GOAL), ("unspawn", GOAL)):
        for rests in (("--zero", "--hold"), ("--hold", "--zero")):
            done = world("controller", *words, *rests)
            assert (done.returncode, done.stderr.splitlines()[0]) == (
                2,
                "error: --zero and --hold exclude each other",
            )
    assert efforts(world) != {0.0}


@pytest.mark.parametrize(
    ("words", "instead"), [(("relase",), ""), (("slider", "release"), " slider"), (("slider", "relese"), " slider")]
)
def test_a_release_that_is_not_understood_says_how_it_is_typed(
    world: CommandLine, words: tuple[str, ...], instead: str
) -> None:
    done = world("estop", *words)
    assert done.returncode == 1
    assert done.stderr == (
        f"error: no robot '{words[-1]}'.\nto end an emergency stop: slidectl estop release{instead}\n"
    )
    assert world("estop", "slidr").stderr == "error: no robot 'slidr'. Did you mean 'slider'?\nrobots: slider\n"


def test_estop_stops_all_robots_and_everything_says_so(world: CommandLine) -> None:
    assert world.ok("estop") == "slider: emergency stop\n"
    assert efforts(world) == {0.0}
    warning = "warning: emergency stop is on: {}; slidectl estop release ends it\n"
    assert world("robots").stderr == warning.format("slider")
    assert world("controller", "list").stderr == warning.format("/slider")
    assert "estop:       on: slider\n" in world.ok("sim", "status")
    assert world.ok("estop", "release") == "slider: released\n"
    assert world("robots").stderr == ""
    assert efforts(world) != {0.0}


def test_estop_of_one_robot_leaves_the_others_alone(world: CommandLine) -> None:
    world.ok("spawn", "rrbot")
    assert world.ok("estop", "--cm", "rrbot") == "rrbot: emergency stop\n"
    assert json.loads(world.ok("estop", "/rrbot", "--json")) == {
        "name": "rrbot", "namespace": "/rrbot", "estop": True, "before": True,
    }  # fmt: skip
    assert json.loads(world.ok("sim", "status", "--json"))["estop"] == ["rrbot"]
    done = world("estop", "release", "rrbto")
    assert done.returncode == 1
    assert "no robot 'rrbto'" in done.stderr
    world.ok("delete", "rrbot", "slider")
    assert world("estop").returncode == 1
