"""relay, throttle and mux of topic_tools, and twist_mux: nodes that pass messages on to another topic.

Each has its own connection as long as the node runs. A topic that does not exist yet is looked for repeatedly. The only
known message types are Twist and Bool.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

from slidectl import names
from slidectl.client import Client
from slidectl.client.connection import Subscription
from slidectl.errors import Refused, TimedOut, UnknownName
from slidectl.extensions.launch.plan import LaunchPlan, Node
from slidectl.extensions.launch.task import Run, Task, number, parse

Message = dict[str, Any]
Take = Callable[[str, Message], None]
"""Takes the type of a message, and the event: `msg`, its simulated `time`, and `latch` if it was latched earlier.

It must not call services: waiting for an answer reads further messages, which would change their order.
"""

_RETRY_S = 0.2
_WITHOUT_EFFECT = ("lazy", "wall_clock")
NONE = "__none"
"""The selection with which a mux passes no messages."""


class TopicTool(Task):
    """Base class: topics that it subscribes to, and one that it publishes."""

    family = "topics"
    needs_presence = True
    output: str
    client: Client

    def __init__(self, node: Node, plan: LaunchPlan) -> None:
        super().__init__(node, plan)
        self._run: Run | None = None
        self._inputs: dict[str, tuple[str | None, Take]] = {}
        self._subscriptions: dict[str, Subscription] = {}
        self._is_search_due = False
        """True when the next search for topics is scheduled."""
        self._has_latched = False
        self._has_warned = False

    def begin(self, run: Run) -> None:
        """Subscribe to topics, and offer services. Raises SlidectlError."""
        raise NotImplementedError

    def start(self, run: Run) -> str | None:
        self._run = run
        self.client = run.client.another()
        for name in _WITHOUT_EFFECT:
            if run.parameter(names.join(self.node.full_name, name)):
                self.warn(run, f"the parameter {name} has no effect")
        self.begin(run)
        self._search()
        run.watch.listen(self.client, self._read)
        self.settled(run, self.text)
        return None

    def stop(self, run: Run) -> None:
        if self._run is not None:
            self._run = None
            run.watch.ignore(self.client)
            self.client.close()

    def listen(self, topic: str, take: Take, type_name: str | None = None) -> None:
        """Call `take` for messages on the topic. Without a type it is subscribed as soon as it exists."""
        self._inputs[topic] = type_name, take

    def ignore(self, topic: str) -> None:
        """Unsubscribe the topic."""
        self._inputs.pop(topic, None)
        if topic in self._subscriptions:
            self._subscriptions.pop(topic).close()

    def pass_on(self, type_name: str, came: Message) -> None:
        """Publish a message. Once a latched message was received, the output is latched too."""
        self._has_latched = self._has_latched or came.get("latch", False)
        self.client.publish(self.output, came["msg"], type_name, self._has_latched)

    def search_later(self, run: Run, seconds: float) -> None:
        """Schedule the next search for missing topics, unless one is scheduled."""
        if not self._is_search_due:
            self._is_search_due = True
            run.watch.later(seconds, self._search)

    def _search(self) -> None:
        """Subscribe to the wanted topics that exist now, and schedule the next search if some do not."""
        self._is_search_due = False
        if self._run is None:
            return
        try:
            self._subscribe_new()
        except TimedOut as error:
            self.warn(self._run, f"{error.message}; it searches for its topics again")
        self._read()
        if self._inputs.keys() - self._subscriptions.keys():
            self.search_later(self._run, _RETRY_S)

    def _subscribe_new(self) -> None:
        wanted = {topic: given for topic, (given, _) in self._inputs.items() if topic not in self._subscriptions}
        there = self.client.topics() if wanted else {}
        for topic, given in wanted.items():
            type_name = given or there.get(topic)
            if type_name is None or topic not in self._inputs:  # a service called meanwhile may end an input
                continue
            subscription = self.client.subscribe(topic, type_name, take=partial(self._receive, topic, type_name))
            if topic in self._inputs:
                self._subscriptions[topic] = subscription
            else:
                subscription.close()

    def _receive(self, topic: str, type_name: str, came: Message) -> None:
        if topic in self._inputs:
            self._inputs[topic][1](type_name, came)

    def _read(self) -> None:
        """Handle all received messages."""
        for message in self.client.events(0.0):
            if message.get("op") == "status" and message.get("level") == "error" and not self._has_warned:
                assert self._run is not None
                self._has_warned = True
                self.warn(self._run, f"not passed on to {self.output}: {message['msg']}")


class Relay(TopicTool):
    """topic_tools' relay: `relay IN [OUT]`; the default of OUT is IN_relay."""

    suffix = "_relay"
    usage = "IN [OUT]"

    def __init__(self, node: Node, plan: LaunchPlan) -> None:
        super().__init__(node, plan)
        words = self.read(parse(node, {}).rest)
        if not 1 <= len(words) <= 2:
            raise self.error(f"takes {self.usage}, not {' '.join(node.words)!r}")
        self.input = node.resolve(words[0])
        self.output = node.resolve(words[1] if len(words) == 2 else words[0] + self.suffix)
        self.is_idle = self.input == self.output
        """True for a relay onto itself: passing messages on would repeat each without end, so it passes none."""
        if self.is_idle:
            plan.notice("wrong", node.place, node.full_name, f"passes {self.input} on to itself, which has no effect")

    def read(self, words: list[str]) -> list[str]:
        """Read the words that are not topics; returns the topics. Raises BadFile."""
        return words

    @property
    def text(self) -> str:
        return f"passes {self.input} on to {self.output}{', so there is nothing to do' if self.is_idle else ''}"

    def begin(self, run: Run) -> None:  # noqa: ARG002
        if not self.is_idle:
            self.listen(self.input, self.receive)

    def receive(self, type_name: str, came: Message) -> None:
        """Pass a message on."""
        self.pass_on(type_name, came)


