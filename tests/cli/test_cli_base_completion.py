"""Completion as a shell asks for it, with and without a daemon."""

from __future__ import annotations

import shutil
import subprocess

import pytest
from command_line import CommandLine
from fake_daemon import NEVER, FakeDaemon
from waiting import eventually

from slidectl.cli.completion import fitting


def complete(slidectl: CommandLine, *words: str) -> list[str]:
    """What fish is offered for the last of the words."""
    line = " ".join(["slidectl", *words])
    asked = {"_SLIDECTL_COMPLETE": "fish_complete", "COMP_WORDS": line, "COMP_CWORD": words[-1]}
    done = slidectl(**asked)
    assert (done.returncode, done.stderr) == (0, "")
    values = [value.split("\t")[0].partition(",")[2] for value in done.stdout.splitlines()]
    return [value for value in values if value]


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_script_of_a_shell_is_valid_for_it(slidectl: CommandLine, shell: str) -> None:
    script = slidectl.ok("completion", shell)
    assert "_SLIDECTL_COMPLETE" in script
    program = shutil.which(shell)
    if program:
        subprocess.run([program, "-n"], input=script, text=True, check=True, timeout=30)


def test_another_shell_is_wrong_usage(slidectl: CommandLine) -> None:
    assert slidectl("completion", "csh").returncode == 2


def test_commands_verbs_and_options_are_completed(slidectl: CommandLine) -> None:
    assert complete(slidectl, "con") == ["controller"]
    assert complete(slidectl, "controller", "sp") == ["spawn"]
    assert "--strict" in complete(slidectl, "controller", "switch", "--s")
    assert "--json" in complete(slidectl, "robots", "--j")


def test_without_a_daemon_there_are_no_names_and_no_words(slidectl: CommandLine) -> None:
    assert complete(slidectl, "delete", "sl") == []
    assert complete(slidectl, "controller", "start", "jo") == []


def test_a_daemon_that_does_not_answer_costs_a_tenth_of_a_second_and_no_words(
    slidectl: CommandLine, fake: FakeDaemon
) -> None:
    fake.answers["/slidectl/list_robots"] = NEVER
    assert complete(slidectl, "delete", "sl") == []


def test_names_come_from_the_daemon(world: CommandLine) -> None:
    world.ok("spawn", "slider", "--controllers", "config/slider_control.yaml")
    for words, names in (
        (("delete", "sl"), ["slider"]),
        (("robots", "s"), ["slider"]),
        (("controller", "load", "joint"), ["joint1_position_controller", "joint_state_controller"]),
        (("controller", "switch", "--start", "joint1"), ["joint1_position_controller"]),
        (("controller", "list", "--cm", "/sl"), ["/slider"]),
        (("wait", "/clo"), ["/clock"]),
        (("wait", "clo"), ["clock"]),
    ):  # a shell does not wait for a daemon that takes long, and shows nothing then
        eventually(lambda words=words, names=names: complete(world, *words) == names, f"{words} is not completed")


def test_shipped_models_are_completed(slidectl: CommandLine) -> None:
    assert complete(slidectl, "spawn", "rr") == ["rrbot"]


def test_a_relative_name_is_held_against_the_ends_of_full_names() -> None:
    names = ["/left/joint_states", "/left/c/command", "/clock"]
    assert fitting(names, "") == sorted(names)
    assert fitting(names, "/left") == ["/left/c/command", "/left/joint_states"]
    assert fitting(names, "joint") == ["joint_states"]
    assert fitting(names, "c") == ["c/command", "clock", "command"]


def test_fields_are_completed_behind_the_name_of_a_topic(world: CommandLine) -> None:
    assert complete(world, "echo", "/clock/c") == ["/clock/clock"]
    assert complete(world, "echo", "/clock/clock/s") == ["/clock/clock/secs"]
    assert complete(world, "wait", "model_states/po") == ["model_states/pose", "model_states/pose[0]"]
    assert complete(world, "assert", "model_states/pose[0]/pos") == ["model_states/pose[0]/position"]
    assert complete(world, "echo", "model_states/nothing") == []
