"""`slidectl record`: record topics into a .bag or .mcap file, until Ctrl-C or a limit is reached."""

from __future__ import annotations

import os
import re
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from slidectl.cli import completion, output
from slidectl.cli.commands import command, finite
from slidectl.cli.context import Context
from slidectl.command_steps import CommandStep, check_not_detached
from slidectl.errors import MessageRefused, NoDaemon, Refused, SlidectlError, UnknownName, UsageError
from slidectl.msgs.schema import nanoseconds

if TYPE_CHECKING:
    from slidectl.client import Subscription
    from slidectl.extensions.recording.recording_files import Recorder

_CHECK_EVERY_S = 0.2
_FLUSH_EVERY_S = 1.0
"""Wall time between two flushes: a killed recorder loses at most the messages of this time. Each flush ends a chunk,
which costs some bytes in the file and in memory. In the first second each check flushes."""
_PROGRESS_EVERY_S = 1.0
_QUEUE = 100_000
_DURATION = re.compile(r"(\d+\.?\d*|\.\d+)([smh]?)\Z")
_UNITS = {"": 1, "s": 1, "m": 60, "h": 3600}


def _duration(_click: click.Context, _param: click.Parameter, value: str | None) -> float | None:
    if value is None:
        return None
    match = _DURATION.match(value)
    if match is None or not float(match[1]):
        raise click.BadParameter(f"{value!r} is not a time above 0, such as 30, 2.5s, 5m or 1h")
    return float(match[1]) * _UNITS[match[2]]


def _chosen(topics: tuple[str, ...], **given: Any) -> tuple[_Choice, Path]:
    """The choice of topics, and the path of the file. Raises UsageError."""
    from slidectl.extensions.recording.recording_files import check_kind

    path = Path(given["file"] if given["file"] is not None else time.strftime("%Y-%m-%d-%H-%M-%S"))
    path = path if path.suffix else path.with_name(f"{path.name}.bag")
    choice = _Choice(topics, given)
    check_kind(path, given["compression"])
    return choice, path


@command(
    step=CommandStep(effects=check_not_detached),
    check_words=_chosen,
    examples=[
        "slidectl record -a -O run.mcap",
        "slidectl record joint_states /rosout -O run.bag --duration 10",
        "slidectl record -e '/rrbot/.*/state' -O states.bag --detach",
    ],
)
@click.argument("topics", nargs=-1, metavar="[TOPIC]...", shell_complete=completion.topics)
@click.option("-a", "--all", "every", is_flag=True, help="All topics, including those created later.")
@click.option("-e", "--regex", is_flag=True, help="TOPIC is a regular expression for whole names.")
@click.option("-x", "--exclude", metavar="REGEX", help="Leave out topics that match.")
@click.option("-O", "--output-name", "file", metavar="FILE", help="The file; its suffix is the format, .bag or .mcap.")
@click.option("--force", is_flag=True, help="Overwrite an existing file.")
@click.option("--duration", callback=_duration, metavar="T", help="End after this simulated time: 30 (s), 5m, 1h.")
@click.option("--size", type=click.FloatRange(min=0, min_open=True), callback=finite, metavar="MB",
              help="End at this size, 10^6 bytes.")  # fmt: skip
