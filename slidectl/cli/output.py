"""The formats of results: text, JSON lines, YAML, CSV; plain tables in a pipe, rich tables on a terminal.

Functions that build text, and that write to stdout and into files. They depend on no command and no daemon.
"""

from __future__ import annotations

import errno
import json
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, TextIO

from slidectl.errors import BadFile, Refused

FORMATS = ("text", "json", "yaml", "csv")

Record = Mapping[str, Any]


class ClosedPipe(Exception):
    """The output has no reader; end without a message."""


def write(text: str) -> None:
    """Write one result to stdout, with a line end if it has none, and flush.

    Raises:
        ClosedPipe: the reader is gone. Refused: the output cannot be written (a full disk).
    """
    try:
        sys.stdout.write(text if text.endswith("\n") else text + "\n")
        sys.stdout.flush()
    except BrokenPipeError:
        raise ClosedPipe from None
    except OSError as error:
        raise Refused(f"cannot write the output: {error.strerror or error}") from None


def save(path: str, text: str | bytes) -> None:
    """Write a result into a file, whole or not at all. Raises BadFile when it cannot be written."""
    from slidectl import writing

    with writing_to(path):
        writing.write_whole(path, text)


@contextmanager
def writing_to(path: str) -> Iterator[None]:
    """Turn an OSError of a block that writes to `path` into BadFile."""
    try:
        yield
    except OSError as error:
        from slidectl.writing import hint, reason

        raise BadFile(f"cannot be written: {reason(error, path)}", path, hint=hint(error, path)) from None


def is_reader_gone() -> bool:
    """True when standard output or standard error is a pipe without a reader."""
    import select

    poll = select.poll()
    for stream in (sys.stdout, sys.stderr):
        poll.register(stream.fileno(), 0)
    return any(event & (select.POLLERR | select.POLLHUP) for _, event in poll.poll(0))


def terminal_is_closed() -> bool:
    """True when standard output is a terminal that was closed."""
    import termios

    try:
        termios.tcgetattr(sys.stdout.fileno())
    except termios.error as error:
        return bool(error.args[0] == errno.EIO)
    except (OSError, ValueError):  # stdout is not a file
        return False
    return False


def check_reader() -> None:
    """Raise ClosedPipe when the reader is gone. For commands that run without end and may have nothing to write."""
    if is_reader_gone():
        raise ClosedPipe


def is_terminal(stream: TextIO) -> bool:
    """True for a terminal that takes control sequences."""
    return stream.isatty() and os.environ.get("TERM", "") != "dumb"


def wants_colour(stream: TextIO) -> bool:
    """True on a terminal unless NO_COLOR is set (https://no-color.org)."""
    return is_terminal(stream) and not os.environ.get("NO_COLOR")


def count(number: int, what: str) -> str:
    """`1 topic`, `2 topics`."""
    return f"{number} {what}{'' if number == 1 else 's'}"


def megabytes(size: int) -> str:
    """A size in 10^6 or 10^3 bytes."""
    return f"{size / 1e6:.1f} MB" if size >= 1e5 else f"{size / 1e3:.1f} kB"


def as_json(value: Any) -> str:
    """One line of JSON; NaN becomes null and infinity 1e999, as in the protocol."""
    try:
        return json.dumps(value, ensure_ascii=False, allow_nan=False)
    except ValueError:
        from slidectl.wire.json_lines import numbers_of_json

        return numbers_of_json(json.dumps(value, ensure_ascii=False))


def as_yaml(value: Any) -> str:
    """YAML in block style, keys in their own order."""
    import yaml

    return str(yaml.safe_dump(_plain(value), sort_keys=False, allow_unicode=True, default_flow_style=False))


def as_csv(rows: Iterable[Sequence[Any]]) -> str:
    """RFC 4180 rows (lines end with a plain newline); nested values are JSON."""
    import csv
    import io

    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerows([_csv_cell(cell) for cell in row] for row in rows)
    return buffer.getvalue()


def as_lines(record: Record) -> str:
    """`key: value` a line, the values in one column."""
    width = max((len(key) for key in record), default=0) + 1
    return "\n".join(f"{key + ':':<{width}} {cell(value)}".rstrip() for key, value in record.items())


def cell(value: Any) -> str:
    """A value in a table: lists are joined by blanks, an empty value is `-`, floats have six significant digits.

    A value that is not there is nan in a world of this process, and null from a daemon: both are `-`.
    """
    if value is None or value == "" or value == [] or value != value:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list | tuple):
        return " ".join(cell(item) for item in value)
    return as_json(value) if isinstance(value, Mapping) else str(value)


def table(rows: Sequence[Record], columns: Sequence[str]) -> str:
    """A table of records; column `a_b` is headed `a b`.

    In a pipe columns are padded with blanks under a header line and never wrapped; on a terminal rich draws them.
    """
    header = [column.replace("_", " ") for column in columns]
    body = [[cell(row.get(column)) for column in columns] for row in rows]
    if is_terminal(sys.stdout):
        return _rich_table(body, header)
    lines = [[name.upper() for name in header], *body]
    widths = [max(len(line[column]) for line in lines) for column in range(len(header))]
    return "\n".join("  ".join(map(str.ljust, line, widths)).rstrip() for line in lines)


def _rich_table(rows: Sequence[Sequence[str]], header: Sequence[str]) -> str:
    """The table drawn by rich, with long cells wrapped."""
    import io

    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False, padding=(0, 1, 0, 0), header_style="bold")
    for index, name in enumerate(header):
        table.add_column(name, style="cyan" if index == 0 else "", overflow="fold")
    for row in rows:
        table.add_row(*map(Text, row))
    buffer, width = io.StringIO(), terminal_width()
    no_color = not wants_colour(sys.stdout)
    Console(file=buffer, force_terminal=True, no_color=no_color, width=width, highlight=False).print(table)
    return buffer.getvalue()


def terminal_width() -> int:
    """Characters in a line of the terminal, 80 where that is not known."""
    import shutil

    return shutil.get_terminal_size().columns


def _csv_cell(value: Any) -> Any:
    if isinstance(value, bool):
        return "true" if value else "false"
    return as_json(value) if isinstance(value, list | tuple | Mapping) else value


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, list | tuple) else value


# --- progress ------------------------------------------------------------------------------------------------------


@contextmanager
def status_line(text: str, wanted: bool) -> Iterator[Callable[[str], None]]:
    """Show a status line on a terminal, and erase it at the end; yields a function that sets its text."""
    if not wanted or not is_terminal(sys.stderr):
        yield lambda _: None
        return
    from rich.console import Console
    from rich.text import Text  # rich must not read brackets in a name as styles

    with Console(stderr=True, highlight=False).status(Text(text), spinner="line") as status:
        yield lambda text: status.update(Text(text))


@contextmanager
def progress_bar(total: int | None, unit: str, wanted: bool) -> Iterator[Callable[[int, str], None]]:
    """Show a bar up to `total` on a terminal, and erase it at the end.

    Yields a function that takes the count so far and a remark.
    """
    if not wanted or not is_terminal(sys.stderr):
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
