"""This process in ROS 2: rclpy's context, its nodes, and the threads that wait for messages and requests.

All of rclpy's objects are made and ended in one of these threads, by `run`; only `publish` is called elsewhere.
"""

from __future__ import annotations

import asyncio
import logging
import os
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Awaitable, Callable, Coroutine, Generator
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from slidectl.errors import Refused, UsageError, cut
from slidectl.extensions.gateways.ros2 import MOST_DOMAIN
from slidectl.paths import install_command

T = TypeVar("T")
Received = Callable[[Any, dict[str, Any]], None]
Answer = Callable[[Any], Awaitable[Any]]
Answered = Callable[[Any, int, Any], None]
_log = logging.getLogger(__name__)

_DOMAIN = "ROS_DOMAIN_ID"
_RANGE, _PEERS = "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_STATIC_PEERS"
_PROFILES = ("FASTDDS_DEFAULT_PROFILES_FILE", "FASTRTPS_DEFAULT_PROFILES_FILE")
"""Where users of Fast DDS name a configuration of their own: the first since Kilted, the second before."""
_STOP_LIMIT_S = 5.0
_GO_ON_AFTER_S = 0.1
_KINDS = ("subscription", "service", "client")
_MOST_AT_ONCE = 100
"""Messages of one topic taken in a row, so that a topic with many does not hold up the others."""


class AwaitedValue:
    """A value that a coroutine of rclpy waits for, given by `set`. Both happen in rclpy's thread."""

    def __init__(self) -> None:
        self._is_set = False
        self._value: Any = None
        self._waiting: Coroutine[Any, Any, Any] | None = None

    def __await__(self) -> Generator[AwaitedValue, None, Any]:
        if not self._is_set:
            yield self
        return self._value

    def set(self, value: Any) -> None:
        """Give the value, and go on with what waits for it. A second one is ignored."""
        if self._is_set:
            return
        self._is_set, self._value = True, value
        if self._waiting is not None:
            carry_on(self._waiting)

    def go_on(self, coroutine: Coroutine[Any, Any, Any]) -> None:
        """Carry on with it once the value is there."""
        self._waiting = coroutine


def carry_on(coroutine: Coroutine[Any, Any, Any]) -> None:
    """Run a coroutine of rclpy as far as it comes without an AwaitedValue that has no value yet."""
    try:
        coroutine.send(None).go_on(coroutine)
    except StopIteration:
        pass
    except Exception:  # of the middleware; nobody waits for the coroutine
        _log.exception("rclpy")


class _Tasks:
    """What rclpy's nodes of actions take for their executor: it carries out goals."""

    def add_node(self, _: Any) -> bool:
        return True

    def remove_node(self, _: Any) -> None:
        pass

    def wake(self) -> None:
        pass

    def create_task(self, work: Callable[..., Coroutine[Any, Any, Any]], *given: Any) -> None:
        carry_on(work(*given))


