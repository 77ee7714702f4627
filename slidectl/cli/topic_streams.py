"""Functions for all commands on topics: the topic that a name means, its types, and the stream of its messages.

All information is from the daemon (`/slidectl/resolve`, rosapi): no message definition is read here.
"""

from __future__ import annotations

import math
import re
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from types import TracebackType
from typing import TYPE_CHECKING, Any, NamedTuple

from slidectl import names
from slidectl.cli.output import check_reader
from slidectl.errors import TimedOut, UnknownName, listing
from slidectl.msgs.schema import Typedefs, nanoseconds

if TYPE_CHECKING:
    from slidectl.cli.context import Context, Target
    from slidectl.client import Subscription
    from slidectl.msgs.typed import StatusResponseMsg

PUBLISHERS = "publishers"
SUBSCRIBERS = "subscribers"
CLOCK = "/clock"
_SILENCE_S = 1.0
_ASK_AGAIN_S = 5.0
_LOOK_EVERY_S = 0.2
_LOOK_AGAIN_S = 0.1
ANY_TYPE = "*"
"""The type of a subscription that begins before the topic exists."""

# --- names ----------------------------------------------------------------------------------------------------------


def find_published_topic(ctx: Context, text: str) -> Target:
    """The topic, and its field, that `text` means among those that somebody publishes. Raises as `find_topic`."""
    try:
        return ctx.find_topic(text, PUBLISHERS)
    except UnknownName as error:
        if re.search(r"(^|/)joint_?states?(/|\[|$)", text):
            error.hint = f"{error.hint}\n{step_to_joint_states(ctx)}"
        raise


def wait_for_topic(ctx: Context, name: str, tell: Callable[[str], None]) -> tuple[Target, list[Subscription]]:
    """The topic that a full name means, with a field behind it, when it exists; its subscription, if it had to wait.

    The subscription begins before the topic does, so that no message is missed. `tell` takes the full name, when the
    wait begins.

    Raises:
        TimedOut: the topic does not exist after `--timeout`; without it the wait has no limit. AmbiguousName.
    """
    try:
        return ctx.find_topic(name, None), []
    except UnknownName:
        tell(name)
    limit = ctx.wait_limit(math.inf)
    deadline = ctx.client.monotonic() + limit
    # The end of the name may be a field: each of these may be the topic.
    words = name.partition("[")[0].strip("/").split("/")
    beginnings = ("/" + "/".join(words[:count]) for count in range(1, len(words) + 1))
    possible = [topic for topic in beginnings if names.is_legal(topic)]  # others are never published
    begun = {topic: ctx.client.subscribe(topic, ANY_TYPE) for topic in possible}
    while True:
        try:
            target = ctx.find_topic(name, None)  # its publisher may have gone again
        except UnknownName as error:
            if ctx.client.monotonic() >= deadline:
                raise TimedOut(f"nobody published {name} within {limit:g} s", error.hint) from None
        else:
            for topic, subscription in begun.items():
                if topic != target.topic:
                    subscription.close()
            return target, [begun[target.topic]]
        check_reader()
        ctx.pause(_LOOK_AGAIN_S)


def users_of(ctx: Context, topics: Iterable[str], role: str) -> dict[str, list[str]]:
    """Topic -> the nodes in that role. The requests are sent all together."""
    calls = {topic: ctx.client.call_async(f"/rosapi/{role}", {"topic": topic}) for topic in topics}
    return {topic: list(ctx.client.answer(call)[role]) for topic, call in calls.items()}


def details(ctx: Context, type_name: str) -> Typedefs:
    """The typedefs of a message type. Raises Refused (with the daemon's text) for an unknown one."""
    return list(ctx.call("/rosapi/message_details", {"type": type_name})["typedefs"])


# --- what must run first ---------------------------------------------------------------------------------------------


