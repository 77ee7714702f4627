"""Simulated time as twenty clients see it: it goes back only by resets and loads, and once at the most for each."""

from __future__ import annotations

import json
from collections import Counter
from random import Random
from typing import Any

from fuzz_target import ANSWER_LIMIT_S, Fault, Target

from slidectl.client import Client
from slidectl.errors import SlidectlError

CLIENTS = 20
ROUNDS = 15
_ROBOT = "timed"
_SPACE = f"/{_ROBOT}"
_SNAPSHOTS = ("a", "b", "c")
_FAULTS = (("sensor-noise", {"sd": 0.01}), ("sensor-delay", {"delay": 0.01}), ("command-loss", {"probability": 0.5}))


class Follower:
    """A client, and the newest time that each of its sources has told."""

    def __init__(self, client: Client) -> None:
        self.client = client
        self.newest: dict[str, int] = {}
        self.steps_back: Counter[str] = Counter()
        client.subscribe("/clock", take=lambda published: self.see("/clock", published["msg"]["clock"]))
        client.subscribe(f"{_SPACE}/joint_states", take=self._see_states)

    def _see_states(self, published: dict[str, Any]) -> None:
        self.see("the stamp of joint_states", published["msg"]["header"]["stamp"])
        self.see("the time of a message", published["time"])

    def see(self, source: str, stamp: dict[str, int]) -> None:
        now = stamp["secs"] * 1_000_000_000 + stamp["nsecs"]
        self.steps_back[source] += now < self.newest.get(source, 0)
        self.newest[source] = now

    def see_status(self, status: dict[str, Any]) -> None:
        now = round(status["time"] * 1e9)
        self.see("status", {"secs": now // 1_000_000_000, "nsecs": now % 1_000_000_000})


class Times:
    """Random operations of twenty clients at once on one world: steps, commands, faults, resets, snapshots, forks."""

    kind = "times"

    def __init__(self, target: Target) -> None:
        self.target = target
        self.backs = 0
        """Requests so far that may have set the time back."""
        target.client.spawn(
            "slider", _ROBOT, controllers="config/slider_control.yaml",
            start=["joint_state_controller", "joint1_position_controller"],
        )  # fmt: skip
        self.followers = [Follower(target.runtime.client(ANSWER_LIMIT_S)) for _ in range(CLIENTS)]
        for follower in self.followers:
            target.closing.callback(follower.client.close)

    def case(self, rng: Random) -> str:
        before = self.backs
        for _ in range(ROUNDS):
            self._round(rng)
            for follower in self.followers:
                for source, count in follower.steps_back.items():
                    if count > self.backs:
                        raise Fault(f"{source} went back {count} times with {self.backs} resets and loads")
        self.target.check()
        return "with resets or loads" if self.backs > before else "without"

    def _round(self, rng: Random) -> None:
        """Operations of some clients under way together."""
        asked = []
        for follower in rng.sample(self.followers, rng.randrange(1, CLIENTS)):
            service, request, sets_back = self._operation(rng)
            if not service:
                follower.client.publish(f"{_SPACE}/joint1_position_controller/command", {"data": rng.random()})
                continue
            self.backs += sets_back
            asked.append((follower, service, follower.client.call_async(service, request)))
        for follower, service, call in asked:
            try:
                answer = follower.client.answer(call)
            except SlidectlError:
                continue  # a step that a reset ended, a snapshot that is not there
            if service == "/slidectl/status":
                follower.see_status(answer)
        for follower in self.followers:  # after this answer it has all that was sent before
            follower.see_status(follower.client.call("/slidectl/status"))

    def _operation(self, rng: Random) -> tuple[str, dict[str, Any], bool]:
        """A service, its request, and whether it may set the time back; no service for a command."""
        kind = rng.randrange(20)
        if kind < 7:
            return "/slidectl/step", {"cycles": rng.choice((1, 7, 20, 60))}, False
        if kind < 10:
            return "", {}, False
        if kind < 12:
            return "/slidectl/status", {}, False
        if kind < 14:
            fault, options = rng.choice(_FAULTS)
            return (
                "/slidectl/fault/add",
                {"target": f"{_ROBOT}::joint1", "kind": fault, "options": json.dumps(options)},
                False,
            )
        if kind == 14:
            return "/slidectl/fault/remove", {"names": []}, False
        if kind == 15:
            return "/gazebo/reset_world", {}, False
        if kind == 16:
            return "/gazebo/reset_simulation", {}, True
        if kind < 19:
            return "/slidectl/save", {"name": rng.choice(_SNAPSHOTS)}, False
        return "/slidectl/load", {"name": rng.choice(_SNAPSHOTS)}, True
