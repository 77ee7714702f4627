"""`slidectl test`: run scenarios, and print their results.

`slidectl.extensions.scenarios` reads, checks and runs them.
"""

from __future__ import annotations

import gc
import os
import textwrap
from collections import Counter
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import click

from slidectl.cli import completion, output
from slidectl.cli.commands import command, positive_seconds, simulated_seconds
from slidectl.cli.context import Context
from slidectl.errors import EXIT_INTERRUPTED, EXIT_REFUSED, BadFile, Refused, UsageError, listing
from slidectl.operating_system import usable_cores
from slidectl.paths import install_command
from slidectl.writing import check_writable

if TYPE_CHECKING:
    from slidectl.extensions.scenarios.case_run import CaseResult
    from slidectl.extensions.scenarios.commands.test_run import CaseRunner
    from slidectl.extensions.scenarios.scenario_file import Case
    from slidectl.extensions.scenarios.step_commands import Commands

_VERDICTS = ("passed", "xfailed", "failed", "error", "xpassed")
"""In the order of the last output line."""


@command(
    step=None,
    examples=[
        "slidectl test scenarios/",
        "slidectl test scenarios/slide.yaml --junitxml out.xml",
        "slidectl test scenarios/ -k 'slider and not slow' --tag nightly -n 2 --maxfail 1",
        "slidectl test scenarios/slide.yaml::far --keep-failed failed/",
        "slidectl test scenarios/ --check",
    ],
)
@click.argument("paths", nargs=-1, metavar="FILE|FOLDER|FILE::CASE...", shell_complete=completion.files)
@click.option("-n", "--workers", type=click.IntRange(min=1), metavar="N",
              help="Number of cases that run at the same time (default: one per core).")  # fmt: skip
@click.option("-k", "--keyword", metavar="EXPR", help="Only cases whose names match; and, or, not, ( ).")
@click.option("--tag", "tags", multiple=True, metavar="TAG", help="Only cases with this tag; may repeat.")
@click.option("--maxfail", type=click.IntRange(min=1), metavar="N", help="Stop after this number of failures.")
@click.option("--timeout", type=float, default=60.0, callback=positive_seconds, metavar="S",
              help="Wall seconds that a case may take (60).")  # fmt: skip
@click.option("--sim-timeout", type=float, default=600.0, callback=simulated_seconds, metavar="S",
              help="Simulated seconds that a case may take (600).")  # fmt: skip