@click.option("--split", is_flag=True, help="Start a new file where --duration or --size would end it.")
@click.option("--max-splits", type=click.IntRange(min=1), metavar="N", help="Keep only the last N files.")
@click.option("-l", "--limit", type=click.IntRange(min=1), metavar="N", help="At most N messages of each topic.")
@click.option("--compression", metavar="KIND", default="none", help=".bag: bz2, lz4; .mcap: lz4, zstd (none).")
@click.option("--repeat-latched", is_flag=True, help="Write latched messages again in each file of a split.")
@click.option("--progress", is_flag=True, help="Print the number of messages each second.")
@click.option("--detach", is_flag=True, help="Return when recording has begun; it continues in the background.")
@click.option("--pid", "pid_file", metavar="FILE", help="Write the process id to FILE.")
@click.pass_obj
def record(ctx: Context, /, topics: tuple[str, ...], **given: Any) -> None:
    """Record topics into a file.

    Messages are stored with the simulated time of their publication, in the order in which they arrive. The recording
    ends at Ctrl-C, at SIGTERM, or at the limit of --duration, --size or (for named topics) --limit; the exit code is 0.
    It is 1 if messages were lost because they came too fast, or if the disk is full. If the daemon ends, the file is
    completed and the exit code is 3. Without -O the file is named after the date. A recorder that is killed loses at
    most its last second, and 'slidectl bag reindex' completes the file. With --detach the process id is printed; 'kill
    PID' ends the recording, and so does the end of the daemon.

    JSON keys: files, messages, topics, seconds (simulated), bytes, dropped; of --progress: messages, topics, seconds.
    """
    choice, path = _chosen(topics, **given)
    choice.resolve(ctx)
    from slidectl.cli.detached import Background, pid_file
    from slidectl.extensions.recording.recording_files import Recorder
    from slidectl.supervision import Interrupts

    background = None
    _ = ctx.client  # raises NoDaemon before a file is touched
    if given["detach"]:
        ctx.close()
        background = Background(ctx.paths, "recording")
        background.fork()
    with Interrupts() as interrupts, pid_file(given["pid_file"]):
        out = Recorder(
            path, given["compression"], given["duration"], given["size"], given["split"], given["max_splits"],
            given["repeat_latched"], given["force"],
        )  # fmt: skip
        recorder = _RecordedTopics(ctx, choice, out, given)
        try:
            recorder.begin()
            topics_text = output.count(len(recorder.subscriptions), "topic")
            ctx.say(f"recording {topics_text} into {out.path}" + ("" if background else "; Ctrl-C ends it"))
            if background is not None:
                ctx.emit({"pid": os.getpid(), "file": str(out.path), "log": background.log}, str(os.getpid()))
                background.everything_runs()
            recorder.run(lambda: bool(interrupts.received))
        finally:
            recorder.end()


class _Choice:
    """The selection of topics to record."""

    def __init__(self, topics: tuple[str, ...], given: dict[str, Any]) -> None:
        """Raises UsageError."""
        if given["every"] == bool(topics):
            raise UsageError("give the topics, or -a for all", "slidectl topic list shows them")
        if given["split"] and not (given["duration"] or given["size"]):
            raise UsageError("--split needs --duration or --size: where a new file begins")
        if given["max_splits"] and not given["split"]:
            raise UsageError("--max-splits goes with --split")
        self._exclude = None if given["exclude"] is None else _compiled(given["exclude"])
        self._patterns = [_compiled(text) for text in topics] if given["regex"] else []
        self.named = [] if given["regex"] else list(topics)
        self._every = given["every"]

    def resolve(self, ctx: Context) -> None:
        """Make the names full. Raises UnknownName for a short one that fits no topic."""
        for index, name in enumerate(self.named):
            try:
                self.named[index] = ctx.resolve("topic", name)["name"]
            except UnknownName:
                if not name.startswith("/"):  # a topic with a full name is recorded as soon as it exists
                    raise

    def includes(self, topic: str) -> bool:
        if self._exclude is not None and self._exclude.fullmatch(topic):
            return False
        return self._every or topic in self.named or any(pattern.fullmatch(topic) for pattern in self._patterns)


def _compiled(text: str) -> re.Pattern[str]:
    try:
        return re.compile(text)
    except re.error as error:
        raise UsageError(f"{text!r} is not a regular expression: {error}") from None


