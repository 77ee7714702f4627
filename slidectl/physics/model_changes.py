"""Reversible changes of a robot's joints and masses: a stuck joint, another friction, a payload.

`hold` applies a change. It is called before every step, since the model may have been rebuilt. `release` reverts the
change completely. `check` raises Refused when the change would have no effect.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar

import mujoco
import numpy as np

from slidectl.errors import Refused
from slidectl.rotations import IDENTITY, Vector, add, compose

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slidectl.physics.attached_robot import AttachedRobot, JointPlace, LinkPlace
    from slidectl.physics.robot_hw import MujocoRobotHW
    from slidectl.physics.world import World


class _JointChange:
    """A change of a joint's dry friction and of another property of its dof in the model."""

    second_array: ClassVar[str]
    """The name of the other property's array in MjModel."""

    def __init__(self, world: World, robot: AttachedRobot, joint: str) -> None:
        self._world = world
        self._robot = robot
        self._joint = joint

    @property
    def _place(self) -> JointPlace:
        return self._robot.place(self._joint)

    @property
    def _arrays(self) -> tuple[Any, Any]:
        return self._world.model.dof_frictionloss, getattr(self._world.model, self.second_array)

    def _set(self, values: Sequence[Any]) -> None:
        """Set dry friction and the other property; None: unchanged."""
        with self._world.changing_friction():
            for array, value in zip(self._arrays, values, strict=True):
                if value is not None:
                    array[self._place.dof] = value


class StuckJoint(_JointChange):
    """Holds a joint at its position by a motor without bound, which overrides its drive."""

    second_array = "dof_solimp"

    saved_attributes: ClassVar[tuple[str, ...]] = ("_dynamics",)
    saved_or_none: ClassVar[tuple[str, ...]] = ("_position", "_lasting")

    def __init__(self, world: World, robot: AttachedRobot, hardware: MujocoRobotHW, joint: str) -> None:
        super().__init__(world, robot, joint)
        self._hardware = hardware
        self._position: float | None = None
        """The position at which it is stuck, m or rad; None while it is not."""
        self._lasting: float | None = None
        self._dynamics: list[Any] = []

    def check(self) -> None:
        """Never raises: any joint can be stuck."""

    @property
    def is_held(self) -> bool:
        """True while the change is applied."""
        return self._position is not None

    def hold(self) -> None:
        """Apply the change. Call this before each step, after all commands to the joint."""
        place, world = self._place, self._world
        if self._position is None:
            self._position = world.data.qpos[place.qpos]
            self._dynamics = [array[place.dof].copy() for array in self._arrays]
            self._lasting = self._robot.lasting_motors.get(self._joint)
        if self._robot.lasting_motors.get(self._joint) != math.inf:
            world.add_motors(self._robot, {self._joint: math.inf})
        views = world.views
        views.qpos[place.qpos], views.qvel[place.dof], views.velocities[place.dof] = self._position, 0.0, 0.0

    def release(self) -> None:
        """Let the joint move again."""
        if self._position is None:
            return
        self._position = None
        del self._robot.lasting_motors[self._joint]
        if self._lasting is not None:
            self._robot.lasting_motors[self._joint] = self._lasting
        self._hardware.engage()
        is_driven = self._joint in self._world.applied_forces.motors.of_robot(self._robot.name)
        self._set((None, None) if is_driven else self._dynamics)

    def effort(self) -> float | None:
        """The hardware's effort, N or N·m, without that of the holding motor; None while the joint is not stuck."""
        return None if self._position is None else self._world.views.forces[self._place.dof]


class JointFriction(_JointChange):
    """Replaces the dry friction (N or N·m), the damping (N·s/m or N·m·s/rad), or both, of a joint; None: unchanged."""

    saved_or_none: ClassVar[tuple[str, ...]] = ("_before",)
    second_array = "dof_damping"

    def __init__(
        self, world: World, robot: AttachedRobot, joint: str, friction: float | None, damping: float | None
    ) -> None:
        super().__init__(world, robot, joint)
        self._values = friction, damping
        self._before: tuple[float, float] | None = None

    def check(self) -> None:
        """Raises Refused: a motor drives the joint."""
        motors, lasting = self._world.applied_forces.motors.of_robot(self._robot.name), self._robot.lasting_motors
        if self._joint in motors and lasting.get(self._joint) != math.inf:
            text = f"{self._joint} is driven by a motor, which takes the place of its friction"
            raise Refused(text, "with gains in gazebo_ros_control/pid_gains it is driven by efforts")

    @property
    def is_held(self) -> bool:
        """True while the change is applied."""
        return self._before is not None

    def hold(self) -> None:
        """Apply the change. Call this before each step."""
        friction, damping = (float(array[self._place.dof]) for array in self._arrays)
        if any(value not in (None, now) for value, now in zip(self._values, (friction, damping), strict=True)):
            self._before = self._before or (friction, damping)
            self._set(self._values)

    def release(self) -> None:
        """Restore the values of the model."""
        if self._before is not None:
            self._set(self._before)
            self._before = None


