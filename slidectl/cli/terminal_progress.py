"""What a terminal shows while a command goes on: a line that changes, or a bar. Both are gone at the end.

Nothing is shown where stderr is no terminal, nor with `-q`.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from slidectl.cli import output
from slidectl.cli.context import Context


@contextmanager
def status_line(ctx: Context, text: str = "", *, wanted: bool = True) -> Iterator[Callable[[str], None]]:
    """A line with that text; what it yields takes the next one."""
    if not wanted or ctx.quiet or not output.is_terminal(sys.stderr):
        yield lambda _: None
        return
    from rich.console import Console
    from rich.text import Text  # brackets of a name are no styles

    with Console(stderr=True, highlight=False).status(Text(text), spinner="line") as status:
        yield lambda text: status.update(Text(text))


@contextmanager
def progress_bar(ctx: Context, total: int | None, unit: str) -> Iterator[Callable[[int, str], None]]:
    """A bar up to `total`; what it yields takes how many there are, and a remark."""
    if ctx.quiet or not output.is_terminal(sys.stderr):
        yield lambda _count, _remark: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (
        BarColumn(), MofNCompleteColumn(), TextColumn(unit), TimeElapsedColumn(), TextColumn("{task.description}"),
    )  # fmt: skip
    console = Console(stderr=True, highlight=False)
    # No thread that refreshes it: a fork would take over the locks that it holds.
    with Progress(*columns, console=console, transient=True, auto_refresh=False) as bar:
        task = bar.add_task("", total=total)
        yield lambda count, remark: bar.update(task, completed=count, description=remark, refresh=True)
