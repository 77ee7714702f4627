"""relay, throttle and mux of topic_tools, and twist_mux: topics that pass on what comes on others.

Each has a connection of its own, which is there as long as the node. A topic that nobody has made yet is looked for
again. Knows no type of message but Twist and Bool.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

from slidectl import names
from slidectl.client import Client
from slidectl.client.client import Subscription
from slidectl.errors import Refused, UnknownName
from slidectl.launch.plan import LaunchPlan, Node
from slidectl.launch.task import Run, Task, number, parse

Message = dict[str, Any]
Take = Callable[[str, Message], None]
"""Takes the type of a message, and the message."""

_LOOK_AGAIN_S = 0.2
_WITHOUT_EFFECT = ("lazy", "wall_clock")
NONE = "__none"
"""What a mux selects that passes on nothing."""


class TopicTool(Task):
    """What all of them share: topics that they listen to, and one that they publish."""

    family = "topics"
    needs_presence = True
    output: str
    client: Client

    def __init__(self, node: Node, plan: LaunchPlan) -> None:
        super().__init__(node, plan)
        self._run: Run | None = None
        self._inputs: dict[str, tuple[str | None, Take]] = {}
        self._heard: dict[str, tuple[str, Subscription]] = {}

    def begin(self, run: Run) -> None:
        """Listen to topics, and offer services. Raises SlidectlError."""
        raise NotImplementedError

    def start(self, run: Run) -> str | None:
        self._run = run
        self.client = run.client.another()
        for name in _WITHOUT_EFFECT:
            if run.parameter(names.join(self.node.full_name, name)):
                self.warn(run, f"the parameter {name} has no effect")
        self.begin(run)
        self._look_again()
        run.watch.add(self.client.fileno(), self._read)
        self.settled(run, self.text)
        return None

    def stop(self, run: Run) -> None:
        if self._run is not None:
            self._run = None
            run.watch.remove(self.client.fileno())
            self.client.close()

    def listen(self, topic: str, take: Take, type_name: str | None = None) -> None:
        """Take what comes on the topic; of one that nobody has made, without a type, as soon as it is there."""
        self._inputs[topic] = type_name, take

    def ignore(self, topic: str) -> None:
        """Listen no more."""
        self._inputs.pop(topic, None)
        if topic in self._heard:
            self._heard.pop(topic)[1].close()

    def publish(self, type_name: str, message: Message) -> None:
        """Pass a message on."""
        self.client.publish(self.output, message, type_name)

    def now_s(self) -> float:
        """Simulated time."""
        return _seconds(self.client.call("/rosapi/get_time")["time"])

    def subscribe_new(self) -> None:
        """Subscribe what is listened to and was not there before."""
        wanted = {topic: given for topic, (given, _) in self._inputs.items() if topic not in self._heard}
        there = self.client.topics() if wanted else {}
        for topic, given in wanted.items():
            if (type_name := given or there.get(topic)) is not None:
                self._heard[topic] = type_name, self.client.subscribe(topic, type_name)

    def _look_again(self) -> None:
        if self._run is None:
            return
        self.subscribe_new()
        self._pass_on()
        if len(self._heard) < len(self._inputs):
            self._run.watch.later(_LOOK_AGAIN_S, self._look_again)

    def _read(self) -> None:
        for _ in self.client.events(0.0):
            pass
        self._pass_on()

    def _pass_on(self) -> None:
        for topic, (type_name, subscription) in tuple(self._heard.items()):
            while len(subscription) and topic in self._inputs:
                self._inputs[topic][1](type_name, subscription.get(0.0))


class Relay(TopicTool):
    """topic_tools' relay: `relay IN [OUT]`, OUT being IN_relay."""

    suffix = "_relay"
    usage = "IN [OUT]"

    def __init__(self, node: Node, plan: LaunchPlan) -> None:
        super().__init__(node, plan)
        words = self.read(parse(node, {}).rest)
        if not 1 <= len(words) <= 2:
            raise self.error(f"takes {self.usage}, not {' '.join(node.words)!r}")
        self.input = node.resolve(words[0])
        self.output = node.resolve(words[1] if len(words) == 2 else words[0] + self.suffix)
        if self.input == self.output:
            raise self.error(f"passes {self.input} on to itself", "the two topics must differ")

    def read(self, words: list[str]) -> list[str]:
        """Take in what is not one of the topics; returns these. Raises BadFile."""
        return words

    @property
    def text(self) -> str:
        return f"passes {self.input} on to {self.output}"

    def begin(self, run: Run) -> None:  # noqa: ARG002
        self.listen(self.input, self.publish)


