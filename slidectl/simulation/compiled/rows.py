"""The tables of the compiled cycle: their columns, and which number means what.

Controllers, PIDs and limits declare their own columns beside their laws; here are those of the cycle itself.
"""

from __future__ import annotations

import ctypes

from slidectl.control.controllers.forward import ForwardController
from slidectl.control.controllers.joint_position import JointPositionController
from slidectl.control.controllers.joint_state import JointStateController
from slidectl.control.controllers.joint_velocity import JointVelocityController
from slidectl.control.laws import Columns
from slidectl.control.limits import LimitHandle
from slidectl.control.pid import Pid
from slidectl.physics.drives import Drive

JOINT = Columns(
    changing="position velocity effort command",
    places="qpos dof turns is_pushed max_effort max_velocity",
    whole="qpos dof turns is_pushed",
)
"""`qpos` and `dof` are indices into MuJoCo's arrays, `turns` is true for angles; the bounds are Gazebo's.
`is_pushed`: the command is the effort, else a drive makes one of it."""

ROBOT = Columns(
    changing="last_update_ns last_write_ns period_ns write_period_ns period_s write_period_s",
    fixed="control_period_ns",
    places="is_plain first_joint joints first_controller controllers first_limit limits first_drive drives",
    whole="last_update_ns last_write_ns period_ns write_period_ns control_period_ns "
    "is_plain first_joint joints first_controller controllers first_limit limits first_drive drives",
)
"""A ControlCycle, and where the robot's rows are in the other tables. `is_plain`: the interpreter has the robot."""

CONTROLLER = Columns(places="kind row", whole="kind row")
"""The controllers of all robots in their order: in which table, and where."""

IN_PYTHON, FORWARD, JOINT_POSITION, JOINT_VELOCITY, JOINT_STATE = range(5)
CONTROLLER_KINDS = {
    ForwardController: FORWARD,
    JointPositionController: JOINT_POSITION,
    JointVelocityController: JOINT_VELOCITY,
    JointStateController: JOINT_STATE,
}
"""What a controller's class that declares `compiled` is in CONTROLLER.kind."""

TABLES: dict[str, Columns] = {
    "robots": ROBOT,
    "joints": JOINT,
    "controllers": CONTROLLER,
    "limits": LimitHandle.columns,
    "drives": Drive.columns,
    "pids": Pid.columns,
    "forwards": ForwardController.compiled.columns,
    "positions": JointPositionController.compiled.columns,
    "velocities": JointVelocityController.compiled.columns,
    "states": JointStateController.compiled.columns,
}
"""The tables in the order of the cycle's arguments; MuJoCo's arrays follow."""
CONSTANT = {"controllers", "drives"}
"""Tables of what never changes while it exists."""
KIND_TABLES = {FORWARD: "forwards", JOINT_POSITION: "positions", JOINT_VELOCITY: "velocities", JOINT_STATE: "states"}
RANGES = ("joints", "controllers", "limits", "drives")
"""Tables of which each robot has a range of rows, as ROBOT has it."""
ARRAYS = ("qpos", "qvel", "forces", "outside")

DONE, ROBOT_IN_PYTHON, CONTROLLER_IN_PYTHON, PUBLICATION, STEP_IN_PYTHON, DIVERGED, FAILED = range(7)
"""What the compiled cycle returns for: all cycles are done, the interpreter has its turn, or there is trouble."""

CHECK_EVERY = 256
"""Cycles between two looks at whether the physics has diverged; counted from time 0, however stepping is cut."""

NEW_CYCLE = -1


class Progress(ctypes.Structure):
    """How far the cycles are: `robot` and `controller` have the next turn, in the cycle at `time_ns`."""

    _fields_ = [
        (name, ctypes.c_int64)
        for name in (
            "time_ns",
            "step_ns",
            "cycles",
            "left",
            "robot",
            "controller",
            "robots",
            "positions",
            "dofs",
            "has_outside",
            "step",
            "model",
            "data",
            "error_hook",
        )
    ]
    time_ns: int
    step_ns: int
    cycles: int
    left: int
    robot: int
    controller: int
    robots: int
    positions: int
    dofs: int
    has_outside: int
    step: int
    """Address of mj_step; 0: somebody else makes the steps."""
    model: int
    data: int
    error_hook: int
    """Address of MuJoCo's variable `mju_user_error`, or 0."""
