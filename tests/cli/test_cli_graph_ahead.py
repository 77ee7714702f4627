"""`slidectl echo` begins to listen before its parser is loaded, and nobody can tell but by the time it takes."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from command_line import ROOT, CommandLine
from fake_daemon import DIE, NEVER, FakeDaemon

from slidectl.cli import ahead


@contextmanager
def running(slidectl: CommandLine, *words: str) -> Iterator[subprocess.Popen[str]]:
    """The command while it runs; it is ended if it does not end by itself."""
    process = slidectl.start(*words)
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


@pytest.mark.parametrize(
    ("line", "target"),
    [
        ("echo joint_states", "joint_states"),
        ("echo joint_states/position[0] -n 1", "joint_states/position[0]"),
        ("echo -n 12 --json /clock", "/clock"),
        ("echo", None),
        ("echo -n 1", None),
        ("echo joint_states -n", None),
        ("echo joint_states -n one", None),
        ("echo joint_states -n 1 -n 2", None),
        ("echo joint_states --ns /slider", None),
        ("echo joint_states -i other", None),
        ("echo joint_states --timeout 1", None),
        ("echo joint_states -p", None),
        ("echo joint_states --for 1", None),
        ("echo joint_states --help", None),
        ("echo a b", None),
        ("pub command", None),
    ],
)
def test_only_the_plainest_lines_begin_early(line: str, target: str | None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("SLIDECTL_NAMESPACE", raising=False)
    assert ahead._target(line.split()) == target


def test_it_listens_before_click_is_imported(world: CommandLine) -> None:
    code = """
import sys
from slidectl.cli import ahead
context = ahead.begin(["echo", "clock", "-n", "1"])
assert "click" not in sys.modules
assert context.call("/rosapi/subscribers", {"topic": "/clock"})["subscribers"]
from slidectl.cli.main import run
context.call("/slidectl/step", {"cycles": 10})
sys.exit(run(["echo", "clock", "-n", "1", "--json"], context))
"""
    environment = world.environment
    with world.client() as stepper, stepper.subscribe("/clock") as clock:
        done = subprocess.run([sys.executable, "-c", code], env=environment, cwd=ROOT, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        stepper.flush()
        assert json.loads(done.stdout) == clock.get()


def test_what_was_published_before_the_command_is_not_shown(world: CommandLine) -> None:
    with world.client() as writer:
        writer.advertise("/numbers", "std_msgs/Int32")
        writer.deliver("/numbers", {"data": 1})
        with running(world, "echo", "numbers", "-n", "1", "--json") as process:
            while len(writer.call("/rosapi/subscribers", {"topic": "/numbers"})["subscribers"]) == 0:
                pass
            writer.deliver("/numbers", {"data": 2})
            assert process.communicate(timeout=30)[0] == '{"data": 2}\n'
        assert writer.call("/rosapi/subscribers", {"topic": "/numbers"})["subscribers"] == []


def test_it_listens_once(world: CommandLine) -> None:
    with world.client() as writer:
        writer.advertise("/numbers", "std_msgs/Int32")
        writer.flush()
        with running(world, "echo", "numbers", "-n", "2", "--json") as process:
            while len(writer.call("/rosapi/subscribers", {"topic": "/numbers"})["subscribers"]) == 0:
                pass
            writer.deliver("/numbers", {"data": 1})
            assert process.stdout is not None
            assert process.stdout.readline() == '{"data": 1}\n'
            assert len(writer.call("/rosapi/subscribers", {"topic": "/numbers"})["subscribers"]) == 1
            writer.deliver("/numbers", {"data": 2})
            assert process.communicate(timeout=30)[0] == '{"data": 2}\n'


@pytest.mark.parametrize("line", ["no_such_topic", "clock/no_field", "clock[0]", "//"])
def test_errors_are_the_commands_own(world: CommandLine, line: str) -> None:
    early, late = world("echo", line), world("echo", line, "--timeout", "9")
    assert (early.returncode, early.stdout, early.stderr) == (late.returncode, late.stdout, late.stderr)
    assert early.stderr.count("error:") == 1


def test_without_a_daemon_it_is_told_once(slidectl: CommandLine) -> None:
    done = slidectl("echo", "clock")
    assert done.returncode == 3
    assert done.stderr.count("no daemon answers") == 1


@pytest.mark.parametrize("answer", [DIE, {"topics": 1, "types": None}, {}])
def test_a_daemon_that_misbehaves_early_is_met_again_by_the_command(
    slidectl: CommandLine, fake: FakeDaemon, answer: dict[str, object]
) -> None:
    fake.answers["/rosapi/topics"] = answer
    done = slidectl("echo", "clock", "-n", "1")
    assert done.returncode != 0
    assert "Traceback" not in done.stderr
    assert done.stderr.count("error:") == 1
    assert len(fake.calls("/rosapi/topics")) == 2


def test_a_daemon_that_is_slow_gets_its_time(slidectl: CommandLine, fake: FakeDaemon) -> None:
    fake.answers["/rosapi/topics"] = NEVER
    with running(slidectl, "echo", "clock", "-n", "1") as process:
        fake.asked.wait(30)
        while len(fake.calls("/rosapi/topics")) < 2:
            assert process.poll() is None
