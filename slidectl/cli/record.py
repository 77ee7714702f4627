"""`slidectl record`: topics into a .bag or .mcap file, as they come, until Ctrl-C or an end that was asked for."""

from __future__ import annotations

import math
import os
import re
import sys
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from slidectl.cli import completion, output
from slidectl.cli.commands import command
from slidectl.cli.context import Context
from slidectl.cli.topic_streams import nanoseconds
from slidectl.errors import MessageRefused, NoDaemon, Refused, SlidectlError, UnknownName, UsageError

if TYPE_CHECKING:
    from slidectl.client import Subscription
    from slidectl.recording.codec import Codec
    from slidectl.recording.recording_files import RecordingWriter

_LOOK_EVERY_S = 0.2
_FLUSH_EVERY_S = 1.0
_QUEUE = 100_000
_MEGABYTE = 1 << 20
_DURATION = re.compile(r"(\d+\.?\d*|\.\d+)([smh]?)\Z")
_UNITS = {"": 1, "s": 1, "m": 60, "h": 3600}
_LOOK_AT_SIZE = 64


def _duration(_click: click.Context, _param: click.Parameter, value: str | None) -> float | None:
    if value is None:
        return None
    match = _DURATION.match(value)
    if match is None or not float(match[1]):
        raise click.BadParameter(f"{value!r} is not a time above 0, such as 30, 2.5s, 5m or 1h")
    return float(match[1]) * _UNITS[match[2]]


@command(
    examples=[
        "slidectl record -a -O run.mcap",
        "slidectl record joint_states /rosout -O run.bag --duration 10",
        "slidectl record -e '/rrbot/.*/state' -O states.bag --detach",
    ]
)
@click.argument("topics", nargs=-1, metavar="[TOPIC]...", shell_complete=completion.topics)
@click.option("-a", "--all", "every", is_flag=True, help="All topics, those too that come later.")
@click.option("-e", "--regex", is_flag=True, help="TOPIC is a regular expression for whole names.")
@click.option("-x", "--exclude", metavar="REGEX", help="Without the topics that match.")
@click.option("-O", "--output-name", "file", metavar="FILE", help="The file; its suffix says .bag or .mcap.")
@click.option("--force", is_flag=True, help="Write over a file that is there.")
@click.option("--duration", callback=_duration, metavar="T", help="End after so much simulated time: 30, 5m, 1h.")
@click.option("--size", type=click.FloatRange(min=0, min_open=True), metavar="MB", help="End at this size.")
@click.option("--split", is_flag=True, help="Go on in a new file where --duration or --size would end it.")
@click.option("--max-splits", type=click.IntRange(min=1), metavar="N", help="Keep only the last N files.")
@click.option("-l", "--limit", type=click.IntRange(min=1), metavar="N", help="So many messages of each topic.")
@click.option("--compression", metavar="KIND", default="none", help=".bag: bz2, lz4; .mcap: lz4, zstd (none).")
@click.option("--repeat-latched", is_flag=True, help="Latched messages again in each file of a split.")
@click.option("--detach", is_flag=True, help="Return when it records; it goes on in the background.")
@click.option("--pid", "pid_file", metavar="FILE", help="Write the process id to FILE.")
@click.pass_obj
def record(ctx: Context, /, topics: tuple[str, ...], **given: Any) -> None:
    """Record topics into a file.

    Messages are stored with the simulated time at which they were published, in the order in which they came. It ends
    at Ctrl-C, SIGTERM, or what --duration, --size or --limit say, and exits 0 then; 1 when messages were lost because
    they came too fast. When the daemon ends meanwhile the file is completed and the exit code is 3. Without -O the file
    is named after the date. A recorder that is killed leaves a file without its last second, which 'slidectl bag
    reindex' completes. With --detach the process id is printed; 'kill PID' ends it, and so does the daemon's end.

    JSON keys: files, messages, topics, seconds (simulated), bytes, dropped.
    """
    choice = _Choice(ctx, topics, given)
    path = _path(given["file"])
    from slidectl.cli.detached import Background, pid_file
    from slidectl.launch.supervision import Interrupted, Interrupts

    background = None
    if given["detach"]:
        ctx.client.close()
        background = Background(ctx.paths, "recording")
        background.fork()
        ctx.close()
    with suppress(Interrupted), Interrupts() as interrupts, pid_file(given["pid_file"]), interrupts.held():
        out = _Output(path, given)
        recorder = _Recorder(ctx, choice, out, given)
        try:
            recorder.begin()
            ctx.say(f"recording {recorder.what()} into {out.path}" + ("" if background else "; Ctrl-C ends it"))
            if background is not None:
                ctx.emit({"pid": os.getpid(), "file": str(out.path), "log": background.log}, str(os.getpid()))
                background.everything_runs()
            recorder.run(lambda: bool(interrupts.received))
        finally:
            recorder.end()


