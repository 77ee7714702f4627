"""`slidectl play`: publish the messages of recordings again, each at its simulated time."""

from __future__ import annotations

import heapq
import math
import os
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from itertools import repeat
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from slidectl import msgs, names
from slidectl.cli import completion, output
from slidectl.cli.commands import command, finite, positive_seconds
from slidectl.cli.context import Context
from slidectl.cli.topic_streams import CLOCK, pause_remark
from slidectl.command_steps import CommandStep, check_not_detached
from slidectl.errors import MessageRefused, Refused, UsageError
from slidectl.extensions.recording.commands.bag import open_recording
from slidectl.msgs.schema import nanoseconds

if TYPE_CHECKING:
    from slidectl.cli.detached import Background
    from slidectl.extensions.recording.codec import RecordedTopic
    from slidectl.extensions.recording.recording_files import Recording

_SECOND = 10**9
_AHEAD, _AHEAD_BYTES = 1000, 4 * 1024 * 1024
"""The most messages that are sent ahead of their time, and the most bytes of them in the recording."""
_FIRST_DELAY_NS = _SECOND // 5
"""Simulated time from now to the first message, as rosbag's --delay, so that its time is in the future."""
_MOST_WARNINGS = 5
_SECONDS: dict[str, Any] = {"type": click.FloatRange(min=0), "callback": finite, "metavar": "S"}


@command(
    step=CommandStep(effects=check_not_detached),
    examples=[
        "slidectl play run.bag",
        "slidectl play run.mcap --topic /slider/joint1_position_controller/command -r 2",
        "slidectl play run.bag --start 2 --until 5 /old/command:=/new/command",
    ],
)
@click.argument("words", nargs=-1, required=True, metavar="FILE... [OLD:=NEW]...", shell_complete=completion.files)
@click.option("--topic", "topics", multiple=True, metavar="TOPIC", help="Only this topic; may repeat.")
@click.option(
    "-r",
    "--rate",
    type=float,
    default=1.0,
    callback=positive_seconds,
    metavar="FACTOR",
    help="FACTOR times as fast (1).",
)
@click.option("-s", "--start", default=0.0, help="Begin S simulated seconds after its start.", **_SECONDS)
@click.option("-u", "--until", help="End S simulated seconds after its start.", **_SECONDS)
@click.option("-l", "--loop", is_flag=True, help="Repeat until Ctrl-C.")
@click.option("--at-recorded-times", is_flag=True, help="Publish at exactly the simulated times of the recording.")
@click.option("--clock", is_flag=True, help="Also play the recorded /clock, which the world itself publishes.")
@click.option("--detach", is_flag=True, help="Return when playing has begun; it continues in the background.")
@click.pass_obj
def play(
    ctx: Context,
    words: tuple[str, ...],
    topics: tuple[str, ...],
    rate: float,
    start: float,
    until: float | None,
    loop: bool,
    at_recorded_times: bool,
    clock: bool,
    detach: bool,
) -> None:
    """Publish the messages of recordings again.

    Messages keep their intervals in simulated time: a paused world pauses the playback, and in every run the same
    cycles get the same messages. The first message is published 0.2 s from now. With --at-recorded-times each message
    is published at its recorded time: a recording of the commands, played into a world in its initial state, gives the
    same bits. The command returns after the last message; with --detach it prints the process id and returns when the
    daemon has the first messages. It exits with 1 if messages were refused.

    OLD:=NEW publishes on another topic. /rosout is left out, and so is /clock without --clock. JSON keys: published,
    late (messages that reached the daemon after their time), refused, topics, seconds; with --detach pid, log.
    """
    if at_recorded_times and (loop or rate != 1.0):
        raise UsageError("--at-recorded-times goes neither with --loop nor with --rate")
    if until is not None and until <= start:
        raise UsageError(f"--until {until:g} is not after --start {start:g}")
    files, renames = _sorted(words)
    background = None
    if detach:
        from slidectl.cli.detached import Background

        background = Background(ctx.paths, "playing")
        background.fork()
    with ExitStack() as stack:
        recordings = [stack.enter_context(open_recording(ctx, file)) for file in files]
        known = sorted({topic for recording in recordings for topic in recording.topics})
        chosen = {names.resolve(topic, known, kind="topic") for topic in topics}
        renames = {names.resolve(old, known, kind="topic"): new for old, new in renames.items()}
        left_out = {"/rosout", "/rosout_agg", *(() if clock else (CLOCK,))} - chosen
        wanted = (chosen or set(known)) - left_out
        begin_ns, last_ns = _span_ns(recordings)
        for channel in (channel for recording in recordings for channel in recording.channels):
            if channel.topic in wanted:
                _check_type(channel)
        player = _Player(ctx, renames, background)
        end_ns = None if until is None else round(until * _SECOND)
        start_ns = round(start * _SECOND)
        base_ns = begin_ns + start_ns
        if not at_recorded_times:
            base_ns = nanoseconds(ctx.call("/rosapi/get_time")["time"]) + _FIRST_DELAY_NS
        for _ in repeat(None) if loop else (None,):
            due = _due_messages(recordings, wanted, start_ns, end_ns, rate)
            base_ns = player.publish(due, base_ns) + _FIRST_DELAY_NS
            if player.refused:
                break
            if not player.published:
                length_s = (last_ns - begin_ns) / _SECOND
                ctx.warn(f"no messages in this part; the recording is {length_s:.3f} s long")
                break
        player.print_summary()