class Participant:
    """The gateway's part of a ROS 2 domain. `open` comes first, `close` last."""

    def __init__(self, domain: int | None, any_host: bool) -> None:
        """`domain` None is that of ROS_DOMAIN_ID, or 0. Without `any_host`, nodes of this machine alone are found.

        Raises UsageError: no such domain.
        """
        given = os.environ.get(_DOMAIN, "")
        try:
            self.domain = int(given or 0) if domain is None else domain
        except ValueError:
            raise UsageError(f"{_DOMAIN}={cut(given, 40)} is not a number from 0 to {MOST_DOMAIN}") from None
        if not 0 <= self.domain <= MOST_DOMAIN:
            raise UsageError(f"the domain {self.domain} is not from 0 to {MOST_DOMAIN}")
        self._any_host = any_host
        self._context: Any = None
        self._tasks = _Tasks()

    def open(self) -> str:
        """Join the domain. Returns its name for people. Raises Refused: there is no usable rclpy."""
        # Read by the DDS or Zenoh of the user's choice when the context is made.
        if not self._any_host:
            os.environ[_RANGE] = "LOCALHOST"
            os.environ.pop(_PEERS, None)
            if not any(os.environ.get(name) for name in _PROFILES):
                os.environ.update(dict.fromkeys(_PROFILES, str(Path(__file__).with_name("loopback.xml"))))
        rclpy = _rclpy()
        try:
            self._context = rclpy.Context()
            self._context.init(domain_id=self.domain)
            rmw = rclpy.get_rmw_implementation_identifier()
        except Exception as error:  # rclpy has no class for a middleware that cannot be loaded
            raise Refused(f"rclpy cannot join domain {self.domain}: {cut(str(error), 400)}") from None
        self._loop = asyncio.get_running_loop()
        self._topics, self._services = _WaitLoop(self._context, "topics"), _WaitLoop(self._context, "services")
        reach = "hosts of the network too" if self._any_host else "this machine only"
        return f"ROS_DOMAIN_ID={self.domain} ({rmw}, {reach})"

    async def run(self, work: Callable[[], T]) -> T:
        """Do `work` where all of rclpy's objects are made and ended, and return its result."""
        loop = self._loop
        done: asyncio.Future[Any] = loop.create_future()

        def finish(result: T | None, error: BaseException | None) -> None:
            if not done.done():
                done.set_result(result) if error is None else done.set_exception(error)

        def carry_out() -> None:
            try:
                result = work()
            except BaseException as error:
                loop.call_soon_threadsafe(finish, None, error)
            else:
                loop.call_soon_threadsafe(finish, result, None)

        self._topics.post(carry_out)
        result: T = await done
        return result

    def post(self, work: Callable[[], None]) -> None:
        """As `run`, without waiting for it."""
        self._topics.post(work)

    def node(self, name: str) -> Any:
        """A new node of the full name. Raises ValueError: ROS 2 has no such names."""
        from rclpy.exceptions import InvalidNamespaceException, InvalidNodeNameException
        from rclpy.node import Node
        from rclpy.parameter import Parameter

        namespace, _, own = name.rpartition("/")
        try:
            return Node(
                own,
                namespace=namespace or "/",
                context=self._context,
                use_global_arguments=False,
                enable_rosout=False,
                start_parameter_services=False,
                enable_logger_service=False,
                parameter_overrides=[Parameter("start_type_description_service", value=False)],
            )
        except (InvalidNamespaceException, InvalidNodeNameException) as error:
            raise ValueError(f"{name} is no name of a node in ROS 2: {str(error).splitlines()[0]}") from None

    def subscribe(self, node: Any, message_class: Any, topic: str, profile: Any, received: Received) -> Any:
        """Subscribe by a node of ours; `received` gets each message with its origin, in rclpy's thread."""
        made = node.create_subscription(message_class, topic, lambda _: None, profile)

        def take() -> None:
            for _ in range(_MOST_AT_ONCE):
                if (found := made.handle.take_message(message_class, False)) is None:
                    return
                received(*found)

        self._topics.add("subscription", made.handle, take)
        return made

    def unsubscribe(self, node: Any, subscription: Any) -> None:
        self._topics.remove("subscription", subscription.handle)
        node.destroy_subscription(subscription)

    def offer(self, node: Any, service_class: Any, name: str, answer: Answer) -> Any:
        """Offer a service by a node of ours; `answer` is run in the event loop for each request."""
        loop = self._loop
        made = node.create_service(service_class, name, lambda _, response: response)

        async def respond(request: Any, header: Any) -> None:
            response = await answer(request)
            try:
                made.send_response(response, header)
            except Exception as error:  # a text that UTF-8 cannot hold; or the service has ended meanwhile
                _log.warning("%s: the answer cannot be sent: %s", name, error)
                with suppress(Exception):
                    made.send_response(service_class.Response(), header)

        def take() -> None:
            request, header = made.handle.service_take_request(service_class.Request)
            if header is not None:
                asyncio.run_coroutine_threadsafe(respond(request, header), loop)

        self._services.add("service", made.handle, take)
        return made

    def withdraw(self, node: Any, service: Any) -> None:
        self._services.remove("service", service.handle)
        node.destroy_service(service)

    def client(self, node: Any, service_class: Any, name: str, answered: Answered) -> Any:
        """A client of a service; `answered` gets it, the number of each request and its response, in the event loop.

        Not before the work of `run` that sent the request is done.
        """
        loop = self._loop
        made = node.create_client(service_class, name)

        def take() -> None:
            header, response = made.handle.take_response(service_class.Response)
            if header is not None:
                self._topics.post(partial(hand_over, header.request_id.sequence_number, response))

        def hand_over(number: int, response: Any) -> None:
            loop.call_soon_threadsafe(answered, made, number, response)

        self._services.add("client", made.handle, take)
        return made

    def end_client(self, node: Any, client: Any) -> None:
        self._services.remove("client", client.handle)
        node.destroy_client(client)

    def serve_action(self, node: Any, action_class: Any, name: str, **callbacks: Any) -> Any:
        """An action server of rclpy by a node of ours. What its `callbacks` wait for is an AwaitedValue."""
        from rclpy.action import ActionServer

        node.executor = self._tasks
        made = ActionServer(node, action_class, name, **callbacks)
        self._topics.add_waitable(made)
        return made

    def end_action(self, server: Any) -> None:
        self._topics.remove_waitable(server)
        server.destroy()

    def close(self) -> None:
        """Leave the domain."""
        if self._context is None:
            return
        for loop in (self._topics, self._services):
            loop.close()
        self._context.try_shutdown()
        self._context = None


