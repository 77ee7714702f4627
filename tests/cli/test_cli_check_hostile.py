"""`slidectl check` of files that mean harm: they run nothing, and the command ends with one line about why."""

from __future__ import annotations

from pathlib import Path
from xml.sax.saxutils import quoteattr

import pytest
from command_line import CommandLine

SHELL = "[c for c in ().__class__.__base__.__subclasses__() if c.__name__ == '_wrap_close'][0].__init__.__globals__"
FRAME = "(i for i in [1]).gi_frame.f_back.f_builtins['open']('pwned', 'w')"


@pytest.mark.parametrize(
    "expression",
    [
        f"${{[{SHELL}['system']('touch pwned') for i in [0]]}}",
        f"${{{FRAME}}}",
        f"${{(lambda: {FRAME})()}}",
        "$(eval [open('pwned', 'w') for i in [0]])",
        "${[x for x in [0] * 10**10]}",
        "${'a' * 10**10}",
    ],
)
@pytest.mark.parametrize("wrapped", [False, True], ids=["model", "param command"])
def test_a_model_runs_no_code_and_comes_to_an_end(
    slidectl: CommandLine, tmp_path: Path, expression: str, wrapped: bool
) -> None:
    head = '<robot name="bot" xmlns:xacro="http://www.ros.org/wiki/xacro">'
    model = tmp_path / "bot.xacro"
    model.write_text(
        f'{head}\n<xacro:property name="a" value={quoteattr(expression)}/>\n<link name="l${{a}}"/></robot>'
    )
    launch = tmp_path / "bot.launch"
    launch.write_text(f'<launch><param name="robot_description" command="xacro {model}"/></launch>')
    done = slidectl("check", "bot.launch" if wrapped else "bot.xacro", cwd=tmp_path)
    assert done.returncode == 2, done.stdout + done.stderr
    assert "bot.xacro:3: " in done.stderr
    assert done.stderr.count("\n") == 1, done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "pwned").exists()
