"""The blocking client: connect, call, publish, subscribe. The public Python API for scripts.

It keeps no thread: what arrives is sorted into answers, messages and refusals while some call waits. A daemon that
ends is NoDaemon; the client does not connect again. Standard library only.
"""

from __future__ import annotations

import json
import math
import os
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any

from slidectl import __version__, names, paths
from slidectl.client.lines import LONGEST_LINE, BadLine, encode
from slidectl.client.link import ClientLink, SocketLink, command
from slidectl.errors import (
    AmbiguousName,
    MessageRefused,
    NoDaemon,
    Reason,
    Refused,
    SlidectlError,
    TimedOut,
    UnknownName,
    Unused,
    UsageError,
    listing,
)

if TYPE_CHECKING:
    from slidectl.client.action_client import Action

Message = dict[str, Any]

DEFAULT_QUEUE = 1000
STRICT = 2
BEST_EFFORT = 1
UNLOADED = "unloaded"
STARTED = ("running", "waiting")
_MANAGER_SERVICES = ("load_controller", "switch_controller", "unload_controller")
SPAWN_LIMIT_S = 30.0
_PROBE_S = 0.5
_MOST_REFUSALS = 1000
_SYNCHRONIZE = "/rosapi/get_time"
"""A service that changes nothing: its answer says that all that was sent before it has been taken in."""
_NAME_ERRORS = {cause.__name__: cause for cause in (AmbiguousName, UnknownName, Unused)}