class _WaitLoop:
    """A thread that waits for what arrives at rclpy's objects of ours.

    rclpy's own executors look at everything that all nodes have for each message, which takes milliseconds here, or
    cannot be used from other threads.
    """

    def __init__(self, context: Any, name: str) -> None:
        from rclpy.impl.implementation_singleton import rclpy_implementation

        self._rclpy = rclpy_implementation
        self._context = context
        self._wake = rclpy_implementation.GuardCondition(context.handle)
        self._posted: deque[Callable[[], None]] = deque()
        self._lock = threading.Lock()
        self._ends: dict[str, dict[int, tuple[Any, Callable[[], None]]]] = {kind: {} for kind in _KINDS}
        """Kind -> address of an object of rclpy -> the object, and what takes what has arrived."""
        self._waitables: list[Any] = []
        """Objects of rclpy that wait for several things, and know themselves which."""
        self._released: list[Any] = []
        """Objects that were removed while they were perhaps waited for."""
        self._has_changed = True
        self._is_ending = False
        self._problem = ""
        self._thread = threading.Thread(target=self._run, name=f"rclpy-{name}", daemon=True)
        self._thread.start()

    def post(self, work: Callable[[], None]) -> None:
        """Do `work` in the thread soon."""
        self._posted.append(work)
        self._wake.trigger_guard_condition()

    def add(self, kind: str, handle: Any, take: Callable[[], None]) -> None:
        """Call `take` in the thread whenever something has arrived at the object."""
        handle.__enter__()  # rclpy frees an object that was ended when nobody has entered it any more
        with self._lock:
            self._ends[kind][handle.pointer] = (handle, take)
            self._has_changed = True
        self._wake.trigger_guard_condition()

    def remove(self, kind: str, handle: Any) -> None:
        with self._lock:
            del self._ends[kind][handle.pointer]
            self._released.append(handle)
            self._has_changed = True
        self._wake.trigger_guard_condition()

    def add_waitable(self, waitable: Any) -> None:
        """Let the object carry out what has arrived at it, in the thread."""
        waitable.__enter__()
        with self._lock:
            self._waitables = [*self._waitables, waitable]
            self._has_changed = True
        self._wake.trigger_guard_condition()

    def remove_waitable(self, waitable: Any) -> None:
        with self._lock:
            self._waitables = [one for one in self._waitables if one is not waitable]
            self._released.append(waitable)
            self._has_changed = True
        self._wake.trigger_guard_condition()

    def close(self) -> None:
        self._is_ending = True
        self._wake.trigger_guard_condition()
        self._thread.join(_STOP_LIMIT_S)

    def _run(self) -> None:
        waits: Any = None
        ends: dict[str, dict[int, tuple[Any, Callable[[], None]]]] = {}
        waitables: list[Any] = []
        while not self._is_ending:
            try:
                if self._has_changed:
                    with self._lock:
                        self._has_changed = False
                        ends = {kind: dict(known) for kind, known in self._ends.items()}
                        waitables = self._waitables
                        released, self._released = self._released, []
                    waits = self._wait_set(ends, waitables)
                    for handle in released:
                        handle.__exit__(None, None, None)
                self._wait(waits, ends, waitables)
            except Exception:  # of the middleware; the gateway would stand still without this thread
                _log.exception("rclpy")
                time.sleep(_GO_ON_AFTER_S)

    def _wait_set(self, ends: dict[str, dict[int, tuple[Any, Callable[[], None]]]], waitables: list[Any]) -> Any:
        counts = [len(ends["subscription"]), 1, 0, len(ends["client"]), len(ends["service"]), 0]
        for waitable in waitables:
            more = waitable.get_num_entities()
            each = (
                *(more.num_subscriptions, more.num_guard_conditions, more.num_timers),
                *(more.num_clients, more.num_services, more.num_events),
            )
            counts = [count + own for count, own in zip(counts, each, strict=True)]
        return self._rclpy.WaitSet(*counts, self._context.handle)

    def _wait(
        self, waits: Any, ends: dict[str, dict[int, tuple[Any, Callable[[], None]]]], waitables: list[Any]
    ) -> None:
        waits.clear_entities()
        for kind, known in ends.items():
            add = getattr(waits, f"add_{kind}")
            for handle, _ in known.values():
                add(handle)
        for waitable in waitables:
            waitable.add_to_wait_set(waits)
        waits.add_guard_condition(self._wake)
        waits.wait(-1)
        for kind, known in ends.items():
            for pointer in waits.get_ready_entities(kind) if known else ():
                self._take(known[pointer][1])
        for waitable in waitables:
            if waitable.is_ready(waits):
                self._take(partial(_carry_out, waitable))
        while self._posted:
            self._posted.popleft()()

    def _take(self, take: Callable[[], None]) -> None:
        try:
            take()
        except Exception as error:  # a message that rclpy cannot read, such as one of another version of its type
            if str(error) != self._problem:
                self._problem = str(error)
                _log.warning("rclpy: %s", error)