class _RecordedTopics:
    """Subscribes to the chosen topics, and writes their messages."""

    def __init__(self, ctx: Context, choice: _Choice, out: Recorder, given: dict[str, Any]) -> None:
        self._ctx = ctx
        self._choice = choice
        self._out = out
        self._limit = given["limit"]
        self._prints_progress = given["progress"]
        self._length_s = None if given["split"] else given["duration"]
        self.subscriptions: dict[str, Subscription] = {}
        self._sleep: str | None = None
        self._topics_call: str | None = None
        self._failure: OSError | SlidectlError | None = None
        self._left_out: set[str] = set()
        self._progress_at = 0.0

    def begin(self) -> None:
        """Subscribe to the chosen topics that exist."""
        client = self._ctx.client
        topics = client.topics()
        self._subscribe_new(topics)
        if self._length_s is not None:
            self._sleep = client.call_async("/slidectl/sleep", {"duration": self._length_s})
            client.flush()  # the duration begins before this method returns
        for name in self._choice.named:
            if name not in topics:
                self._ctx.warn(f"{name} has no publisher yet; it is recorded as soon as it has one")

    def _subscribe_new(self, topics: dict[str, str]) -> None:
        for topic, kind in topics.items():
            if topic not in self._out.topics and topic not in self._left_out and self._choice.includes(topic):
                try:
                    self._out.add(topic, kind)
                except SlidectlError as error:
                    self._left_out.add(topic)
                    self._ctx.warn(f"{topic} is not recorded: {error.message}")
        client = self._ctx.client
        new = [topic for topic in self._out.topics if topic not in self.subscriptions]
        for topic in new:  # all subscriptions begin at the same time
            self.subscriptions[topic] = client.subscribe(
                topic, topics[topic], queue_length=_QUEUE, take=self._write, wait=False
            )
        if new:
            try:
                client.flush()
            except MessageRefused as error:  # a node advertised it with another type meanwhile
                self._ctx.warn(f"not recorded: {error.message}")

    def _write(self, published: dict[str, Any]) -> None:
        topic = published["topic"]
        if self._failure is not None or (self._limit is not None and self._out.counts[topic] >= self._limit):
            return
        try:
            self._out.write(topic, nanoseconds(published["time"]), published["msg"], published.get("latch", False))
            if self._out.counts.total() == 1:  # a recorder that is killed at once leaves a file that can be read
                self._out.flush()
        except (OSError, SlidectlError) as error:
            self._failure = error

    def run(self, is_over: Callable[[], bool]) -> None:
        """Record until `is_over` or a limit is reached.

        Raises:
            Refused: the file cannot be written. NoDaemon.
        """
        client = self._ctx.client
        began = flushed = client.monotonic()
        try:
            with output.status_line("", not (self._prints_progress or self._ctx.quiet)) as show:
                while not is_over() and not self._is_done():
                    check_at = client.monotonic() + _CHECK_EVERY_S
                    for _ in client.events(_CHECK_EVERY_S):
                        if is_over() or self._is_done() or client.monotonic() >= check_at:
                            break
                    self._subscribe_to_new()
                    now = client.monotonic()
                    if now >= flushed + _FLUSH_EVERY_S or now < began + _FLUSH_EVERY_S:
                        flushed = now
                        try:
                            self._out.flush()
                        except OSError as error:
                            self._failure = error
                    if self._prints_progress:
                        self._progress()
                    else:
                        show(self._so_far())
            if is_over():  # receive what was published up to now
                client.call("/rosapi/get_time")
        except KeyboardInterrupt:  # this ends a background step of a scenario
            client.call("/rosapi/get_time")
            raise
        except NoDaemon:
            with suppress(NoDaemon):  # before it ended, the daemon sent all that was published
                deque(client.events(0.0), maxlen=0)
            raise

    def _subscribe_to_new(self) -> None:
        client = self._ctx.client
        if self._topics_call is not None and client.is_answered(self._topics_call):
            answer = client.answer(self._topics_call)
            self._topics_call = None
            self._subscribe_new(dict(zip(answer["topics"], answer["types"], strict=True)))
        if self._topics_call is None:
            self._topics_call = client.call_async("/rosapi/topics")

    def _is_done(self) -> bool:
        if self._failure is not None or self._out.is_full:
            return True
        named, limit = self._choice.named, self._limit
        if named and limit is not None and all(self._out.counts[name] >= limit for name in named):
            return True
        return self._sleep is not None and self._ctx.client.is_answered(self._sleep)

    def _progress(self) -> None:
        """Print a line on stdout each second."""
        now = self._ctx.client.monotonic()
        if now >= self._progress_at:
            self._progress_at = now + _PROGRESS_EVERY_S
            counts = self._out.counts
            record = {"messages": counts.total(), "topics": len(counts), "seconds": self._seconds()}
            self._ctx.done(record, self._so_far())

    def _seconds(self) -> float:
        out = self._out
        return 0.0 if out.first_ns is None else (out.last_ns - out.first_ns) / 1e9

    def _so_far(self) -> str:
        out, seconds = self._out, self._seconds()
        messages, topics = output.count(out.counts.total(), "message"), output.count(len(out.counts), "topic")
        return f"{messages} of {topics}, {seconds:.3f} s"

    def end(self) -> None:
        """Complete the file and print a summary of it.

        Raises:
            Refused: the file could not be completed, or messages were lost.
        """
        out = self._out
        dropped = sum(subscription.dropped for subscription in self.subscriptions.values())
        try:
            out.close()
        except OSError as error:
            self._failure = self._failure or error
        if isinstance(self._failure, OSError):
            raise out.incomplete(self._failure)
        files = [str(path) for path in out.files]
        record = {
            "files": files, "messages": out.counts.total(), "topics": len(out.counts), "seconds": self._seconds(),
            "bytes": out.bytes, "dropped": dropped,
        }  # fmt: skip
        self._ctx.done(record, f"{', '.join(files)}: {self._so_far()}, {output.megabytes(out.bytes)}")
        if self._failure is not None:
            raise self._failure
        if dropped:
            raise Refused(f"{dropped} messages were lost: they came faster than they could be written")
