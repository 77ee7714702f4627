"""A browser's session without a socket: what it sends and what it lets go, in an order that no network gives surely."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import cbor2

from slidectl.extensions.gateways.websocket.action_goals import ActionGoals
from slidectl.extensions.gateways.websocket.rosbridge_session import RosbridgeSession

Message = dict[str, Any]


class FakeDaemon:
    """Has one topic, and one action server."""

    node = "/rosbridge_websocket"

    def __init__(self) -> None:
        self.lines: list[bytes] = []
        self.takers: dict[str, Callable[[Message], None]] = {}
        self.goals: list[str] = []

    def send_line(self, line: bytes) -> None:
        self.lines.append(line)

    async def call(self, service: str, _: Any = None) -> Message:
        return {"type": "actionlib/TestActionGoal", "subscribers": ["/server"]} if service else {}

    async def subscribe(self, topic: str, _: str, take: Callable[[Message], None]) -> None:
        self.takers[topic] = take

    def unsubscribe(self, topic: str) -> None:
        del self.takers[topic]

    def publish(self, _: str, message: Message) -> None:
        self.goals.append(message["goal_id"]["id"])


def test_messages_stay_packed_while_one_of_two_subscriptions_ends() -> None:
    daemon: Any = FakeDaemon()
    frames: list[tuple[bytes, bool]] = []
    line = b'{"op":"publish","topic":"/note","msg":{"data":"a"}}'

    async def type_of(_: str) -> str:
        session.pass_on(line)  # a message comes while the daemon is asked
        return "std_msgs/String"

    session = RosbridgeSession(
        daemon, ActionGoals(daemon), type_of, lambda frame, is_text: frames.append((frame, is_text)), 1000, False
    )

    async def run() -> None:
        for wish in ("a", "b"):
            await session.take(b'{"op":"subscribe","topic":"/note","compression":"cbor","id":"%s"}' % wish.encode())
        frames.clear()
        await session.take(b'{"op":"unsubscribe","topic":"/note","id":"a"}')
        session.pass_on(line)

    asyncio.run(run())
    assert [is_text for _, is_text in frames] == [False] * len(frames)
    assert cbor2.loads(frames[-1][0])["msg"] == {"data": "a"}


def test_the_topics_of_an_action_are_let_go_when_the_last_browser_with_a_goal_has_gone() -> None:
    daemon: Any = FakeDaemon()
    goals = ActionGoals(daemon)
    told: list[Message] = []
    goal = {"op": "send_action_goal", "id": "g", "action": "/test", "args": {"goal": 1}}

    async def run() -> None:
        await goals.send(goal, told.append)
        assert set(daemon.takers) == {"/test/feedback", "/test/result"}
        goals.forget(told.append)

    asyncio.run(run())
    assert len(daemon.goals) == 1
    assert told == []
    assert daemon.takers == {}
