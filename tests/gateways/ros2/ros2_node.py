"""A node of ROS 2 in a process of its own, driven by the test: nodes/driver.py."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from waiting import eventually

END_WITHIN_S = 20.0
DRIVER = Path(__file__).parent / "nodes" / "driver.py"


class Ros2Node:
    """`node.call("/service", "pkg/srv/Type", {})`: an attribute is an operation of the driver."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self.process = process
        self._answer()

    def __getattr__(self, operation: str) -> Any:
        def carry_out(*given: Any, **named: Any) -> Any:
            names = _ARGUMENTS.get(operation, ())
            self._write({"op": operation, **dict(zip(names, given, strict=False)), **named})
            return self._answer()

        return carry_out

    def _write(self, operation: dict[str, Any]) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps(operation) + "\n")
        self.process.stdin.flush()

    def _answer(self) -> Any:
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        assert line, "the node has ended"
        return json.loads(line)

    def gets(self, topic: str, condition: Any = lambda _: True) -> Any:
        """Wait for a message of a subscribed topic that fulfils the condition, and return the newest such one."""
        found: list[Any] = []

        def came() -> bool:
            found[:] = [message for message in self.messages(topic) if condition(message)]
            return bool(found)

        eventually(came, f"no such message on {topic}")
        return found[-1]


_ARGUMENTS = {
    "subscribe": ("topic", "type", "qos"), "advertise": ("topic", "type", "qos"), "messages": ("topic",),
    "publish": ("topic", "values", "times"), "subscribers": ("topic",), "publishers_of": ("topic",),
    "all_are_reached": ("topic",),
    "offer": ("service", "type", "values"),
    "call": ("service", "type", "values"),
    "send_goal": ("action", "type", "values"), "cancel_goal": ("number",), "has_ended": ("number",),
    "send_goals": ("action", "type", "values", "count"),
    "result_of": ("number",), "has_action": ("action",),
}  # fmt: skip


@contextmanager
def running_node(programs: Path, name: str, domain: int, env: dict[str, str]) -> Iterator[Ros2Node]:
    """A node of the full name in the domain; ended at the end."""
    own = {**env, "ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    words = [str(programs / "python"), str(DRIVER), name]
    with subprocess.Popen(words, env=own, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        try:
            yield Ros2Node(process)
        finally:
            assert process.stdin is not None
            process.stdin.close()  # with it the node ends; one that is killed leaves its shared memory
            try:
                process.wait(END_WITHIN_S)
            except subprocess.TimeoutExpired:
                process.kill()
