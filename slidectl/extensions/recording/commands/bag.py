"""`slidectl bag`: inspect, compare, filter and export recordings, and complete files that were not closed."""

from __future__ import annotations

import csv
import math
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from io import TextIOWrapper
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

import click

from slidectl import names
from slidectl.cli import completion, output
from slidectl.cli.commands import Variadic, finite, group
from slidectl.cli.context import Context
from slidectl.errors import Refused, UsageError
from slidectl.paths import install_command
from slidectl.writing import CannotWrite, whole_file, write_whole

if TYPE_CHECKING:
    from slidectl.extensions.recording.codec import Record
    from slidectl.extensions.recording.recording_files import Recording

_SECOND = 10**9


@group(examples=["slidectl bag info run.mcap", "slidectl bag export run.bag --csv run.csv"])
def bag() -> None:
    """Recordings: info, diff, filter, export, reindex."""


def open_recording(ctx: Context, file: str | Path) -> Recording:
    """Open a recording; warn when it was not closed. Raises BadFile, NoMcap."""
    from slidectl.extensions.recording.recording_files import opened

    recording = opened(Path(file))
    if recording.damage:
        count = output.count(recording.summary().counts.total(), "message")
        ctx.warn(f"{file}: {recording.damage}; {count} in it can be read (slidectl bag reindex {file} completes it)")
    return recording


@bag.command("info", examples=["slidectl bag info run.mcap", "slidectl bag info run.bag --json"])
@click.argument("file", shell_complete=completion.files)
@click.pass_obj
def info(ctx: Context, file: str) -> None:
    """Show the content of a recording.

    Times are simulated, in s. JSON keys: path, duration, start, end, size, messages, compression, chunks, damage, types
    (type and md5sum), topics (topic, type, messages, latching).
    """
    with open_recording(ctx, file) as recording:
        summary, channels, damage = recording.summary(), recording.channels, recording.damage
    begin, end = (None if ns is None else ns / _SECOND for ns in (summary.begin_ns, summary.end_ns))
    latched = {channel.topic for channel in channels if channel.latching}
    types = {channel.topic: channel.type for channel in channels}
    record = {
        "path": file,
        "duration": None if begin is None or end is None else end - begin,
        "start": begin,
        "end": end,
        "size": Path(file).stat().st_size,
        "messages": summary.counts.total(),
        "compression": summary.compression,
        "chunks": summary.chunks,
        "damage": damage or None,
        "types": [{"type": kind, "md5sum": md5} for kind, md5 in sorted({(c.type, c.md5) for c in channels})],
        "topics": [
            {"topic": topic, "type": types[topic], "messages": summary.counts[topic], "latching": topic in latched}
            for topic in sorted(types)
        ],
    }
    ctx.emit(record, _info_text(record))


def _info_text(record: dict[str, Any]) -> str:
    """The text, in the order of `rosbag info`."""
    times = {key: "-" if record[key] is None else f"{record[key]:.3f} s" for key in ("duration", "start", "end")}
    lines = {
        "path": record["path"],
        **times,
        "size": output.megabytes(record["size"]),
        "messages": str(record["messages"]),
        "compression": f"{record['compression']} [{record['chunks']} chunks]",
        **({"damage": record["damage"]} if record["damage"] else {}),
    }
    width = max((len(one["type"]) for one in record["types"]), default=0)
    types = [f"{one['type']:<{width}} [{one['md5sum']}]" for one in record["types"]]
    width = max((len(one["topic"]) for one in record["topics"]), default=0)
    wide = max((len(str(one["messages"])) for one in record["topics"]), default=0)
    topics = [
        f"{one['topic']:<{width}}  {one['messages']:>{wide}} msgs : {one['type']}"
        + (" (latched)" if one["latching"] else "")
        for one in record["topics"]
    ]
    text = [f"{key + ':':<13}{value}" for key, value in lines.items()]
    for key, rows in (("types", types), ("topics", topics)):
        text += [f"{key + ':' if number == 0 else '':<13}{row}" for number, row in enumerate(rows)]
    return "\n".join(text)


# --- golden traces ----------------------------------------------------------------------------------------------------


@bag.command(
    "diff",
    examples=[
        "slidectl bag diff run.bag golden.bag --fields joint_states/position --tol 1e-6",
        "slidectl bag diff run.mcap baselines/ --update-baseline",
    ],
)
@click.argument("run", shell_complete=completion.files)
@click.argument("baseline", shell_complete=completion.files)
@click.option(
    "--fields", cls=Variadic, metavar="F[=TOL]...", help="Only these topics or fields, with tolerances in their units."
)
@click.option("--tol", type=click.FloatRange(min=0), default=0.0, callback=finite, metavar="T",
              help="Tolerance of numbers, in their own units (0).")  # fmt: skip
