"""Writes docs/commands.md and the man pages from the help texts of the commands. `--check` only compares.

python scripts/command_reference.py [--check]
"""

from __future__ import annotations

import inspect
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import click

from slidectl.cli.command_table import COMMANDS
from slidectl.cli.commands import common_options as options_of_all
from slidectl.cli.context import Context
from slidectl.cli.main import root

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs" / "commands.md"
MAN_PAGES = ROOT / "docs" / "man"
WIDTH = 100

HEAD = """# Commands

<!-- python scripts/command_reference.py writes this page. -->

This page has the `--help` of every command.

Every command also has the common options, before or after its name:

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

Results go to stdout, everything else to stderr. With `--json` an error is one object, the last line of stderr, with the
keys `error` (what failed), `hint` (what to do next, or null) and `exit_code`; warnings before it stay text. A command
ends quietly when the reader closes the pipe. Commands write their files completely or not at all, also on a full disk
and at Ctrl-C; recordings and journals keep everything before the interruption.

Commands and the daemon read only regular files and links to them. They refuse a folder, a named pipe, a device or a
socket at once (2), and also a file that is too large:

| files | largest size |
| --- | --- |
| YAML of controllers and scenarios | 2 MiB |
| models, launch files, and code of your own | 16 MiB |
| values, trajectories and meshes as text | 64 MiB |
| binary meshes | 128 MiB |
| tables and snapshots | 256 MiB |
| journals | 1 GiB |
| recordings and scripts | not limited |

Commands that read a text whole also accept the output of a command, `<(COMMAND)` in bash and zsh, and `-` for standard
input where their help says so. The daemon and recordings accept neither.
"""


