"""`slidectl play`: publish the messages of recordings again, each at its simulated time."""

from __future__ import annotations

import math
import os
from collections import deque
from collections.abc import Iterator
from contextlib import ExitStack
from itertools import repeat
from typing import TYPE_CHECKING, Any

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
    from slidectl.extensions.recording.playback import DueMessage
    from slidectl.extensions.recording.records import RecordedTopic

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
@click.option("-l", "--loop", is_flag=True, help="Again and again, until Ctrl-C.")
@click.option("--at-recorded-times", is_flag=True, help="At the very simulated times of the recording.")
@click.option("--clock", is_flag=True, help="Also the recorded /clock, which the world itself publishes.")
@click.option("--detach", is_flag=True, help="Return when it plays; it goes on in the background.")
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

    Each is published in the cycle that is as far from the first as it was, in simulated time: a world that is paused
    holds the playing, and on every run the same cycles see the same messages. The first comes 0.2 s after now; with
    --at-recorded-times each comes at the time that it was recorded at, so a recording of the commands, played into a
    world as it was at its beginning, gives the same bits. It returns when the last was published; with --detach when
    the daemon has the first ones, and prints the process id. It exits with 1 when messages were refused.

    OLD:=NEW publishes on another topic. /rosout is left out, and /clock is without --clock. JSON keys: published, late
    (messages whose time had passed when the daemon got them), refused, topics, seconds; with --detach pid, log.
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
    from slidectl.extensions.recording.playback import due_messages, span_ns

    with ExitStack() as stack:
        recordings = [stack.enter_context(open_recording(ctx, file)) for file in files]
        known = sorted({topic for recording in recordings for topic in recording.topics})
        chosen = {names.resolve(topic, known, kind="topic") for topic in topics}
        renames = {names.resolve(old, known, kind="topic"): new for old, new in renames.items()}
        left_out = {"/rosout", "/rosout_agg", *(() if clock else (CLOCK,))} - chosen
        wanted = (chosen or set(known)) - left_out
        begin_ns, last_ns = span_ns(recordings)
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
            due = due_messages(recordings, wanted, start_ns, end_ns, rate)
            base_ns = player.publish(due, base_ns) + _FIRST_DELAY_NS
            if player.refused:
                break
            if not player.published:
                length_s = (last_ns - begin_ns) / _SECOND
                ctx.warn(f"there is no message to play in that part; the recording is {length_s:.3f} s long")
                break
        player.tell()


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
        raise UsageError("which recording?", "slidectl play FILE [OLD:=NEW]...")
    return files, renames


def _check_type(channel: RecordedTopic) -> None:
    """Raise UsageError when the type is unknown here, or has another definition."""
    topic, type_name, md5 = channel.topic, channel.type, channel.md5
    if not msgs.exists(type_name):
        raise UsageError(f"{topic} has the type {type_name}, which is not known here", "leave it out: --topic")
    if md5 and msgs.md5(type_name) != md5:
        raise UsageError(
            f"{topic}: {type_name} is another type here ({msgs.md5(type_name)}) than in the recording ({md5})"
        )


class _Player:
    """Publishes messages at simulated times, some sent ahead."""

    def __init__(self, ctx: Context, renames: dict[str, str], background: Background | None) -> None:
        self._ctx = ctx
        self._background = background
        self._renames = renames
        self._told: set[str] = set()
        self._has_looked = False
        self.published = 0
        self.late = 0
        self.refused = 0
        self._topics: set[str] = set()
        self._first_ns: int | None = None
        self._last_ns = 0

    def publish(self, messages: Iterator[DueMessage], base_ns: int) -> int:
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
                self._take(publish_id)
                ahead -= size
            waiting.append((client.publish_at(topic, due.message, at_ns, due.type, due.latch), due.size))
            ahead += due.size
        for publish_id, _ in waiting:
            self._take(publish_id)
        return at_ns

    def _take(self, publish_id: str) -> None:
        client = self._ctx.client
        if not self._has_looked:  # its answer confirms that the daemon has all messages sent so far
            self._has_looked = True
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
            if error.message not in self._told and len(self._told) < _MOST_WARNINGS:
                self._told.add(error.message)
                self._ctx.warn(error.message)

    def tell(self) -> None:
        """Print what was played. Raises Refused when messages were refused."""
        seconds = 0.0 if self._first_ns is None else (self._last_ns - self._first_ns) / _SECOND
        record = {
            "published": self.published, "late": self.late, "refused": self.refused, "topics": sorted(self._topics),
            "seconds": seconds,
        }  # fmt: skip
        if self.late:
            text = f"{self.late} messages came after their time, and were published at once"
            self._ctx.warn(f"{text}; in a world that is paused when the playing begins none is late")
        messages = f"{output.count(self.published, 'message')} on {output.count(len(self._topics), 'topic')}"
        self._ctx.done(record, f"played {messages}, {seconds:.3f} s")
        if self.refused:
            raise Refused(f"{self.refused} messages were refused")
