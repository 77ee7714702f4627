"""A read-only gateway changes nothing of the world: each service that there is, called with whatever it may take."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from daemon_fixture import ROOT, Runtime, running_daemon
from running_gateway import log, running_gateway

from slidectl import msgs
from slidectl.client import Client
from slidectl.msgs.schema import BYTES, SCALAR

sys.path.append(str(Path(__file__).parent / "websocket"))
from rosbridge_client import RosbridgeClient

Message = dict[str, Any]
_STATUS = ("time", "cycles", "paused", "holders", "lockstep", "speed", "chosen", "timestep", "robots", "estop",
           "frozen", "faults", "controllers", "controllers_running", "log", "journal")  # fmt: skip


@pytest.fixture(scope="module")
def world() -> Iterator[Runtime]:
    """Two robots, one with sensors, with controllers, a fault, a snapshot, parameters and a trace of time."""
    with running_daemon(paused=True) as runtime, runtime.client() as client:
        started = ["joint_state_controller", "joint1_position_controller"]
        client.spawn("slider", controllers=str(ROOT / "config/slider_control.yaml"), start=started)
        client.spawn("rrbot", controllers=str(ROOT / "config/rrbot_control.yaml"), start=started[:1])
        client.call("/rosapi/set_param", {"name": "/own/number", "value": "1"})
        client.call("/slidectl/step", {"cycles": 20})
        client.add_fault("slider/joint1", "sensor-noise", name="noise", sd=0.1)
        client.call("/slidectl/save", {"name": "one"})
        client.call("/slidectl/step", {"cycles": 20})
        yield runtime


def digest(client: Client, folder: Path) -> Message:
    """All that a reader must leave as it was."""
    status = client.call("/slidectl/status")
    robots = client.call("/slidectl/list_robots", {"name": ""})["robots"]
    controllers = {
        one["name"]: client.call(f"/{one['namespace'].strip('/')}/controller_manager/list_controllers")
        for one in robots
    }
    models = client.call("/gazebo/get_world_properties")["model_names"]
    return {
        "status": {key: status[key] for key in _STATUS},
        "robots": robots,
        "controllers": controllers,
        "states": {name: client.call("/gazebo/get_model_state", {"model_name": name}) for name in models},
        "joints": client.call("/slidectl/joint_states"),
        "physics": client.call("/gazebo/get_physics_properties"),
        "parameters": client.call("/rosapi/get_param", {"name": "/"})["value"],
        "topics": sorted(client.topics().items()),
        "services": sorted(client.call("/rosapi/services")["services"]),
        "faults": client.call("/slidectl/fault/list")["faults"],
        "snapshots": client.call("/slidectl/snapshots")["snapshots"],
        "files": sorted((str(path), path.stat().st_mtime_ns) for path in folder.rglob("*")),
    }


def plausible(type_name: str, name: str, folder: Path, depth: int = 0) -> Message:
    """A request in which every field has a value that may be meant: `name`, or for files a path of the folder."""
    return {one.name: _value(one, name, folder, depth) for one in msgs.fields(type_name)}


def _value(one: Any, name: str, folder: Path, depth: int) -> Any:
    if one.array != SCALAR:
        if one.type in BYTES:
            return ""
        element = _scalar(one.type, one.name, name, folder, depth)
        return [element] * (one.array if isinstance(one.array, int) and one.array > 0 else 1)
    return _scalar(one.type, one.name, name, folder, depth)


def _scalar(kind: str, field: str, name: str, folder: Path, depth: int) -> Any:
    if kind == "string":
        known = {"joint": "slider/joint1", "topic": "/clock", "kind": "sensor-noise", "value": "2", "options": "{}"}
        if "file" in field or "path" in field:
            return str(folder / "written")
        return next((text for key, text in known.items() if key in field), name)
    if kind == "bool":
        return True
    if kind in ("time", "duration"):
        return {"secs": 1, "nsecs": 0}
    if "/" in kind:
        return plausible(kind, name, folder, depth + 1) if depth < 5 else {}
    return 1


def test_every_service_leaves_the_world_as_it_was_by_a_read_only_gateway(world: Runtime, tmp_path: Path) -> None:
    (tmp_path / "there").write_text("here", "utf-8")
    with (
        running_gateway(world, "websocket", read_only=True) as url,
        RosbridgeClient(url) as reader,
        world.client() as client,
    ):
        services = sorted(client.call("/rosapi/services")["services"])
        assert len(services) > 80
        before = digest(client, tmp_path)
        assert digest(client, tmp_path) == before  # looking changes nothing
        for service in services:
            kind = client.call("/rosapi/service_type", {"service": service})["type"]
            request = msgs.request_type(kind)
            for args in (
                {},
                *(plausible(request, name, tmp_path) for name in ("slider", "one", "noise", "/own/number")),
            ):
                # Some wait for what does not come: the next answer tells that this call has been taken.
                reader.send(op="call_service", id=service, service=service, args=args)
                assert reader.call("/rosapi/get_time")["result"]
                assert digest(client, tmp_path) == before, f"{service} {json.dumps(args)} changes the world"
        for op in ("publish", "advertise"):
            reader.send(op=op, topic="/slider/joint1_position_controller/command", type="std_msgs/Float64", msg={})
            assert reader.call("/rosapi/get_time")["result"]
            assert digest(client, tmp_path) == before, op
    assert "Traceback" not in log(world, "websocket")
