"""`slidectl test`: run scenarios, and print their results.

`slidectl.extensions.scenarios` reads, checks and runs them.
"""

from __future__ import annotations

import ast
import os
import re
import textwrap
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import click

from slidectl.cli import completion, output
from slidectl.cli.commands import command, positive_seconds, simulated_seconds
from slidectl.cli.context import Context
from slidectl.cli.terminal_progress import progress_bar
from slidectl.errors import EXIT_INTERRUPTED, EXIT_REFUSED, BadFile, UsageError, listing
from slidectl.expressions import evaluate, parsed
from slidectl.operating_system import usable_cores
from slidectl.writing import check_writable

if TYPE_CHECKING:
    from slidectl.extensions.scenarios.case_run import CaseResult
    from slidectl.extensions.scenarios.live import Live
    from slidectl.extensions.scenarios.scenario_file import Case
    from slidectl.extensions.scenarios.stages import CaseRuns, InProcess
    from slidectl.extensions.scenarios.step_commands import Commands

_VERDICTS = ("passed", "xfailed", "failed", "error", "xpassed")
"""In the order of the last output line."""
_WORDS = re.compile(r"\(|\)|[^\s()]+")
_MOST_WORDS = 100
_OPERATORS = ("and", "or", "not", "(", ")")
_ALLOWED = (ast.BoolOp, ast.UnaryOp, ast.Name, ast.boolop, ast.Not, ast.expr_context)


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
              help="How many cases run at the same time (default: one per core).")  # fmt: skip
@click.option("-k", "--keyword", metavar="EXPR", help="Only cases that have this in their names; and, or, not, ( ).")
@click.option("--tag", "tags", multiple=True, metavar="TAG", help="Only cases with this tag; may repeat.")
@click.option("--maxfail", type=click.IntRange(min=1), metavar="N", help="Stop after so many failures.")
@click.option("--timeout", type=float, default=60.0, callback=positive_seconds, metavar="S",
              help="Wall seconds that a case may take (60).")  # fmt: skip
@click.option("--sim-timeout", type=float, default=600.0, callback=simulated_seconds, metavar="S",
              help="Simulated seconds that a case may take (600).")  # fmt: skip
@click.option("--list", "only_list", is_flag=True, help="List the cases, and run nothing.")
@click.option("--check", "only_check", is_flag=True, help="Check the files, and run nothing.")
@click.option(
    "--junitxml", metavar="FILE", shell_complete=completion.files, help="Write the results as JUnit XML, too."
)
@click.option(
    "--keep-failed", metavar="FOLDER", help="Keep a recording and a journal of each case that fails, in this folder."
)
@click.option("--baseline", metavar="FOLDER", help="Compare each case that passes with an earlier run, kept there.")
@click.option("--update-baseline", is_flag=True, help="Make the runs the baselines where these differ or are missing.")
@click.option("--daemon", "live", is_flag=True, help="Run in the daemon of -i, which holds no robots, one at a time.")
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

    Each case runs in a process and a world of its own, without a daemon, as fast as the machine can, and gives the same
    bits on every run. All files are checked before anything runs. A folder means all .yaml and .yml files below it.
    Exits 0 when all passed or failed as known (xfail), 1 when something failed, and 2 when a file is wrong or nothing
    was chosen. Ctrl-C ends what runs, with its teardown, and reports what ran (130). JSON keys: id, verdict, sim_time,
    wall_time, steps, step, section, line, message, hint, detail, failed_at, log, kept, baseline, was_ended.
    """
    ctx: Context = click_context.obj
    from slidectl.extensions.scenarios.commands.step_runner import StepRunner

    commands = StepRunner(live)
    if schema:
        from slidectl.extensions.scenarios.scenario_file import schema_text

        output.write(schema_text(commands))
        return
    if not paths:
        raise UsageError("which scenarios?", "slidectl test FILE or FOLDER")
    if update_baseline and baseline is None:
        raise UsageError("--update-baseline needs the folder", "--baseline FOLDER")
    read, known = _read(ctx, paths, commands)
    cases = _chosen(read, keyword, tags)
    if only_check:
        ctx.say(f"{output.count(len(cases), 'case')} checked, nothing wrong")
        return
    if not cases:
        raise UsageError("no case is left", "see which there are: slidectl test --list " + " ".join(paths))
    if only_list:
        _list(ctx, cases)
        return
    from slidectl.extensions.scenarios import live as daemon_stage
    from slidectl.extensions.scenarios import stages
    from slidectl.extensions.scenarios.baselines import Baselines

    baselines = None if baseline is None else Baselines(baseline, update_baseline)
    ctx.close()
    stage: InProcess | Live = daemon_stage.Live(ctx.paths.socket_text) if live else stages.InProcess()
    if keep_failed is not None:
        with output.writing_to(keep_failed):
            os.makedirs(keep_failed, exist_ok=True)
    if junitxml is not None:
        with output.writing_to(junitxml):
            check_writable(junitxml)  # before anything runs
    runner = stages.CaseRuns(commands, stage, sim_timeout, keep_failed, baselines)
    count = 1 if live else workers or usable_cores()
    results, interrupted = _run(ctx, cases, lambda: stage.warm(cases, commands), runner, count, timeout, maxfail)
    if baselines is not None and not interrupted:
        for case, result in baselines.without_case(known):
            cases.append(case)
            results.append(result)
    failed = _tell(ctx, cases, results)
    if junitxml is not None:
        _write_junit(junitxml, cases, results)
    if interrupted:
        click_context.exit(EXIT_INTERRUPTED)
    if failed:
        click_context.exit(EXIT_REFUSED)


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


def _chosen(cases: Sequence[Case], keyword: str | None, tags: Sequence[str]) -> list[Case]:
    fits = (lambda _: True) if keyword is None else _keyword(keyword)
    known = {tag for case in cases for tag in case.tags}
    for tag in tags:
        if tag not in known:
            raise UsageError(f"no case has the tag {tag!r}", f"tags: {', '.join(sorted(known)) or 'none'}")
    return [case for case in cases if fits(case) and (not tags or set(tags) & set(case.tags))]


def _list(ctx: Context, cases: Sequence[Case]) -> None:
    if ctx.format == "text":
        output.write("\n".join(case.id for case in cases))
        return
    rows = [{"id": case.id, "tags": list(case.tags), "xfail": case.xfail, "steps": len(case.steps)} for case in cases]
    ctx.emit_rows(rows, ["id", "tags", "xfail", "steps"])


def _keyword(text: str) -> Callable[[Case], bool]:
    """The predicate of `-k`: words in a case's id, name or tags, with and, or, not. Raises UsageError."""
    words = {f"word{index}": word for index, word in enumerate(_WORDS.findall(text))}
    tree = None
    with suppress(SyntaxError):
        tree = parsed(" ".join(word if word in _OPERATORS else name for name, word in words.items()))
    if tree is None or len(words) > _MOST_WORDS or not all(isinstance(node, _ALLOWED) for node in ast.walk(tree)):
        raise UsageError(f"-k takes words with and, or, not and ( ), not {text!r}")

    def fits(case: Case) -> bool:
        name = " ".join([case.id, case.scenario, *case.tags]).lower()
        return bool(evaluate(tree, {variable: word.lower() in name for variable, word in words.items()}))

    return fits