def next_step(ctx: Context, topic: str) -> str | None:
    """A hint with the command that must run before a controller takes messages on `topic`; None when none must."""
    steps = _steps(ctx, names.parent(names.join("/", topic)))
    return steps[0] if steps and topic.rpartition("/")[2] == "command" else None


def step_to_joint_states(ctx: Context) -> str:
    """A hint with the command that must run before there are joint states."""
    steps = _steps(ctx, "/joint_state_controller")
    return steps[0] if steps else "a running joint_state_controller publishes them: slidectl controller list"


def _steps(ctx: Context, node: str) -> list[str]:
    """What must be done before a controller runs: a step for each robot, or one when it only has to be loaded.

    `node` is the name of the controller's node, or its end.
    """
    above = node + "/"
    found = ctx.managers()
    steps = [] if found else ["no robot with controllers is in the world; spawn one: slidectl spawn slider"]
    for manager in found:
        space, states, configured = manager.namespace, manager.states(), manager.configured()
        waiting = [name for name in configured if name not in states]
        if controller := next((name for name in waiting if above.endswith(f"/{name}/")), None):
            return [f"{controller} is not loaded; load and start it: slidectl controller spawn {controller}"]
        if waiting:
            steps.append(f"not loaded in {space}: {listing(waiting)}; load and start: slidectl controller spawn NAME")
        elif not states:
            load_them = "load their configuration: slidectl controller config FILE.yaml"
            steps.append(f"{space} has no controllers yet; {load_them}")
    return steps


# --- messages -------------------------------------------------------------------------------------------------------


class Event(NamedTuple):
    """One message. `time_ns` is its simulated arrival time (0 when the stream does not follow the clock)."""

    topic: str
    message: dict[str, Any]
    time_ns: int


class Stream:
    """The messages of some topics. A context manager, which prints the number of dropped messages on stderr at its end.

    `with_clock` follows /clock too; `sim_seconds` of simulated time end the stream. `begun` are subscriptions of the
    topics that have begun before.
    """

    def __init__(
        self,
        ctx: Context,
        topics: list[str],
        *,
        with_clock: bool = False,
        sim_seconds: float | None = None,
        begun: Sequence[Subscription] = (),
    ) -> None:
        self._ctx = ctx
        self._client = ctx.client
        self._topics = topics
        self._with_clock = with_clock
        self.sim_seconds = sim_seconds
        self._queue: deque[Event] = deque()
        self._subscriptions: list[Subscription] = list(begun)
        self._sleep: str | None = None
        self._status: str | None = None
        self._ask_at = math.inf
        self._look_at = 0.0
        self.time_ns = 0
        self.ended = False

    def __enter__(self) -> Stream:
        topics = self._topics
        if self._with_clock:
            self.time_ns = nanoseconds(self._client.call("/rosapi/get_time")["time"])
            topics = [CLOCK, *(topic for topic in topics if topic != CLOCK)]  # the clock before messages at its time
        if self.sim_seconds is not None:  # before the topics: it has begun when a publisher sees the subscriber
            self._sleep = self._client.call_async("/slidectl/sleep", {"duration": self.sim_seconds})
        begun = {subscription.topic for subscription in self._subscriptions}
        for topic in [topic for topic in topics if topic not in begun]:
            self._subscriptions.append(self._client.subscribe(topic))
        self._ask_at = self.monotonic() + _SILENCE_S
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for subscription in self._subscriptions:
            subscription.tells = False  # told below, of all together
            subscription.close()
        dropped = sum(subscription.dropped for subscription in self._subscriptions)
        if dropped:
            self._ctx.warn(f"{dropped} messages were dropped: they came faster than they were read")

    def next(self, deadline: float = math.inf) -> Event | None:
        """The next message, or None: at the deadline (of `monotonic`), or at the end, when `ended` is true.

        Raises:
            NoDaemon: the daemon ended. Refused: the wait for the simulated time failed. ClosedPipe.
        """
        while not self._receive() and not self.ended:
            now = self.monotonic()
            if self._sleep is not None and self._client.is_answered(self._sleep):
                self._client.answer(self._sleep)
                self.ended = True
            elif now >= deadline:
                return None
            else:
                if now >= self._look_at:  # notice a closed output although there is nothing to write
                    self._look_at = now + _LOOK_EVERY_S
                    check_reader()
                self._ask_status(now)
                next(self._client.events(max(0.0, min(deadline, self._ask_at, self._look_at) - now)), None)
        return self._queue.popleft() if self._queue else None

    def monotonic(self) -> float:
        """The time in s on the clock of deadlines."""
        return self._client.monotonic()

    @property
    def is_drained(self) -> bool:
        """True when all messages that arrived were read; latched messages arrive on entry."""
        return not self._receive()

    def _receive(self) -> bool:
        """Queue the messages that have arrived. True when there is a message to read."""
        for subscription in self._subscriptions:
            while len(subscription):
                message = subscription.get()
                if self._ask_at < math.inf:
                    self._ask_at = self.monotonic() + _SILENCE_S
                if self._with_clock and subscription.topic == CLOCK:
                    self.time_ns = nanoseconds(message["clock"])
                if subscription.topic in self._topics:
                    self._queue.append(Event(subscription.topic, message, self.time_ns))
        return bool(self._queue)

    def _ask_status(self, now: float) -> None:
        """After some time without a message, ask for the status; print once when the world is paused."""
        if self._status is not None and self._client.is_answered(self._status):
            status: Any = self._client.answer(self._status)
            self._status = None
            if remark := pause_remark(status, "nothing comes until it goes on"):
                self._ask_at = math.inf
                self._ctx.say(remark)
        if now >= self._ask_at:
            self._ask_at = now + _ASK_AGAIN_S
            self._status = self._client.call_async("/slidectl/status")


