"""`slidectl top` in a terminal: what it shows, how it fits, what its keys do, and how it ends; and once, as text."""

from __future__ import annotations

import json
import os
import re
import signal
from collections.abc import Iterator

import pytest
from command_line import CommandLine
from daemon_fixture import running_daemon
from terminal import Terminal

from slidectl.extensions.viewing.world_monitor import log_record

STARTED = ("joint_state_controller", "joint1_position_controller")
CONTROLLER = "/slider/joint1_position_controller"


@pytest.fixture(scope="module")
def run() -> Iterator[CommandLine]:
    """A slider at its set point's way, at real time."""
    with running_daemon() as runtime:
        slidectl = CommandLine(runtime.folder)
        slidectl.ok("spawn", "slider", "--controllers", "config/slider_control.yaml", "--start", *STARTED)
        slidectl.ok("pub", "command", "0.5")
        yield slidectl


def row(screen: list[str], name: str) -> list[str]:
    """The cells of the row of that name, none where there is no such row."""
    return next((cells for line in screen if (cells := line.split())[:1] == [name]), [])


def state(slidectl: CommandLine) -> str:
    with slidectl.client() as client:
        return client.controllers("/slider").states()["joint1_position_controller"]


def test_it_shows_controllers_joints_rates_and_the_log_in_80_columns_and_24_lines(run: CommandLine) -> None:
    with Terminal(run, "top") as terminal:
        terminal.until(lambda: row(terminal.screen, "/slider/joint_states")[1:2] == ["50.000"])
        screen = terminal.shows("running, real-time factor", "CONTROLLERS", "JOINTS", "TOPICS", "LOG", "answers on")
        assert max(map(len, screen)) <= 80
        assert row(screen, CONTROLLER)[1:3] == ["running", "joint1"]
        assert row(screen, "/slider/joint1")[4] == "0.500"
        terminal.resize(20, 12)
        screen = terminal.shows("JOINTS")
        assert max(map(len, screen)) <= 20
        assert any(re.match(r"\S+ +-?\d", line) for line in screen)
        terminal.resize(60, 6)
        assert terminal.shows("CONTROLLERS")[-1].startswith("? help")
        terminal.press("?")
        terminal.shows("pause the world")
        terminal.press("xq")
        assert terminal.ended() == 0
        assert terminal.is_restored
        assert terminal.output.endswith("\x1b[?1049l")


def test_the_log_has_simulated_times_and_whole_lines(run: CommandLine) -> None:
    text = "/gazebo: /slider/joint1_position_controller/pid: i = 0.01 has no effect without i_clamp"
    with Terminal(run, "top") as terminal:
        terminal.resize(60, 40)
        screen = terminal.shows("i_clamp")
        assert max(map(len, screen)) <= 60
        first = next(number for number, line in enumerate(screen) if "/gazebo:" in line and "warn" in line)
        last = next(number for number, line in enumerate(screen) if line.rstrip().endswith("i_clamp"))
        assert last > first
        time, level, *message = " ".join(screen[first : last + 1]).split()
        assert 0 < float(time) < 60
        assert (level, " ".join(message)) == ("warn", text)
        terminal.press("q")
        assert terminal.ended() == 0
    once = run.ok("top", "--once")
    assert re.search(rf"^[\d.]+ +warn +{re.escape(text)}$", once, re.MULTILINE)
    assert not re.search(r"\d{4}-\d\d-\d\d", once)


def test_its_keys_switch_controllers_pause_and_step_the_world(run: CommandLine) -> None:
    with Terminal(run, "top") as terminal, run.client() as client:
        terminal.shows(CONTROLLER)
        terminal.press("j\r")
        terminal.shows(f"{CONTROLLER}: stopped (was running)")
        assert state(run) == "stopped"
        terminal.press("\r")
        terminal.shows(f"{CONTROLLER}: running (was stopped)")
        assert state(run) == "running"
        terminal.press(" ")
        terminal.shows("s, paused")
        cycles = client.call("/slidectl/status")["cycles"]
        terminal.press("...")
        terminal.until(lambda: client.call("/slidectl/status")["cycles"] == cycles + 3)
        terminal.press(" ")
        terminal.shows("s, running")
        terminal.press("\x03")
        assert terminal.ended() == 130
        assert terminal.is_restored


def test_a_terminal_that_is_closed_ends_it_as_an_interrupt(run: CommandLine) -> None:
    with Terminal(run, "top") as terminal:
        terminal.shows(CONTROLLER)
        terminal.close()
        assert terminal.process.wait(60) == 130