@click.option("--list", "only_list", is_flag=True, help="List the cases, and run nothing.")
@click.option("--check", "only_check", is_flag=True, help="Check the files, and run nothing.")
@click.option(
    "--junitxml", metavar="FILE", shell_complete=completion.files, help="Also write the results as JUnit XML."
)
@click.option(
    "--keep-failed", metavar="FOLDER", help="Keep a recording and a journal of each case that fails, in this folder."
)
@click.option("--baseline", metavar="FOLDER", help="Compare each case that passes with an earlier run, kept there.")
@click.option("--update-baseline", is_flag=True, help="Make the runs the baselines that differ or are missing.")
@click.option(
    "--daemon", "live", is_flag=True, help="Run one case at a time in the daemon of -i, which must have no robots."
)
@click.option("--schema", is_flag=True, help="Print the JSON schema of scenarios.")
@click.pass_context
def test(
    click_context: click.Context,
    paths: tuple[str, ...],
    workers: int | None,
    keyword: str | None,
    tags: tuple[str, ...],
    maxfail: int | None,
    timeout: float,
    sim_timeout: float,
    only_list: bool,
    only_check: bool,
    junitxml: str | None,
    keep_failed: str | None,
    baseline: str | None,
    update_baseline: bool,
    live: bool,
    schema: bool,
) -> None:
    """Run scenarios: files of steps that a robot must pass.

    Each case runs in a process and a world of its own, without a daemon, as fast as possible, and gives the same bits
    in every run. All files are checked before the first case. A folder means all .yaml and .yml files below it. Exits 0
    if all cases passed or failed as known (xfail), 1 after a failure, and 2 if a file is wrong or no case was chosen.
    Ctrl-C ends the running cases, with their teardowns, and reports the results so far (130). JSON keys: id, verdict,
    sim_time, wall_time, steps, step, section, line, message, hint, detail, failed_at, log, kept, baseline, was_ended.
    """
    ctx: Context = click_context.obj
    gc.disable()  # little is freed, and the search for it would take a tenth of the time of a short scenario
    click_context.call_on_close(gc.enable)
    from slidectl.extensions.scenarios.commands.step_runner import StepRunner

    commands = StepRunner(live)
    if schema:
        from slidectl.extensions.scenarios.scenario_file import schema_text

        output.write(schema_text(commands))
        return
    if not paths:
        raise UsageError("name the scenarios", "slidectl test FILE or FOLDER")
    if update_baseline and baseline is None:
        raise UsageError("--update-baseline needs the folder", "--baseline FOLDER")
    read, known = _read(ctx, paths, commands)
    cases = _tagged(read, tags)
    if keyword is not None:
        _check_pytest()
        from slidectl.extensions.scenarios.commands.test_run import chosen

        cases = chosen(cases, keyword)
    if only_check:
        ctx.say(f"{output.count(len(cases), 'case')} checked, no mistakes")
        return
    if not cases:
        raise UsageError("no cases chosen", "list them: slidectl test --list " + " ".join(paths))
    if only_list:
        _list(ctx, cases)
        return
    _check_pytest()
    from slidectl.extensions.scenarios.baselines import Baselines
    from slidectl.extensions.scenarios.commands.test_run import CaseRunner, RunOptions

    baselines = None if baseline is None else Baselines(baseline, update_baseline)
    ctx.close()
    socket = ctx.paths.socket_text if live else None
    if socket is not None:
        from slidectl.extensions.scenarios.live import Live

        daemon = Live(socket)
        daemon.hold(cases)  # until this function ends
    if keep_failed is not None:
        with output.writing_to(keep_failed):
            os.makedirs(keep_failed, exist_ok=True)
    if junitxml is not None:
        with output.writing_to(junitxml):
            check_writable(junitxml)  # before anything runs
    options = RunOptions(timeout, sim_timeout, keep_failed, baselines, socket)
    more = iter(()) if baselines is None else baselines.without_case(known)
    runner = CaseRunner(cases, options, 1 if live else workers or usable_cores(), maxfail, more)
    fault = _run(ctx, runner)
    failed = _print_results(ctx, runner.cases, runner.results)
    if fault is not None:
        raise fault
    if junitxml is not None:
        output.save(junitxml, runner.junit)
    if runner.interrupted:
        click_context.exit(EXIT_INTERRUPTED)
    if failed:
        click_context.exit(EXIT_REFUSED)


def _check_pytest() -> None:
    """Raise Refused when a library is not installed with which scenarios run."""
    for module, library in (("pytest", "pytest"), ("xdist", "pytest-xdist")):
        if find_spec(module) is None:
            raise Refused(f"scenarios run with the library {library}", f"install it: {install_command('test')}")


# --- choice of cases ------------------------------------------------------------------------------------------------


def _read(ctx: Context, paths: Sequence[str], commands: Commands) -> tuple[list[Case], list[Case]]:
    """The named cases, and all cases of their files. Raises BadFile with all errors."""
    from slidectl.extensions.scenarios import scenario_file

    mistakes: list[BadFile] = []
    cases: list[Case] = []
    known: list[Case] = []
    for file, wanted in scenario_file.find(paths):
        found = scenario_file.read(file, commands, mistakes)
        known += found
        mine = [case for case in found if not wanted or case.name == wanted]
        if found and not mine:
            there = listing(case.name for case in found if case.name)
            mistakes.append(BadFile(f"has no case {wanted!r}", file, hint=f"cases: {there}"))
        cases += [case for case in mine if case not in cases]
    if not mistakes:
        return cases, known
    if ctx.format == "json":
        for mistake in mistakes:
            ctx.emit({"file": mistake.file, "line": mistake.line, "error": mistake.reason, "hint": mistake.hint})
    more = "\n".join(map(str, mistakes[1:]))
    hint = "\n".join(filter(None, [mistakes[0].hint, more]))
    raise BadFile(mistakes[0].reason, mistakes[0].file, mistakes[0].line, hint or None)