@click.option("--update-baseline", is_flag=True, help="Make this run the baseline instead.")
@click.pass_obj
def diff(ctx: Context, run: str, baseline: str, fields: tuple[str, ...], tol: float, update_baseline: bool) -> None:
    """Show the first differences of a recording from a baseline.

    BASELINE is a recording, a folder with one of the same name, or a .csv file of --baseline in 'slidectl test'.
    The command compares messages with the same simulated time, exactly or within a tolerance: those of the baseline's
    topics except /rosout, or those of --fields; of a .csv file all columns. Exits 1 on a difference. JSON keys, one
    line for each field that differs: topic, field, time, value, baseline, tolerance.
    """
    from slidectl.extensions.recording.comparison import compare_file, tolerances_of

    found = compare_file(
        Path(run), Path(baseline), tolerances_of(fields, tol), tol, update_baseline,
        lambda path: open_recording(ctx, path),
    )  # fmt: skip
    if ctx.format != "text":
        for difference in found:
            ctx.emit(difference._asdict())
    if found:
        raise Refused("\n".join(map(str, found)), "to keep this run as the baseline: --update-baseline")
    if ctx.format == "text":
        ctx.done({}, f"{baseline}: {'updated' if update_baseline else 'no difference'}")


# --- copies -----------------------------------------------------------------------------------------------------------


def _target(file: str, source: str, force: bool) -> Path:
    """The path to write. Raises Refused when the file exists (unless `force`), UsageError when it is the source."""
    from slidectl.extensions.recording.recording_files import refuse_existing

    path = Path(file)
    if not force:
        refuse_existing(path)
    if path.resolve() == Path(source).resolve():
        raise UsageError("the target is the source", "give another name")
    return path


@bag.command("reindex", examples=["slidectl bag reindex run.bag"])
@click.argument("file", shell_complete=completion.files)
@click.pass_obj
def reindex(ctx: Context, file: str) -> None:
    """Complete a recording whose recorder was killed.

    All readable messages are written to a new file of this name, with an index. The original is kept as NAME.orig.bag
    (or .mcap). JSON keys: file, messages, kept.
    """
    from slidectl.extensions.recording.recording_files import copy, opened

    path = Path(os.path.realpath(file))
    with opened(path) as recording:
        if not recording.damage:
            ctx.done({"file": file, "messages": recording.summary().counts.total(), "kept": None}, f"{file}: complete")
            return
        recording.refuse_written()
        kept = path.with_name(f"{path.stem}.orig{path.suffix}")
        if kept.exists():
            raise Refused(f"{kept} already exists", f"it is from an earlier reindex; remove it, or rename {file}")
        count = copy(recording.records(), recording, path, recording.summary().compression, kept)
    ctx.done({"file": file, "messages": count, "kept": str(kept)}, f"{file}: {count} messages; the original is {kept}")


@bag.command(
    "filter",
    examples=[
        "slidectl bag filter run.bag short.bag 'topic == \"/slider/joint_states\" and t < 5'",
        "slidectl bag filter run.bag run.mcap --compression zstd",
    ],
)
@click.argument("source", shell_complete=completion.files)
@click.argument("target", shell_complete=completion.files)
@click.argument("condition", required=False, metavar="[EXPR]")
@click.option("--compression", metavar="KIND", default="none", help=".bag: bz2, lz4; .mcap: lz4, zstd (none).")
@click.option("--force", is_flag=True, help="Overwrite an existing file.")
@click.pass_obj
def filter_command(
    ctx: Context, source: str, target: str, condition: str | None, compression: str, force: bool
) -> None:
    """Copy the messages for which EXPR is true.

    EXPR can use topic, t (simulated s) and the fields of the message m, with the operators of Python and the functions
    of its math module; topics without a field of EXPR are left out. Without EXPR all messages are copied: from .bag to
    .mcap or back, or with another compression. JSON keys: file, messages, of.
    """
    from slidectl.extensions.recording.recording_files import copy

    path = _target(target, source, force)
    with open_recording(ctx, source) as recording:
        keep = _condition(condition, recording)
        total = recording.summary().counts.total()
        count = copy((one for one in recording.records() if keep(one)), recording, path, compression)
    ctx.done({"file": target, "messages": count, "of": total}, f"{target}: {count} of {total} messages")


def _condition(text: str | None, recording: Recording) -> Callable[[Record], bool]:
    """The predicate of an expression. Raises UsageError: it is invalid, or no topic has its fields."""
    if text is None:
        return lambda _record: True
    from slidectl.msgs.message_expressions import Filter

    filters: dict[int, Filter] = {}
    refusal: UsageError | None = None
    for channel in recording.channels:
        schema = recording.codec(channel).schema
        try:
            filters[channel.number] = Filter(text, schema, ("topic", "t"))
        except UsageError as error:
            refusal = error
    if not filters and refusal is not None:
        raise refusal

    def keep(one: Record) -> bool:
        known = filters.get(one.channel.number)
        if known is None:
            return False
        return known(recording.message(one), topic=one.channel.topic, t=one.time_ns / _SECOND)

    return keep