def _sorted(words: tuple[str, ...]) -> tuple[list[str], dict[str, str]]:
    """The files, and old topic name -> new name. Raises UsageError, BadName."""
    files, renames = [], {}
    for word in words:
        old, given, new = word.partition(":=")
        if given and not new:
            raise UsageError(f"{word} names no topic", "slidectl play FILE OLD:=NEW")
        if given:
            renames[old] = names.check(names.join("/", new))
        else:
            files.append(word)
    if not files:
        raise UsageError("name the recording", "slidectl play FILE [OLD:=NEW]...")
    return files, renames


def _check_type(channel: RecordedTopic) -> None:
    """Raise UsageError when the type is unknown here, or has another definition."""
    topic, type_name, md5 = channel.topic, channel.type, channel.md5
    if not msgs.exists(type_name):
        raise UsageError(f"{topic} has the type {type_name}, which is unknown here", "leave it out: --topic")
    if md5 and msgs.md5(type_name) != md5:
        raise UsageError(
            f"{topic}: {type_name} is another type here ({msgs.md5(type_name)}) than in the recording ({md5})"
        )


class _DueMessage(NamedTuple):
    """A message to publish at `at_ns` after the start; `size` is its number of bytes in the recording."""

    at_ns: int
    topic: str
    type: str
    latch: bool
    message: Any
    size: int


def _span_ns(recordings: Sequence[Recording]) -> tuple[int, int]:
    """The times of the first and the last message of all recordings; zeros if there are no messages."""
    summaries = [recording.summary() for recording in recordings]
    begin = min((one.begin_ns for one in summaries if one.begin_ns is not None), default=0)
    return begin, max((one.end_ns for one in summaries if one.end_ns is not None), default=begin)


def _due_messages(
    recordings: Sequence[Recording], topics: set[str], start_ns: int = 0, end_ns: int | None = None, rate: float = 1.0
) -> Iterator[_DueMessage]:
    """The messages from `start_ns` to before `end_ns` after the first message, by time; `rate` divides their times.

    Latched messages from before the start come first: the last one of each topic.
    """
    begin_ns = _span_ns(recordings)[0]
    streams = [((record, recording) for record in recording.records(topics)) for recording in recordings]
    latched: dict[str, _DueMessage] = {}
    for record, recording in heapq.merge(*streams, key=lambda pair: pair[0].time_ns):
        channel, offset_ns = record.channel, record.time_ns - begin_ns - start_ns
        if end_ns is not None and offset_ns + start_ns >= end_ns:
            break
        if offset_ns < 0 and not channel.latching:
            continue
        at_ns, message = round(max(offset_ns, 0) / rate), recording.message(record)
        due = _DueMessage(at_ns, channel.topic, channel.type, channel.latching, message, len(record.raw))
        if offset_ns < 0:
            latched[channel.topic] = due
            continue
        yield from latched.values()
        latched.clear()
        yield due
    yield from latched.values()


class _Player:
    """Publishes messages at simulated times, some sent ahead."""

    def __init__(self, ctx: Context, renames: dict[str, str], background: Background | None) -> None:
        self._ctx = ctx
        self._background = background
        self._renames = renames
        self._warned: set[str] = set()
        self._is_checked = False
        self.published = 0
        self.late = 0
        self.refused = 0
        self._topics: set[str] = set()
        self._first_ns: int | None = None
        self._last_ns = 0

    def publish(self, messages: Iterator[_DueMessage], base_ns: int) -> int:
        """Publish all messages; returns the simulated time of the last one. Raises NoDaemon, Refused."""
        client = self._ctx.client
        waiting: deque[tuple[str, int]] = deque()
        ahead = 0
        at_ns = base_ns
        for due in messages:
            at_ns = base_ns + due.at_ns
            topic = self._renames.get(due.topic, due.topic)
            self._topics.add(topic)
            self._first_ns = at_ns if self._first_ns is None else self._first_ns
            self._last_ns = at_ns
            while waiting and (len(waiting) >= _AHEAD or ahead + due.size > _AHEAD_BYTES):
                publish_id, size = waiting.popleft()
                self._confirm(publish_id)
                ahead -= size
            waiting.append((client.publish_at(topic, due.message, at_ns, due.type, due.latch), due.size))
            ahead += due.size
        for publish_id, _ in waiting:
            self._confirm(publish_id)
        return at_ns

    def _confirm(self, publish_id: str) -> None:
        client = self._ctx.client
        if not self._is_checked:  # its answer confirms that the daemon has all messages sent so far
            self._is_checked = True
            status = self._ctx.call("/slidectl/status")
            self._ctx.say(pause_remark(status, "nothing is played until it goes on"))
            if self._background is not None:
                self._ctx.emit({"pid": os.getpid(), "log": self._background.log}, str(os.getpid()))
                self._background.everything_runs()
        try:
            self.late += not client.published(publish_id, timeout=self._ctx.wait_limit(math.inf))
            self.published += 1
        except MessageRefused as error:
            self.refused += 1
            if error.message not in self._warned and len(self._warned) < _MOST_WARNINGS:
                self._warned.add(error.message)
                self._ctx.warn(error.message)

    def print_summary(self) -> None:
        """Print what was played. Raises Refused when messages were refused."""
        seconds = 0.0 if self._first_ns is None else (self._last_ns - self._first_ns) / _SECOND
        record = {
            "published": self.published, "late": self.late, "refused": self.refused, "topics": sorted(self._topics),
            "seconds": seconds,
        }  # fmt: skip
        if self.late:
            text = f"{self.late} messages were late and were published at once"
            self._ctx.warn(f"{text}; none is late if the world is paused at the start")
        messages = f"{output.count(self.published, 'message')} on {output.count(len(self._topics), 'topic')}"
        self._ctx.done(record, f"played {messages}, {seconds:.3f} s")
        if self.refused:
            raise Refused(f"{self.refused} messages were refused")