class Throttle(Relay):
    """topic_tools' throttle: so many messages a second, or so many bytes in a window of seconds.

    The time of a message is the stamp in its header if it has one, else that of the world when it comes here.
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
        what = f"bytes in {self._window_s:g} s" if self._window_s else "messages a second"
        return f"{super().text}, {self._rate:g} {what}"

    def begin(self, run: Run) -> None:  # noqa: ARG002
        self.listen(self.input, self._take)

    def _take(self, type_name: str, message: Message) -> None:
        header = message.get("header")
        stamped_s = _seconds(header["stamp"]) if isinstance(header, dict) and "stamp" in header else 0.0
        now_s = stamped_s or self.now_s()
        if now_s < self._last_s:  # time was set back
            self._last_s = float("-inf")
            self._sent.clear()
        if self._fits(type_name, message, now_s):
            self._last_s = now_s
            self.publish(type_name, message)

    def _fits(self, type_name: str, message: Message, now_s: float) -> bool:
        if not self._window_s:
            return now_s - self._last_s > 1.0 / self._rate - _ROUNDING_S
        from slidectl.msgs import fields, sizes

        while self._sent and self._sent[0][0] < now_s - self._window_s:
            self._sent.popleft()
        if sum(size for _, size in self._sent) >= self._rate:
            return False
        self._sent.append((now_s, sizes.size(fields, type_name, message)))
        return True


_ROUNDING_S = 1e-9
"""Stamps of 10 Hz are not more than 0.1 s apart, and meant to be."""


class Mux(TopicTool):
    """topic_tools' mux: `mux OUT IN...` passes on the selected one of its inputs, at first the first one."""

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
        self.listen(self.selected, self.publish)
        self._tell()

    def _tell(self) -> None:
        topic = self.node.resolve("mux/selected")
        self.client.publish(topic, {"data": self.selected}, "std_msgs/String", latch=True)

    def _select(self, request: Message) -> Message:
        wanted, before = request["topic"], self.selected
        wanted = NONE if wanted == NONE else self._known(wanted)
        if before != NONE:
            self.ignore(before)
        self.selected = wanted
        if wanted != NONE:
            self.listen(wanted, self.publish)
        self._tell()
        assert self._run is not None
        self._run.watch.later(0.0, self._look_again)
        return {"prev_topic": before}

    def _add(self, request: Message) -> Message:
        topic = self.node.resolve(request["topic"])
        if topic in self.topics or request["topic"] == NONE:
            raise Refused(f"{self.node.full_name} has the input {request['topic']} already")
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
    """An entry of twist_mux's `topics` or `locks`."""

    topic: str
    timeout_s: float
    """0: what comes counts for ever."""
    priority: int


class TwistMux(TopicTool):
    """twist_mux: of the sources that speak the one with the highest priority drives, unless a lock has a higher one."""

    def __init__(self, node: Node, plan: LaunchPlan) -> None:
        super().__init__(node, plan)
        if parse(node, {}).rest:
            raise self.error("takes no arguments", "its topics and locks are parameters")
        self.output = node.resolve("cmd_vel_out")
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
            self.listen(source.topic, self._taking(source), "geometry_msgs/Twist")
        for lock in self._locks:
            self.listen(lock.topic, self._locking(lock), "std_msgs/Bool")
        self.client.advertise(self.output, "geometry_msgs/Twist")

    def _read_sources(self, run: Run, kind: str) -> list[Source]:
        place = names.join(self.node.full_name, kind)
        value = run.parameter(place) or []
        if not isinstance(value, list):
            raise Refused(f"{place} is a list, not {value!r}")
        return [self._source(entry, place) for entry in value]

    def _source(self, entry: Any, place: str) -> Source:
        try:
            topic, timeout_s, priority = entry["topic"], float(entry["timeout"]), int(entry["priority"])
        except (KeyError, TypeError, ValueError):
            message = f"{place}: an entry has name, topic, timeout (s) and priority, not {entry!r}"
            raise Refused(message) from None
        if timeout_s < 0.0 or not 0 <= priority <= 255:
            raise Refused(f"{place}: {topic} has timeout {timeout_s:g} s and priority {priority}; 0 up, and 0 to 255")
        return Source(self.node.resolve(topic), timeout_s, priority)

    def _taking(self, source: Source) -> Take:
        def take(type_name: str, message: Message) -> None:
            now_s = self._came_s[source.topic] = self.now_s()
            if self._has_priority(source, now_s):
                self.publish(type_name, message)

        return take

    def _locking(self, lock: Source) -> Take:
        def take(_: str, message: Message) -> None:
            self._came_s[lock.topic], self._locked[lock.topic] = self.now_s(), message["data"]

        return take

    def _has_priority(self, source: Source, now_s: float) -> bool:
        """A lock whose time-out has passed counts as locked, as it does before its first message."""
        locked = [one.priority for one in self._locks if self._locked.get(one.topic) or self._is_silent(one, now_s)]
        least, best = max(locked, default=0), None
        for one in self._sources:
            speaks = not self._is_silent(one, now_s) and one.priority >= least
            if speaks and one.priority > (best.priority if best else 0):
                best = one
        return best == source

    def _is_silent(self, source: Source, now_s: float) -> bool:
        return source.timeout_s > 0.0 and now_s - self._came_s.get(source.topic, 0.0) > source.timeout_s


def _seconds(time: Message) -> float:
    return float(time["secs"]) + 1e-9 * float(time["nsecs"])