class Client:
    """A connection to a daemon. Use it as a context manager: leaving it waits until what was published is taken in.

    It raises MessageRefused then for what was refused, and for a topic of which no message has reached anybody.
    A name without a leading slash is the unique end of a full name, as on the command line.

    Args:
        instance: the daemon's name; by default `SLIDECTL_SOCKET`, `SLIDECTL_INSTANCE` or `default` decide.
        socket: the path of its socket instead.
        timeout: wall seconds that any one wait may take unless it says otherwise; `inf` for ever.
        link: a connection that there is already, instead of a new one.

    It is for one thread: where several use one at a time, one takes the answers of the others. Give each its own.

    Raises:
        NoDaemon: nobody answers. Refused: the socket's folder is not private, or the daemon is another user's.
    """

    def __init__(
        self,
        instance: str | None = None,
        socket: str | None = None,
        timeout: float = 10.0,
        link: ClientLink | None = None,
    ) -> None:
        self._link = link or SocketLink(paths.instance(instance, socket), time.monotonic() + timeout)
        self.paths = self._link.paths
        self.timeout = timeout
        self.reasons: list[Reason] = []
        """What the daemon warned of, or gave as an error, while it carried out the request answered last.

        That is the last `call`, `answer`, `deliver` or `flush`, whether it raised or not.
        """
        self.on_other_version: Callable[[str], None] = lambda _version: None
        """Called once, with the version of a daemon that is not this client's; empty for one that does not say."""
        self._serial = 0
        self._awaited: set[str] = set()
        """Ids of requests whose answers somebody will ask for; other answers are not kept."""
        self._answers: dict[str, Message] = {}
        self._refusals: dict[str, SlidectlError] = {}
        """The first ones, by the id of what was refused."""
        self._subscriptions: dict[str, list[Subscription]] = {}
        self._advertised: dict[tuple[str, str | None, bool], str] = {}
        self._published = False
        self._full_names: dict[tuple[str, str], str] = {}
        self._sent: dict[str, int] = {}
        """Topic -> messages that were published and not latched."""
        self._unheard: dict[str, int] = {}
        """Topic -> those of them that nobody got."""
        self._first_call: str | None = None
        self._handlers: dict[str, Callable[[Message], Message]] = {}
        """Of the services that this client provides."""

    # --- services -----------------------------------------------------------------------------------------------

    def call(self, service: str, request: Message | None = None, *, timeout: float | None = None) -> Message:
        """Call a service and wait for its response; missing fields of the request take their defaults.

        Raises:
            Refused: the service failed; its text and exit code are the daemon's.
            TimedOut: no answer within `timeout` wall seconds. NoDaemon: the daemon went away.
        """
        return self.answer(self.call_async(service, request), timeout=timeout)

    def call_async(self, service: str, request: Message | None = None) -> str:
        """Send a call and return its id at once; `answer` waits for the response."""
        full = self._full("service", service)
        call_id = self._next_id("call")
        self._awaited.add(call_id)
        message = {"op": "call_service", "id": call_id, "service": full, "args": request or {}}
        if self._first_call is None:  # it asks for the daemon's version too, which costs no round trip
            self._first_call = call_id
            message["version"] = __version__
        self._send(**message)
        return call_id

    def answer(self, call_id: str, *, timeout: float | None = None) -> Message:
        """The response to an earlier `call_async`. Raises as `call` does."""
        answer = self._answer(call_id, timeout)
        values = answer.get("values")
        if not answer.get("result", True):
            raise _refusal(Refused, str(values), answer)
        return values if isinstance(values, dict) else {}

    def _answer(self, call_id: str, timeout: float | None) -> Message:
        """Wait for the answer, as it is on the wire."""
        try:
            if call_id not in self._answers:
                self.wait_until(lambda: call_id in self._answers, timeout, "the service did not answer")
        finally:
            self._awaited.discard(call_id)
        answer = self._answers.pop(call_id)
        texts = list(map(str, answer.get("reasons", ())))
        levels = answer.get("levels", ["error"] * len(texts))  # an older daemon does not tell them
        self.reasons = [Reason(text, level) for text, level in zip(texts, levels, strict=True)]
        return answer

    def is_answered(self, call_id: str) -> bool:
        """True when the response to an earlier `call_async` is here: `answer` will not wait."""
        return call_id in self._answers

    def forget(self, call_id: str) -> None:
        """Nobody will ask for the response to an earlier `call_async`."""
        self._awaited.discard(call_id)
        self._answers.pop(call_id, None)

    def advertise_service(self, service: str, type: str, handler: Callable[[Message], Message]) -> None:
        """Provide a service until the client is closed: the handler makes the response of a request.

        Requests are answered while the client waits for something. What the handler raises is the caller's failure. A
        name without a leading slash is in the root.

        Raises:
            Refused: there is such a service already, or no such type.
        """
        service = names.join("/", service)
        if service in self._handlers:
            raise Refused(f"this client provides {service} already")
        advertise_id = self._next_id("advertise")
        self._handlers[service] = handler
        self._send(op="advertise_service", id=advertise_id, service=service, type=type)
        self.call(_SYNCHRONIZE)
        if advertise_id in self._refusals:
            del self._handlers[service]
            raise self._refusals.pop(advertise_id)

    def _serve(self, request: Message) -> None:
        handler = self._handlers.get(request["service"])
        if handler is None:  # whoever advertised it by hand reads `events`
            return
        answer: Message = {"op": "service_response", "id": request["id"], "service": request["service"]}
        try:
            line = _line(answer | {"values": handler(request["args"]), "result": True})
        except Exception as error:  # the caller's, not ours; also about a response that is no JSON
            line = _line(answer | {"values": str(error) or type(error).__name__, "result": False})
        self._link.send(line, self.monotonic() + self.timeout)

    # --- topics -------------------------------------------------------------------------------------------------

    def advertise(self, topic: str, type: str | None = None, latch: bool = False) -> None:
        """Become a publisher of the topic until the client is closed; `latch` keeps the last message for latecomers."""
        if (topic, type, latch) in self._advertised:
            return
        advertise_id = self._advertised[topic, type, latch] = self._next_id("advertise")
        full = self._full("topic", topic, "subscribers", type)
        self._send(op="advertise", id=advertise_id, topic=full, latch=latch, **_typed(type))
        self._published = True

    def publish(self, topic: str, message: Message, type: str | None = None, latch: bool = False) -> None:
        """Send one message. A topic that exists needs no type; `flush` says whether the message was taken."""
        topic = self._full("topic", topic, "subscribers", type)
        if latch:  # it is kept for those who come later
            self._publish(topic, message, type, latch)
        else:
            self._publish(topic, message, type, latch, unheard=True)
            self._sent[topic] = self._sent.get(topic, 0) + 1
        self._published = True

    def _publish(self, topic: str, message: Message, type: str | None, latch: bool, /, **more: Any) -> str:
        """`more` are further fields of the publish object. Returns the id."""
        if type is not None or latch:
            self.advertise(topic, type, latch)
        full, publish_id = self._full("topic", topic, "subscribers", type), self._next_id("publish")
        self._send(op="publish", id=publish_id, topic=full, msg=message, **more)
        return publish_id

    def publish_at(
        self, topic: str, message: Message, time_ns: int, type: str | None = None, latch: bool = False
    ) -> str:
        """Send a message that the daemon publishes at the end of the first cycle with that simulated time or a later.

        Returns an id at once, for `is_answered` and `published`. At most 10000 messages of a client may wait for their
        time. They are not published when the client has gone.
        """
        at = {"secs": time_ns // 10**9, "nsecs": time_ns % 10**9}
        publish_id = self._publish(topic, message, type, latch, at=at, ack=True, **_typed(type))
        self._awaited.add(publish_id)
        return publish_id

    def published(self, publish_id: str, *, timeout: float | None = None) -> bool:
        """Wait until what `publish_at` sent is published; False when its time had passed before it was there.

        Raises:
            MessageRefused, TimedOut, NoDaemon.
        """
        answer = self._answer(publish_id, timeout)
        if publish_id in self._refusals:
            raise self._refusals.pop(publish_id)
        return not answer.get("late", False)

    def deliver(self, topic: str, message: Message, type: str | None = None, latch: bool = False) -> None:
        """`publish` and `flush` in one, in the time of one call. Raises as `flush`."""
        publish_id = self._publish(topic, message, type, latch, ack=True)
        self._awaited.add(publish_id)
        self._flushed(publish_id, None)

    def flush(self, *, timeout: float | None = None) -> None:
        """Wait until all that was sent has been taken in and has reached the subscribers.

        Raises:
            MessageRefused: the first of the refusals that came back, with its exit code; TimedOut, NoDaemon.
        """
        self._flushed(self.call_async(_SYNCHRONIZE), timeout)

    def _flushed(self, call_id: str, timeout: float | None) -> None:
        self._published = False
        self.answer(call_id, timeout=timeout)
        refusals = list(self._refusals.values())
        self._refusals.clear()
        if refusals:
            raise refusals[0]

    def subscribe(
        self,
        topic: str,
        type: str | None = None,
        queue_length: int = 0,
        throttle_rate: int = 0,
        take: Callable[[Message], None] | None = None,
        wait: bool = True,
    ) -> Subscription:
        """Receive the topic's messages from now on.

        Args:
            type: needed only for a topic that nobody has advertised yet.
            queue_length: messages kept for a slow reader, the newest; 0 means 1000.
            throttle_rate: least wall milliseconds between two messages.
            take: called with each publish object (`topic`, `msg`, and the simulated `time` at which it was published;
                with `latch`, where it was published before, that of the subscription) while some call waits; nothing is
                kept then.
            wait: False returns at once, to subscribe many topics from one moment on; `flush` raises what was refused.

        Raises:
            Refused: no such topic, or it has another type.
        """
        topic = self._full("topic", topic, "publishers", type)
        subscription = Subscription(self, topic, self._next_id("subscribe"), queue_length, take)
        options: Message = {"queue_length": queue_length, "throttle_rate": throttle_rate, **_typed(type)}
        if take is not None:
            options["stamped"] = True
        self._subscriptions.setdefault(topic, []).append(subscription)
        try:
            self._send(op="subscribe", id=subscription.id, topic=topic, **options)
            if wait:
                self.call(_SYNCHRONIZE)
        except BaseException:
            self.unsubscribe(subscription)
            raise
        if subscription.id in self._refusals:
            self._subscriptions[topic].remove(subscription)
            raise self._refusals.pop(subscription.id)
        return subscription

    def unsubscribe(self, subscription: Subscription) -> None:
        """What `Subscription.close` does."""
        receivers = self._subscriptions.get(subscription.topic, [])
        if subscription not in receivers:
            return
        receivers.remove(subscription)
        with suppress(NoDaemon):  # a dead daemon has unsubscribed us already
            self._send(op="unsubscribe", id=subscription.id, topic=subscription.topic)

    # --- names --------------------------------------------------------------------------------------------------

    def topics(self, *, timeout: float | None = None) -> dict[str, str]:
        """Every topic with its type."""
        answer = self.call("/rosapi/topics", timeout=timeout)
        return dict(zip(answer["topics"], answer["types"], strict=True))

    def services(self) -> list[str]:
        """Every service, sorted."""
        return list(self.call("/rosapi/services")["services"])

    def _full(self, kind: str, name: str, role: str = "", type: str | None = None) -> str:
        """The full name of a relative one, remembered for this connection. A new topic with a type is in the root."""
        if name.startswith("/"):
            return name
        full = self._full_names.get((kind, name))
        if full is None:
            try:
                full = self.resolve(kind, name, role=role)["name"]
            except Unused:
                full = self.resolve(kind, name)["name"]
            except UnknownName:
                if type is None:
                    raise
                full = names.join("/", name)
            self._full_names[kind, name] = full
        return full

    def resolve(
        self, kind: str, name: str, *, namespace: str = "/", role: str = "", with_field: bool = False
    ) -> Message:
        """What a short name means, as the command line has it: itself, or the one name that ends with it.

        Args:
            kind: `topic`, `service`, `parameter` (or a namespace of parameters), `node` or `robot`.
            namespace: where relative names begin, and which of several is meant.
            role: of a topic: only those with `publishers`, or with `subscribers`; empty for all.
            with_field: of a topic: a field may follow the name.

        Returns:
            slidectl/Resolve's response: `name` is the full name; then `field`, `type`, `typedefs`,
            `response_typedefs` and `nodes`, as far as the kind has them.

        Raises:
            UnknownName: nothing fits. AmbiguousName: several do. Unused: the topic has nobody in the role.
        """
        request = {"kind": kind, "name": name, "namespace": namespace, "role": role, "with_field": with_field}
        call_id = self.call_async("/slidectl/resolve", request)
        answer = self._answer(call_id, None)
        if answer.get("result", True):
            return dict(answer["values"])
        cause = _NAME_ERRORS.get(str(answer.get("cause")))
        if cause is None:
            raise _refusal(Refused, str(answer.get("values")), answer)
        message, _, hint = str(answer.get("values")).partition("\n")
        error = cause.__new__(cause)  # without its constructor, which makes the text that is here already
        SlidectlError.__init__(error, message, hint or None)
        if isinstance(error, AmbiguousName):
            error.matches = list(map(str, answer.get("matches", ())))
        raise error

    # --- the world ----------------------------------------------------------------------------------------------

    def spawn(
        self,
        model: str,
        name: str | None = None,
        at: Sequence[float] = (),
        controllers: str | None = None,
        start: Sequence[str] = (),
        joints: Mapping[str, float] | None = None,
        transmissions: str | None = None,
        **xacro_arguments: str,
    ) -> Message:
        """Put a robot, or all models of a file, into the world, as `slidectl spawn` does.

        Returns slidectl/RobotInfo, of a world the first model's.

        Args:
            model: a shipped model's name, the path of a .xacro, .urdf, .sdf or .world file, or `model://NAME`.
            at: x, y, z in m, or these and roll, pitch, yaw in rad.
            controllers: the YAML file of its controllers' parameters.
            start: controllers to load and start.
            joints: where joints start, rad or m.
            transmissions: `gazebo` or `real`, whatever the model says.

        Raises:
            BadFile, UnknownName, UsageError: before anything is changed. Refused: with the daemon's reason.
        """
        # What reads a robot's files is imported here: a script that spawns none starts without it.
        from slidectl.client import spawning

        if name is not None:
            names.check_robot(name)
        pose = spawning.pose(at)
        if spawning.is_scene(model):
            spawning.check_scene_options(xacro_arguments, controllers, start, joints or {}, transmissions)
            models = spawning.scene(model).named(name)
            self.spawn_models([spawning.request(one, at) for one in models])
            return dict(self.call("/slidectl/list_robots", {"name": models[0].name})["robots"][0])
        document = spawning.document(model, xacro_arguments, name)
        given = {f"{argument}:=" for argument in xacro_arguments}
        for notice in document.report:
            if notice.subject in given:
                raise UsageError(f"{model}: {notice.subject} {notice.text}")
        xml = spawning.with_transmissions(document, transmissions)
        chosen, namespace = spawning.identity(xml, document, name, joints=joints or {})
        spawning.check_free(self.robots(), chosen, namespace)
        if controllers is not None:
            self.params.set_all(spawning.controller_parameters(controllers, namespace))
        manager = self.controllers(namespace)
        known = manager.configured() if start else []
        for wanted in start:
            if wanted not in known:
                raise UnknownName("controller", wanted, known, f"in the parameters of {namespace}")
        self.spawn_urdf(chosen, xml, pose, joints)
        if start:
            manager.bring_up(start, states={})  # the robot is new: it has none yet
        return dict(self.call("/slidectl/list_robots", {"name": chosen})["robots"][0])

    def spawn_urdf(
        self,
        name: str,
        xml: str,
        pose: Message,
        joints: Mapping[str, float] | None = None,
        *,
        timeout: float = SPAWN_LIMIT_S,
    ) -> list[str]:
        """Put a URDF into the world at a geometry_msgs/Pose, with joints where they start (rad or m).

        Returns the world's remarks. Raises Refused.
        """
        request = {"model_name": name, "model_xml": xml, "initial_pose": pose}
        if not joints:
            return self._spawn("urdf", request, timeout)
        with self._spawning() as spawned:  # no moment passes between the two
            self._spawn("urdf", request, timeout)
            spawned.append(name)
            return self.start_joints(name, joints)  # what it was put into with its joints at 0 is not in them

    def start_joints(self, robot: str, positions: Mapping[str, float]) -> list[str]:
        """Put joints of a robot there (rad or m), at rest, and let resets do so too.

        Returns the world's remarks on the robot as it is now. Raises Refused.
        """
        names, values = list(positions), list(positions.values())
        answer = self.call("/slidectl/start_joints", {"robot": robot, "joint_names": names, "joint_positions": values})
        if not answer["success"]:
            raise Refused(answer["message"])
        return list(answer["message"].split("\n")[1:])

    def spawn_models(self, models: Sequence[Message], *, timeout: float = SPAWN_LIMIT_S) -> list[str]:
        """Put models into the world, all or none; it stands still meanwhile. Returns the world's remarks.

        Each of `models` is a request of gazebo_msgs/SpawnModel, of SDF or of the URDF that was made of it.

        Raises:
            Refused: a name is taken, or the world cannot take a model.
        """
        taken = {robot["name"] for robot in self.robots()} & {model["model_name"] for model in models}
        if taken:
            there = ", ".join(repr(name) for name in sorted(taken))
            raise Refused(f"there is already: {there}", f"slidectl delete {' '.join(sorted(taken))}")
        remarks: list[str] = []
        with self._spawning() as spawned:
            for model in models:
                remarks += self._spawn("sdf", model, timeout)
                spawned.append(model["model_name"])  # not before: what could not be spawned may be another's
        return remarks

    @contextmanager
    def _spawning(self) -> Iterator[list[str]]:
        """The world stands still, and the models that are listed leave it again if this fails."""
        was_running = not self.call("/slidectl/status")["paused"]
        spawned: list[str] = []
        if was_running:
            self.call("/gazebo/pause_physics")
        try:
            yield spawned
        except BaseException:
            for name in reversed(spawned):
                with suppress(SlidectlError):
                    self.call("/gazebo/delete_model", {"model_name": name})
            raise
        finally:
            if was_running:
                with suppress(NoDaemon):
                    self.call("/gazebo/unpause_physics")

    def _spawn(self, kind: str, request: Message, timeout: float) -> list[str]:
        answer = self.call(f"/gazebo/spawn_{kind}_model", request, timeout=timeout)
        if not answer["success"]:
            raise Refused(f"cannot spawn {request['model_name']}: {answer['status_message']}")
        return list(answer["status_message"].split("\n")[1:])

    def delete(self, name: str) -> None:
        """Take a robot out of the world. Raises UnknownName, Refused."""
        full = self.resolve("robot", name)["name"]
        answer = self.call("/gazebo/delete_model", {"model_name": full})
        if not answer["success"]:
            raise Refused(f"cannot delete {full}: {answer['status_message']}")

    def robots(self) -> list[Message]:
        """The robots (slidectl/RobotInfo), by name: `name`, `namespace`, `pose`, `links`, `joints`, `controllers`."""
        return sorted(self.call("/slidectl/list_robots")["robots"], key=lambda robot: str(robot["name"]))

    def add_fault(
        self,
        target: str,
        kind: str,
        start: float | None = None,
        end: float | None = None,
        *,
        seed: int = 0,
        name: str = "",
        namespace: str = "/",
        **options: Any,
    ) -> Message:
        """Let something go wrong from one simulated time (s; now) to another (until it is removed).

        Returns slidectl/Fault, with its options as a dict.

        Args:
            target: a joint, link (`robot/joint`), controller or topic; the unique end of its name is enough.
            kind: `sensor-noise`, `joint-stuck` ...; `slidectl fault kinds` lists them with their options.
            seed: of its random numbers.
            name: how it is listed; without one it gets one.
            namespace: where the target is looked for first.

        Raises:
            Refused: with the daemon's reason.
        """
        request = {"target": target, "kind": kind, "seed": seed, "name": name, "namespace": namespace}
        times = {field: [] if time is None else [time] for field, time in (("start", start), ("end", end))}
        answer = self.call("/slidectl/fault/add", {**request, **times, "options": json.dumps(options)})
        return _with_options(answer["fault"])

    def faults(self) -> list[Message]:
        """All faults, each as slidectl/Fault, with what they did so far and their options as a dict."""
        return [_with_options(fault) for fault in self.call("/slidectl/fault/list")["faults"]]

    def remove_faults(self, *names: str) -> list[str]:
        """Take these faults back, or all there are. Returns their names. Raises Refused: one is not there."""
        return list(self.call("/slidectl/fault/remove", {"names": names})["names"])

    def controllers(self, namespace: str) -> Manager:
        """The controller manager of a robot's namespace: load, start, switch, list."""
        return Manager(self, names.join("/", namespace).rstrip("/") or "/")

    def action(self, name: str) -> Action:
        """An action by its name, or by that of a controller with one: send goals, follow and cancel them.

        Raises:
            UnknownName, AmbiguousName.
        """
        from slidectl.client.action_client import Action

        return Action(self, name)

    @property
    def params(self) -> Params:
        """The parameters, as a mapping of names to values."""
        return Params(self)

    def step(self, cycles: int | None = None, *, seconds: float = 0.0, until: float = 0.0) -> float:
        """Pause the world and run so many cycles (1), or simulated seconds, or up to a simulated time above 0.

        Returns the simulated time in s.

        Raises:
            Refused: a time that is no whole number of cycles away, or has passed, or the steps were given up.
        """
        if (cycles is not None) + bool(seconds) + bool(until) > 1:
            raise UsageError("step takes one of cycles, seconds and until")
        count = 1 if cycles is None and not (seconds or until) else cycles or 0
        request = {"cycles": count, "seconds": seconds, "until": until}
        answer = self.call("/slidectl/step", request, timeout=math.inf)
        if not answer["success"]:
            raise Refused(answer["message"])
        return float(answer["time"])

    def sleep(self, seconds: float, *, timeout: float | None = None) -> float:
        """Wait until so many simulated seconds have passed. Returns the simulated time in s.

        `timeout` is in wall seconds; a minute plus ten times the simulated ones when not given. Raises TimedOut, also
        for a world that is paused.
        """
        limit = 60.0 + 10.0 * seconds if timeout is None else timeout
        return float(self.call("/slidectl/sleep", {"duration": seconds}, timeout=limit)["time"])

    def save(self, name: str, file: str | None = None) -> float:
        """Keep the whole state of the world under a name, and write it to the file as well if there is one.

        Returns the simulated time in s. Raises Refused: a switch is under way, or a class has what no snapshot holds.
        """
        return float(self.call("/slidectl/save", {"name": name, "file": _absolute(file)})["time"])

    def load(self, name: str | None = None, file: str | None = None) -> float:
        """Put the world back to what was saved under the name, or what the file holds. Returns the simulated time in s.

        Raises Refused: no such snapshot, one of another version, cut off or damaged, or a switch is under way.
        """
        return float(self.call("/slidectl/load", {"name": name or "", "file": _absolute(file)})["time"])

    def snapshots(self) -> list[Message]:
        """Those that the daemon keeps, in the order of their saving (slidectl/SnapshotInfo)."""
        return list(self.call("/slidectl/snapshots")["snapshots"])

    @contextmanager
    def lockstep(self, period: float = 0.0, timeout: float = 5.0) -> Iterator[LockStep]:
        """Inside, the world goes on only by `step` of what this gives: one period each, of every client in lock-step.

        Args:
            period: simulated seconds, whole cycles; one cycle when not given.
            timeout: wall seconds for which the world waits for this client; then it goes on without it.

        Raises:
            Refused: no whole number of cycles.
        """
        seconds = period or float(self.call("/slidectl/status")["timestep"])
        joined = self.call("/slidectl/lockstep", {"period": seconds, "timeout": timeout})
        lock = LockStep(self, float(joined["time"]))
        try:
            yield lock
        finally:
            with suppress(NoDaemon, Refused):  # it was let go already
                self.call("/slidectl/lockstep", {"leave": True})

    def wait(
        self,
        target: str,
        *,
        near: float | None = None,
        above: float | None = None,
        below: float | None = None,
        equals: Any = None,
        tol: float = 0.01,
        within: float = 0.0,
        for_: float = 0.0,
        timeout: float | None = None,
    ) -> Any:
        """Wait until a field of a topic (`joint_states/position[0]`) meets one condition. Returns its value.

        Args:
            tol: how far `near` may be off.
            within: simulated seconds after which it fails; 0 for no limit.
            for_: simulated seconds that the condition must hold.
            timeout: wall seconds; a minute plus ten times the simulated ones when not given.

        Raises:
            Refused: not met `within`. TimedOut. UnknownName, Unused: no such topic or field.
        """
        conditions = {"near": near, "above": above, "below": below, "equals": equals}
        given = {kind: value for kind, value in conditions.items() if value is not None}
        if len(given) != 1:
            raise UsageError("give exactly one of near, above, below and equals")
        ((condition, value),) = given.items()
        found = self.resolve("topic", target, role="publishers", with_field=True)
        request = {
            "topic": found["name"], "field": found["field"], "condition": condition, "value": json.dumps(value),
            "tolerance": tol, "hold": for_, "within": within,
        }  # fmt: skip
        limit = 60.0 + 10.0 * (within + for_) if timeout is None else timeout
        answer = self.call("/slidectl/wait", request, timeout=limit)
        if not answer["success"]:
            raise Refused(f"{target} was not {condition} {value}: {answer['message']}")
        return json.loads(answer["last"])

    # --- what arrives -------------------------------------------------------------------------------------------

    def events(self, timeout: float = math.inf) -> Iterator[Message]:
        """Every object that arrives, as it is on the wire, until nothing has come for `timeout` seconds."""
        while (message := self._link.receive(self.monotonic() + timeout)) is not None:
            self._sort(message)
            yield message

    def wait_until(self, condition: Callable[[], bool], timeout: float | None, failure: str) -> None:
        """Take in what arrives until the condition is true. Raises TimedOut with the text of `failure`, NoDaemon."""
        seconds = self.timeout if timeout is None else timeout
        if not self._becomes(condition, seconds):
            raise TimedOut(f"{failure} within {seconds:.3g} s", self._why_nothing_happens())

    def _becomes(self, condition: Callable[[], bool], seconds: float) -> bool:
        deadline = self.monotonic() + seconds
        while not condition():
            message = self._link.receive(deadline)
            if message is None:
                return False
            self._sort(message)
        return True

    def _sort(self, message: Message) -> None:
        op = message.get("op")
        self._link.last_status = ""
        if op == "publish":
            for subscription in self._subscriptions.get(message["topic"], ()):
                subscription.put(message)
            return
        if op == "call_service":
            self._serve(message)
        elif op == "status":
            self._take_status(message)
        elif message.get("id") == self._first_call and message.get("version") != __version__:
            self._first_call = ""
            self.on_other_version(str(message.get("version", "")))
        if op in ("service_response", "status") and message.get("id") in self._awaited:
            self._answers[message["id"]] = message

    def _take_status(self, status: Message) -> None:
        for subscription in self._subscriptions.get(status.get("topic", ""), ()):
            subscription.dropped += int(status.get("dropped", 0))
        if status.get("level") == "error":
            self._advertised = {key: sent for key, sent in self._advertised.items() if sent != status.get("id")}
            if len(self._refusals) < _MOST_REFUSALS:
                self._refusals[str(status.get("id"))] = _refusal(MessageRefused, str(status.get("msg", "")), status)
        if status.get("unheard"):
            topic = status["topic"]
            self._unheard[topic] = self._unheard.get(topic, 0) + 1
        if "id" not in status and "dropped" not in status:
            self._link.last_status = str(status.get("msg", ""))

    def _why_nothing_happens(self) -> str | None:
        """The hint of a TimedOut: a paused world answers nobody who waits for its time, and a daemon may hang."""
        call_id = self.call_async("/slidectl/status")
        if not self._becomes(lambda: call_id in self._answers, _PROBE_S):
            self.forget(call_id)
            return "the daemon itself does not answer; see: " + command(self.paths, "daemon logs")
        status = self.answer(call_id)
        if status.get("paused") and status.get("trouble"):
            return f"the simulation is paused ({status['trouble']}); first: {command(self.paths, 'sim reset')}"
        if status.get("paused"):
            return "the simulation is paused; let it go on with: " + command(self.paths, "sim resume")
        if status.get("lockstep"):
            return "the world waits for clients in lock-step: " + listing(status["lockstep"])
        return None

    # --- the connection -----------------------------------------------------------------------------------------

    @property
    def daemon_pid(self) -> int:
        """The daemon's process id, as the kernel gives it."""
        return self._link.daemon_pid

    def another(self) -> Client:
        """A further connection to the same daemon, with the same `timeout`. Raises as a new client."""
        return Client(link=self._link.another(self.monotonic() + self.timeout), timeout=self.timeout)

    def monotonic(self) -> float:
        """The clock of all waits, in s: that of the machine, unless the world is in this process and has its own."""
        return self._link.monotonic()

    def fileno(self) -> int:
        """The socket, for a `select` of the caller's."""
        return self._link.fileno()

    def call_back(self, action: Callable[[], object] | None) -> bool:
        """In a world in this process: call it between two cycles whenever something has come while others wait.

        None: no more. False where the world is in another process, and `fileno` says when something has come.
        """
        return self._link.call_back(action)

    def _send(self, **message: Any) -> None:
        """Raises BadLine: one that the daemon would not take. TimedOut, NoDaemon."""
        self._link.send(_line(message), self.monotonic() + self.timeout)

    def _next_id(self, purpose: str) -> str:
        self._serial += 1
        return f"{purpose}:{self._serial}"

    def close(self) -> None:
        """Let go of the connection at once; what it advertised and subscribed ends with it."""
        self._link.close()

    def __enter__(self) -> Client:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            if kind is None and self._published:
                self.flush()
                for topic, unheard in self._unheard.items():
                    if unheard == self._sent.get(topic):
                        raise MessageRefused(
                            f"nobody subscribes to {topic}: {unheard} published, none of them received"
                        )
        finally:
            self.close()


def _with_options(fault: Message) -> Message:
    return {**fault, "options": json.loads(fault["options"])}


def _line(message: Message) -> bytes:
    """Raises BadLine."""
    line = encode(message)
    if len(line) > LONGEST_LINE:
        raise BadLine(f"a message of {len(line)} bytes is more than the {LONGEST_LINE} that fit a line")
    return line


def _absolute(file: str | None) -> str:
    """For the daemon, which works in another folder."""
    return os.path.abspath(file) if file else ""


def _typed(type: str | None) -> Message:
    return {} if type is None else {"type": type}


def _refusal(cause: type[Refused], text: str, answer: Message) -> Refused:
    error = cause(text)
    error.exit_code = int(answer.get("exit_code", cause.exit_code))
    return error


class Subscription:
    """Messages of one topic, in order. Iterating waits for each without a limit; `get` waits with one.

    `dropped` counts the messages that came faster than they were read and were given up, the oldest first, by the
    daemon or here.
    """

    def __init__(
        self,
        client: Client,
        topic: str,
        subscription_id: str,
        queue_length: int,
        take: Callable[[Message], None] | None = None,
    ) -> None:
        self.topic = topic
        self.id = subscription_id
        self.dropped = 0
        self._client = client
        self._take = take
        self._queue: deque[Message] = deque(maxlen=queue_length or DEFAULT_QUEUE)

    def put(self, published: Message) -> None:
        """Called by the client for each publish object that arrives."""
        if self._take is not None:
            self._take(published)
            return
        if len(self._queue) == self._queue.maxlen:
            self.dropped += 1
        self._queue.append(published["msg"])

    def get(self, timeout: float | None = None) -> Message:
        """The next message; waits at most `timeout` wall seconds (the client's by default, `inf` for ever).

        Raises:
            TimedOut: none came. NoDaemon: the daemon went away.
        """
        queue = self._queue
        if not queue:
            self._client.wait_until(lambda: bool(queue), timeout, f"no message on {self.topic}")
        return queue.popleft()

    def __iter__(self) -> Iterator[Message]:
        return self

    def __next__(self) -> Message:
        return self.get(math.inf)

    def __len__(self) -> int:
        """Messages that are here already."""
        return len(self._queue)

    def close(self) -> None:
        """Unsubscribe. Messages that are here already can still be read."""
        self._client.unsubscribe(self)

    def __enter__(self) -> Subscription:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class LockStep:
    """A client for which the world waits; see Client.lockstep. `time` is the simulated time at which it stands, s."""

    def __init__(self, client: Client, time: float) -> None:
        self._client = client
        self._under_way: str | None = None
        """The call of a step that timed out."""
        self.time = time

    def step(self, timeout: float = math.inf) -> float:
        """Say that this client is done, and wait until its next period is over. Returns the simulated time in s.

        All messages of the period have arrived then.

        Raises:
            TimedOut: not within `timeout` wall seconds: others are not done, or the world is paused. The next `step`
                waits on for the same period. Refused: this client was let go, since the world waited for it for longer
                than its time-out.
        """
        client = self._client
        call = self._under_way = self._under_way or client.call_async("/slidectl/lockstep")
        client.wait_until(lambda: client.is_answered(call), timeout, "the period was not over")
        self._under_way = None
        self.time = float(client.answer(call)["time"])
        return self.time


class Params:
    """The parameters of a daemon. A value is a number, text, truth value, list, or a dict for all below a namespace.

    Names may be short, as on the command line; a new parameter's name begins at the root.
    """

    def __init__(self, client: Client) -> None:
        self._client = client

    def __getitem__(self, name: str) -> Any:
        full = self._client.resolve("parameter", name)["name"]
        return json.loads(self._client.call("/rosapi/get_param", {"name": full})["value"])

    def get(self, name: str, default: Any = None) -> Any:
        """The value, or `default` when there is no such parameter."""
        try:
            return self[name]
        except UnknownName:
            return default

    def __setitem__(self, name: str, value: Any) -> None:
        try:
            full = self._client.resolve("parameter", name)["name"]
        except UnknownName:
            full = names.join("/", name)
        self.set_all({full: value})

    def set_all(self, values: Mapping[str, Any]) -> None:
        """Set several by their full names, all or none. Raises Refused: a loaded controller cannot take a value."""
        texts = [json.dumps(value, allow_nan=False) for value in values.values()]
        self._client.call("/slidectl/set_params", {"names": list(values), "values": texts})

    def __delitem__(self, name: str) -> None:
        full = self._client.resolve("parameter", name)["name"]
        self._client.call("/rosapi/delete_param", {"name": full})

    def names(self) -> list[str]:
        """The full names, sorted."""
        return sorted(self._client.call("/rosapi/get_param_names")["names"])


class Manager:
    """`/<namespace>/controller_manager/*`. What it refuses is raised with the reasons that its answer brings.

    Args:
        warn: called with each warning, and with each error of a request that went well all the same.
        limit_s: wall seconds that one call may take; None: as the client has it.
        timeout_s: longest simulated time that a switch may take; 0: no limit.
    """

    def __init__(
        self,
        client: Client,
        namespace: str,
        warn: Callable[[str], None] = lambda _text: None,
        limit_s: float | None = None,
        timeout_s: float = 0.0,
    ) -> None:
        self.client = client
        self.namespace = namespace
        self.name = names.join(namespace, "controller_manager")
        self.warn = warn
        self._limit_s = limit_s
        self._timeout_s = timeout_s

    def _call(self, verb: str, **request: Any) -> Message:
        return self.client.call(f"{self.name}/{verb}", request, timeout=self._limit_s)

    def _act(self, what: str, verb: str, **request: Any) -> None:
        self._answered(what, self.client.call_async(f"{self.name}/{verb}", request))

    def _answered(self, what: str, call_id: str) -> None:
        """Wait for the answer of a service that says `ok`. Raises Refused."""
        ok = self.client.answer(call_id, timeout=self._limit_s)["ok"]
        reasons = self.client.reasons
        for reason in reasons:
            if ok or reason.is_warning:
                self.warn(reason)
        if not ok:
            raise self.refusal(what, [reason for reason in reasons if not reason.is_warning])

    def refusal(self, what: str, reasons: Sequence[str]) -> Refused:
        """The error of a request that was refused for these reasons."""
        return Refused("\n".join(reasons) or f"cannot {what}, and no reason was given")

    def is_there(self) -> bool:
        """Whether its services exist."""
        known = self.client.services()
        return all(f"{self.name}/{service}" in known for service in _MANAGER_SERVICES)

    def ask_for_controllers(self) -> str:
        """Send the request; `controllers` and `states` take the answer."""
        return self.client.call_async(f"{self.name}/list_controllers")

    def controllers(self, asked: str | None = None) -> list[Message]:
        """The loaded controllers, in load order (controller_manager_msgs/ControllerState)."""
        call_id = self.ask_for_controllers() if asked is None else asked
        return list(self.client.answer(call_id, timeout=self._limit_s)["controller"])

    def states(self, asked: str | None = None) -> dict[str, str]:
        """Name -> state of the loaded controllers."""
        return {controller["name"]: controller["state"] for controller in self.controllers(asked)}

    def update_times(self) -> list[Message]:
        """How long the updates of the loaded controllers took, in load order (slidectl/UpdateTimes)."""
        return list(self.client.call("/slidectl/update_times", {"robot": self.namespace})["controllers"])

    def types(self) -> Message:
        """`types` and `base_classes`, parallel lists."""
        return self._call("list_controller_types")

    def configured(self) -> list[str]:
        """Controllers that have a `type` parameter here, loaded or not."""
        return configured(self.client.params.names(), self.namespace)

    def known(self) -> list[str]:
        """Controllers that are loaded or could be."""
        return sorted({*self.states(), *self.configured()})

    def type_parameter(self, name: str) -> str:
        """The type that the parameters give a controller; empty when they give none."""
        request = {"name": names.join(self.namespace, f"{name}/type"), "default": '""'}
        return str(json.loads(self.client.call("/rosapi/get_param", request)["value"]))

    def load(self, name: str) -> None:
        """Raises Refused with the reason."""
        self._act(f"load {name}", "load_controller", name=name)

    def unload(self, name: str) -> None:
        """Raises Refused with the reason."""
        self._act(f"unload {name}", "unload_controller", name=name)

    def switch(
        self, start: Sequence[str], stop: Sequence[str] = (), strictness: int = STRICT, asap: bool = False
    ) -> None:
        """Stop and start in one cycle. Raises Refused with the reasons."""
        wishes = [f"{verb} {', '.join(wanted)}" for verb, wanted in (("stop", stop), ("start", start)) if wanted]
        self._act(
            " and ".join(wishes) or "switch",
            "switch_controller",
            start_controllers=list(start),
            stop_controllers=list(stop),
            strictness=strictness,
            start_asap=asap,
            timeout=self._timeout_s,
        )

    def reload_libraries(self) -> None:
        """Raises Refused when controllers are in the way."""
        self._act("reload the libraries", "reload_controller_libraries", force_kill=True)

    def load_file(self, name: str, file: str, class_name: str = "") -> None:
        """Load a controller of a class in a Python file (an absolute path). Raises Refused with the reason."""
        request = {"robot": self.namespace, "name": name, "file": file, "class_name": class_name}
        self._answered(f"load {name}", self.client.call_async("/slidectl/load_controller_file", request))

    def reload(self, name: str) -> None:
        """Put a controller of a user in its place as its file is now. Raises Refused with the reasons."""
        request = {"robot": self.namespace, "name": name}
        before = self.states().get(name)
        self._answered(f"reload {name}", self.client.call_async("/slidectl/reload_controller", request))
        if before in STARTED or before == "aborted":
            self.check_started([name])

    def ask_to_load(self, wanted: Sequence[str]) -> dict[str, str]:
        """Send the requests; `loaded` takes the answers."""
        service = f"{self.name}/load_controller"
        return {name: self.client.call_async(service, {"name": name}) for name in dict.fromkeys(wanted)}

    def loaded(self, calls: dict[str, str]) -> None:
        """The answers to `ask_to_load`. Raises Refused with what went wrong."""
        each(lambda name: self._answered(f"load {name}", calls[name]), list(calls))

    def bring_up(
        self,
        wanted: Sequence[str],
        start: bool = True,
        *,
        stop: Sequence[str] = (),
        states: Mapping[str, str] | None = None,
        loads: dict[str, str] | None = None,
    ) -> dict[str, str]:
        """Load what is not loaded, then start what does not run in one strict switch. Returns the states afterwards.

        Args:
            stop: running controllers that the same switch stops.
            states: those before; None: they are asked for.
            loads: calls of `ask_to_load` that are under way; None: what is not loaded is asked for here.

        Raises:
            Refused: what cannot be loaded, and then nothing is started; or what did not start.
        """
        states = self.states() if states is None else states
        self.loaded(self.ask_to_load([name for name in wanted if name not in states]) if loads is None else loads)
        idle = [name for name in dict.fromkeys(wanted) if states.get(name) != "running"]
        return self.start(idle, stop) if start and (idle or stop) else self.states()

    def start(self, wanted: Sequence[str], stop: Sequence[str] = ()) -> dict[str, str]:
        """Start loaded controllers in one strict switch, and see that they run. Returns the states. Raises Refused."""
        self.switch(wanted, stop)
        return self.check_started(wanted)

    def check_started(self, wanted: Sequence[str]) -> dict[str, str]:
        """A switch may be done and a controller still not run: it was aborted. Returns the states. Raises Refused."""
        states = self.states()
        failed = [f"{name} is {states.get(name, UNLOADED)}" for name in wanted if states.get(name) not in STARTED]
        if failed:
            raise Refused(f"did not start: {', '.join(failed)}", "slidectl daemon logs says why")
        return states


def configured(parameters: Sequence[str], namespace: str) -> list[str]:
    """Controllers of a namespace that have a `type` among these parameters."""
    prefix = namespace.rstrip("/") + "/"
    inside = (name.removeprefix(prefix) for name in parameters if name.startswith(prefix))
    return [name.removesuffix("/type") for name in inside if name.endswith("/type") and name.count("/") == 1]


def claimed_text(resources: Sequence[Message]) -> str:
    """`EffortJointInterface: joint1 joint2`, several parted by semicolons."""
    parts = ((item["hardware_interface"].rpartition("::")[2], item["resources"]) for item in resources)
    return "; ".join(f"{interface}: {' '.join(claimed)}" if claimed else interface for interface, claimed in parts)


def each(action: Callable[[str], None], wanted: Sequence[str]) -> None:
    """Try all of them; then raise Refused with what went wrong."""
    failures = []
    for name in wanted:
        try:
            action(name)
        except Refused as error:
            failures.append(str(error))
    if failures:
        raise Refused("\n".join(failures))
