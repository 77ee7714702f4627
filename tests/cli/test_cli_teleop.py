"""`slidectl teleop` in a terminal: what keys publish, and that all stops when they are let go, or the terminal is."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from command_line import CommandLine
from daemon_fixture import Runtime, running_daemon
from terminal import Terminal
from waiting import eventually

from slidectl import Client

CMD_VEL = "/cart/cmd_vel"
COMMAND = "/slider/joint1_effort_controller/command"
STILL = (0.0, 0.0, 0.0)
FOR_EVER = ("--key-timeout", "1000")


@pytest.fixture(scope="module")
def runtime() -> Iterator[Runtime]:
    with running_daemon() as daemon:
        yield daemon


@pytest.fixture(scope="module")
def run(runtime: Runtime) -> CommandLine:
    """A cart that is driven by a plugin, and a slider without a controller."""
    slidectl = CommandLine(runtime.folder)
    slidectl.ok("spawn", "cart")
    slidectl.ok("spawn", "slider", "--controllers", "config/slider_control.yaml", "--start", "joint_state_controller")
    return slidectl


@pytest.fixture
def client(run: CommandLine) -> Iterator[Client]:
    with run.client() as connected:
        yield connected


def listen(client: Client, topic: str, of: Callable[[dict[str, Any]], Any]) -> Callable[[], list[Any]]:
    """What has been published on the topic so far, call by call."""
    heard: list[Any] = []
    client.subscribe(topic, take=lambda published: heard.append(of(published["msg"])))

    def so_far() -> list[Any]:
        for _ in client.events(0.0):
            pass
        return heard

    return so_far


def planar(twist: dict[str, Any]) -> tuple[float, float, float]:
    return twist["linear"]["x"], twist["linear"]["y"], round(twist["angular"]["z"], 6)


def test_a_base_drives_while_a_key_is_held_and_stops_when_it_is_let_go(run: CommandLine, client: Client) -> None:
    heard = listen(client, CMD_VEL, planar)
    with Terminal(run, "teleop") as terminal:
        terminal.says(f"publishes on {CMD_VEL}")
        terminal.until(lambda: (0.5, 0.0, 0.0) in heard(), lambda: terminal.press("i"))
        terminal.until(lambda: heard()[-1] == STILL)
        terminal.until(lambda: (0.0, 0.5, 0.0) in heard(), lambda: terminal.press("J"))
        terminal.press("q")
        terminal.says("speed 0.55 m/s, turn 1.1 rad/s")
        terminal.until(lambda: (-0.55, 0.0, 1.1) in heard(), lambda: terminal.press("."))
        terminal.press("\x03")
        assert terminal.ended() == 130
        assert terminal.is_restored
        assert heard()[-1] == STILL


@pytest.mark.parametrize("end", ["a key without a meaning", "Ctrl-C", "Ctrl-Z and a signal", "the terminal is closed"])
def test_what_ends_the_drive_stops_the_base(run: CommandLine, client: Client, end: str) -> None:
    heard = listen(client, CMD_VEL, planar)
    with Terminal(run, "teleop", "cmd_vel", "--speed", "0.2", *FOR_EVER) as terminal:
        terminal.says("publishes on")
        terminal.press("o" if end == "Ctrl-Z and a signal" else "\x1b[A")
        terminal.until(lambda: len(heard()) > 3)  # it is repeated for bases that have a time-out
        assert heard()[-1][0] == 0.2
        if end == "the terminal is closed":
            terminal.close()
        elif end == "Ctrl-Z and a signal":
            terminal.press("\x1a")
            terminal.until(lambda: heard()[-1] == STILL)
            terminal.press("i")
            terminal.until(lambda: heard()[-1] != STILL)
            terminal.process.send_signal(signal.SIGTERM)
        else:
            terminal.press("\x03" if end == "Ctrl-C" else " ")
        eventually(lambda: heard()[-1] == STILL, "it goes on")
        if end != "a key without a meaning":
            assert terminal.process.wait(60) == 130


def test_nothing_is_published_before_a_key_moves_something(run: CommandLine, client: Client) -> None:
    heard = listen(client, CMD_VEL, planar)
    with Terminal(run, "teleop") as terminal:
        terminal.says("publishes on")
        terminal.press("qz k")
        terminal.says("speed 0.495 m/s")
        terminal.press("\x03")
        assert terminal.ended() == 130
    assert heard() == []


def test_a_joint_begins_at_the_set_point_of_others_and_stands_in_a_paused_world(
    run: CommandLine, client: Client
) -> None:
    controller = "/slider/joint1_position_controller"
    run.ok("controller", "spawn", "joint1_position_controller")
    heard = listen(client, f"{controller}/command", lambda message: message["data"])
    told = listen(client, f"{controller}/state", lambda message: message["set_point"])
    with Terminal(run, "teleop", "--joint", "joint1", "--speed", "0.01", *FOR_EVER) as terminal:
        terminal.says("publishes on")
        terminal.press("\x1b[C")
        terminal.until(lambda: len(heard()) > 2)
        terminal.press(" ")
        terminal.says("stopped")
        client.deliver(f"{controller}/command", {"data": 0.7})
        terminal.until(lambda: told()[-1] == 0.7)
        terminal.press("qz")
        terminal.says("0.0099 m/s")
        assert heard()[-1] == 0.7
        run.ok("sim", "pause")
        terminal.press("\x1b[C")
        terminal.says("waits for the set point")
        client.deliver(f"{controller}/command", {"data": 0.4})
        count = len(heard())
        run.ok("sim", "step", "100")
        terminal.until(lambda: len(heard()) > count)
        assert heard()[count:] == pytest.approx([0.4] * (len(heard()) - count), abs=0.01)
        run.ok("sim", "resume")
        terminal.until(lambda: heard()[-1] > 0.4005)
    run.ok("controller", "stop", "joint1_position_controller")
    run.ok("controller", "unload", "joint1_position_controller")


def test_a_joint_follows_the_arrow_keys_by_its_set_point(run: CommandLine, client: Client) -> None:
    run.ok("controller", "spawn", "joint1_position_controller")
    heard = listen(client, "/slider/joint1_position_controller/command", lambda message: message["data"])
    with Terminal(run, "teleop", "--joint", "joint1", "--speed", "0.5") as terminal:
        terminal.says("publishes on")
        terminal.until(lambda: heard() and heard()[-1] > 0.3, lambda: terminal.press("\x1b[C"))
        terminal.until(lambda: "stopped" in terminal.output.rpartition("forwards")[2])
        highest = heard()[-1]
        client.wait("/slider/joint_states/position[0]", near=highest, tol=0.05, timeout=60)
        terminal.until(lambda: heard()[-1] < highest - 0.1, lambda: terminal.press("\x1b[B"))
        terminal.press("\x03")
        assert terminal.ended() == 130
    assert heard() == sorted(heard()[: heard().index(highest)]) + heard()[heard().index(highest) :]
    run.ok("controller", "stop", "joint1_position_controller")


def test_an_effort_is_given_while_the_key_is_held_and_the_end_of_the_daemon_ends_it(
    run: CommandLine, client: Client, runtime: Runtime
) -> None:
    parameters = {"type": "effort_controllers/JointEffortController", "joint": "joint1"}
    client.params.set_all({f"/slider/joint1_effort_controller/{key}": value for key, value in parameters.items()})
    run.ok("controller", "spawn", "joint1_effort_controller")
    heard = listen(client, COMMAND, lambda message: message["data"])
    with Terminal(run, "teleop", "--joint", "/slider/joint1", "--speed", "3") as terminal:
        terminal.says("publishes on")
        terminal.until(lambda: -3.0 in heard(), lambda: terminal.press("\x1b[D"))
        terminal.until(lambda: heard()[-1] == 0)
        runtime.stop()
        assert terminal.ended() == 3
        assert terminal.is_restored
    runtime.start()


def test_what_cannot_be_driven_is_told(world: CommandLine) -> None:
    world.ok("spawn", "slider", "--controllers", "config/slider_control.yaml", "--start", "joint_state_controller")
    for words, code, says in (
        ((), 1, "nobody subscribes to a topic of geometry_msgs/Twist"),
        (("--joint", "joint1"), 1, "no running controller takes commands for joint1 alone"),
        (("--joint", "joint3"), 1, "/slider/joint1"),
        (("/gazebo/set_model_state",), 2, "takes gazebo_msgs/ModelState"),
        (("cmd_vel", "--joint", "joint1"), 2, "does not go with --joint"),
    ):
        with Terminal(world, "teleop", *words) as terminal:
            assert terminal.ended() == code
            assert says in terminal.output.replace("\r\n", " ")
    done = world("teleop")
    assert done.returncode == 2
    assert "slidectl pub" in done.stderr
