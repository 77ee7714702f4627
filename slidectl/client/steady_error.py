"""Why a joint stands still short of its set point: the effort that its controller holds there, in a sentence.

A PID without an integral part needs an error for every effort: against a weight of 9.8 N with p = 100 it is 0.098 m.
"""

from __future__ import annotations

import math
from contextlib import suppress

from slidectl import names
from slidectl.client.client import Client
from slidectl.client.manager import RUNNING
from slidectl.errors import SlidectlError
from slidectl.msgs.schema import nanoseconds

_TYPE = "JointPositionController"
_WAIT_S = 1.0
_STANDS = 0.01
"""The largest velocity of a joint that stands still, m/s or rad/s."""
_LONG_ENOUGH_NS = 200_000_000
"""How long it stands then, simulated."""
_EXPLAINED = 0.05
"""The part of the effort that may come from elsewhere than p times the error."""


def of_target(client: Client, name: str) -> str | None:
    """The sentence on a joint (`/slider/joint1`), or on the field of `joint_states` that is its position."""
    topic, mark, field = name.partition("/joint_states/")
    if mark:
        return of_field(client, f"{topic}/joint_states", field)
    controller, mark, field = name.partition("/state/")
    if mark:
        return of_field(client, f"{controller}/state", field)
    joint = name.removesuffix("/position")
    return of_joint(client, names.parent(joint), joint.rpartition("/")[2])


def of_field(client: Client, topic: str, field: str) -> str | None:
    """The sentence on the joint whose position a field is: of joint states (`position[0]`), of a controller's state."""
    controller, _, last = topic.rpartition("/")
    if last == "state" and field in ("error", "process_value", "set_point"):
        with suppress(SlidectlError):
            joint = client.params.get(f"{controller}/joint")
            return of_joint(client, names.parent(controller), joint) if isinstance(joint, str) else None
    name, bracket, index = field.partition("[")
    if not topic.endswith("/joint_states") or name != "position" or not bracket:
        return None
    try:
        with client.subscribe(topic, queue_length=1) as states:
            joint = states.get(_WAIT_S)["name"][int(index.rstrip("]"))]
        return of_joint(client, names.parent(topic), joint)
    except (SlidectlError, ValueError, LookupError):
        return None


def of_joint(client: Client, namespace: str, joint: str) -> str | None:
    """The sentence on a joint by its position controller that runs; None when it moves, or has another reason."""
    try:
        for controller in client.controllers(namespace).controllers():
            space = names.join(namespace, controller["name"])
            is_one = controller["type"].endswith(_TYPE) and controller["state"] in RUNNING
            if is_one and client.params.get(f"{space}/joint") == joint:
                return _of_controller(client, namespace, space, joint)
    except SlidectlError:  # it only explains; the failure itself is told in any case
        pass
    return None


def _of_controller(client: Client, namespace: str, space: str, joint: str) -> str | None:
    with client.subscribe(f"{space}/state") as states:
        begin = states.get(_WAIT_S)
        state = begin
        # At the turn of a swing a joint stands for a moment, too.
        while nanoseconds(state["header"]["stamp"]) - nanoseconds(begin["header"]["stamp"]) < _LONG_ENOUGH_NS:
            state = states.get(_WAIT_S)
    numbers = [state[name] for name in ("error", "command", "process_value_dot", "p", "i")]
    if any(number is None for number in (*numbers, begin["error"], begin["process_value_dot"])):
        return None
    error, effort, velocity, p, i = numbers
    stands = max(abs(velocity), abs(begin["process_value_dot"])) < _STANDS
    stands = stands and math.isclose(error, begin["error"], rel_tol=_EXPLAINED)
    is_held_by_p = bool(p) and abs(error) >= 1e-6 and math.isclose(effort, p * error, rel_tol=_EXPLAINED)
    if not stands or not is_held_by_p or (i and state["i_clamp"]):
        return None
    length, force = _units(client, namespace, joint)
    return (
        f"{joint} stands still: {space} holds {abs(effort):.3g} {force} with p = {p:g}: {abs(error):.3g} {length} "
        "short; raise p, or give i and i_clamp"
    )


def _units(client: Client, namespace: str, joint: str) -> tuple[str, str]:
    robots = client.call("/slidectl/list_robots", {"name": ""})["robots"]
    own = (one for robot in robots if robot["namespace"] == namespace for one in robot["joints"])
    kind = next((one["type"] for one in own if one["name"] == joint), "")
    return ("m", "N") if kind == "prismatic" else ("rad", "N m")