# --- running --------------------------------------------------------------------------------------------------------


def _run(
    ctx: Context,
    cases: Sequence[Case],
    warm: Callable[[], None],
    runner: CaseRuns,
    count: int,
    timeout: float,
    maxfail: int | None,
) -> tuple[list[CaseResult], bool]:
    """Run the cases, `count` at a time. Returns the results so far, and whether Ctrl-C ended the run."""
    from slidectl.extensions.launch.supervision import Interrupted, Interrupts
    from slidectl.extensions.scenarios.case_run import BAD
    from slidectl.extensions.scenarios.workers import WorkerPool

    results: list[CaseResult] = []
    failures = Counter[str]()
    with suppress(Interrupted), Interrupts() as interrupts:
        with interrupts.raised():
            warm()
        with (
            progress_bar(ctx, len(cases), "cases") as show,
            WorkerPool(runner.run, count, timeout, lambda: bool(interrupts.received)) as pool,
        ):
            for result in pool.results(cases):
                results.append(result)
                if result.verdict in BAD:
                    failures[result.verdict] += 1
                show(len(results), ", ".join(f"{number} {verdict}" for verdict, number in failures.items()))
                if maxfail is not None and failures.total() >= maxfail:
                    break
            results += pool.ended()
    return results, bool(interrupts.received)


def _write_junit(path: str, cases: Sequence[Case], results: Sequence[CaseResult]) -> None:
    """Write the results as JUnit XML. Raises BadFile."""
    from slidectl.extensions.scenarios.junit import junit

    output.save(path, junit(cases, results))


# --- output ---------------------------------------------------------------------------------------------------------


def _tell(ctx: Context, cases: Sequence[Case], results: Sequence[CaseResult]) -> int:
    """Print the results in the order of the cases. Returns how many failed."""
    from slidectl.extensions.scenarios.case_run import BAD
    from slidectl.extensions.scenarios.junit import told

    by_id = {result.id: result for result in results}
    ran = [(case, by_id[case.id]) for case in cases if case.id in by_id]
    failures = [(case, result) for case, result in ran if result.verdict in BAD]
    rows: list[dict[str, Any]] = [
        result.as_dict() | {"sim_time": round(result.sim_time, 9), "wall_time": round(result.wall_time, 3)}
        for _, result in ran
    ]
    if ctx.format != "text":
        ctx.emit_rows(rows, ["id", "verdict", "sim_time", "wall_time", "message"])
        return len(failures)
    if not ctx.quiet:
        table = [{"case": row["id"], **row} for row in rows]
        output.write(output.table(table, ["case", "verdict", "sim_time", "wall_time"]))
    for case, result in failures:
        details = textwrap.indent("\n".join(told(case, result)), "  ")
        output.write(f"\n{result.verdict.upper()} {case.id}\n{details}")
    if written := [result.baseline for _, result in ran if result.baseline]:
        output.write("\n" + "\n".join(written))
    counts = Counter(result.verdict for _, result in ran)
    text = ", ".join(f"{counts[verdict]} {verdict}" for verdict in _VERDICTS if counts[verdict])
    missing = len(cases) - len(ran)
    output.write(f"\n{text or 'nothing ran'}" + (f", {missing} not run" if missing else ""))
    return len(failures)
