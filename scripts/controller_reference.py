"""Writes docs/controllers.md from what the controllers say of themselves. `--check` only compares.

python scripts/controller_reference.py [--check]
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

from slidectl.control import registry, ros2_names
from slidectl.control.controller_interface import ControllerBase
from slidectl.control.params import Parameter

PAGE = Path(__file__).parent.parent / "docs" / "controllers.md"

HEAD = """# Controllers

<!-- python scripts/controller_reference.py writes this page. -->

This page lists the types that `slidectl controller types` prints, with the parameters below the name of a controller.
They behave as those of ros_controllers, or as those of ros2_controllers ([below](#controllers-of-ros-2));
[deviations](deviations.md) lists the differences. Every controller also reads `type` and `update_budget`
([times](extending.md#a-controller-of-your-own)).

## Follow a trajectory

This file configures a trajectory controller for two joints of the shipped arm. Save it as `two_joints.yaml`:

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

Send it a goal and read the result:

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

An action has five topics. The client publishes `goal` and `cancel`. The server publishes `feedback`, `result` and
`status` (five times a second, and at each change). The server assigns an id to a goal without one. An empty `cancel`
cancels all goals, and a new goal preempts the previous one.

## Drive a base

The shipped cart takes velocities of its base. Its odometry reports its speed:

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

The shipped car steers its four wheels. It takes velocities, or a speed and the angles of its axles:

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

## Follow a trajectory as in ROS 2

This file of ROS 2 configures its trajectory controller for the same two joints. Save it as `ros2_joints.yaml`:

```yaml
controller_manager:
  ros__parameters:
    arm_controller:
      type: joint_trajectory_controller/JointTrajectoryController
arm_controller:
  ros__parameters:
    joints: [joint1, joint2]
    command_interfaces: [effort]
    state_interfaces: [position, velocity]
    gains:
      joint1: {p: 400.0, d: 60.0}
      joint2: {p: 400.0, d: 60.0}
    constraints:
      goal_time: 0.5
      stopped_velocity_tolerance: 0.1
      joint1: {trajectory: 0.5, goal: 0.02}
```

```console
$ slidectl daemon start --paused
daemon default: started, process 4711
$ slidectl spawn arm --controllers ros2_joints.yaml --start arm_controller
arm: spawned in /arm at 0 0 0, joints: joint1 joint2 joint3 joint4 joint5 joint6
$ slidectl sim resume
running at 0 s
$ slidectl trajectory plan arm_controller --to joint1=1.0 joint2=-0.5 --duration 2 --wait
/arm/arm_controller/follow_joint_trajectory: succeeded: Goal successfully reached!
$ slidectl echo /arm/arm_controller/controller_state/reference/positions -n 1
[1.0, -0.5]
---
$ slidectl daemon stop
daemon default: stopped, it was process 4711
```
"""

CHAINS = """

## Chain controllers

A chainable controller, such as `pid_controller/PidController`, takes its references from other controllers. It exports
each reference under a name `CONTROLLER/JOINT`, in the interface of its quantity. Any controller finds and claims it
there as it does a joint. So a forward command controller gives positions to a PID, and the PID gives efforts to the
joint, in the same cycle. This file of ROS 2 does that for the shipped slider. Save it as `chain.yaml`:

```yaml
controller_manager:
  ros__parameters:
    pid_controller: {type: pid_controller/PidController}
    position_controller: {type: forward_command_controller/ForwardCommandController}

pid_controller:
  ros__parameters:
    dof_names: [joint1]
    command_interface: effort
    reference_and_state_interfaces: [position]
    gains:
      joint1: {p: 400.0, i: 800.0, d: 40.0, u_clamp_max: 100.0, u_clamp_min: -100.0}

position_controller:
  ros__parameters:
    joints: [pid_controller/joint1]
    interface_name: position
```

```console
$ slidectl daemon start --paused
daemon default: started, process 4711
$ slidectl spawn slider --controllers chain.yaml --start pid_controller position_controller
slider: spawned in /slider at 0 0 0, joints: joint1
$ slidectl controller list
MANAGER  NAME                 STATE    TYPE
/slider  position_controller  running  forward_command_controller/ForwardCommandController
/slider  pid_controller       running  pid_controller/PidController
$ slidectl pub position_controller/commands '[0.5]'
$ slidectl sim step 8s
time 8 s after 8000 cycles
$ slidectl robots slider | grep joint1
joint1  prismatic  EffortJointInterface  0.5  0  0  -1  1  0.1  100
$ slidectl daemon stop
daemon default: stopped, it was process 4711
```

* **Load** the following controller (here the PID) first: the others find its interfaces then. It cannot be unloaded
  while another loaded controller has them.
* **Start** both in one switch, or the following one first. A following controller that runs already is restarted in
  the same switch. From then on it is in chained mode: messages on its topics have no effect.
* **Stop** both, or the preceding one alone. The following one is then restarted, and takes messages again.
* **Order**: a controller is updated before those whose references it writes, and is listed before them.
* **A failure** of one aborts the whole chain.
* A reference is nan until it is written.

A chainable controller also exports its states, as `CONTROLLER/JOINT` in the JointStateInterface. A controller that
reads them needs it running, too. The exported names are none of the robot's joints: joint states do not list them.
"""

OF_ROS_2 = """## Controllers of ROS 2

The controllers of the following sections behave as those of ros2_controllers: names, topics, parameters, and what they
do. Where ros_controllers have a type of the same name, as `position_controllers/JointGroupPositionController`, a
[robot of ROS 2](ros2-robots.md) gets that of ROS 2, any other robot that of ROS 1.

slidectl reads parameter files of ROS 2. It puts parameters below `ros__parameters` directly below their node, and those
of `controller_manager` beside it, and reads dots in names as slashes. `update_rate` of a controller counts against the
rate of the control cycle, as in ROS 2 against that of the manager. A parameter that is read-only in ROS 2 is fixed when
the controller is loaded.

This file drives the shipped cart, which is a robot of ROS 1. Save it as `base.yaml`:

```yaml
controller_manager:
  ros__parameters:
    states: {type: joint_state_broadcaster/JointStateBroadcaster}
    base: {type: diff_drive_controller/DiffDriveController}
states:
  ros__parameters:
    update_rate: 50
base:
  ros__parameters:
    left_wheel_names: [left_wheel_joint]
    right_wheel_names: [right_wheel_joint]
    wheel_separation: 0.4
    wheel_radius: 0.1
    tf_frame_prefix_enable: false
    linear.x: {max_velocity: 1.0, max_acceleration: 2.0}
    angular.z.max_velocity: 2.0
```

```console
$ slidectl daemon start --paused
daemon default: started, process 4711
$ slidectl spawn cart drive:=controller --controllers base.yaml --start states base
cart: spawned in /cart at 0 0 0, joints: left_wheel_joint right_wheel_joint
$ slidectl pub cart/base/cmd_vel '{twist: {linear: {x: 0.5}}}'
warning: /cart/base: the command has no stamp, and counts from its arrival
$ slidectl sim step 0.4s
time 0.4 s after 400 cycles
$ slidectl robots cart | grep position    # 2 m/s² for 0.25 s, then 0.5 m/s
position:    0.137516 -1.92734e-18 -0.000293718
$ slidectl daemon stop
daemon default: stopped, it was process 4711
```

These are the differences from the controllers of ros_controllers.

* `joint_state_broadcaster/JointStateBroadcaster` publishes at its `update_rate`, and a field without data is nan.
  `joint_state_controller/JointStateController` needs `publish_rate`.
* Forward and group controllers listen to `commands` and command nothing before the first message. When a group stops,
  its velocities and efforts become 0. Those of ROS 1 listen to `command` and first command 0, or hold positions.
* `joint_trajectory_controller/JointTrajectoryController` is one type for all interfaces, with other topics. A violated
  tolerance stops the motion, and a `goal_time` of 0 waits for ever ([more](#joint-trajectory-of-ros-2)).
* A broadcaster of a sensor publishes the one sensor `sensor_name` on `~/imu` or `~/wrench`, at its `update_rate`. The
  controllers of ROS 1 publish all sensors at `publish_rate`, each on its own name.
* `diff_drive_controller/DiffDriveController` is that of ROS 2 also where `left_wheel_names` or `right_wheel_names` is
  set. Commands are geometry_msgs/TwistStamped, whose stamps are simulated time; 0 is the time of the arrival. A limit
  applies where it is set. The geometry must be given. Odometry comes with each update, and its frames have the robot's
  namespace as prefix unless `tf_frame_prefix_enable` is false.
"""


def page() -> str:
    """The whole page."""
    names = registry.common.types()
    classes = {(name, registry.common.find(name, for_ros2=of_2)): None for of_2 in (False, True) for name in names}
    families: dict[bool, dict[str, dict[str, type[ControllerBase]]]] = {False: {}, True: {}}
    for name, cls in classes:
        module = cls.__module__
        families[is_of_ros_2(module)].setdefault(module, {})[name] = cls
    of_1, of_2 = ([line for each in one.items() for line in family(*each)] for one in families.values())
    lines = (*of_1, "", *OF_ROS_2.splitlines(), *of_2, *CHAINS.splitlines()[1:], *names_of_ros_2())
    return HEAD + "".join(line + "\n" for line in lines)


def is_of_ros_2(module: str) -> bool:
    """True for a module of controllers that behave as in ros2_controllers."""
    return module.rpartition(".")[2].startswith("ros2_")


def names_of_ros_2() -> Iterator[str]:
    """The types of ROS 2 that are not here, with what to write instead."""
    yield from ("", "## Other types of ROS 2", "")
    yield from ("slidectl refuses the following types, and the error names what to use instead.", "")
    refused: dict[str, list[str]] = {}
    for name, (advice, telling) in ros2_names.OTHERS.items():
        refused.setdefault(advice, []).append(f"`{name}`" + (f" with {quoted(telling, 'or')}" if telling else ""))
    for advice, names in refused.items():
        yield f"* {', '.join(names)}: {advice}."


def quoted(names: Iterable[str], word: str) -> str:
    """Names as code, as a list in a sentence."""
    *first, last = [f"`{name}`" for name in names]
    return f"{', '.join(first)} {word} {last}" if first else last


def sentence(text: str) -> str:
    """The text with a capital letter and a full stop."""
    return f"{text[0].upper()}{text[1:].rstrip('.')}."


def family(module: str, classes: dict[str, type[ControllerBase]]) -> Iterator[str]:
    """The controllers of one file: what they are, their types, their parameters."""
    title, _, text = (sys.modules[module].__doc__ or "").partition("\n\n")
    word = module.rpartition(".")[2].removeprefix("ros2_").replace("_", " ").capitalize()
    yield from ("", f"## {word} of ROS 2" if is_of_ros_2(module) else f"## {word}", "", sentence(title), "")
    yield from (text.strip(), "")
    for name, cls in classes.items():
        yield f"* `{name}`: {(cls.__doc__ or '').splitlines()[0]}"
    kinds: dict[str, tuple[Parameter, list[str]]] = {}
    for name, cls in classes.items():
        for parameter in cls.parameters:
            kinds.setdefault(repr(parameter), (parameter, []))[1].append(name)
    shared: dict[tuple[str, ...], list[Parameter]] = {}
    for parameter, names in kinds.values():
        shared.setdefault(tuple(names), []).append(parameter)
    for names, parameters in sorted(shared.items(), key=lambda each: -len(each[0])):
        if len(names) < len(classes):
            yield from ("", f"Only of {quoted(names, 'and')}:")
        yield from ("", "| parameter | type | default | meaning |", "| --- | --- | --- | --- |")
        for each in parameters:
            yield f"| `{each.name}` | {each.kind.words} | {default(each)} | {each.meaning} |"


def default(parameter: Parameter) -> str:
    """What counts when it is not set, with its unit."""
    if parameter.required:
        return "required"
    value = parameter.default
    if value in (None, []):
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
