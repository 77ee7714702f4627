"""`rosbag record`, `info` and `play`, and the contents of bags for `rostopic echo -b`, `list -b` and `rosmsg show -b`.

They run `slidectl record`, `bag info` and `play`. Options that have no counterpart are refused by name. Files are .bag;
times are simulated, as with /use_sim_time. Types of messages are those in the bag.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import datetime
from optparse import Values
from pathlib import Path

import click

from slidectl import names
from slidectl.cli import output
from slidectl.cli.context import Context
from slidectl.cli.echo import MessageFormat, predicate, writer
from slidectl.cli.topic_streams import Event
from slidectl.errors import BadFile
from slidectl.extensions.recording.recording_files import NotARecording, Recording, opened
from slidectl.extensions.ros_commands.arguments import Failure, Parser, option
from slidectl.msgs.schema import Schema

_VERBS = {"record": "slidectl record", "info": "slidectl bag info", "play": "slidectl play"}
_OTHERS = {
    "reindex": "slidectl bag reindex FILE",
    "fix": "slidectl bag reindex FILE",
    "filter": "slidectl bag filter",
    "compress": "slidectl record --compression bz2",
    "decompress": "slidectl bag filter",
    "check": "slidectl bag info FILE",
}


def rosbag(ctx: Context, argv: Sequence[str]) -> None:
    """Run a verb. Raises Failure: there is no such verb, or an option without a counterpart."""
    verb, *rest = argv or [""]
    verbs = {"record": _record, "info": _info, "play": _play}
    if verb in verbs:
        verbs[verb](ctx, rest)
        return
    if verb in ("", "-h", "--help"):
        lines = [f"\t{name}  \t{instead}" for name, instead in _VERBS.items()]
        raise Failure("\n".join(["Usage: rosbag <subcommand> [options] [args]", "", *lines]), 0 if verb else 1)
    hint = f"; use {_OTHERS[verb]}" if verb in _OTHERS else ""
    raise Failure(f"ERROR: rosbag {verb} is not available{hint}; available: {', '.join(_VERBS)}", 1)


def _record(ctx: Context, argv: Sequence[str]) -> None:
    from slidectl.extensions.recording.commands.record import record

    given = Parser(
        "rosbag",
        "rosbag record TOPIC1 [TOPIC2 TOPIC3 ...]",
        option("-a --all", "all topics"),
        option("-e --regex", "topics are regular expressions"),
        option("-x --exclude", "exclude topics that match", "EXCLUDE_REGEX"),
        option("-q --quiet", "no output"),
        option("-o --output-prefix", "beginning of the file name, before the date", "PREFIX", dest="prefix"),
        option("-O --output-name", "name of the file", "NAME", dest="name"),
        option("--split", "begin a new file at --duration or --size"),
        option("--max-splits", "number of files to keep", "MAX_SPLITS"),
        option("--size", "MB", "SIZE"),
        option("--duration", "of simulated time: 30, 5m, 1h", "DURATION"),
        option("-l --limit", "messages of each topic", "NUM"),
        option("--repeat-latched", "latched messages again in each file"),
        option("-j --bz2", "compress with BZ2"),
        option("--lz4", "compress with LZ4"),
        option("-b --buffsize", "no effect: no messages are lost", "SIZE"),
        option("--chunksize", "no effect", "SIZE"),
        option("--udp", "no effect"),
        option("--tcpnodelay", "no effect"),
    ).parse(argv)
    if not given.words and not given.all and not given.regex:
        raise Failure("[FATAL] You must specify a topic name or else use the '-a' option.", 1)
    date = datetime.now().strftime("%Y-%m-%d-%H-%M-%S")
    name = given.name or (f"{given.prefix}_{date}" if given.prefix else date)
    words = ["-O", name if name.endswith((".bag", ".mcap")) else f"{name}.bag"]
    words += ["--compression", "bz2"] if given.bz2 else ["--compression", "lz4"] if given.lz4 else []
    words += _passed_on(given, "all", "regex", "split", "repeat_latched", "quiet")
    words += _passed_on(given, "exclude", "max_splits", "size", "duration", "limit")
    _run(ctx, record, [*words, *given.words])


def _info(ctx: Context, argv: Sequence[str]) -> None:
    from slidectl.extensions.recording.commands.bag import info

    given = Parser(
        "rosbag", "rosbag info [options] BAGFILE1 [BAGFILE2 ...]", option("-y --yaml", "as YAML"),
    ).parse(argv, least=1, missing="You must specify at least 1 bag file.")  # fmt: skip
    for file in given.words:
        _run(ctx, info, ["-o", "yaml", file] if given.yaml else [file])


def _play(ctx: Context, argv: Sequence[str]) -> None:
    from slidectl.extensions.recording.commands.play import play

    given = Parser(
        "rosbag",
        "rosbag play BAGFILE1 [BAGFILE2 BAGFILE3 ...]",
        option("-q --quiet", "no output"),
        option("-r --rate", "factor of the speed", "FACTOR"),
        option("-s --start", "seconds to skip at the beginning", "SEC"),
        option("-u --duration", "seconds to play", "SEC"),
        option("-l --loop", "repeat without end"),
        option("--clock", "the recorded /clock too"),
        option("--topics", "only the topics that follow; bags go before it"),
        option("--bags", "bags follow, after --topics"),
    ).parse([word for word in argv if word not in ("--topics", "--bags")])
    files, topics = _files_and_topics(argv, given.words)
    if not files:
        raise Failure("You must specify at least one bag file to play back.", 1)
    words = [part for topic in topics for part in ("--topic", topic)]
    words += _passed_on(given, "loop", "clock", "quiet", "rate", "start")
    if given.duration is not None:  # rosbag counts from --start, `--until` from the beginning of the file
        words += ["--until", f"{_seconds(given.duration) + _seconds(given.start or '0'):g}"]
    _run(ctx, play, [*words, *files])


def _passed_on(given: Values, *options: str) -> list[str]:
    """The options that have been given, as options of slidectl of the same names."""
    words = []
    for name in options:
        value = getattr(given, name)
        if value is not None:
            words += [f"--{name.replace('_', '-')}", *([] if value is True else [value])]
    return words


def _files_and_topics(argv: Sequence[str], words: Sequence[str]) -> tuple[list[str], list[str]]:
    """The bags, and the topics behind `--topics`. Words with `:=` are remappings, which go with the bags."""
    left, wanted = list(words), "files"
    files: list[str] = []
    topics: list[str] = []
    for word in argv:
        if word in ("--topics", "--bags"):
            wanted = "topics" if word == "--topics" else "files"
        elif word in left:
            left.remove(word)
            (topics if wanted == "topics" and ":=" not in word else files).append(word)
    return files, topics


def _seconds(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise Failure(f"ERROR: {text!r} is not a number of seconds", 2) from None


def _run(ctx: Context, command: click.Command, words: list[str]) -> None:
    command.main(words, prog_name="rosbag", standalone_mode=False, obj=ctx)


# --- contents of bags -------------------------------------------------------------------------------------------------


@contextmanager
def open_bag(path: str) -> Iterator[Recording]:
    """Open the recording at `path`. Raises Failure (1) when it is missing or damaged."""
    if not Path(path).exists():
        raise Failure(f"ERROR: bag file [{path}] does not exist")
    try:
        with opened(Path(path)) as recording:
            yield recording
    except NotARecording:
        raise Failure("ERROR: unable to use bag file: This does not appear to be a bag file") from None
    except BadFile as error:
        raise Failure(f"ERROR: unable to use bag file: {error.reason}") from None


def schemas_of(recording: Recording) -> dict[str, Schema]:
    """Topic -> schema, in the order of the first appearance in the recording."""
    return {channel.topic: recording.codec(channel).schema for channel in recording.channels}


def list_topics(path: str, namespace: str | None) -> None:
    """Print the topics; with a namespace, the number of messages in it, and the times of the first and the last."""
    with open_bag(path) as recording:
        topics = list(schemas_of(recording))
        if namespace is None:
            return output.write("\n".join(topics))
        inside = {topic for topic in topics if names.is_under(topic, namespace)}
        times = [record.time_ns for record in recording.records(inside)]
        if not times:
            raise Failure(f"ERROR: no messages on [{namespace}] in {path}; topics: {', '.join(topics)}")
        first, last = (time.strftime("%d %b %Y %H:%M:%S", time.localtime(t // 10**9)) for t in (min(times), max(times)))
        return output.write(f"{len(times)} message(s) from {first} to {last}")


def echo(
    ctx: Context, path: str, target: str | None, message_format: MessageFormat, condition: str | None, count: int | None
) -> None:
    """Print the messages of a topic or a field, or without a target of all topics, in recorded order."""
    printed = 0
    with open_bag(path) as recording:
        schemas = schemas_of(recording)
        fields = dict.fromkeys(schemas, "") if target is None else _chosen(schemas, target, path)
        writers = {topic: writer(ctx, schemas[topic], field, message_format) for topic, field in fields.items()}
        keeps = {topic: predicate(condition, schemas[topic]) for topic in fields}
        for record in recording.records(set(fields)):
            if count is not None and printed >= count:
                return
            topic, message = record.channel.topic, recording.message(record)
            if keeps[topic](message):
                writers[topic](Event(topic, message, record.time_ns))
                printed += 1


def _chosen(schemas: dict[str, Schema], target: str, path: str) -> dict[str, str]:
    """Topic -> field, for `target`."""
    for topic, field in names.cut_from_field(target):
        if topic in schemas:
            return {topic: field}
    raise Failure(f"ERROR: no topic [{target}] in {path}; topics: {', '.join(schemas)}")


def definition(path: str, type_name: str, raw: bool) -> str:
    """The definition of a type in the bag, as `rosmsg show` prints it. Raises Failure when the bag has no such type."""
    with open_bag(path) as recording:
        codecs = [recording.codec(channel) for channel in recording.channels]
        for codec in codecs:
            if type_name in codec.schema.types:
                return codec.texts[type_name] if raw else "\n".join(_shown(codec.schema, type_name, ""))
        known = sorted({name for codec in codecs for name in codec.schema.types})
    raise Failure(f"Unable to load msg [{type_name}]: it is not in {path}\ntypes: {' '.join(known)}")


def _shown(schema: Schema, type_name: str, indent: str) -> Iterator[str]:
    for field in schema.fields(type_name):
        yield f"{indent}{field.type_text} {field.name}"
        yield from _shown(schema, field.type, indent + "  ")