_OF_MASS = ("body_mass", "body_ipos", "body_iquat", "body_inertia", "body_gravcomp", "body_sameframe")


class Payload:
    """Adds a point mass (kg) at a point of a link (m, in the link's frame)."""

    saved_or_none: ClassVar[tuple[str, ...]] = ("_before",)

    def __init__(self, world: World, robot: AttachedRobot, link: str, mass: float, at: Vector) -> None:
        self._world = world
        self._robot = robot
        self._link = link
        self._mass = mass
        self._at = at
        self._model: Any = None
        """The model that has the payload."""
        self._before: dict[str, Any] = {}
        self._links: list[tuple[str, LinkPlace, LinkPlace]] = []
        """For the links of the body: name, and place without and with the payload."""

    def check(self) -> None:
        """Raises Refused: the robot is a single free link."""
        model = self._world.model
        if model.body_simple[self.body] and model.body_dofnum[self.body] > 1:
            raise Refused(f"{self._robot.name!r} is one free link, {self._link}: MuJoCo takes its mass as constant")

    @property
    def is_held(self) -> bool:
        """True while it is applied, in this model or in an earlier one."""
        return bool(self._before)

    @property
    def body(self) -> int:
        """MuJoCo's id of the body that the link is part of."""
        return self._robot.link(self._link).body

    def hold(self) -> None:
        """Apply the change. Call this before each step."""
        model, body = self._world.model, self.body
        if self._model is model:
            return
        self._model = model
        x, y, z = compose(self._robot.link(self._link).frame, (self._at, IDENTITY))[0]
        place, mass = np.array([x, y, z]), float(model.body_mass[body])
        self._before = {name: getattr(model, name)[body].copy() for name in _OF_MASS}
        centre = model.body_ipos[body].copy()
        whole = mass + self._mass
        together = (mass * centre + self._mass * place) / whole
        turn, values, vectors, attitude = np.zeros(9), np.zeros(3), np.zeros(9), np.zeros(4)
        mujoco.mju_quat2Mat(turn, model.body_iquat[body])
        axes = turn.reshape(3, 3)
        inertia = axes @ np.diag(model.body_inertia[body]) @ axes.T
        for one, away in ((mass, centre - together), (self._mass, place - together)):
            inertia += one * (away @ away * np.eye(3) - np.outer(away, away))
        mujoco.mju_eig3(values, vectors, attitude, inertia.ravel())
        model.body_mass[body], model.body_ipos[body] = whole, together
        model.body_iquat[body], model.body_inertia[body] = attitude, values
        model.body_gravcomp[body] *= mass / whole  # gravity acts on the payload only
        model.body_sameframe[body] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE
        self._update_sums(model, is_simple=False)
        x, y, z = (centre - together).tolist()
        self._restore_links()
        # Wrenches act at the centres of mass of the links without the payload.
        for name, link in self._robot.links.items():
            if link.body == body:
                arm = add(link.arm or (0.0, 0.0, 0.0), (x, y, z))
                self._links.append((name, link, replace(link, arm=arm)))
        self._robot.links.update({name: place for name, _, place in self._links})

    def release(self) -> None:
        """Restore the mass of the link."""
        model, body = self._world.model, self.body
        if self._model is model:
            for name, value in self._before.items():
                getattr(model, name)[body] = value
            self._update_sums(model, is_simple=bool(model.body_simple[body]))
        self._restore_links()
        self._model, self._before = None, {}

    def _restore_links(self) -> None:
        """Restore the places of the links, except those that a rebuild has replaced."""
        for name, link, place in self._links:
            if self._robot.links.get(name) is place:
                self._robot.links[name] = link
        self._links.clear()

    def _update_sums(self, model: Any, is_simple: bool) -> None:
        """Update MuJoCo's sums of the masses, and its flags for bodies with constant inertia.

        MuJoCo takes the inertia of a simple body, alone on its joint, as constant. `dof_simplenum` counts runs of such
        dofs.
        """
        model.body_subtreemass[:] = model.body_mass
        for below in range(model.nbody - 1, 0, -1):
            model.body_subtreemass[model.body_parentid[below]] += model.body_subtreemass[below]
        simple = model.dof_simplenum > 0
        start = model.body_dofadr[self.body]
        simple[start : start + model.body_dofnum[self.body]] = is_simple
        run = 0
        for dof in range(model.nv - 1, -1, -1):
            run = run + 1 if simple[dof] else 0
            model.dof_simplenum[dof] = run


Change = StuckJoint | JointFriction | Payload