def _tagged(cases: Sequence[Case], tags: Sequence[str]) -> list[Case]:
    """The cases with one of the tags; all without tags. Raises UsageError: no case has one of them."""
    known = {tag for case in cases for tag in case.tags}
    for tag in tags:
        if tag not in known:
            raise UsageError(f"no case has the tag {tag!r}", f"tags: {', '.join(sorted(known)) or 'none'}")
    return [case for case in cases if not tags or set(tags) & set(case.tags)]


def _list(ctx: Context, cases: Sequence[Case]) -> None:
    if ctx.format == "text":
        output.write("\n".join(case.id for case in cases))
        return
    rows = [{"id": case.id, "tags": list(case.tags), "xfail": case.xfail, "steps": len(case.steps)} for case in cases]
    ctx.emit_rows(rows, ["id", "tags", "xfail", "steps"])


# --- running --------------------------------------------------------------------------------------------------------


def _run(ctx: Context, runner: CaseRunner) -> Exception | None:
    """Run the cases, and show how far it is. Returns what has ended the run early: its results are there."""
    from slidectl.extensions.scenarios.case_run import BAD

    failures = Counter[str]()
    with output.progress_bar(len(runner.cases), "cases", not ctx.quiet) as show:

        def count(result: CaseResult) -> None:
            if result.verdict in BAD:
                failures[result.verdict] += 1
            show(len(runner.results), ", ".join(f"{number} {verdict}" for verdict, number in failures.items()))

        try:
            runner.run(count)
        except OSError as error:  # the disk with the folder for temporary files is full
            return Refused(f"not all cases have run: {error.filename or 'the run'}: {error.strerror or error}")
        except RuntimeError as error:
            return error
    return None


# --- output ---------------------------------------------------------------------------------------------------------


def _print_results(ctx: Context, cases: Sequence[Case], results: Mapping[str, CaseResult]) -> int:
    """Print the results in the order of the cases. Returns how many failed."""
    from slidectl.extensions.scenarios.case_run import BAD, report_lines

    ran = [(case, results[case.id]) for case in cases if case.id in results]
    failures = [(case, result) for case, result in ran if result.verdict in BAD]
    rows: list[dict[str, Any]] = [
        vars(result) | {"sim_time": round(result.sim_time, 9), "wall_time": round(result.wall_time, 3)}
        for _, result in ran
    ]
    if ctx.format != "text":
        ctx.emit_rows(rows, ["id", "verdict", "sim_time", "wall_time", "message"])
        return len(failures)
    if not ctx.quiet:
        table = [{"case": row["id"], **row} for row in rows]
        output.write(output.table(table, ["case", "verdict", "sim_time", "wall_time"]))
    for case, result in failures:
        details = textwrap.indent("\n".join(report_lines(case, result)), "  ")
        output.write(f"\n{result.verdict.upper()} {case.id}\n{details}")
    if written := [result.baseline for _, result in ran if result.baseline]:
        output.write("\n" + "\n".join(written))
    counts = Counter(result.verdict for _, result in ran)
    text = ", ".join(f"{counts[verdict]} {verdict}" for verdict in _VERDICTS if counts[verdict])
    missing = len(cases) - len(ran)
    output.write(f"\n{text or 'nothing ran'}" + (f", {missing} not run" if missing else ""))
    return len(failures)
