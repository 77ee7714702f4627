"""The same commands at the same simulated times give the same bits, whoever is connected and however steps are cut."""

from __future__ import annotations

import json
from contextlib import ExitStack
from typing import Any

from daemon_fixture import Runtime, running_daemon
from rosbridge_wire import Wire

from slidectl import description
from slidectl.client import Client

CONTROLLERS = {
    "joint_state_controller": {"type": "joint_state_controller/JointStateController", "publish_rate": 50},
    "joint1_position_controller": {
        "type": "effort_controllers/JointPositionController",
        "joint": "joint1",
        "pid": {"p": 100.0, "i": 0.01, "d": 10.0},
    },
}


def bring_up(client: Client) -> None:
    """The slider with its controllers running."""
    client.call("/gazebo/spawn_urdf_model", {"model_name": "slider", "model_xml": description.load("slider").xml})
    for name, settings in CONTROLLERS.items():
        client.call("/rosapi/set_param", {"name": f"/slider/{name}", "value": json.dumps(settings)})
        assert client.call("/slider/controller_manager/load_controller", {"name": name})["ok"]
    switch = {"start_controllers": list(CONTROLLERS), "strictness": 2}
    assert client.call("/slider/controller_manager/switch_controller", switch)["ok"]


def slide(client: Client, cuts: list[int]) -> list[dict[str, Any]]:
    """Two commands, 600 cycles each; the state after each of them."""
    states = []
    for command in (0.5, -0.25):
        client.publish("/slider/joint1_position_controller/command", {"data": command})
        for cut in cuts:
            assert client.call("/slidectl/step", {"cycles": cut})["success"]
        states.append(client.call("/gazebo/get_joint_properties", {"joint_name": "slider::joint1"}))
    return states


def crowd(runtime: Runtime, stack: ExitStack) -> None:
    """Clients that listen to everything, ask about everything and say nonsense."""
    for number in range(3):
        wire = stack.enter_context(Wire(runtime.paths.socket))
        for topic in (
            "/clock",
            "/slider/joint_states",
            "/slider/joint1_position_controller/state",
            "/gazebo/link_states",
        ):
            wire.send(op="subscribe", topic=topic, queue_length=number)
        wire.send(op="call_service", service="/rosapi/topics")
        wire.raw(b"nonsense\n" * 20)


def run(cuts: list[int], crowded: bool) -> list[dict[str, Any]]:
    """One run in a daemon of its own."""
    with running_daemon(paused=True) as runtime, runtime.client() as client, ExitStack() as stack:
        bring_up(client)
        if crowded:
            crowd(runtime, stack)
        return slide(client, cuts)


def test_neither_listeners_nor_the_cut_of_the_steps_change_a_bit() -> None:
    alone = run([600], crowded=False)
    assert alone[0]["position"] != alone[1]["position"]
    assert run([1, 2, 3, 94, 500], crowded=True) == alone