def test_its_rows_are_filtered_and_sorted(run: CommandLine) -> None:
    def topics() -> list[str]:
        screen = terminal.screen
        below = next((index for index, line in enumerate(screen) if line.startswith("TOPICS")), len(screen))
        return [line.split()[0] for line in screen[below:] if line.startswith("/")]

    with Terminal(run, "top", size=(100, 50)) as terminal:
        terminal.shows("/gazebo/link_states", CONTROLLER)
        terminal.press("/gazebo/_\x7flink\r")
        terminal.until(lambda: topics() == ["/gazebo/link_states"])
        terminal.press("/\x1b\t\tsss")
        by_name = terminal.until(lambda: len(found := topics()) > 9 and found == sorted(found) and found)
        terminal.press("r")
        terminal.until(lambda: topics() == by_name[::-1])
        terminal.press("s")  # by rate
        terminal.until(lambda: topics()[:2] == ["/slider/joint1_position_controller/state", "/slider/joint_states"])
        terminal.process.send_signal(signal.SIGTERM)
        assert terminal.ended() == 130
        assert terminal.is_restored


def test_a_daemon_that_goes_away_is_waited_for() -> None:
    with running_daemon() as runtime:
        slidectl = CommandLine(runtime.folder)
        with Terminal(slidectl, "top") as terminal:
            terminal.shows("robots: 0", "CONTROLLERS: none")
            runtime.stop()
            terminal.shows("top waits for a daemon")
            runtime.start()
            slidectl.ok("spawn", "slider")
            terminal.shows("robots: 1", "/slider/joint1 ")
            terminal.press("q")
            assert terminal.ended() == 0


def test_it_waits_for_a_daemon_that_does_not_answer_and_tells_its_end_at_once() -> None:
    with running_daemon() as runtime:
        slidectl = CommandLine(runtime.folder)
        assert runtime.pid
        os.kill(runtime.pid, signal.SIGSTOP)
        with Terminal(slidectl, "top") as terminal:
            terminal.shows("did not answer")
            terminal.press(" ")
            os.kill(runtime.pid, signal.SIGCONT)
            terminal.shows("robots: 0")
        with Terminal(slidectl, "top", "--delay", "1000") as terminal:
            terminal.shows("robots: 0")
            runtime.stop()
            terminal.shows("top waits for a daemon")
            terminal.press("q")
            assert terminal.ended() == 0


def test_rates_of_rare_messages_are_shown_until_they_stay_away() -> None:
    with running_daemon(paused=True) as runtime:
        slidectl = CommandLine(runtime.folder)
        with Terminal(slidectl, "top", "--delay", "0.1") as terminal, slidectl.client() as client:
            client.advertise("/rare", "std_msgs/Float64")

            def step() -> None:
                client.call("/slidectl/step", {"cycles": 8000})

            def publish() -> None:
                step()
                client.deliver("/rare", {"data": 1.0})

            terminal.until(lambda: row(terminal.screen, "/rare")[1:2] == ["0.125"], publish)
            terminal.until(lambda: row(terminal.screen, "/rare")[1:2] == ["0.000"], step)


def test_without_a_terminal_it_is_printed_once(run: CommandLine) -> None:
    text = run.ok("top", "--delay", "1")
    assert "\x1b" not in text
    screen = text.splitlines()
    assert row(screen, CONTROLLER) == [CONTROLLER, "running", "joint1", "effort_controllers/JointPositionController"]
    assert row(screen, "/slider/joint_states") == ["/slider/joint_states", "50.000", "sensor_msgs/JointState"]
    run.ok("pub", "command", "0.5")
    data = json.loads(run.ok("top", "/slider/joint1", "--json"))
    assert [joint["name"] for joint in data["joints"]] == ["/slider/joint1"]
    assert data["joints"][0]["set_point"] == 0.5
    assert data["status"]["robots"] == ["slider"]
    assert all("/slider/joint1" in topic["topic"] for topic in data["topics"])


def test_without_a_daemon_it_says_so(slidectl: CommandLine) -> None:
    with Terminal(slidectl, "top") as terminal:
        assert terminal.ended() == 3
        assert "daemon start" in terminal.output


def test_an_address_in_brackets_is_not_a_time() -> None:
    record = log_record("2026-01-02 03:04:05.678 warn  [127.0.0.1] refused")
    assert (record["time"], record["level"], record["message"]) == (None, "warn", "[127.0.0.1] refused")
