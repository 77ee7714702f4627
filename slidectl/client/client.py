"""The blocking client: connect, call, publish, subscribe. The public Python API for scripts.

The client starts no thread: what arrives is sorted into answers, messages and refusals while a call waits. When the
daemon ends, calls raise NoDaemon; the client does not connect again. Standard library only.
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
"""A service that changes nothing. Its answer means that the daemon has processed everything sent before it."""
_NAME_ERRORS = {cause.__name__: cause for cause in (AmbiguousName, UnknownName, Unused)}


class Client:
    """A connection to a daemon. Use it as a context manager: leaving it waits until the daemon has taken what was
    published.

    Leaving it raises MessageRefused for a refused message, and for a topic none of whose messages reached a subscriber.
    A name without a leading slash is the unique end of a full name, as on the command line.

    Args:
        instance: the daemon's name; by default `SLIDECTL_SOCKET`, `SLIDECTL_INSTANCE` or `default` decide.
        socket: the path of the daemon's socket, instead of `instance`.
        timeout: default limit of each wait in wall seconds; `inf` for no limit.
        link: an existing connection to use instead of a new one.

    Use a client from one thread only: threads that share one take each other's answers. Give each thread its own.

    Raises:
        NoDaemon: no daemon answers. Refused: the socket's folder is not private, or the daemon is another user's.
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
        self.reasons: list[str] = []
        """The daemon's warnings and errors from the request that was answered last.

        That is the last `call`, `answer`, `deliver` or `flush`, whether it raised or not. `warnings` and `errors` have
        them apart.
        """
        self.warnings: list[str] = []
        self.errors: list[str] = []
        self.on_other_version: Callable[[str], None] = lambda _version: None
        """Called once with the daemon's version if it differs from the client's; empty if the daemon sends none."""
        self._serial = 0
        self._awaited: set[str] = set()
        """Ids of the requests whose answers are kept for `answer`; other answers are discarded."""
        self._answers: dict[str, Message] = {}
        self._refusals: dict[str, SlidectlError] = {}
        """Request id -> its first error."""
        self._subscriptions: dict[str, list[Subscription]] = {}
        self._advertised: dict[tuple[str, str | None, bool], str] = {}
        self._published = False
        self._full_names: dict[tuple[str, str], str] = {}
        self._sent: dict[str, int] = {}
        """Topic -> number of messages published without latch."""
        self._unheard: dict[str, int] = {}
        """Topic -> number of those messages that no subscriber received."""
        self._first_call: str | None = None
        self._handlers: dict[str, Callable[[Message], Message]] = {}
        """Service -> handler, of the services that this client provides."""

    # --- services -----------------------------------------------------------------------------------------------

    def call(self, service: str, request: Message | None = None, *, timeout: float | None = None) -> Message:
        """Call a service and wait for its response; missing fields of the request take their defaults.

        Raises:
            Refused: the service failed; its text and exit code are the daemon's.
            TimedOut: no answer within `timeout` wall seconds. NoDaemon: the daemon went away.
        """
        return self.answer(self.call_async(service, request), timeout=timeout)

    def call_async(self, service: str, request: Message | None = None) -> str:
        """Send a call and return its id without waiting; `answer` waits for the response."""
        full = self._full("service", service)
        call_id = self._next_id("call")
        self._awaited.add(call_id)
        message = {"op": "call_service", "id": call_id, "service": full, "args": request or {}}
        if self._first_call is None:  # the first call also asks for the daemon's version: no extra round trip
            self._first_call = call_id
            message["version"] = __version__
        self._send(**message)
        return call_id

    def answer(self, call_id: str, *, timeout: float | None = None) -> Message:
        """Wait for the response to an earlier `call_async` and return it. Raises as `call` does."""
        answer = self._answer(call_id, timeout)
        values = answer.get("values")
        if not answer.get("result", True):
            raise _refusal(Refused, str(values), answer)
        return values if isinstance(values, dict) else {}

    def _answer(self, call_id: str, timeout: float | None) -> Message:
        """Wait for the answer and return the object as received."""
        try:
            if call_id not in self._answers:
                self.wait_until(lambda: call_id in self._answers, timeout, "the service did not answer")
        finally:
            self._awaited.discard(call_id)
        answer = self._answers.pop(call_id)
        texts = list(map(str, answer.get("reasons", ())))
        levels = answer.get("levels", ["error"] * len(texts))  # an older daemon sends no levels
        self.reasons = texts
        self.warnings = [text for text, level in zip(texts, levels, strict=True) if level == "warn"]
        self.errors = [text for text, level in zip(texts, levels, strict=True) if level != "warn"]
        return answer

    def is_answered(self, call_id: str) -> bool:
        """True when the response to an earlier `call_async` has arrived: `answer` will not wait."""
        return call_id in self._answers

    def forget(self, call_id: str) -> None:
        """Discard the response to an earlier `call_async`, now or when it arrives."""
        self._awaited.discard(call_id)
        self._answers.pop(call_id, None)

    def restrict(self, *permitted: str) -> None:
        """Give up all effects but these on this connection, for good: "reads", "writes", "files", "code".

        For programs that act for others, as gateways do: the daemon refuses the rest. Raises Refused: no such effect.
        """
        restrict_id = self._next_id("restrict")
        self._send(op="restrict", id=restrict_id, permitted=list(permitted))
        self.call(_SYNCHRONIZE)
        if restrict_id in self._refusals:
            raise self._refusals.pop(restrict_id)

    def advertise_service(
        self, service: str, type: str, handler: Callable[[Message], Message], effect: str = "writes"
    ) -> None:
        """Provide a service until the client is closed. The handler takes a request and returns the response.

        With the effect "reads" clients may call it that may only read.

        Requests are answered while the client waits in a call. An exception of the handler is the failure of the
        caller's call. A name without a leading slash is in the root namespace.

        Raises:
            Refused: the service exists already, or the type does not exist.
        """
        service = names.join("/", service)
        if service in self._handlers:
            raise Refused(f"this client provides {service} already")
        advertise_id = self._next_id("advertise")
        self._handlers[service] = handler
        self._send(op="advertise_service", id=advertise_id, service=service, type=type, effect=effect)
        self.call(_SYNCHRONIZE)
        if advertise_id in self._refusals:
            del self._handlers[service]
            raise self._refusals.pop(advertise_id)

    def _serve(self, request: Message) -> None:
        handler = self._handlers.get(request["service"])
        if handler is None:  # a script that advertised the service without a handler reads `events`
            return
        answer: Message = {"op": "service_response", "id": request["id"], "service": request["service"]}
        try:
            line = _line(answer | {"values": handler(request["args"]), "result": True})
        except Exception as error:  # reported to the caller; also raised for a response that JSON cannot hold
            line = _line(answer | {"values": str(error) or type(error).__name__, "result": False})
        self._link.send(line, self.monotonic() + self.timeout)

    # --- topics -------------------------------------------------------------------------------------------------

    def advertise(self, topic: str, type: str | None = None, latch: bool = False) -> None:
        """Become a publisher until the client is closed; `latch` keeps the last message for new subscribers."""
        if (topic, type, latch) in self._advertised:
            return
        advertise_id = self._advertised[topic, type, latch] = self._next_id("advertise")
        full = self._full("topic", topic, "subscribers", type)
        self._send(op="advertise", id=advertise_id, topic=full, latch=latch, **_typed(type))
        self._published = True

    def publish(self, topic: str, message: Message, type: str | None = None, latch: bool = False) -> None:
        """Send one message. An existing topic needs no type; `flush` raises if the message was refused."""
        topic = self._full("topic", topic, "subscribers", type)
        if latch:  # a latched message is kept for later subscribers
            self._publish(topic, message, type, latch)
        else:
            self._publish(topic, message, type, latch, unheard=True)
            self._sent[topic] = self._sent.get(topic, 0) + 1
        self._published = True

    def _publish(self, topic: str, message: Message, type: str | None, latch: bool, /, **more: Any) -> str:
        """Send a publish object with the further fields `more`. Returns its id."""
        if type is not None or latch:
            self.advertise(topic, type, latch)
        full, publish_id = self._full("topic", topic, "subscribers", type), self._next_id("publish")
        self._send(op="publish", id=publish_id, topic=full, msg=message, **more)
        return publish_id

    def publish_at(
        self, topic: str, message: Message, time_ns: int, type: str | None = None, latch: bool = False
    ) -> str:
        """Send a message that the daemon publishes at the end of the first cycle whose simulated time is at least
        `time_ns`.

        Returns an id without waiting, for `is_answered` and `published`. A client may have at most 10000 waiting
        messages. They are discarded when the client disconnects.
        """
        at = {"secs": time_ns // 10**9, "nsecs": time_ns % 10**9}
        publish_id = self._publish(topic, message, type, latch, at=at, ack=True, **_typed(type))
        self._awaited.add(publish_id)
        return publish_id

    def published(self, publish_id: str, *, timeout: float | None = None) -> bool:
        """Wait until a message of `publish_at` is published. False when it reached the daemon after its time."""
        answer = self._answer(publish_id, timeout)
        if publish_id in self._refusals:
            raise self._refusals.pop(publish_id)
        return not answer.get("late", False)

    def deliver(self, topic: str, message: Message, type: str | None = None, latch: bool = False) -> None:
        """`publish` and `flush` in one round trip. Raises as `flush`."""
        publish_id = self._publish(topic, message, type, latch, ack=True)
        self._awaited.add(publish_id)
        self._flushed(publish_id, None)

    def flush(self, *, timeout: float | None = None) -> None:
        """Wait until the daemon has processed everything that was sent and passed it to the subscribers.

        Raises:
            MessageRefused: the first refusal, with its exit code. TimedOut. NoDaemon.
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
            type: needed only for a topic that is not advertised yet.
            queue_length: the newest messages kept for a slow reader; 0 means 1000.
            throttle_rate: minimum interval between two messages in wall milliseconds.
            take: called, while a call waits, with each publish object: `topic`, `msg` and `time`, the simulated time of
                publication. A message latched before the subscription has `latch`, and the time of the subscription.
                With `take` no messages are queued.
            wait: False returns without waiting, so that many subscriptions begin together; `flush` raises refusals.

        Raises:
            Refused: the topic does not exist or has another type.
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
        """End a subscription. `Subscription.close` calls this."""
        receivers = self._subscriptions.get(subscription.topic, [])
        if subscription not in receivers:
            return
        receivers.remove(subscription)
        with suppress(NoDaemon):  # a daemon that ended has no subscriptions left
            self._send(op="unsubscribe", id=subscription.id, topic=subscription.topic)

    # --- names --------------------------------------------------------------------------------------------------

    def topics(self, *, timeout: float | None = None) -> dict[str, str]:
        """Every topic -> its type."""
        answer = self.call("/rosapi/topics", timeout=timeout)
        return dict(zip(answer["topics"], answer["types"], strict=True))

    def services(self) -> list[str]:
        """Every service, sorted."""
        return list(self.call("/rosapi/services")["services"])

    def _full(self, kind: str, name: str, role: str = "", type: str | None = None) -> str:
        """The full name of a relative one, cached. A new topic with a type is in the root namespace."""
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
        """The full name of a short one: the name itself, or the only name that ends with it, as on the command line.

        Args:
            kind: `topic`, `service`, `parameter` (or a namespace of parameters), `node` or `robot`.
            namespace: relative names begin here; it also decides between several matches.
            role: of a topic: only those with `publishers`, or with `subscribers`; empty for all.
            with_field: of a topic: a field may follow the name.

        Returns:
            slidectl/Resolve's response: `name` is the full name; then `field`, `type`, `typedefs`, `response_typedefs`
            and `nodes`, as far as the kind has them.

        Raises:
            UnknownName: no match. AmbiguousName: several matches. Unused: the topic has no node in the role.
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
        error = cause.__new__(cause)  # skips the constructor, which would build the text again
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
        """Spawn a robot, or all models of a file, as `slidectl spawn` does.

        Returns slidectl/RobotInfo; for a world, that of the first model.

        Args:
            name: any text; what is no graph name becomes one, with a warning.
            model: a shipped model's name, the path of a .xacro, .urdf, .sdf or .world file, or `model://NAME`.
            at: x, y, z in m, or these and roll, pitch, yaw in rad.
            controllers: the YAML file of its controllers' parameters.
            start: controllers to load and start.
            joints: start positions of joints, rad or m.
            transmissions: `gazebo` or `real`; overrides the model.

        Raises:
            BadFile, UnknownName, UsageError: nothing has been changed. Refused: with the daemon's reason.
        """
        # Imported here because it reads robot files: a script that spawns nothing starts without it.
        from slidectl.client import spawning

        if name is not None and (remark := names.remark_on_robot(name)):
            import warnings

            warnings.warn(remark, stacklevel=2)
        pose = spawning.pose(at)
        if spawning.is_scene(model):
            spawning.check_scene_options(xacro_arguments, controllers, start, joints or {}, transmissions)
            models = spawning.scene(model).named(name)
            requests = [spawning.request(one, at) for one in models]
            self.spawn_models(requests)
            return dict(self.call("/slidectl/list_robots", {"name": requests[0]["model_name"]})["robots"][0])
        document = spawning.document(model, xacro_arguments, name)
        given = {f"{argument}:=" for argument in xacro_arguments}
        for notice in document.report:
            if notice.subject in given:
                raise UsageError(f"{model}: {notice.subject} {notice.text}")
        xml = spawning.with_transmissions(document, transmissions)
        chosen, namespace, _ = spawning.identity(xml, document, name, joints=joints or {})
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
        """Spawn a URDF at a geometry_msgs/Pose, with start positions of joints (rad or m).

        Returns the world's remarks. Raises Refused.
        """
        request = {"model_name": name, "model_xml": xml, "initial_pose": pose}
        if not joints:
            return self._spawn("urdf", request, timeout)
        with self._spawning() as spawned:  # the world is paused: no cycle runs between the two calls
            self._spawn("urdf", request, timeout)
            spawned.append(name)
            return self.start_joints(name, joints)  # replaces the spawn's remarks, which are about joints at 0

    def start_joints(self, robot: str, positions: Mapping[str, float]) -> list[str]:
        """Move joints of a robot to these positions (rad or m) at rest, and make them the positions after a reset.

        Returns the world's remarks on the robot in its new state. Raises Refused.
        """
        names, values = list(positions), list(positions.values())
        answer = self.call("/slidectl/start_joints", {"robot": robot, "joint_names": names, "joint_positions": values})
        if not answer["success"]:
            raise Refused(answer["message"])
        return list(answer["message"].split("\n")[1:])

    def spawn_models(self, models: Sequence[Message], *, timeout: float = SPAWN_LIMIT_S) -> list[str]:
        """Spawn models, all or none; the world is paused meanwhile. Returns the world's remarks.

        Each of `models` is a gazebo_msgs/SpawnModel request, with SDF or a URDF made from it.

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
                spawned.append(model["model_name"])  # after the call: a refused name may be another model's
        return remarks

    @contextmanager
    def _spawning(self) -> Iterator[list[str]]:
        """Pause the world inside the context. On an exception, delete the models in the list that it gives."""
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
        """Delete a robot from the world. Raises UnknownName, Refused."""
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
        """Add a fault from one simulated time (s; by default now) to another (by default until it is removed).

        Returns slidectl/Fault, with its options as a dict.

        Args:
            target: a joint, link (`robot/joint`), controller or topic; the unique end of its name is enough.
            kind: `sensor-noise`, `joint-stuck` ...; `slidectl fault kinds` lists them with their options.
            seed: the seed of its random numbers.
            name: the fault's name in lists; by default the daemon makes one.
            namespace: where the target is looked for first.

        Raises:
            Refused: with the daemon's reason.
        """
        request = {"target": target, "kind": kind, "seed": seed, "name": name, "namespace": namespace}
        times = {field: [] if time is None else [time] for field, time in (("start", start), ("end", end))}
        answer = self.call("/slidectl/fault/add", {**request, **times, "options": json.dumps(options)})
        return _with_options(answer["fault"])

    def faults(self) -> list[Message]:
        """All faults, each as slidectl/Fault, with their effects so far and their options as a dict."""
        return [_with_options(fault) for fault in self.call("/slidectl/fault/list")["faults"]]

    def remove_faults(self, *names: str) -> list[str]:
        """Remove these faults, or all without names. Returns the names. Raises Refused: a fault does not exist."""
        return list(self.call("/slidectl/fault/remove", {"names": names})["names"])

    def controllers(self, namespace: str | None = None) -> Manager:
        """The controller manager of a robot's namespace, by default the only one: load, start, stop, switch, list.

        Raises:
            UsageError: no namespace is given, and there is no controller manager, or more than one.
        """
        if namespace is None:
            found = self.managers()
            if len(found) != 1:
                known = listing([manager.namespace for manager in found])
                raise UsageError(f"which controller manager? there are: {known}", "name its namespace, as '/slider'")
            return found[0]
        return Manager(self, names.join("/", namespace).rstrip("/") or "/")

    def managers(self) -> list[Manager]:
        """All controller managers, by namespace."""
        request, name = {"type": "controller_manager_msgs/ListControllers"}, "/controller_manager/list_controllers"
        services = self.call("/rosapi/services_for_type", request)["services"]
        return [Manager(self, one.removesuffix(name) or "/") for one in sorted(services) if one.endswith(name)]

    def action(self, name: str) -> Action:
        """An action by its name, or by the name of a controller with one action: send goals, follow and cancel them.

        Raises:
            UnknownName, AmbiguousName.
        """
        from slidectl.client.action_client import Action

        return Action(self, name)

    @property
    def params(self) -> Params:
        """The parameters, as a mapping of names to values."""
        return Params(self)

    def pause(self) -> None:
        """Pause the world; it stays as it is. As `slidectl sim pause`."""
        self.call("/gazebo/pause_physics")

    def resume(self) -> None:
        """Let the world go on. Raises Refused: an error has stopped it, and only `reset` goes on."""
        self.call("/gazebo/unpause_physics")

    def reset(self, *, time: bool = False) -> None:
        """Put robots and models back where they were spawned, at rest; with `time` also the clock to 0."""
        self.call("/gazebo/reset_simulation" if time else "/gazebo/reset_world")

    def step(self, cycles: int | None = None, *, seconds: float = 0.0, until: float = 0.0) -> float:
        """Pause the world and run `cycles` cycles (1 by default), `seconds` simulated seconds, or up to the time
        `until`.

        Returns the simulated time in s.

        Raises:
            Refused: the time has passed or is no whole number of cycles away, or the steps were interrupted.
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
        """Wait until `seconds` of simulated time have passed. Returns the simulated time in s.

        `timeout` is in wall seconds; the default is 60 plus ten times `seconds`. Raises TimedOut, also for a paused
        world.
        """
        limit = 60.0 + 10.0 * seconds if timeout is None else timeout
        return float(self.call("/slidectl/sleep", {"duration": seconds}, timeout=limit)["time"])

    def save(self, name: str, file: str | None = None) -> float:
        """Save the whole state of the world under a name, and also to `file` if given.

        Returns the simulated time in s. Raises Refused: a switch is in progress, or a class has state that a snapshot
        cannot hold.
        """
        return float(self.call("/slidectl/save", {"name": name, "file": _absolute(file)})["time"])

    def load(self, name: str | None = None, file: str | None = None) -> float:
        """Restore the world from the snapshot `name` or from the file. Returns the simulated time in s.

        Raises Refused: no such snapshot, one of another version, truncated or damaged, or a switch is in progress.
        """
        return float(self.call("/slidectl/load", {"name": name or "", "file": _absolute(file)})["time"])

    def snapshots(self) -> list[Message]:
        """The daemon's snapshots (slidectl/SnapshotInfo), oldest first."""
        return list(self.call("/slidectl/snapshots")["snapshots"])

    @contextmanager
    def lockstep(self, period: float = 0.0, timeout: float = 5.0) -> Iterator[LockStep]:
        """Run the world in lock-step inside the context: it advances only by `step` of the LockStep that this gives.

        Each step is one period. With several clients in lock-step, the world advances when all have called `step`.

        Args:
            period: simulated seconds, a whole number of cycles; one cycle by default.
            timeout: wall seconds that the world waits for this client; then it goes on without it.

        Raises:
            Refused: the period is no whole number of cycles.
        """
        seconds = period or float(self.call("/slidectl/status")["timestep"])
        joined = self.call("/slidectl/lockstep", {"period": seconds, "timeout": timeout})
        lock = LockStep(self, float(joined["time"]))
        try:
            yield lock
        finally:
            with suppress(NoDaemon, Refused):  # the daemon has already ended this client's lock-step
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
            tol: tolerance of `near`.
            within: simulated seconds after which it fails; 0 for no limit.
            for_: simulated seconds that the condition must hold.
            timeout: limit in wall seconds; by default 60 plus ten times the simulated ones.

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
        """Every object that arrives, as received. Ends when nothing arrives for `timeout` seconds."""
        while (message := self._link.receive(self.monotonic() + timeout)) is not None:
            self._sort(message)
            yield message

    def wait_until(self, condition: Callable[[], bool], timeout: float | None, failure: str) -> None:
        """Read what arrives until the condition is true. Raises TimedOut with the text of `failure`, NoDaemon."""
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
        """The hint of a TimedOut: the world is paused or waits for lock-step, or the daemon hangs; None if unknown."""
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
        """The daemon's process id: from the kernel, or from the daemon where the kernel does not tell it."""
        pid = self._link.daemon_pid
        return int(self.call("/slidectl/status")["pid"]) if pid is None else pid

    def another(self) -> Client:
        """Open a further connection to the same daemon, with the same `timeout`. Raises as the constructor."""
        return Client(link=self._link.another(self.monotonic() + self.timeout), timeout=self.timeout)

    def monotonic(self) -> float:
        """The clock of all waits, in s: the machine's, or that of a world in this process that has its own."""
        return self._link.monotonic()

    def fileno(self) -> int:
        """The file descriptor of the socket, for the caller's `select`."""
        return self._link.fileno()

    def call_back(self, action: Callable[[], object] | None) -> bool:
        """Set a callback for a world in this process: run between two cycles when something arrived while other clients
        wait.

        None removes it. Returns False for a world in another process; use `fileno` there.
        """
        return self._link.call_back(action)

    def _send(self, **message: Any) -> None:
        """Send one object. Raises BadLine: the daemon would refuse it. TimedOut. NoDaemon."""
        self._link.send(_line(message), self.monotonic() + self.timeout)

    def _next_id(self, purpose: str) -> str:
        self._serial += 1
        return f"{purpose}:{self._serial}"

    def close(self) -> None:
        """Close the connection without waiting. Its advertisements and subscriptions end. Warns of dropped messages."""
        self._link.close()
        for subscription in [one for topic in self._subscriptions.values() for one in topic]:
            subscription.tell_dropped()

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
    """Encode an object as a line. Raises BadLine: it is too long."""
    line = encode(message)
    if len(line) > LONGEST_LINE:
        raise BadLine(f"a message of {len(line)} bytes is more than the {LONGEST_LINE} that fit a line")
    return line


def _absolute(file: str | None) -> str:
    """The absolute path, since the daemon works in another folder; empty for None."""
    return os.path.abspath(file) if file else ""


def _typed(type: str | None) -> Message:
    return {} if type is None else {"type": type}


def _refusal(cause: type[Refused], text: str, answer: Message) -> Refused:
    error = cause(text)
    error.exit_code = int(answer.get("exit_code", cause.exit_code))
    return error


class MessagesDropped(UserWarning):
    """A subscription was read too slowly: messages were dropped, and the reader did not ask for the newest alone."""


class Subscription:
    """Messages of one topic, in order. Iterating waits for each without a limit; `get` waits with one.

    `dropped` counts the messages that the daemon or the client discarded, oldest first, because the reader was too
    slow. With the default `queue_length` the end of the subscription warns of them (MessagesDropped).
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
        self.tells = not queue_length and take is None
        """False when nobody is to be warned of dropped messages."""
        self._client = client
        self._take = take
        self._queue: deque[Message] = deque(maxlen=queue_length or DEFAULT_QUEUE)

    def put(self, published: Message) -> None:
        """Take a publish object that has arrived. The client calls this."""
        if self._take is not None:
            self._take(published)
            return
        if len(self._queue) == self._queue.maxlen:
            self.dropped += 1
        self._queue.append(published["msg"])

    def get(self, timeout: float | None = None) -> Message:
        """Return the next message; wait at most `timeout` wall seconds (the client's by default, `inf` for no limit).

        Raises:
            TimedOut: no message arrived. NoDaemon: the daemon ended.
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
        """The number of messages in the queue."""
        return len(self._queue)

    def close(self) -> None:
        """Unsubscribe. Messages in the queue can still be read. Warns of dropped messages."""
        self._client.unsubscribe(self)
        self.tell_dropped()

    def tell_dropped(self) -> None:
        """Warn of dropped messages, once."""
        if self.dropped and self.tells:
            import warnings

            self.tells = False
            text = f"{self.dropped} messages of {self.topic} were dropped: {self._queue.maxlen} wait for a slow reader"
            hint = "read more often, or give subscribe a queue_length (1: the newest alone)"
            warnings.warn(f"{text}; {hint}", MessagesDropped, stacklevel=3)

    def __enter__(self) -> Subscription:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class LockStep:
    """A client in lock-step with the world; see Client.lockstep. `time` is the simulated time of the world in s."""

    def __init__(self, client: Client, time: float) -> None:
        self._client = client
        self._under_way: str | None = None
        """The id of a step call that timed out."""
        self.time = time

    def step(self, timeout: float = math.inf) -> float:
        """Report this client as done and wait until its next period is over. Returns the simulated time in s.

        All messages of the period have arrived then.

        Raises:
            TimedOut: not within `timeout` wall seconds: other clients are not done, or the world is paused. The next
                `step` waits on for the same period. Refused: the daemon ended this client's lock-step, because the
                world waited longer than its time-out.
        """
        client = self._client
        call = self._under_way = self._under_way or client.call_async("/slidectl/lockstep")
        client.wait_until(lambda: client.is_answered(call), timeout, "the period was not over")
        self._under_way = None
        self.time = float(client.answer(call)["time"])
        return self.time


class Params:
    """The parameters of a daemon. A value is a number, text, truth value or list, or a dict for a whole namespace.

    Names may be short, as on the command line; a new parameter's name is relative to the root namespace.
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
        """Set several by full name, all or none. Raises Refused: a loaded controller cannot take a value."""
        texts = [json.dumps(value, allow_nan=False) for value in values.values()]
        self._client.call("/slidectl/set_params", {"names": list(values), "values": texts})

    def __delitem__(self, name: str) -> None:
        full = self._client.resolve("parameter", name)["name"]
        self._client.call("/rosapi/delete_param", {"name": full})

    def names(self) -> list[str]:
        """The full names, sorted."""
        return sorted(self._client.call("/rosapi/get_param_names")["names"])


class Manager:
    """A client of the services `/<namespace>/controller_manager/*`. A refusal raises Refused with the answer's reasons.

    Args:
        warn: called with each warning, and with each error of a request that succeeded nevertheless.
        limit_s: limit of one call in wall seconds; None for the client's `timeout`.
        timeout_s: limit of a switch in simulated seconds; 0 for no limit.
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
        """Wait for an answer with the field `ok`. Raises Refused."""
        ok = self.client.answer(call_id, timeout=self._limit_s)["ok"]
        for reason in self.client.reasons if ok else self.client.warnings:
            self.warn(reason)
        if not ok:
            raise self.refusal(what, self.client.errors)

    def refusal(self, what: str, reasons: Sequence[str]) -> Refused:
        """The error of a request that was refused for these reasons."""
        return Refused("\n".join(reasons) or f"cannot {what}, and no reason was given")

    def is_there(self) -> bool:
        """True when the services of the controller manager exist."""
        known = self.client.services()
        return all(f"{self.name}/{service}" in known for service in _MANAGER_SERVICES)

    def ask_for_controllers(self) -> str:
        """Send the request of `controllers` and `states` ahead."""
        return self.client.call_async(f"{self.name}/list_controllers")

    def controllers(self, asked: str | None = None) -> list[Message]:
        """The loaded controllers, in load order (controller_manager_msgs/ControllerState)."""
        call_id = self.ask_for_controllers() if asked is None else asked
        return list(self.client.answer(call_id, timeout=self._limit_s)["controller"])

    def states(self, asked: str | None = None) -> dict[str, str]:
        """Name -> state of the loaded controllers."""
        return {controller["name"]: controller["state"] for controller in self.controllers(asked)}

    def update_times(self) -> list[Message]:
        """Update durations of the loaded controllers, in load order (slidectl/UpdateTimes)."""
        return list(self.client.call("/slidectl/update_times", {"robot": self.namespace})["controllers"])

    def types(self) -> Message:
        """The controller types: `types` and `base_classes`, parallel lists."""
        return self._call("list_controller_types")

    def configured(self) -> list[str]:
        """The controllers with a `type` parameter in this namespace, loaded or not."""
        return configured(self.client.params.names(), self.namespace)

    def is_configured(self, name: str) -> bool:
        """True when a controller has a `type` parameter in this namespace. Its name may hold a slash."""
        return is_configured(self.client.params.names(), self.namespace, name)

    def known(self) -> list[str]:
        """Names of the controllers that are loaded or configured, sorted."""
        return sorted({*self.states(), *self.configured()})

    def type_parameter(self, name: str) -> str:
        """The type of a controller in its parameters; empty without one."""
        request = {"name": names.join(self.namespace, f"{name}/type"), "default": '""'}
        return str(json.loads(self.client.call("/rosapi/get_param", request)["value"]))

    def load(self, name: str) -> None:
        """Load a controller. Raises Refused with the reason."""
        self._act(f"load {name}", "load_controller", name=name)

    def unload(self, name: str) -> None:
        """Unload a controller. Raises Refused with the reason."""
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
        """Reload the controller libraries. Raises Refused when controllers prevent it."""
        self._act("reload the libraries", "reload_controller_libraries", force_kill=True)

    def load_file(self, name: str, file: str, class_name: str = "") -> None:
        """Load a controller from a class in a Python file (an absolute path). Raises Refused with the reason."""
        request = {"robot": self.namespace, "name": name, "file": file, "class_name": class_name}
        self._answered(f"load {name}", self.client.call_async("/slidectl/load_controller_file", request))

    def reload(self, name: str) -> None:
        """Replace a controller loaded from a user's file by the file's present version. Raises Refused with the
        reasons.
        """
        request = {"robot": self.namespace, "name": name}
        before = self.states().get(name)
        self._answered(f"reload {name}", self.client.call_async("/slidectl/reload_controller", request))
        if before in STARTED or before == "aborted":
            self.check_started([name])

    def ask_to_load(self, wanted: Sequence[str]) -> dict[str, str]:
        """Send load requests without waiting. Returns name -> call id, for `loaded`."""
        service = f"{self.name}/load_controller"
        return {name: self.client.call_async(service, {"name": name}) for name in dict.fromkeys(wanted)}

    def loaded(self, calls: dict[str, str]) -> None:
        """Wait for the answers to `ask_to_load`. Raises Refused with the errors."""
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
        """Load the controllers that are not loaded, then start the idle ones in one strict switch. Returns the states.

        Args:
            stop: running controllers that the same switch stops.
            states: the states before; None: they are requested.
            loads: calls of `ask_to_load` under way; None: the missing controllers are loaded here.

        Raises:
            Refused: a controller cannot be loaded, and none is started; or one did not start.
        """
        states = self.states() if states is None else states
        self.loaded(self.ask_to_load([name for name in wanted if name not in states]) if loads is None else loads)
        idle = [name for name in dict.fromkeys(wanted) if states.get(name) != "running"]
        return self.start(idle, stop) if start and (idle or stop) else self.states()

    def spawn(self, *wanted: str) -> dict[str, str]:
        """Load the controllers that are not loaded, and start them in one cycle. Returns the states. Raises Refused."""
        return self.bring_up(wanted)

    def stop(self, *running: str) -> None:
        """Stop controllers in one cycle; their joints keep the last commands. Raises Refused."""
        self.switch((), running)

    def unspawn(self, *wanted: str) -> None:
        """Stop controllers that run, and unload them. Raises Refused."""
        states = self.states()
        if running := [name for name in wanted if states.get(name) in STARTED]:
            self.switch((), running)
        each(self.unload, list(wanted)[::-1])

    def start(self, wanted: Sequence[str], stop: Sequence[str] = ()) -> dict[str, str]:
        """Start loaded controllers in one strict switch, check that they run, return the states. Raises Refused."""
        self.switch(wanted, stop)
        return self.check_started(wanted)

    def check_started(self, wanted: Sequence[str]) -> dict[str, str]:
        """Check that controllers run: one may abort after its switch. Returns the states. Raises Refused."""
        states = self.states()
        failed = [f"{name} is {states.get(name, UNLOADED)}" for name in wanted if states.get(name) not in STARTED]
        if failed:
            raise Refused(f"did not start: {', '.join(failed)}", "slidectl daemon logs says why")
        return states


def configured(parameters: Sequence[str], namespace: str) -> list[str]:
    """Names of the controllers in a namespace that have a `type` among these parameters.

    A name may have one slash, as `arm/position`, where no controller `arm` has a parameter of that name, and not in the
    root, which holds the namespaces of others.
    """
    prefix = namespace.rstrip("/") + "/"
    inside = (name.removeprefix(prefix) for name in parameters if name.startswith(prefix))
    typed = [name.removesuffix("/type") for name in inside if name.endswith("/type")]
    plain = [name for name in typed if "/" not in name]
    grouped = [name for name in typed if name.count("/") == 1 and name.partition("/")[0] not in plain]
    return plain if prefix == "/" else plain + grouped


def is_configured(parameters: Sequence[str], namespace: str, name: str) -> bool:
    """True when a controller has a `type` among these parameters. Its name may hold a slash: `arm/position`."""
    return names.join(namespace, f"{name}/type") in parameters


def claimed_text(resources: Sequence[Message]) -> str:
    """The claims as text, for example `EffortJointInterface: joint1 joint2`; `; ` separates interfaces."""
    parts = ((item["hardware_interface"].rpartition("::")[2], item["resources"]) for item in resources)
    return "; ".join(f"{interface}: {' '.join(claimed)}" if claimed else interface for interface, claimed in parts)


def each(action: Callable[[str], None], wanted: Sequence[str]) -> None:
    """Call `action` for each name, then raise Refused with all the errors if there were any."""
    failures = []
    for name in wanted:
        try:
            action(name)
        except Refused as error:
            failures.append(str(error))
    if failures:
        raise Refused("\n".join(failures))
