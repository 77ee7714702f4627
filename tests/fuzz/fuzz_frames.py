"""Attacks on the WebSocket gateway: frames of its protocol with odd fields, broken ones, and bytes that are none."""

from __future__ import annotations

import asyncio
import json
import sys
from pathlib import Path
from random import Random
from typing import Any

from fuzz_attacks import Lines
from fuzz_mutations import ODD_VALUES, mutated_bytes
from fuzz_target import ANSWER_LIMIT_S, Fault, Target, check_text

sys.path.append(str(Path(__file__).parent.parent / "gateways"))
from running_gateway import log, running_gateway
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from slidectl.extensions.gateways.websocket.action_goals import ActionGoals
from slidectl.extensions.gateways.websocket.rosbridge_session import RosbridgeSession

FRAMES_A_CASE = 100
"""Sent to a gateway."""
READ_A_CASE = 2000
"""Given to a session in this process, which is quicker."""
_MOST_BYTES = 100_000
_OWN_OPS = ("fragment", "png", "auth", "send_action_goal", "cancel_action_goal", "advertise_action", "subscribe")
_NUMBERS = (0, 1, 2, 3, -1, 256, 1000, 10**9, 2**70, 0.5, None, True, "1")


class _Daemon:
    """Takes all that a session sends, and knows no topic."""

    node = "/rosbridge_websocket"

    def __init__(self) -> None:
        self.lines: list[bytes] = []

    def send_line(self, line: bytes) -> None:
        self.lines.append(line)

    async def call(self, service: str, _: Any = None) -> dict[str, Any]:
        if service.endswith("topic_type"):
            return {"type": ""}
        return {"subscribers": [], "action_servers": []}

    def publish(self, topic: str, _: Any) -> None:
        raise Fault(f"there is no action, and {topic} is published")

    def close(self) -> None:
        pass


class Frames:
    """A hundred frames a case, on one connection while that lives, and two thousand to a session without one."""

    kind = "frames"

    def __init__(self, target: Target) -> None:
        self.target = target
        self.lines = Lines(target)
        self.url = target.closing.enter_context(running_gateway(target.runtime, "websocket", max_rate=1_000_000))

    def case(self, rng: Random) -> str:
        sent = 0
        outcome = "answered"
        while sent < FRAMES_A_CASE:
            with connect(self.url, max_size=None, open_timeout=ANSWER_LIMIT_S) as one:
                try:
                    while sent < FRAMES_A_CASE:
                        sent += 1
                        one.send(self.frame(rng))
                    self.ask(one, f"done{rng.randrange(10**9)}")
                except ConnectionClosed:
                    outcome = "hung up on"
        check_text(log(self.target.runtime, "websocket"), "the log of the gateway")
        self.target.check()
        asyncio.run(self.read(rng))
        return outcome

    async def read(self, rng: Random) -> None:
        """Frames to a session alone: one line each at most. What a reader may do is judged by the daemon."""
        daemon: Any = _Daemon()
        answers: list[bytes] = []
        is_reader = rng.random() < 0.5

        async def type_of(topic: str) -> str:
            return "std_msgs/Float64" if topic in self.lines.topics else ""

        session = RosbridgeSession(
            daemon, ActionGoals(daemon), type_of, lambda frame, _: answers.append(frame), _MOST_BYTES, is_reader
        )
        for _ in range(READ_A_CASE):
            frame = self.frame(rng)
            daemon.lines.clear()
            answers.clear()
            await session.take(frame.encode("utf-8", "surrogatepass") if isinstance(frame, str) else frame)
            for line in daemon.lines:
                if line.count(b"\n") != 1 or not line.endswith(b"\n"):
                    raise Fault(f"the daemon gets {line!r} of {frame!r}")
            for answer in answers:
                json.loads(answer)
        if session._fragments._bytes > _MOST_BYTES:
            raise Fault(f"{session._fragments._bytes} bytes of fragments are kept")
        session.close()

    def ask(self, one: ClientConnection, mark: str) -> None:
        """Raises Fault unless a call is answered after all that was sent; ConnectionClosed."""
        one.send(json.dumps({"op": "call_service", "id": mark, "service": "/rosapi/get_time", "fragment_size": None}))
        while True:
            try:
                if mark in str(one.recv(timeout=ANSWER_LIMIT_S)):
                    return
            except TimeoutError:
                raise Fault(f"no answer within {ANSWER_LIMIT_S:g} s") from None

    def frame(self, rng: Random) -> str | bytes:
        if rng.random() < 0.5:
            frame = self.lines.line(rng)
        else:
            frame = json.dumps(self.own(rng)).encode()
            frame = mutated_bytes(rng, frame) if rng.random() < 0.3 else frame
        return frame if rng.random() < 0.5 else frame.decode("utf-8", "replace")

    def own(self, rng: Random) -> dict[str, Any]:
        """A message of the ops that the gateway carries out itself."""
        pick = rng.choice
        inner = json.dumps({"op": pick(("subscribe", "publish", "fragment", "call_service")), "id": pick(ODD_VALUES)})
        fields = {
            "id": pick(("a", "b", *_NUMBERS)), "topic": pick((*self.lines.topics, *ODD_VALUES)),
            "compression": pick(("none", "png", "cbor", "cbor-raw", *_NUMBERS)), "fragment_size": pick(_NUMBERS),
            "type": pick(("std_msgs/Float64", "sensor_msgs/JointState", *ODD_VALUES)), "num": pick(_NUMBERS),
            "total": pick(_NUMBERS), "data": pick((inner, *ODD_VALUES, None)),
            "level": pick(("none", "error", *_NUMBERS)),
            "action": pick((*ODD_VALUES, None, [1])), "args": pick((None, {}, [], {"a": 1}, "x")),
        }  # fmt: skip
        kept = rng.sample(list(fields), rng.randrange(len(fields) + 1))
        return {"op": pick(_OWN_OPS), **{name: fields[name] for name in kept}}