def _path(given: str | None) -> Path:
    path = Path(given if given is not None else time.strftime("%Y-%m-%d-%H-%M-%S"))
    return path if path.suffix else path.with_name(f"{path.name}.bag")


def _megabytes(size: int) -> str:
    return f"{size / 1e6:.1f} MB" if size >= 1e5 else f"{size / 1e3:.1f} kB"


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


def _readable(path: Path) -> int:
    """How many messages a file has that was not completed."""
    from slidectl.recording.recording_files import opened

    try:
        with opened(path) as recording:
            return recording.summary().counts.total()
    except SlidectlError:
        return 0


class _Choice:
    """Which topics are recorded."""

    def __init__(self, ctx: Context, topics: tuple[str, ...], given: dict[str, Any]) -> None:
        """Raises UsageError, and UnknownName for a short name that fits no topic."""
        if given["every"] == bool(topics):
            raise UsageError("give the topics, or -a for all", "slidectl topic list shows them")
        if given["split"] and not (given["duration"] or given["size"]):
            raise UsageError("--split needs --duration or --size: where a new file begins")
        if given["max_splits"] and not given["split"]:
            raise UsageError("--max-splits goes with --split")
        self._exclude = None if given["exclude"] is None else _compiled(given["exclude"])
        self._patterns = [_compiled(text) for text in topics] if given["regex"] else []
        self.named = [] if given["regex"] else [self._full(ctx, name) for name in topics]
        self._every = given["every"]

    @staticmethod
    def _full(ctx: Context, name: str) -> str:
        try:
            return str(ctx.resolve("topic", name)["name"])
        except UnknownName:
            if not name.startswith("/"):
                raise
            return name  # it is recorded as soon as it is there

    def takes(self, topic: str) -> bool:
        if self._exclude is not None and self._exclude.fullmatch(topic):
            return False
        return self._every or topic in self.named or any(pattern.fullmatch(topic) for pattern in self._patterns)


def _compiled(text: str) -> re.Pattern[str]:
    try:
        return re.compile(text)
    except re.error as error:
        raise UsageError(f"{text!r} is not a regular expression: {error}") from None


