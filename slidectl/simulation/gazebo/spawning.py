"""`spawn_urdf_model`, `spawn_sdf_model` (refused with the reason) and `delete_model`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from slidectl.control.node_handle import Message
from slidectl.errors import Refused, SlidectlError, quoted
from slidectl.physics import hulls
from slidectl.physics.frames import compose
from slidectl.simulation.assembly import SpawnedRobot
from slidectl.simulation.gazebo.answers import Answer, provide
from slidectl.simulation.gazebo.entities import frame
from slidectl.simulation.gazebo.shapes import pose
from slidectl.simulation.graph import WORLD_NODE
from slidectl.simulation.pending import Pending

if TYPE_CHECKING:
    from slidectl.simulation.simulation import Simulation

_MOST_TAGS = 100_000
"""Opening and closing tags of a URDF: some thousand links. To read more than these holds up the world."""


def advertise(simulation: Simulation) -> None:
    """Provide them."""
    node = simulation.graph.node(WORLD_NODE)
    provide(node, "spawn_urdf_model", "SpawnModel", lambda request: _spawn(simulation, request))
    provide(node, "spawn_sdf_model", "SpawnModel", lambda request: _refuse_sdf(request))
    provide(node, "delete_model", "DeleteModel", lambda request: _delete(simulation, request))


def _spawn(simulation: Simulation, request: Message) -> Answer | Pending:
    """At once, or as soon as its meshes are read: a driver lets the world go on meanwhile."""
    place = compose(frame(simulation, request["reference_frame"]).pose, pose(request["initial_pose"]))
    tags = request["model_xml"].count("<")
    if tags > _MOST_TAGS:
        raise Refused(f"the URDF has {tags} tags, and {_MOST_TAGS} is the most")
    robots = simulation.robots
    newcomer = robots.read(request["model_xml"], request["model_name"], request["robot_namespace"] or None)
    wanted = hulls.sources(newcomer.paper)
    if not wanted:
        return _spawned(robots.spawn_read(newcomer, place, {}))
    reading = simulation.read_meshes(wanted)
    answer = Pending(on_cancel=reading.cancel)

    def go_on(read: Pending) -> None:
        try:
            answer.resolve(_spawned(robots.spawn_read(newcomer, place, read.result())))
        except SlidectlError as error:
            answer.reject(error)
        except Exception as error:  # nobody but the one who asked would hear of it
            answer.reject(Refused(f"{newcomer.name!r} cannot be spawned: {type(error).__name__}: {error}"))

    reading.then(go_on)
    return answer


def _spawned(robot: SpawnedRobot) -> Answer:
    lines = [f"spawned {robot.name!r} in the namespace {robot.namespace}", *robot.warnings]
    return "\n".join(lines), {}


def _refuse_sdf(request: Message) -> Answer:
    raise Refused(
        f"{quoted(request['model_name'])} is SDF, and only URDF can be spawned", "describe the robot in URDF or xacro"
    )


def _delete(simulation: Simulation, request: Message) -> Answer:
    simulation.delete(request["model_name"])
    return f"deleted {request['model_name']!r}", {}