def _carry_out(waitable: Any) -> None:
    carry_on(waitable.execute(waitable.take_data()))


def _rclpy() -> Any:
    """The module. Raises Refused: it is not there, is one for another Python, or has no middleware."""
    asked = os.environ.get("RMW_IMPLEMENTATION", "")
    if asked and not _starts():  # rclpy's library would end this process
        hint = f"RMW_IMPLEMENTATION is {asked}: install it, or unset the variable"
        raise Refused(f"rclpy cannot load the middleware {cut(asked, 80)}", hint)
    try:
        import rclpy
        from rclpy.impl.implementation_singleton import rclpy_implementation  # noqa: F401
    except ModuleNotFoundError as error:
        missing = error.name or ""
        if missing.partition(".")[0] != "rclpy":
            raise Refused(f"rclpy, ROS 2's client for Python, needs the module {missing}", _how()) from None
        raise _for_another_python() or Refused("rclpy, ROS 2's client for Python, is not here", _how()) from None
    except ImportError as error:
        raise _for_another_python() or Refused(f"rclpy cannot be loaded: {cut(str(error), 400)}", _how()) from None
    return rclpy


def _starts() -> bool:
    """False when rclpy is there and ends a process that imports it. The check costs 0.2 s."""
    words = [sys.executable, "-c", "import rclpy; rclpy.init()"]
    ended = subprocess.run(words, stdin=subprocess.DEVNULL, capture_output=True, check=False)
    return not ended.returncode or b"ModuleNotFoundError" in ended.stderr or b"ImportError" in ended.stderr


def _how() -> str:
    return f"source a ROS 2 first (/opt/ros/DISTRO/setup.bash), or, with Python 3.12: {install_command('ros2')}"


def _for_another_python() -> Refused | None:
    """The refusal of an rclpy that was built for another version of Python, or None."""
    for folder in sys.path:
        built = sorted((Path(folder) / "rclpy").glob("_rclpy_pybind11.cpython-*.so"))
        if built:
            digits = built[0].name.split("-")[1]
            theirs, ours = f"{digits[0]}.{digits[1:]}", f"{sys.version_info.major}.{sys.version_info.minor}"
            if theirs != ours:
                text = f"rclpy in {folder} is for Python {theirs}, and slidectl runs with Python {ours}"
                return Refused(text, f"make an environment for slidectl with it: python{theirs} -m venv ...")
    return None