class _Output:
    """The file that is written, or one after the other. Each topic is added to a file when its first message comes."""

    def __init__(self, path: Path, given: dict[str, Any]) -> None:
        from slidectl.recording.recording_files import create

        self._create: Callable[[Path, str], RecordingWriter] = create
        self._base = path
        self._given = given
        self._length_ns = None if given["duration"] is None else round(given["duration"] * 1e9)
        self._most_bytes = None if given["size"] is None else given["size"] * _MEGABYTE
        self._latched: dict[str, tuple[Codec, bytes]] = {}
        self._numbers = 0
        self.files: list[Path] = []
        self.counts: Counter[str] = Counter()
        self.first_ns: int | None = None
        self.last_ns = 0
        self.bytes = 0
        """Of files that are complete."""
        self.is_full = False
        self._open()

    @property
    def path(self) -> Path:
        """The file that is written now."""
        return self.files[-1]

    def _open(self) -> None:
        path = self._base
        if self._given["split"]:
            path = path.with_name(f"{path.stem}_{self._numbers}{path.suffix}")
            self._numbers += 1
        if self._given["force"]:
            with suppress(OSError):
                path.unlink()
        self._writer = self._create(path, self._given["compression"])
        self.files.append(path)
        self._topics: dict[str, Any] = {}
        self._begin_ns: int | None = None
        if len(self.files) > (self._given["max_splits"] or math.inf):
            gone = self.files.pop(0)
            self.bytes -= gone.stat().st_size
            gone.unlink()

    def write(self, topic: str, codec: Codec, latching: bool, time_ns: int, raw: bytes) -> None:
        """Raises OSError."""
        if self._ends(time_ns):
            if not self._given["split"]:
                self.is_full = True
                return
            self.close()
            self._open()
        if self._begin_ns is None:
            self._begin_ns = time_ns
            if self._given["repeat_latched"]:
                for name, (kind, message) in self._latched.items():
                    self._put(name, kind, True, time_ns, message)
        if latching:
            self._latched[topic] = codec, raw
        self._put(topic, codec, latching, time_ns, raw)
        self.counts[topic] += 1
        self.first_ns = time_ns if self.first_ns is None else min(self.first_ns, time_ns)
        self.last_ns = max(self.last_ns, time_ns)

    def _put(self, topic: str, codec: Codec, latching: bool, time_ns: int, raw: bytes) -> None:
        handle = self._topics.get(topic)
        if handle is None:
            handle = self._topics[topic] = self._writer.add(topic, codec, latching)
        self._writer.write(handle, time_ns, raw)

    def _ends(self, time_ns: int) -> bool:
        if self._length_ns is not None and self._begin_ns is not None and time_ns - self._begin_ns >= self._length_ns:
            return True
        total = self.counts.total()
        return self._most_bytes is not None and total % _LOOK_AT_SIZE == 0 and self._writer.size >= self._most_bytes

    def flush(self) -> None:
        """Raises OSError."""
        self._writer.flush()

    def close(self) -> None:
        """Raises OSError."""
        try:
            self._writer.close()
        finally:
            self.bytes += self.path.stat().st_size


