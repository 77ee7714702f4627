"""Writes docs/controllers.md from what the controllers say of themselves. `--check` only compares.

python scripts/controller_reference.py [--check]
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

from slidectl.control import registry, ros2_names
from slidectl.control.controller_interface import ControllerBase
from slidectl.control.params import Parameter

PAGE = Path(__file__).parent.parent / "docs" / "controllers.md"

HEAD = """# Controllers

What `slidectl controller types` lists, with the parameters below a controller's own name. Written by
`python scripts/controller_reference.py`. They behave as those of ros_controllers; [deviations](deviations.md) has what
differs. Every controller reads its `type`, and `update_budget` ([times](extending.md#a-controller-of-your-own)).

A trajectory controller for two joints of the shipped arm; save it as `two_joints.yaml`:

```yaml
arm:
  arm_controller:
    type: effort_controllers/JointTrajectoryController
    joints: [joint1, joint2]
    gains:
      joint1: {p: 400.0, d: 60.0}
      joint2: {p: 400.0, d: 60.0}
    constraints:
      goal_time: 0.5
      joint1: {trajectory: 0.5, goal: 0.02}
```

A goal for it, and what comes of it:

```console
$ slidectl daemon start --paused
daemon default: started, process 4711
$ slidectl spawn arm --controllers two_joints.yaml --start arm_controller
arm: spawned in /arm at 0 0 0, joints: joint1 joint2 joint3 joint4 joint5 joint6
$ slidectl echo /arm/arm_controller/follow_joint_trajectory/result/result -n 1 -q > result.yaml &
$ slidectl pub /arm/arm_controller/follow_joint_trajectory/goal '{goal: {trajectory: {joint_names: [joint1, joint2],
>   points: [{positions: [1.0, -0.5], velocities: [0.0, 0.0], time_from_start: {secs: 2}}]}}}'
$ slidectl sim step 3s
time 3 s after 3000 cycles
$ wait
$ cat result.yaml
error_code: 0
error_string: ''
---
$ slidectl sim resume
running at 3 s
$ slidectl delete arm
arm: deleted
```

![The desired and the actual position of a joint through three points, with the path tolerance](pictures/trajectory.svg)

Between the points of a goal the controller follows a spline through their positions and velocities. The error must stay
within the path tolerance on the way, and within the goal tolerance at the end.

An action has five topics: `goal` and `cancel` for the client; `status` (five times a second, and at each change),
`feedback` and `result` for the server. A goal without an id gets one, an empty `cancel` is for all goals, and a new
goal preempts the one before.

The shipped cart, driven by velocities of its base. Its odometry tells how fast it is:

```console
$ slidectl spawn cart drive:=controller --controllers config/cart_control.yaml --start base_controller
cart: spawned in /cart at 0 0 0, joints: left_wheel_joint right_wheel_joint
$ slidectl pub /cart/base_controller/cmd_vel '{linear: {x: 0.5}, angular: {z: 0.3}}' -r 10 &
$ slidectl wait /cart/base_controller/odom/twist/twist/linear/x --near 0.5 --tol 0.01 --within 5
/cart/base_controller/odom/twist/twist/linear/x is 0.4921 at 3.48 s
$ kill %%
$ slidectl delete cart
cart: deleted
```

The shipped car, whose four wheels are steered, takes velocities as well, or a speed and the angles of its axles:

```console
$ slidectl spawn car --controllers config/car_control.yaml --start joint_state_controller base_controller
...
$ slidectl pub /car/base_controller/cmd_vel '{linear: {x: 0.5}, angular: {z: 0.4}}' -r 10 -n 10
$ slidectl pub /car/base_controller/cmd_four_wheel_steering \\
>   '{speed: 0.5, front_steering_angle: 0.8, rear_steering_angle: 0.8}' -r 10 &
$ slidectl wait /car/base_controller/odom_steer/data/front_steering_angle --near 0.8 --tol 0.05 --within 5
/car/base_controller/odom_steer/data/front_steering_angle is 0.7612 at 6.1 s
$ kill %%
$ slidectl daemon stop
daemon default: stopped, it was process 4711
```
"""

ROS_2 = """Files of ROS 2 are read too: what is below `ros__parameters` of a node is taken as directly below the node,
what a `controller_manager` has there as beside it, and dots in names as slashes. Types that mean the same are
understood, and the answer to the load says what they are here; others, such as
`position_controllers/JointGroupPositionController`, have the same name in both."""


def page() -> str:
    """The whole page."""
    families: dict[str, dict[str, type[ControllerBase]]] = {}
    for name in registry.common.types():
        cls = registry.common.find(name)
        families.setdefault(cls.__module__, {})[name] = cls
    lines = [line for module, classes in families.items() for line in family(module, classes)]
    return HEAD + "".join(line + "\n" for line in (*lines, *names_of_ros_2()))


def names_of_ros_2() -> Iterator[str]:
    """The types that users of ROS 2 write, with what they are here."""
    yield from ("", "## Names of ROS 2", "", ROS_2, "", "| in ROS 2 | here |", "| --- | --- |")
    for name, known in ros2_names.NAMES.items():
        if isinstance(known.here, str):
            types = f"`{known.here}`"
        else:
            types = f"by `{known.interfaces}`: " + ", ".join(f"`{each}`" for each in known.here.values())
        new = ", ".join(f"`{old}` is `{new}`" for old, new in known.renamed.items())
        given = ", ".join(f"`{parameter}` {value}" for parameter, value in known.defaults.items())
        more = "; ".join(filter(None, (new, given and f"by default {given}", known.note)))
        yield f"| `{name}` | {types}{f'; {more}' if more else ''} |"
    for name, (advice, telling) in ros2_names.OTHERS.items():
        with_one = f", with {' or '.join(f'`{each}`' for each in telling)}" if telling else ""
        yield f"| `{name}`{with_one} | is refused; {advice} |"


def family(module: str, classes: dict[str, type[ControllerBase]]) -> Iterator[str]:
    """The controllers of one file: what they are, their types, their parameters."""
    title, _, text = (sys.modules[module].__doc__ or "").partition("\n\n")
    word = module.rpartition(".")[2].replace("_", " ")
    yield from ("", f"## {word.capitalize()}", "", title.rstrip("."), "")
    yield from (text.strip(), "")
    yield from ("| type | |", "| --- | --- |")
    for name, cls in classes.items():
        yield f"| `{name}` | {(cls.__doc__ or '').splitlines()[0]} |"
    yield from ("", "| parameter | of type | default | |", "| --- | --- | --- | --- |")
    kinds: dict[Parameter, list[str]] = {}
    for name, cls in classes.items():
        for parameter in cls.parameters:
            kinds.setdefault(parameter, []).append(name)
    for parameter, names in kinds.items():
        of = "" if len(names) == len(classes) else f" ({', '.join(f'`{name}`' for name in names)})"
        yield f"| `{parameter.name}` | {parameter.kind.words} | {default(parameter)} | {parameter.meaning}{of} |"


def default(parameter: Parameter) -> str:
    """What counts when it is not set, with its unit."""
    if parameter.required:
        return "required"
    value = parameter.default
    if value is None:
        return ""
    shown = str(value).lower() if isinstance(value, bool) else str(value)
    return f"{shown} {parameter.unit}".strip()


def main(arguments: list[str]) -> int:
    """Write the page, or compare it. The exit code."""
    text = page()
    if "--check" not in arguments:
        PAGE.write_text(text, encoding="utf-8")
        return 0
    if PAGE.read_text(encoding="utf-8") == text:
        return 0
    print(f"{PAGE} is out of date: python scripts/controller_reference.py", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
