"""Writes docs/commands.md and the man page from the help texts of the commands. `--check` only compares.

python scripts/command_reference.py [--check]
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import click

from slidectl.cli.context import Context
from slidectl.cli.main import root

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs" / "commands.md"
MAN_PAGE = ROOT / "docs" / "man" / "slidectl.1"
WIDTH = 100

HEAD = """# Commands

Every command with its `--help`, written by `python scripts/command_reference.py`.

Every command takes the common options too, before its name or after it:

```text
@COMMON@
```

| exit code | meaning |
| ---: | --- |
| 0 | done |
| 1 | refused or failed: the service said no, the condition is false, the name does not exist |
| 2 | wrong usage, an ambiguous name, or a bad file |
| 3 | no daemon answers |
| 4 | timed out |
| 130 | interrupted |

Results go to stdout, all else to stderr. With `--json` an error is one object, the last line of stderr, with the keys
`error` (what failed), `hint` (what to do next, or null) and `exit_code`; warnings before it stay text. A reader that
closes the pipe ends a command quietly. A file that a command makes is there whole, or nothing new is, also on a full
disk and at Ctrl-C; recordings and journals keep what came before.

Files that are read are regular files, or links to these; a folder, a named pipe, a device or a socket is refused at
once (2), by commands and by the daemon, and so is what is larger than the bound of its kind: 16 MiB for models, launch
files, scenarios and code of your own (2 MiB for YAML of controllers and scenarios), 64 MiB for values, trajectories
and meshes as text, 128 MiB for binary meshes, 256 MiB for tables and snapshots, 1 GiB for journals. Recordings and
scripts have none. The output of a command, `<(COMMAND)` in bash and zsh, is a file to commands that read a text whole,
and `-` is standard input where a command says so; to the daemon and to recordings neither is.
"""


MAN_HEAD = r""".TH SLIDECTL 1
.SH NAME
slidectl \- run the ros_control and Gazebo tutorials without ROS and without Gazebo
.SH SYNOPSIS
.B slidectl
[common options] COMMAND [options] [arguments]
.SH DESCRIPTION
A daemon holds a simulated world and its controller managers, and listens on a local socket. Every command but those
that only read files talks to it. Start with
.B slidectl daemon start
and
.BR "slidectl spawn slider" .
.SH COMMON OPTIONS
.nf
@COMMON@
.fi
.SH EXIT STATUS
.nf
0    done
1    refused or failed: the service said no, the condition is false, the name does not exist
2    wrong usage, an ambiguous name, or a bad file
3    no daemon answers
4    timed out
130  interrupted
.fi
.SH FILES
.TP
.I $XDG_RUNTIME_DIR/slidectl/NAME/
Socket, lock and log of the instance NAME.
.SH COMMANDS
"""


def commands() -> Iterator[tuple[str, str]]:
    """Full name and help text of every command, without the common options; groups before their members."""
    for name, text in _helps():
        yield name, _parted(text)[0]


def common_options() -> str:
    """The common options as a help text lists them."""
    return _parted(next(text for _, text in _helps()))[1]


def _parted(text: str) -> tuple[str, str]:
    """A help text without its section of common options, and the lines of that section."""
    before, _, rest = text.partition("Common options:\n")
    section, _, after = rest.partition("\n\n")
    return (before + after).rstrip(), section.rstrip()


def _helps() -> Iterator[tuple[str, str]]:
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
    return HEAD.replace("@COMMON@", common_options()) + "\n" + "\n".join(blocks)


def man_page() -> str:
    """All commands as one page for man(1)."""
    blocks = [f".SS {name}\n.nf\n{_troff(text)}\n.fi\n" for name, text in commands()]
    return MAN_HEAD.replace("@COMMON@", _troff(common_options())) + "".join(blocks)


def _troff(text: str) -> str:
    """Text as it is: no line is a request, a backslash is one, and a hyphen can be copied."""
    lines = (line.rstrip().replace("\\", "\\e").replace("-", "\\-") for line in text.splitlines())
    return "\n".join(f"\\&{line}" if line.startswith((".", "'")) else line for line in lines)


def main(arguments: list[str]) -> int:
    """Write the pages, or with `--check` exit 1 when they are not what they should be."""
    texts = {PAGE: page(), MAN_PAGE: man_page()}
    if "--check" in arguments:
        behind = [p for p, text in texts.items() if not p.exists() or p.read_text(encoding="utf-8") != text]
        for path in behind:
            print(f"{path.relative_to(ROOT)} is behind; run: python scripts/command_reference.py", file=sys.stderr)
        return 1 if behind else 0
    for path, text in texts.items():
        path.parent.mkdir(exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
