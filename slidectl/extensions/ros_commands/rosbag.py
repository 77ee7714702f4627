"""`rosbag record`, `info` and `play`, as `slidectl record`, `bag info` and `play`: never ROS's own on the PATH.

Options that have no counterpart are refused by name. Files are .bag; times are simulated, as with /use_sim_time.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime

import click

from slidectl.cli.context import Context
from slidectl.extensions.ros_commands.arguments import Failure, Parser, option

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
    hint = f"; {_OTHERS[verb]} does what it does" if verb in _OTHERS else ""
    raise Failure(f"ERROR: rosbag {verb} is not here{hint}; there are: {', '.join(_VERBS)}", 1)


def _record(ctx: Context, argv: Sequence[str]) -> None:
    from slidectl.extensions.recording.commands.record import record

    given = Parser(
        "rosbag",
        "rosbag record TOPIC1 [TOPIC2 TOPIC3 ...]",
        option("-a --all", "all topics"),
        option("-e --regex", "topics are regular expressions"),
        option("-x --exclude", "without the topics that match", "EXCLUDE_REGEX"),
        option("-q --quiet", "no output"),
        option("-o --output-prefix", "the name begins so, the date follows", "PREFIX", dest="prefix"),
        option("-O --output-name", "the name", "NAME", dest="name"),
        option("--split", "a new file at --duration or --size"),
        option("--max-splits", "keep only so many files", "MAX_SPLITS"),
        option("--size", "MB", "SIZE"),
        option("--duration", "of simulated time: 30, 5m, 1h", "DURATION"),
        option("-l --limit", "messages of each topic", "NUM"),
        option("--repeat-latched", "latched messages again in each file"),
        option("-j --bz2", "compress with BZ2"),
        option("--lz4", "compress with LZ4"),
        option("-b --buffsize", "no effect: nothing is lost here while it is read", "SIZE"),
        option("--chunksize", "no effect", "SIZE"),
        option("--udp", "no effect"),
        option("--tcpnodelay", "no effect"),
    ).parse(argv)
    if not given.words and not given.all and not given.regex:
        raise Failure("[FATAL] You must specify a topic name or else use the '-a' option.", 1)
    date = datetime.now().strftime("%Y-%m-%d-%H-%M-%S")
    name = given.name or (f"{given.prefix}_{date}" if given.prefix else date)
    words = ["-O", name if name.endswith((".bag", ".mcap")) else f"{name}.bag"]
    words += [flag for flag, wanted in (("-a", given.all), ("-e", given.regex), ("--split", given.split)) if wanted]
    words += ["--repeat-latched"] if given.repeat_latched else []
    words += ["--quiet"] if given.quiet else []
    words += ["--compression", "bz2"] if given.bz2 else ["--compression", "lz4"] if given.lz4 else []
    for flag in ("exclude", "max_splits", "size", "duration", "limit"):
        if (value := getattr(given, flag)) is not None:
            words += [f"--{flag.replace('_', '-')}", value]
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
        option("-r --rate", "so many times as fast", "FACTOR"),
        option("-s --start", "begin after so many seconds", "SEC"),
        option("-u --duration", "play only so many seconds", "SEC"),
        option("-l --loop", "again and again"),
        option("--clock", "the recorded /clock too"),
        option("--topics", "only the topics that follow; the bags stand before it"),
        option("--bags", "the bags follow, when --topics stands before"),
    ).parse([word for word in argv if word not in ("--topics", "--bags")])
    files, topics = _files_and_topics(argv, given.words)
    if not files:
        raise Failure("You must specify at least one bag file to play back.", 1)
    words = [part for topic in topics for part in ("--topic", topic)]
    words += [flag for flag, wanted in (("--loop", given.loop), ("--clock", given.clock)) if wanted]
    words += ["--quiet"] if given.quiet else []
    words += ["--rate", given.rate] if given.rate is not None else []
    words += ["--start", given.start] if given.start is not None else []
    if given.duration is not None:  # rosbag counts from --start, `--until` from the beginning of the file
        words += ["--until", f"{_seconds(given.duration) + _seconds(given.start or '0'):g}"]
    _run(ctx, play, [*words, *files])


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
        raise Failure(f"ERROR: {text!r} is no number of seconds", 2) from None


def _run(ctx: Context, command: click.Command, words: list[str]) -> None:
    command.main(words, prog_name="rosbag", standalone_mode=False, obj=ctx)
