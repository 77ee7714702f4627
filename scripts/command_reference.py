"""Writes docs/commands.md from the help texts of the commands themselves. `--check` only compares.

python scripts/command_reference.py [--check]
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import click

from slidectl.cli.context import Context
from slidectl.cli.main import root

PAGE = Path(__file__).parent.parent / "docs" / "commands.md"
WIDTH = 100

HEAD = """# Commands

Every command with its `--help`, written by `python scripts/command_reference.py`.

The options `-i`, `--socket`, `--ns`, `-o`, `--json`, `-q`, `-v` and `--timeout` are understood before the command
and after it.

| exit code | meaning |
| ---: | --- |
| 0 | done |
| 1 | refused or failed: the service said no, the condition is false, the name does not exist |
| 2 | wrong usage, an ambiguous name, or a bad file |
| 3 | no daemon answers |
| 4 | timed out |
| 130 | interrupted |

Results go to stdout, all else to stderr. With `--json` an error is one object, the last line of stderr, with the keys `error` (what
failed), `hint` (what to do next, or null) and `exit_code`; warnings before it stay text. A reader that closes the pipe ends a command quietly.
"""


def commands() -> Iterator[tuple[str, str]]:
    """Full name and help text of every command, groups before their members."""
    context = click.Context(root, info_name="slidectl", obj=Context(), terminal_width=WIDTH, max_content_width=WIDTH)
    yield "slidectl", root.get_help(context)
    yield from _below(root, context)


def _below(group: click.Group, context: click.Context) -> Iterator[tuple[str, str]]:
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        assert command is not None
        inner = click.Context(command, info_name=name, parent=context, terminal_width=WIDTH, max_content_width=WIDTH)
        yield inner.command_path, command.get_help(inner)
        if isinstance(command, click.Group):
            yield from _below(command, inner)


def page() -> str:
    """The whole page."""
    blocks = []
    for name, text in commands():
        lines = "\n".join(line.rstrip() for line in text.splitlines())
        blocks.append(f"{'##' if name.count(' ') <= 1 else '###'} {name}\n\n```text\n{lines}\n```\n")
    return HEAD + "\n" + "\n".join(blocks)


def main(arguments: list[str]) -> int:
    """Write the page, or with `--check` exit 1 when it is not what it should be."""
    text = page()
    if "--check" in arguments:
        same = PAGE.exists() and PAGE.read_text(encoding="utf-8") == text
        if not same:
            print("docs/commands.md is behind; run: python scripts/command_reference.py", file=sys.stderr)
        return 0 if same else 1
    PAGE.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