class Throttle(Relay):
    """topic_tools' throttle: at most RATE messages per second, or RATE bytes in a window of seconds.

    The time of a message is the stamp in its header, else the time when it was published.
    """

    suffix = "_throttle"
    usage = "messages IN RATE [OUT], or bytes IN RATE WINDOW_S [OUT]"

    def read(self, words: list[str]) -> list[str]:
        kind, *rest = words or [""]
        values = {"messages": 1, "bytes": 2}.get(kind, 0)
        if not values or len(rest) < 1 + values:
            return []
        numbers = [number(self.node, "each of the values", word) for word in rest[1 : 1 + values]]
        if min(numbers) <= 0.0:
            raise self.error(f"the {'rate' if values == 1 else 'rate and the window'} must be above 0")
        self._rate, self._window_s = numbers[0], numbers[1] if values == 2 else 0.0
        self._last_s = float("-inf")
        self._sent: deque[tuple[float, int]] = deque()
        """Times and sizes of the messages in the window."""
        return [rest[0], *rest[1 + values :]]

    @property
    def text(self) -> str:
        what = f"bytes in {self._window_s:g} s" if self._window_s else "a second"
        return f"{super().text}, at most {self._rate:g} {what}"

    def receive(self, type_name: str, came: Message) -> None:
        header = came["msg"].get("header")
        stamped_s = _seconds(header["stamp"]) if isinstance(header, dict) and "stamp" in header else 0.0
        now_s = stamped_s or _seconds(came["time"])
        if now_s < self._last_s:  # time went back
            self._last_s = float("-inf")
            self._sent.clear()
        if self._fits(type_name, came["msg"], now_s):
            self._last_s = now_s
            self.pass_on(type_name, came)

    def _fits(self, type_name: str, message: Message, now_s: float) -> bool:
        if not self._window_s:
            return now_s - self._last_s > 1.0 / self._rate - _ROUNDING_S
        from slidectl.extensions.recording import codec

        while self._sent and self._sent[0][0] < now_s - self._window_s:
            self._sent.popleft()
        if sum(size for _, size in self._sent) >= self._rate:
            return False
        self._sent.append((now_s, len(codec.of(type_name).encode(message))))
        return True


_ROUNDING_S = 1e-9
"""A tolerance: stamps of 10 Hz are at most 0.1 s apart, and must pass a limit of 10 Hz."""


class Mux(TopicTool):
    """topic_tools' mux: `mux OUT IN...` passes on the selected input; the first one is selected initially."""

    def __init__(self, node: Node, plan: LaunchPlan) -> None:
        super().__init__(node, plan)
        words = parse(node, {}).rest
        if len(words) < 2:
            raise self.error(f"takes OUT IN [IN]..., not {' '.join(words)!r}")
        self.output, *self.topics = map(node.resolve, words)
        self.selected = self.topics[0]

    @property
    def text(self) -> str:
        return f"passes {self.selected} on to {self.output}, of {', '.join(self.topics)}"

    def begin(self, run: Run) -> None:  # noqa: ARG002
        for name, handler in (
            ("select", self._select), ("add", self._add), ("delete", self._delete), ("list", self._list),
        ):  # fmt: skip
            kind = f"topic_tools/Mux{name.capitalize()}"
            self.client.advertise_service(self.node.resolve(f"mux/{name}"), kind, handler)
        self.listen(self.selected, self.pass_on)
        self._publish_selection()

    def _publish_selection(self) -> None:
        topic = self.node.resolve("mux/selected")
        self.client.publish(topic, {"data": self.selected}, "std_msgs/String", latch=True)

    def _select(self, request: Message) -> Message:
        wanted, before = request["topic"], self.selected
        wanted = NONE if wanted == NONE else self._known(wanted)
        if before != NONE:
            self.ignore(before)
        self.selected = wanted
        if wanted != NONE:
            self.listen(wanted, self.pass_on)
        self._publish_selection()
        assert self._run is not None
        self.search_later(self._run, 0.0)
        return {"prev_topic": before}

    def _add(self, request: Message) -> Message:
        topic = self.node.resolve(request["topic"])
        if topic in self.topics or request["topic"] == NONE:
            raise Refused(f"{self.node.full_name} already has the input {request['topic']}")
        self.topics.append(names.check_absolute(topic, "topic"))
        return {}

    def _delete(self, request: Message) -> Message:
        topic = self._known(request["topic"])
        if topic == self.selected:
            raise Refused(f"{topic} is selected", f"select another one first, or {NONE}")
        self.topics.remove(topic)
        return {}

    def _list(self, _: Message) -> Message:
        return {"topics": self.topics}

    def _known(self, name: str) -> str:
        topic = self.node.resolve(name)
        if topic not in self.topics:
            raise UnknownName("input", name, self.topics, f"of {self.node.full_name}")
        return topic