def pause_remark(status: StatusResponseMsg, effect: str = "this waits until it goes on") -> str:
    """That the world is paused, the effect of that, and the commands that resume it; empty when it runs.

    Takes the answer of /slidectl/status.
    """
    if not status["paused"]:
        return ""
    if status["trouble"]:
        return f"the simulation is paused ({status['trouble']}); {effect}: slidectl sim reset, then slidectl sim resume"
    return f"the simulation is paused; {effect}: slidectl sim resume, or slidectl sim step"


# --- text -----------------------------------------------------------------------------------------------------------

Users = Mapping[str, Sequence[str]]
"""Topic -> nodes."""


def usage_of_topics(types: Mapping[str, str], publishers: Users | None, subscribers: Users | None) -> str:
    """The text of `rostopic list -v`, topics in the order of `types`; None leaves a section out."""
    parts = []
    for title, users, role in (("Published", publishers, PUBLISHERS), ("Subscribed", subscribers, SUBSCRIBERS)):
        if users is not None:
            counts = [(topic, kind, len(users[topic])) for topic, kind in types.items() if users[topic]]
            lines = [f" * {topic} [{kind}] {n} {role if n > 1 else role[:-1]}" for topic, kind, n in counts]
            parts.append("\n".join([f"{title} topics:", *lines]) + "\n")
    return "\n" + "\n".join(parts) + "\n"


def usage_of_topic(kind: str, publishers: Sequence[str], subscribers: Sequence[str], uri: str) -> str:
    """The text of `rostopic info`; `uri` is the URI of the nodes."""
    users = {"Publishers": publishers, "Subscribers": subscribers}
    blocks = [block(title, [f"{node} ({uri})" for node in nodes]) for title, nodes in users.items()]
    return f"Type: {kind}\n\n" + "\n".join(blocks) + "\n\n"


def block(title: str, items: Sequence[str]) -> str:
    """A list as `rostopic info` and `rosnode info` print it."""
    return f"{title}: \n" + "".join(f" * {item}\n" for item in items) if items else f"{title}: None\n"
