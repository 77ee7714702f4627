"""A node of ROS 2 that a test drives: one JSON object a line on stdin, one answer a line on stdout."""

from __future__ import annotations

import array
import json
import math
import sys
import threading
import time
from importlib import import_module
from pathlib import Path
from random import Random
from typing import Any

import numpy
import rclpy
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

WITHIN_S = 60.0


def class_of(name: str) -> Any:
    package, kind, own = name.split("/")
    return getattr(import_module(f"{package}.{kind}"), own)


def as_json(value: Any) -> Any:
    """A message as plain values."""
    if hasattr(value, "get_fields_and_field_types"):
        return {name: as_json(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if isinstance(value, bytes):
        return list(value)
    if isinstance(value, (array.array, numpy.ndarray)):
        return value.tolist()
    return [as_json(one) for one in value] if isinstance(value, (list, tuple)) else value


def filled(message: Any, values: dict[str, Any]) -> Any:
    """A message with these fields."""
    for name, value in values.items():
        current = getattr(message, name)
        if isinstance(value, dict):
            filled(current, value)
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            kind = message.get_fields_and_field_types()[name].removeprefix("sequence<").removesuffix(">")
            package, _, own = kind.partition("/")
            setattr(message, name, [filled(class_of(f"{package}/msg/{own}")(), one) for one in value])
        else:
            setattr(message, name, type(current)(value) if isinstance(current, (float, int)) else value)
    return message


def came(future: Any) -> Any:
    """The value of a future; None when it does not come."""
    arrived = threading.Event()
    future.add_done_callback(lambda _: arrived.set())
    return future.result() if arrived.wait(WITHIN_S) else None


def profile(given: str) -> QoSProfile:
    made = QoSProfile(depth=1000)
    if "best_effort" in given:
        made.reliability = ReliabilityPolicy.BEST_EFFORT
    if "transient" in given:
        made.durability = DurabilityPolicy.TRANSIENT_LOCAL
    return made


class Driver:
    """The operations, each a method."""

    def __init__(self, name: str) -> None:
        rclpy.init()
        namespace, _, own = name.rpartition("/")
        self.node = Node(own, namespace=namespace or "/")
        self.received: dict[str, list[Any]] = {}
        self.publishers: dict[str, Any] = {}
        self.actions: dict[str, Any] = {}
        self.goals: list[Any] = []
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.spinning = threading.Thread(target=self.executor.spin)
        self.spinning.start()

    def subscribe(self, topic: str, type: str, qos: str = "") -> None:
        messages = self.received.setdefault(topic, [])
        self.node.create_subscription(
            class_of(type), topic, lambda message: messages.append(as_json(message)), profile(qos)
        )

    def messages(self, topic: str) -> list[Any]:
        return self.received[topic]

    def advertise(self, topic: str, type: str, qos: str = "") -> None:
        self.publishers[topic] = self.node.create_publisher(class_of(type), topic, profile(qos))

    def publish(self, topic: str, values: dict[str, Any], times: int = 1) -> None:
        publisher = self.publishers[topic]
        for _ in range(times):
            publisher.publish(filled(publisher.msg_type(), values))

    def subscribers(self, topic: str) -> int:
        return self.node.count_subscribers(topic)

    def all_are_reached(self, topic: str) -> bool:
        """True when the publisher of this node has found all subscribers that are known."""
        return self.publishers[topic].get_subscription_count() == self.subscribers(topic)

    def publishers_of(self, topic: str) -> int:
        return self.node.count_publishers(topic)

    def offer(self, service: str, type: str, values: dict[str, Any]) -> None:
        """Offer a service that answers with `values`, and keeps the requests as messages."""
        requests = self.received.setdefault(service, [])

        def answer(request: Any, response: Any) -> Any:
            requests.append(as_json(request))
            return filled(response, values)

        self.node.create_service(class_of(type), service, answer)

    def call(self, service: str, type: str, values: dict[str, Any]) -> Any:
        client = self.node.create_client(class_of(type), service)
        if not client.wait_for_service(WITHIN_S):
            return f"no service {service}"
        answer = came(client.call_async(filled(client.srv_type.Request(), values)))
        return f"{service} does not answer" if answer is None else as_json(answer)

    def send_goal(self, action: str, type: str, values: dict[str, Any]) -> Any:
        """Send a goal. Returns its number, and -1 when it is rejected. Its feedback is that of `messages`."""
        if action not in self.actions:
            self.actions[action] = ActionClient(self.node, class_of(type), action)
        client, feedback = self.actions[action], self.received.setdefault(action, [])
        if not client.wait_for_server(WITHIN_S):
            return f"no action {action}"
        goal = filled(class_of(type).Goal(), values)
        handle = came(client.send_goal_async(goal, lambda message: feedback.append(as_json(message.feedback))))
        if handle is None or not handle.accepted:
            return f"{action} does not answer" if handle is None else -1
        self.goals.append((handle, handle.get_result_async()))
        return len(self.goals) - 1

    def send_goals(self, action: str, type: str, values: dict[str, Any], count: int) -> list[bool]:
        """Send many to an action that is known. Returns which of those that are decided within 15 s are accepted.

        A server of ROS 2 keeps ten requests: more in a moment are lost.
        """
        goal, sent = filled(class_of(type).Goal(), values), []
        for _ in range(count):
            sent.append(self.actions[action].send_goal_async(goal))
            time.sleep(0.01)
        end = time.monotonic() + 15.0
        while not all(future.done() for future in sent) and time.monotonic() < end:
            time.sleep(0.1)
        return [future.result().accepted for future in sent if future.done()]

    def cancel_goal(self, number: int) -> int:
        """How many goals are being cancelled."""
        return len(came(self.goals[number][0].cancel_goal_async()).goals_canceling)

    def has_ended(self, number: int) -> bool:
        return bool(self.goals[number][1].done())

    def result_of(self, number: int) -> Any:
        """The status of a goal that ends, as in action_msgs/GoalStatus, and its result."""
        answer = came(self.goals[number][1])
        return "no result" if answer is None else [answer.status, as_json(answer.result)]

    def has_action(self, action: str) -> bool:
        return bool(self.actions[action].server_is_ready())

    def topics(self) -> dict[str, list[str]]:
        return dict(self.node.get_topic_names_and_types())

    def services(self) -> dict[str, list[str]]:
        return dict(self.node.get_service_names_and_types())

    def nodes(self) -> list[str]:
        return [f"{space.rstrip('/')}/{name}" for name, space in self.node.get_node_names_and_namespaces()]

    def time(self) -> float:
        return self.node.get_clock().now().nanoseconds * 1e-9

    def use_sim_time(self) -> None:
        self.node.set_parameters([rclpy.Parameter("use_sim_time", value=True)])

    def close(self) -> None:
        self.executor.shutdown()
        self.spinning.join()
        self.node.destroy_node()
        rclpy.shutdown()

    def round_trips(self) -> dict[str, int]:
        """Send random messages of each type that both sides have through CDR and back; names those that differ."""
        from rclpy.serialization import deserialize_message, serialize_message

        from slidectl import msgs
        from slidectl.extensions.gateways.ros2.conversion import NotInRos2, conversion

        sys.path.append(str(Path(__file__).parent.parent.parent.parent))
        from random_messages import random_message

        rng, differ, same = Random(7), [], 0
        for name in msgs.type_names():
            if name in ("rosgraph_msgs/Log", "controller_manager_msgs/ControllerState"):  # they hold less there
                continue
            try:
                both = conversion(name)
            except NotInRos2:
                continue
            for message in (msgs.default(name), *(random_message(rng, name) for _ in range(20))):
                message = as_ros2_holds_it(message)
                data = serialize_message(both.to_ros2(message))
                back = both.from_ros2(deserialize_message(data, both.ros2_class))
                if repr(as_ros2_holds_it(back)) != repr(message):  # nan differs from itself
                    differ.append(name)
                    break
            same += 1
        return {"differ": differ, "types": same}


def as_ros2_holds_it(value: Any) -> Any:
    """A message without what ROS 2 has not: sequence numbers, times after 2038, and texts behind a NUL."""
    if isinstance(value, dict):
        made = {name: as_ros2_holds_it(part) for name, part in value.items()}
        if "frame_id" in made and "seq" in made:
            made["seq"] = 0
        return {**made, "secs": min(made["secs"], 2**31 - 1)} if "nsecs" in made else made
    if isinstance(value, list):
        return [as_ros2_holds_it(part) for part in value]
    if isinstance(value, str):
        return value.partition("\0")[0]
    return math.nan if value is None else value


def main() -> None:
    driver = Driver(sys.argv[1])
    print(json.dumps("ready"), flush=True)
    try:
        for line in sys.stdin:
            given = json.loads(line)
            print(json.dumps(getattr(driver, given.pop("op"))(**given)), flush=True)
    finally:
        driver.close()  # its thread would keep the process alive


main()