MAN_HEAD = r""".TH SLIDECTL 1
.nh
.ad l
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
Each command has a page of its own:
.BR slidectl\-spawn (1)
has
.BR "slidectl spawn" .
.SH COMMANDS
@COMMANDS@
.SH COMMON OPTIONS
They stand before the name of the command or after it.
@COMMON@
.SH EXIT STATUS
.nf
0    done
1    refused or failed: the service said no, the condition is false, the name does not exist
2    wrong usage, an ambiguous name, or a bad file
3    no daemon answers
4    timed out
130  interrupted
.fi
.SH ENVIRONMENT
.TP
.B SLIDECTL_INSTANCE, SLIDECTL_SOCKET
As \-\-instance and \-\-socket.
.TP
.B SLIDECTL_NAMESPACE
As \-\-ns.
.TP
.B NO_COLOR
No colours.
.SH FILES
.TP
.I $XDG_RUNTIME_DIR/slidectl/NAME/
Socket, lock and log of the instance NAME.
"""
MAN_END = r""".SH SEE ALSO
.BR slidectl (1)
has the common options and the exit codes.
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
    context = _root_context()
    yield "slidectl", root.get_help(context)
    yield from _below(root, context)


def _root_context() -> click.Context:
    return click.Context(root, info_name="slidectl", obj=Context(), terminal_width=WIDTH, max_content_width=WIDTH)


def _inside(group: click.Group, name: str, context: click.Context) -> click.Context:
    """The context of a command of the group."""
    command = group.get_command(context, name)
    assert command is not None
    return click.Context(command, info_name=name, parent=context, terminal_width=WIDTH, max_content_width=WIDTH)


def _below(group: click.Group, context: click.Context) -> Iterator[tuple[str, str]]:
    for name in group.list_commands(context):
        inner = _inside(group, name, context)
        yield inner.command_path, inner.get_help()
        if isinstance(inner.command, click.Group):
            yield from _below(inner.command, inner)


def page() -> str:
    """The whole page."""
    blocks = []
    for name, text in commands():
        lines = "\n".join(line.rstrip() for line in text.splitlines())
        blocks.append(f"{'##' if name.count(' ') <= 1 else '###'} {name}\n\n```text\n{lines}\n```\n")
    return HEAD.replace("@COMMON@", common_options()) + "\n" + "\n".join(blocks)


def man_pages() -> Iterator[tuple[str, str]]:
    """The names of all pages for man(1) and their texts: one of the program, and one of each command."""
    context = _root_context()
    rows, pages = [], []
    for name in root.list_commands(context):
        inner = _inside(root, name, context)
        summary = _troff(COMMANDS[name].help.removesuffix("."))
        rows.append(f".TP\n.BR slidectl\\-{name} (1)\n{summary}")
        head = f".TH SLIDECTL\\-{name.upper()} 1\n.nh\n.ad l\n.SH NAME\nslidectl\\-{name} \\- {summary}\n"
        pages.append((f"slidectl-{name}", head + "".join(_man_sections(inner, ".SH")) + MAN_END))
    common = _man_options(options_of_all(), context)
    yield "slidectl", MAN_HEAD.replace("@COMMANDS@", "\n".join(rows)).replace("@COMMON@", common)
    yield from pages


def _man_sections(context: click.Context, heading: str) -> Iterator[str]:
    """What a page says of a command. The verbs of a group are sections of their own."""
    command = context.command
    usage = command.get_usage(context).partition(": ")[2].replace(context.command_path, "", 1)
    synopsis = f".B {_troff(context.command_path)}\n{_troff(' '.join(usage.split()))}\n"
    options = [p for p in command.params if isinstance(p, click.Option) and p.get_help_record(context)]
    parts = [("SYNOPSIS", synopsis), ("DESCRIPTION", _man_text(command.help or ""))]
    if options:
        parts.append(("OPTIONS", _man_options(options, context) + "\n"))
    if examples := getattr(command, "examples", ()):
        parts.append(("EXAMPLES", f".nf\n{_troff(chr(10).join(examples))}\n.fi\n"))
    if heading == ".SH":
        yield from (f".SH {title}\n{text}" for title, text in parts)
    else:  # a verb: its own heading, and no more of them
        yield f".SS {_troff(context.command_path)}\n{synopsis}.PP\n{parts[1][1]}"
        for _, text in parts[2:]:
            yield f".PP\n{text}"
    if isinstance(command, click.Group):
        yield ".SH COMMANDS\n"
        for name in command.list_commands(context):
            yield from _man_sections(_inside(command, name, context), ".SS")


def _man_text(text: str) -> str:
    """A help text, in paragraphs; one that begins with \\b stands line by line."""
    blocks = [block for block in inspect.cleandoc(text).split("\n\n") if block.strip()]
    shown = []
    for block in blocks:
        mark, _, rest = block.partition("\n")
        shown.append(f".nf\n{_troff(rest)}\n.fi\n" if mark.strip() == "\b" else f"{_troff(block)}\n")
    return ".PP\n".join(shown)


def _man_options(options: Sequence[click.Option], context: click.Context) -> str:
    records = [record for option in options if (record := option.get_help_record(context))]
    return "\n".join(f".TP\n.B {_troff(flags)}\n{_troff(text)}" for flags, text in records)


_TROFF = {"\\": "\\e", "-": "\\-", "'": "\\(aq", "^": "\\(ha", "~": "\\(ti", "`": "\\(ga", '"': "\\(dq"}


def _troff(text: str) -> str:
    """Text as it is: no line is a request, and every sign can be copied and typed."""
    lines = []
    for line in text.splitlines():
        signs = (_TROFF.get(sign, sign if sign.isascii() else f"\\[u{ord(sign):04X}]") for sign in line.rstrip())
        shown = "".join(signs)
        lines.append(f"\\&{shown}" if shown.startswith(".") else shown)
    return "\n".join(lines)


def main(arguments: list[str]) -> int:
    """Write the pages, or with `--check` exit 1 when they are not what they should be."""
    texts = {PAGE: page()} | {MAN_PAGES / f"{name}.1": text for name, text in man_pages()}
    surplus = set(MAN_PAGES.glob("*.1")) - set(texts)
    if "--check" in arguments:
        behind = [p for p, text in texts.items() if not p.exists() or p.read_text(encoding="utf-8") != text]
        behind += sorted(surplus)
        for path in behind:
            print(f"{path.relative_to(ROOT)} is behind; run: python scripts/command_reference.py", file=sys.stderr)
        return 1 if behind else 0
    for path in surplus:
        path.unlink()
    for path, text in texts.items():
        path.parent.mkdir(exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
