"""`slidectl check`: report how slidectl uses each entry of a file, without a daemon.

`slidectl.check` produces the findings; this module prints them.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

import click

from slidectl import input_files
from slidectl.cli import completion, output
from slidectl.cli.commands import command
from slidectl.cli.context import Context
from slidectl.cli.spawn import package_lookup, pairs, parameter_text, report_own_packages
from slidectl.client import spawning
from slidectl.errors import EXIT_REFUSED, Refused

if TYPE_CHECKING:
    from slidectl.check import Findings
    from slidectl.description import Notice
    from slidectl.description.robot import Verdict

_COLUMNS = ("file", "line", "verdict", "subject", "text")
_VERDICTS: tuple[Verdict, ...] = ("used", "converted", "ignored", "wrong")
_COLOURS = {"used": "green", "converted": "cyan", "ignored": "yellow", "wrong": "red"}


@command(
    examples=[
        "slidectl check slider --controllers config/slider_control.yaml",
        "slidectl check robot.urdf.xacro width:=0.2 --strict",
        "slidectl check my_slider slider.launch",
        "slidectl check rrbot_description rrbot.xacro",
        "slidectl check config/slider_control.yaml --only ignored --only wrong",
        "slidectl check my_control.yaml --import my_laws.py",
    ]
)
@click.argument("source", metavar="MODEL|LAUNCH|CONTROLLERS", shell_complete=completion.models)
@click.argument("arguments", nargs=-1, metavar="[KEY:=VALUE]...")
@completion.file_option("--controllers", multiple=True, help="Controllers of the model; may repeat.")
@click.option(
    "--transmissions", type=click.Choice(["gazebo", "real"]), help="As for spawn: how transmissions of the model count."
)
@click.option("--import", "imports", multiple=True, metavar="MODULE", shell_complete=completion.files,
              help="Use the controllers and hardware in this module or FILE.py; may repeat.")  # fmt: skip
@click.option("--strict", is_flag=True, help="Also exit 1 when anything is ignored, and refuse what spawn corrects.")
@click.option("--only", multiple=True, type=click.Choice(_VERDICTS), help="Print findings of this kind; may repeat.")
@click.option("--keep-going", is_flag=True, help="Leave out missing parts, as launch and spawn do.")
@click.option("--second-opinion", is_flag=True, help="Also compare models with yourdfpy; takes half a second more.")
@click.option("--package", "packages", multiple=True, metavar="NAME=PATH", help="Where a ROS package is; may repeat.")
@click.pass_context
def check(
    click_context: click.Context,
    source: str,
    arguments: tuple[str, ...],
    controllers: tuple[str, ...],
    transmissions: str | None,
    imports: tuple[str, ...],
    strict: bool,
    only: tuple[str, ...],
    keep_going: bool,
    second_opinion: bool,
    packages: tuple[str, ...],
) -> None:
    """Check a model, a launch file or controllers, without a daemon.

    MODEL and LAUNCH are as for spawn and launch: a file, the name of a shipped one, PACKAGE FILE, or - for standard
    input. KEY:=VALUE are their arguments. Every tag, attribute, limit and parameter is listed with file and line as
    used, converted (used in a changed form), ignored (no effect here) or wrong. Exits 0 when nothing is wrong, 1 when
    something is, and 2 when a file cannot be used at all. --keep-going leaves out missing parts and lists them at the
    end; the exit code is then 1 only when nothing is left to drive. --import runs the code of the module, but no
    controller. JSON keys: file, line, verdict, subject, text.
    """
    ctx: Context = click_context.obj
    from slidectl.check.dispatch import check as run
    from slidectl.cli.daemon import module_or_file
    from slidectl.description.missing import Missing

    places = package_lookup(packages, "check")
    files = [spawning.find(file) for file in controllers]
    text = _streamed(source)
    if source.endswith((".yaml", ".yml")):
        source = str(spawning.find(source))  # may be the name of a shipped controllers file
    words = ["<stdin>" if source == "-" else source]
    words += [word for word in arguments if ":=" not in word]
    given = pairs([word for word in arguments if ":=" in word], ":=", "check")
    missing = Missing("all" if keep_going else "nothing")
    modules = [module_or_file(module) for module in imports]
    findings = run(
        words, given, places, files, text, second_opinion=second_opinion, strict=strict, missing=missing,
        transmissions=transmissions, imports=modules,
    )  # fmt: skip
    report_own_packages(ctx, places)
    _print(ctx, findings, only)
    if lines := missing.lines():
        ctx.say("\n".join(["left out:", *lines]))
    if keep_going and missing:
        if not findings.is_drivable:
            raise Refused("nothing is left to drive")
        return
    missing.refuse()
    for error in findings.broken[:1]:
        raise error
    if findings.count("wrong") or (strict and findings.count("ignored")):
        click_context.exit(EXIT_REFUSED)


def _streamed(source: str) -> bytes | None:
    """The content of standard input or of a pipe (`<(xacro robot.xacro)`), which can be read only once; else None."""
    if source == "-":
        from slidectl.description.xml_tree import is_utf8

        found = input_files.read_stdin()
        return parameter_text(found.decode()).encode() if is_utf8(found) else found
    if not input_files.is_output(source):
        return None
    return input_files.read_bytes(source, input_files.MOST_TEXT, pipes=True)


def _print(ctx: Context, findings: Findings, only: Sequence[str]) -> None:
    notices = findings.sorted(only)
    if ctx.format != "text":
        ctx.emit_rows([{key: getattr(notice, key) for key in _COLUMNS} for notice in notices], _COLUMNS)
        return
    groups: dict[str, list[Notice]] = {}
    for notice in notices:
        groups.setdefault(notice.file, []).append(notice)
    counts = ", ".join(f"{findings.count(verdict)} {verdict}" for verdict in _VERDICTS)
    output.write("\n\n".join([*("\n".join(_lines(group)) for group in groups.values()), counts]))


def _lines(notices: Sequence[Notice]) -> list[str]:
    """`file:line  verdict  subject: text`, in columns."""
    width = max(len(notice.where) for notice in notices)
    colours = _COLOURS if output.wants_colour(sys.stdout) else {}
    verdicts = {
        verdict: click.style(f"{verdict:<9}", fg=colours.get(verdict), reset=bool(colours)) for verdict in _VERDICTS
    }
    return [f"{n.where:<{width}}  {verdicts[n.verdict]}  {n.subject}: {n.text}" for n in notices]
