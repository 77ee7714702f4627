"""Compiles robots to a MuJoCo model, with the options of every world, the ground, and errors that name the robot.

Robots are added to a specification and removed from it without building the others again.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import mujoco

from slidectl.errors import SlidectlError
from slidectl.physics import mujoco_library
from slidectl.physics.attached_robot import AttachedRobot
from slidectl.physics.builder import RobotBuilder, set_friction
from slidectl.physics.collisions import set_collision_bits
from slidectl.rotations import Vector

GROUND = "ground_plane"

GROUND_FRICTION = 100.0
"""The mu of Gazebo's ground plane."""

FRICTION_STIFFNESS = 1000.0
"""Ratio of a contact's stiffness in its plane to that along its normal. A box on a slope of 18 degrees then slips 3 mm
per hour."""
SOLVER_TOLERANCE = 1e-11
"""At MuJoCo's own 1e-8 the solver leaves off early for stiff friction, and a robot of 1 kg that stands creeps by 0.1 mm
in a second. Once it stands, the solver needs fewer iterations with this one."""

_ELEMENT = re.compile(r"Element name '([^']*)'")


class BadModel(SlidectlError):
    """MuJoCo does not accept a robot. The message names the robot and, if MuJoCo does, its link or joint."""

    def __init__(self, robot: str, element: str | None, trouble: str) -> None:
        part = f" ({element})" if element else ""
        super().__init__(f"robot {robot!r}{part} cannot be simulated: {trouble}")


@dataclass
class Settings:
    """Settings of a world's compilation: `timestep` in s, `gravity` in m/s², whether there is a ground."""

    timestep: float
    gravity: Vector
    ground: bool


class WorldSpec:
    """The specification of a world with robots. After an error it must not be used further."""

    def __init__(self, settings: Settings, robots: Iterable[AttachedRobot] = ()) -> None:
        """Raises as `add` does."""
        self._settings = settings
        self._spec = _empty(settings.ground)
        for robot in robots:
            self.add(robot)

    def add(self, robot: AttachedRobot) -> None:
        """Add a robot after the others. Raises BadInertia, BadJoint, BadShape."""
        RobotBuilder(self._spec, robot.description, robot.name, robot.hulls).build(robot.spawn_pose)

    def remove(self, robot: AttachedRobot) -> None:
        """Remove a robot, with its meshes and the constraints on its joints (mimic joints)."""
        self._spec.delete(self._spec.body(f"{robot.name}/{robot.description.root}"))
        for mesh in [mesh for mesh in self._spec.meshes if mesh.name.startswith(f"{robot.name}/")]:
            self._spec.delete(mesh)
        used = {mesh.file for mesh in self._spec.meshes}
        for name in [name for name in self._spec.assets if name not in used]:
            del self._spec.assets[name]

    def compile(self, newest: str = "") -> Any:
        """Compile the MjModel. Raises BadModel, which names `newest` when MuJoCo does not name a robot."""
        option = self._spec.option
        option.timestep, option.gravity = self._settings.timestep, self._settings.gravity
        try:
            with mujoco_library.warnings_kept():
                model = self._spec.compile()
        except (ValueError, mujoco.FatalError) as error:
            raise _explained(str(error), newest) from error
        # Older versions scale the solver's tolerance with the mean inertia of the whole world.
        model.stat.meaninertia = 1.0
        set_collision_bits(model)
        return model


def _empty(ground: bool) -> Any:
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    # The motion of a robot must not depend on the other robots. Sums over a sparse row are the same at any place of the
    # row, and the automatic choice between dense and sparse depends on the number of degrees of freedom in the world.
    spec.option.jacobian = mujoco.mjtJacobian.mjJAC_SPARSE
    # With warm starts, the solver starts from the last accelerations or from free motion, whichever is better for the
    # whole world. So always start from free motion, which costs Newton's method one or two iterations at most.
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_WARMSTART
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    # With pyramidal cones the normal stiffness depends on the friction: without any, a contact throws the body up,
    # from 10 on it lets it sink. Elliptic cones do neither. The ratio makes friction stiffer than the
    # contact along its normal, so that bodies held by friction do not creep.
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = FRICTION_STIFFNESS
    spec.option.tolerance = SOLVER_TOLERANCE
    spec.worldbody.add_light(name="sun", pos=[0, 0, 10], dir=[-0.5, 0.1, -0.9])
    if ground:
        # At z = 0, with the friction of Gazebo's ground, so that in nearly all contacts the robot's friction counts.
        plane = spec.worldbody.add_geom(name=GROUND, type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1])
        set_friction(plane, GROUND_FRICTION)
    return spec


def _explained(text: str, newest: str) -> BadModel:
    found = _ELEMENT.search(text)
    element = found.group(1) if found else ""
    robot, _, part = element.rpartition("/") if element.count("/") == 1 else element.partition("/")
    trouble = text.removeprefix("Error: ").split("\n", 1)[0]
    return BadModel(robot or newest, part or None, trouble)