class Source(NamedTuple):
    """An entry of twist_mux's `topics` or `locks`. With `timeout_s` 0 a message is valid forever."""

    topic: str
    timeout_s: float
    priority: int


class TwistMux(TopicTool):
    """twist_mux.

    It passes on the commands of the source with the highest priority among those whose time-out has not passed,
    unless a lock has a higher priority.
    """

    def __init__(self, node: Node, plan: LaunchPlan) -> None:
        super().__init__(node, plan)
        if parse(node, {}).rest:
            raise self.error("takes no arguments", "its topics and locks are parameters")
        self.output = node.resolve("cmd_vel_out")
        self._now_s = 0.0
        self._came_s: dict[str, float] = {}
        self._locked: dict[str, bool] = {}

    @property
    def text(self) -> str:
        return f"drives {self.output} by the source with the highest priority"

    def begin(self, run: Run) -> None:
        self._sources = self._read_sources(run, "topics")
        self._locks = self._read_sources(run, "locks")
        if not self._sources:
            place = names.join(self.node.full_name, "topics")
            self.warn(run, f"{place} names no topic, a list of {{name, topic, timeout, priority}}: nothing drives")
        for source in self._sources:
            self.listen(source.topic, partial(self._receive_command, source), "geometry_msgs/Twist")
        for lock in self._locks:
            self.listen(lock.topic, partial(self._receive_lock, lock), "std_msgs/Bool")
        self.client.advertise(self.output, "geometry_msgs/Twist")

    def _read_sources(self, run: Run, kind: str) -> list[Source]:
        place = names.join(self.node.full_name, kind)
        value = run.parameter(place) or []
        if not isinstance(value, list):
            raise Refused(f"{place} is a list, not {value!r}")
        return [self._source(entry, place) for entry in value]

    def _source(self, entry: Any, place: str) -> Source:
        try:
            source = Source(self.node.resolve(entry["topic"]), float(entry["timeout"]), int(entry["priority"]))
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError):
            message = f"{place}: an entry has name, topic, timeout (s) and priority, not {entry!r}"
            raise Refused(message) from None
        if not source.timeout_s >= 0.0 or not 0 <= source.priority <= 255:
            numbers = f"timeout {source.timeout_s:g} s and priority {source.priority}"
            bounds = "the timeout must be at least 0 s, the priority 0 to 255"
            raise Refused(f"{place}: {source.topic} has {numbers}; {bounds}")
        return source

    def _receive_command(self, source: Source, type_name: str, came: Message) -> None:
        self._note_time(source, came)
        if self._has_priority(source):
            self.client.publish(self.output, came["msg"], type_name)

    def _receive_lock(self, lock: Source, _: str, came: Message) -> None:
        self._note_time(lock, came)
        self._locked[lock.topic] = came["msg"]["data"]

    def _note_time(self, source: Source, came: Message) -> None:
        """Record the time of a message. When time jumps back, drop all earlier messages."""
        now_s = _seconds(came["time"])
        if now_s < self._now_s:
            self._came_s.clear()
            self._locked.clear()
        self._now_s = self._came_s[source.topic] = now_s

    def _has_priority(self, source: Source) -> bool:
        """True when the source drives now. A lock is locked after its time-out, and before its first message."""
        locked = [one.priority for one in self._locks if self._locked.get(one.topic) or self._is_silent(one)]
        least = max(1, *locked) if locked else 1
        speaking = [one for one in self._sources if one.priority >= least and not self._is_silent(one)]
        return bool(speaking) and max(speaking, key=lambda one: one.priority) == source

    def _is_silent(self, source: Source) -> bool:
        return source.timeout_s > 0.0 and self._now_s - self._came_s.get(source.topic, 0.0) > source.timeout_s


def _seconds(time: Message) -> float:
    return float(time["secs"]) + 1e-9 * float(time["nsecs"])
