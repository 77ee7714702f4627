"""Progress on a terminal while a command runs: a status line, or a bar. Both are erased at the end.

Nothing is shown when stderr is not a terminal, nor with `-q`.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from slidectl.cli import output
from slidectl.cli.context import Context


@contextmanager
def status_line(ctx: Context, text: str = "", *, wanted: bool = True) -> Iterator[Callable[[str], None]]:
    """Show a status line; yields a function that sets its text."""
    if not wanted or ctx.quiet or not output.is_terminal(sys.stderr):
        yield lambda _: None
        return
    from rich.console import Console
    from rich.text import Text  # rich must not read brackets in a name as styles

    with Console(stderr=True, highlight=False).status(Text(text), spinner="line") as status:
        yield lambda text: status.update(Text(text))


@contextmanager
def progress_bar(ctx: Context, total: int | None, unit: str) -> Iterator[Callable[[int, str], None]]:
    """Show a bar up to `total`; yields a function that takes the count so far and a remark."""
    if ctx.quiet or not output.is_terminal(sys.stderr):
        yield lambda _count, _remark: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (
        BarColumn(), MofNCompleteColumn(), TextColumn(unit), TimeElapsedColumn(), TextColumn("{task.description}"),
    )  # fmt: skip
    console = Console(stderr=True, highlight=False)
    # No refresh thread: a fork would copy the locks that it holds.
    with Progress(*columns, console=console, transient=True, auto_refresh=False) as bar:
        task = bar.add_task("", total=total)
        yield lambda count, remark: bar.update(task, completed=count, description=remark, refresh=True)
