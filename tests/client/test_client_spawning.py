"""A spawn by a script: what it asks for, and what is left when it is refused."""

from __future__ import annotations

import pytest
from daemon_fixture import ROOT, Runtime

from slidectl.client import Client
from slidectl.client.link import SocketLink
from slidectl.client.spawning import Spawn, document, pose, robot_plan
from slidectl.errors import Refused, UnknownName

CONTROLLERS = str(ROOT / "config" / "slider_control.yaml")
STARTED = ("joint_state_controller", "joint1_position_controller")


def test_a_spawn_with_two_controllers_is_six_requests(daemon: Runtime, monkeypatch: pytest.MonkeyPatch) -> None:
    with daemon.client() as client:
        client.resume()
        sent: list[bytes] = []
        send = SocketLink.send
        monkeypatch.setattr(SocketLink, "send", lambda link, line, due: (sent.append(line), send(link, line, due))[1])
        robot = client.spawn("slider", controllers=CONTROLLERS, start=STARTED)
        assert len(sent) <= 6
        assert robot["controllers"] == list(STARTED)
        client.delete("slider")
        client.pause()


def test_a_spawn_with_a_controller_that_nothing_describes_changes_nothing(client: Client) -> None:
    before = client.params.names()
    with pytest.raises(UnknownName, match="nobody"):
        client.spawn("rrbot", controllers=str(ROOT / "config" / "rrbot_control.yaml"), start=["nobody"])
    assert client.params.names() == before
    assert client.robots() == []


def test_a_spawn_under_a_name_that_is_taken_changes_nothing(client: Client) -> None:
    client.spawn("slider")
    before = client.params.names()
    with pytest.raises(Refused, match="there is a robot 'slider' already"):
        client.spawn("slider", controllers=CONTROLLERS)
    assert client.params.names() == before
    client.delete("slider")


@pytest.mark.parametrize("is_paused", [True, False])
def test_a_robot_whose_joints_cannot_be_put_is_taken_back(client: Client, is_paused: bool) -> None:
    (client.pause if is_paused else client.resume)()
    plan = robot_plan(document("slider", {}, None), pose(()), joints={"joint1": 0.1})
    plan.joints = {"no_joint": 0.0}  # which the plan would have refused
    spawn = Spawn(client, plan)
    with pytest.raises(Refused, match="no_joint"):
        spawn.apply()
    assert client.robots() == []
    assert client.call("/slidectl/status")["paused"] is is_paused
    client.pause()


def test_joints_start_where_the_plan_puts_them(client: Client) -> None:
    plan = robot_plan(document("slider", {}, None), pose(()), joints={"joint1": 0.1})
    client.pause()
    [robot], _ = Spawn(client, plan).apply()
    [position] = [joint["position"] for joint in robot["joints"] if joint["name"] == "joint1"]
    assert position == 0.1
    client.delete("slider")