# --- tables -----------------------------------------------------------------------------------------------------------


@bag.command(
    "export",
    examples=[
        "slidectl bag export run.bag --csv run.csv",
        "slidectl bag export run.bag --parquet run.parquet --topic /slider/joint_states",
    ],
)
@click.argument("file", shell_complete=completion.files)
@click.option("--csv", "csv_file", metavar="FILE", help="A CSV file; - is stdout.")
@click.option("--parquet", "parquet_file", metavar="FILE", help="A Parquet file (needs pyarrow).")
@click.option("--topic", "topics", multiple=True, metavar="TOPIC", help="Only this topic; may repeat.")
@click.option("--force", is_flag=True, help="Overwrite an existing file.")
@click.pass_obj
def export(
    ctx: Context, file: str, csv_file: str | None, parquet_file: str | None, topics: tuple[str, ...], force: bool
) -> None:
    """Write a table with a row for each message and a column for each field.

    The first columns are time (simulated, s) and topic. The others have the names of the fields: for one topic
    position[0] or pose.position.x, for several topics with the topic before them (/slider/joint_states/position[0]). A
    cell is empty if the message of its row has no such field. JSON keys: file, rows, columns.
    """
    target = csv_file or parquet_file
    if target is None or (csv_file and parquet_file):
        raise UsageError("give one of --csv and --parquet")
    path = None if csv_file == "-" else _target(target, file, force)
    with open_recording(ctx, file) as recording:
        wanted = {names.resolve(topic, recording.topics, kind="topic") for topic in topics} or set(recording.topics)
        rows = Rows(recording, wanted)
        columns = rows.columns()
        count = _write_csv(path, rows, columns) if csv_file else _write_parquet(Path(target), rows, columns)
    if path is not None:
        ctx.done({"file": target, "rows": count, "columns": len(columns)}, f"{target}: {count} rows")


class Rows:
    """The messages of some topics as flat rows: `time` (s), `topic`, and each field by its path.

    If there are several topics, paths begin with the topic. nan becomes None.
    """

    def __init__(self, recording: Recording, topics: set[str]) -> None:
        self._recording = recording
        self._topics = topics

    def columns(self) -> list[str]:
        """All columns in order of first use. All messages are read for that, as arrays may grow."""
        found: dict[str, None] = {"time": None, "topic": None}
        for row in self:
            found.update(dict.fromkeys(row))
        return list(found)

    def __iter__(self) -> Iterator[dict[str, Any]]:
        for record in self._recording.records(self._topics):
            prefix = "" if len(self._topics) == 1 else f"{record.channel.topic}/"
            row: dict[str, Any] = {"time": record.time_ns / _SECOND, "topic": record.channel.topic}
            row.update(_flat(prefix, self._recording.message(record)))
            yield row


def _flat(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    if isinstance(value, dict) and value.keys() == {"secs", "nsecs"}:
        yield name, value["secs"] + value["nsecs"] / _SECOND
    elif isinstance(value, dict):
        for key, below in value.items():
            yield from _flat(f"{name}{'' if not name or name.endswith('/') else '.'}{key}", below)
    elif isinstance(value, list):
        for index, below in enumerate(value):
            yield from _flat(f"{name}[{index}]", below)
    else:
        yield name, None if isinstance(value, float) and math.isnan(value) else value


def _write_csv(path: Path | None, rows: Rows, columns: list[str]) -> int:
    count = 0
    try:
        with nullcontext(sys.stdout) if path is None else _text_file(path) as file:
            table = csv.DictWriter(file, columns, lineterminator="\n")
            table.writeheader()
            for row in rows:
                table.writerow(row)
                count += 1
            file.flush()
    except BrokenPipeError:
        raise output.ClosedPipe from None
    except OSError as error:
        if path is None:
            raise Refused(f"cannot write the output: {error.strerror or error}") from None
        raise CannotWrite(path, error) from None
    return count


@contextmanager
def _text_file(path: Path) -> Iterator[TextIO]:
    """A file of text, written whole."""
    with whole_file(path) as file:
        text = TextIOWrapper(file, encoding="utf-8", newline="")
        yield text
        text.detach()


def _write_parquet(path: Path, rows: Rows, columns: list[str]) -> int:
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError:
        raise Refused(
            "Parquet files need the library pyarrow", f"install it: {install_command('parquet')}, or use --csv"
        ) from None
    content: dict[str, list[Any]] = {column: [] for column in columns}
    for row in rows:
        for column, cells in content.items():
            cells.append(row.get(column))
    sink = pyarrow.BufferOutputStream()
    try:
        parquet.write_table(pyarrow.table(content), sink)
        write_whole(path, sink.getvalue().to_pybytes())
    except OSError as error:
        raise CannotWrite(path, error) from None
    except pyarrow.ArrowException as error:
        raise Refused(f"cannot write {path}: {error}") from None
    return len(content["time"])