class _Recorder:
    """Subscribes what is chosen, and writes what comes."""

    def __init__(self, ctx: Context, choice: _Choice, out: _Output, given: dict[str, Any]) -> None:
        self._ctx = ctx
        self._choice = choice
        self._out = out
        self._limit = given["limit"]
        self._length_s = None if given["split"] else given["duration"]
        self._subscriptions: dict[str, Subscription] = {}
        self._codecs: dict[str, Codec] = {}
        self._sleep: str | None = None
        self._topics_call: str | None = None
        self._failure: OSError | None = None
        self._left_out: set[str] = set()

    def what(self) -> str:
        return _count(len(self._subscriptions), "topic")

    def begin(self) -> None:
        """Returns when everything that is there is subscribed."""
        client = self._ctx.client
        topics = client.topics()
        self._subscribe_new(topics)
        if self._length_s is not None:
            self._sleep = client.call_async("/slidectl/sleep", {"duration": self._length_s})
        for name in self._choice.named:
            if name not in topics:
                self._ctx.warn(f"nobody publishes {name} yet; it is recorded as soon as somebody does")

    def _subscribe_new(self, topics: dict[str, str]) -> None:
        from slidectl.recording import codec

        for topic, kind in topics.items():
            if topic not in self._codecs and topic not in self._left_out and self._choice.takes(topic):
                try:
                    self._codecs[topic] = codec.of(kind)
                except SlidectlError as error:
                    self._leave_out(topic, error)
        client = self._ctx.client
        new = [topic for topic in self._codecs if topic not in self._subscriptions]
        for topic in new:  # all from the same moment on
            options: dict[str, Any] = {"queue_length": _QUEUE, "take": self._take, "wait": False}
            self._subscriptions[topic] = client.subscribe(topic, topics[topic], **options)
        if new:
            try:
                client.flush()
            except MessageRefused as error:  # somebody advertised it with another type meanwhile
                self._ctx.warn(f"not recorded: {error.message}")

    def _leave_out(self, topic: str, error: SlidectlError) -> None:
        self._left_out.add(topic)
        self._ctx.warn(f"{topic} is not recorded: {error.message}")

    def _take(self, published: dict[str, Any]) -> None:
        topic = published["topic"]
        if self._failure is not None or (self._limit is not None and self._out.counts[topic] >= self._limit):
            return
        kind = self._codecs[topic]
        latching = published.get("latch", False)
        try:
            time_ns = nanoseconds(published["time"])
            self._out.write(topic, kind, latching, time_ns, kind.encode(published["msg"]))
        except OSError as error:
            self._failure = error

    def run(self, is_over: Callable[[], bool]) -> None:
        """Until `is_over`, or what was asked for has come.

        Raises:
            Refused: the file cannot be written. NoDaemon.
        """
        client = self._ctx.client
        flush_at = client.monotonic() + _FLUSH_EVERY_S
        try:
            with self._status() as tell:
                while not is_over() and not self._is_done():
                    look_at = client.monotonic() + _LOOK_EVERY_S
                    while (left := look_at - client.monotonic()) > 0 and not is_over() and not self._is_done():
                        next(client.events(left), None)
                    self._look_for_topics()
                    if client.monotonic() >= flush_at:
                        self._flush()
                        flush_at = client.monotonic() + _FLUSH_EVERY_S
                    tell()
            if is_over():  # what was published up to now is on its way
                client.call("/rosapi/get_time")
        except NoDaemon:
            with suppress(NoDaemon):  # a daemon that ends has sent what was published
                deque(client.events(0.0), maxlen=0)
            raise

    def _look_for_topics(self) -> None:
        client = self._ctx.client
        if self._topics_call is not None and client.is_answered(self._topics_call):
            answer = client.answer(self._topics_call)
            self._topics_call = None
            self._subscribe_new(dict(zip(answer["topics"], answer["types"], strict=True)))
        if self._topics_call is None:
            self._topics_call = client.call_async("/rosapi/topics")

    def _flush(self) -> None:
        try:
            self._out.flush()
        except OSError as error:
            self._failure = error

    def _is_done(self) -> bool:
        if self._failure is not None or self._out.is_full:
            return True
        if self._limit is not None and self._choice.named:
            return all(self._out.counts[name] >= self._limit for name in self._choice.named)
        if self._sleep is not None and self._ctx.client.is_answered(self._sleep):
            self._ctx.client.answer(self._sleep)
            return True
        return False

    @contextmanager
    def _status(self) -> Iterator[Callable[[], None]]:
        """A line on the terminal that says how far it is."""
        if not output.is_terminal(sys.stderr) or self._ctx.quiet:
            yield lambda: None
            return
        from rich.console import Console
        from rich.text import Text

        with Console(stderr=True, highlight=False).status("", spinner="line") as status:
            yield lambda: status.update(Text(self._so_far()))

    def _so_far(self) -> str:
        out = self._out
        seconds = 0.0 if out.first_ns is None else (out.last_ns - out.first_ns) / 1e9
        return f"{_count(out.counts.total(), 'message')} of {_count(len(out.counts), 'topic')}, {seconds:.3f} s"

    def end(self) -> None:
        """Complete the file and say what is in it.

        Raises:
            Refused: the file could not be completed, or messages were lost.
        """
        out = self._out
        dropped = sum(subscription.dropped for subscription in self._subscriptions.values())
        try:
            out.close()
        except OSError as error:
            self._failure = self._failure or error
        size = out.bytes
        names = ", ".join(map(str, out.files))
        seconds = 0.0 if out.first_ns is None else (out.last_ns - out.first_ns) / 1e9
        record = {
            "files": [str(path) for path in out.files], "messages": out.counts.total(), "topics": len(out.counts),
            "seconds": seconds, "bytes": size, "dropped": dropped,
        }  # fmt: skip
        self._ctx.done(record, f"{names}: {self._so_far()}, {_megabytes(size)}")
        if self._failure is not None:
            kept = _readable(out.path)
            raise Refused(
                f"cannot write {out.path}: {self._failure.strerror or self._failure}; "
                f"{kept} of its messages are in it and can be read",
                f"complete it with: slidectl bag reindex {out.path}" if kept else None,
            )
        if dropped:
            raise Refused(f"{dropped} messages were lost: they came faster than they could be written")
