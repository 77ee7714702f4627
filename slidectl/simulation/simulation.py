"""The simulation: a world, a graph, robots, and a loop that moves them. What batch scripts and the daemon hold.

Knows no wall time, no sockets and no threads: the same calls give the same bits.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from numbers import Integral
from typing import Any

from slidectl.control import registry
from slidectl.control.duration import from_seconds
from slidectl.control.node_handle import Message, MessageCallback
from slidectl.description.robot import Camera
from slidectl.errors import Refused
from slidectl.physics import World, hulls
from slidectl.physics.hulls import MeshSource
from slidectl.physics.rendering import RenderProcess
from slidectl.rotations import ORIGIN, Pose
from slidectl.simulation import base_drives, joint_traces, rosapi, waits
from slidectl.simulation.compiled.engine import Engine
from slidectl.simulation.entities import Entities
from slidectl.simulation.faults import Faults
from slidectl.simulation.gazebo_services import GazeboServices
from slidectl.simulation.graph import Graph
from slidectl.simulation.lockstep import LockStepService
from slidectl.simulation.loop import Loop, RunState, check_timestep
from slidectl.simulation.own_services import OwnServices
from slidectl.simulation.parameters import Parameters
from slidectl.simulation.pending import Pending
from slidectl.simulation.sensor_topics import bring_up as bring_up_sensors
from slidectl.simulation.snapshots import Snapshots
from slidectl.simulation.spawned_robots import Robots, SpawnedRobot
from slidectl.simulation.standard_services import StandardServices
from slidectl.simulation.state_publisher import StatePublishers
from slidectl.simulation.topics import TopicSubscription

SCRIPT_NODE = "/script"
"""The node under which calls of `publish` and `subscribe` appear."""


class Simulation:
    """Build it, spawn a robot, load controllers, `step(n)`, read.

    Args:
        timestep: seconds of one cycle, 1e-6 to 1.
        gravity: m/s².
        ground: whether there is a floor at height 0.
        engine: who runs the cycles: `plain` (the interpreter), `compiled` (machine code; needs numba) or `auto`, which
            is compiled as soon as it can be. The results are the same to the bit.
        imports: modules with controllers and hardware of your own, by dotted name or as files (`FILE.py`), imported
            first.

    Callbacks of `subscribe` and of `graph.timers` find what the script holds of a robot (controllers, joint handles) as
    it is in that moment. Who listens in another way, as a node of the graph, takes it from `robots` anew.

    Raises:
        Refused: no time step, or `compiled` without numba. BadFile: a module cannot be found, its code fails, or it has
            no controller.
    """

    def __init__(
        self,
        timestep: float = 0.001,
        gravity: tuple[float, float, float] = (0.0, 0.0, -9.8),
        ground: bool = True,
        engine: str = "auto",
        imports: Sequence[str] = (),
    ) -> None:
        check_timestep(timestep)
        for module in imports:
            registry.add_module(module)
        self.world = World(timestep, gravity, ground)
        self.graph = Graph()
        self.loop = Loop(self.graph, self.world, from_seconds(timestep), engine)
        self.robots = Robots(self.world, self.loop)
        self.entities = Entities(self)
        self.monitor: Callable[[], dict[str, Any]] = dict
        """What the driver adds to `/slidectl/status`: wall times, connections, memory."""
        self.read_meshes: Callable[[Sequence[MeshSource]], Pending] = _read_here
        """How `/gazebo/spawn_urdf_model` gets the hulls (physics.hulls.Hulls) of meshes. A driver puts its own, which
        may answer later."""
        self.render: Callable[[Camera, Pose, int], Pending] = self._render_here
        """How a camera at a pose gets its picture (pixels in base64), with the seed of its noise. A driver puts its
        own, which may answer later."""
        self._renderer: RenderProcess | None = None
        self.snapshots = Snapshots(self)
        self.kept: dict[str, object] = {}
        """What a snapshot saves besides world, clock, parameters and robots, by names of whoever puts it here. What
        counts of an object is in `kept_state`."""
        self.chosen: set[str] = set()
        """What a user has asked for, of `speed`, `timestep` and `gravity`: the file of a world does not change it."""
        self.world.clock = self.graph.clock.now_ns
        self.run.on_halt = self.robots.settle_switches
        self.graph.parameters.set("/use_sim_time", True)
        rosapi.advertise(self.graph)
        self.lockstep = LockStepService(self.graph, self.loop)
        OwnServices(self)
        StandardServices(self)
        waits.advertise(self.graph)
        joint_traces.advertise(self)
        GazeboServices(self)
        self.faults = Faults(self)
        self.robots.on_spawn += [
            StatePublishers(self).bring_up,
            partial(bring_up_sensors, self),
            partial(base_drives.bring_up, self),
        ]

    @property
    def time_ns(self) -> int:
        """Simulated time of the last cycle, in nanoseconds."""
        return self.graph.clock.time_ns

    @property
    def cycles(self) -> int:
        """Cycles since the clock was at 0."""
        return self.graph.clock.cycles

    @property
    def timestep_ns(self) -> int:
        """Nanoseconds of one cycle."""
        return self.loop.step_ns

    @property
    def parameters(self) -> Parameters:
        """The parameter tree."""
        return self.graph.parameters

    @property
    def engine(self) -> Engine:
        """Who runs the cycles."""
        return self.loop.engine

    @property
    def run(self) -> RunState:
        """How the world is asked to run."""
        return self.loop.run

    @property
    def driven(self) -> bool:
        """True when a driver calls `step` as `run` says; else time moves only when this object is asked.

        A driver looks at controllers and joints through robots, topics and services only: handles that it keeps from an
        earlier look may be old while the compiled engine runs.
        """
        return self.loop.driven

    @driven.setter
    def driven(self, value: bool) -> None:
        self.loop.driven = value
        self.loop.settle()

    def step(self, cycles: int = 1) -> int:
        """Run so many cycles. Returns how many: fewer only when the physics diverges and `driven`.

        Raises:
            Diverged: the state of a robot is no longer a number, and nobody drives. Refused: no number of cycles.
        """
        if not isinstance(cycles, Integral) or cycles < 0:
            raise Refused(f"a number of cycles is a whole one of 0 or more, not {cycles!r}")
        return self.loop.step(int(cycles))

    def ask_steps(self, cycles: int, reader: str = "") -> Pending:
        """Pause, and run so many cycles more: now, or when the driver does. Resolved with their number.

        For a `reader` see RunState.ask_steps. Raises Diverged: it cannot go on before a reset.
        """
        if reader:
            self.run.holders.add(reader)
        elif not cycles:
            self.pause()
        if not cycles:
            return Pending.of(0)
        self.check_trouble()
        if self.driven:
            return self.run.ask_steps(cycles, reader)
        return Pending.attempt(lambda: self.step(cycles))

    def spawn(self, xml: str, name: str, namespace: str | None = None, pose: Pose = ORIGIN) -> SpawnedRobot:
        """A robot from the text of its URDF, with its meshes read here and now; see Robots.spawn."""
        return self.robots.spawn(xml, name, namespace, pose)

    def delete(self, name: str) -> None:
        """Take a robot out of the world. Raises UnknownName."""
        self.robots.delete(name)

    def call(self, service: str, request: Message | None = None) -> Message:
        """Call a service and give its response. What needs simulated time is stepped through, unless `driven`.

        Raises:
            SlidectlError: the call failed. Refused: it needs simulated time, and that is the driver's.
        """
        pending = self.graph.services.call(service, request)
        while not pending.done:
            if self.driven or not self.step():
                pending.cancel()
                raise Refused(f"{service} needs simulated time to pass before it can answer")
        response: Message = pending.result()
        return response

    def publish(self, topic: str, message: Any, type_name: str | None = None) -> None:
        """Publish a message, complete or partial. Raises BadMessage, UnknownName, or what a subscriber says."""
        self.graph.topics.publish(topic, type_name, message, SCRIPT_NODE)

    def subscribe(self, topic: str, callback: MessageCallback, type_name: str | None = None) -> TopicSubscription:
        """Call back for each message. Raises UnknownName when the topic does not exist and no type is given."""

        def take(message: Message) -> None:
            if not self.driven:
                self.loop.settle()
            callback(message)

        return self.graph.topics.subscribe(topic, type_name, SCRIPT_NODE, take)

    def pause(self) -> None:
        """Hold the world. Steps that somebody waits for are given up; switches that wait for a cycle are finished."""
        self.run.pause()

    def resume(self) -> None:
        """Let the world go on. Raises Diverged: it cannot before a reset."""
        self.check_trouble()
        self.run.resume()

    def check_trouble(self) -> None:
        """Raises Diverged when the world was held for that, and is still as it was."""
        if self.run.trouble:
            self.world.check()

    def set_speed(self, factor: float) -> None:
        """Real-time factor, 0 for as fast as possible. Raises Refused for anything else."""
        self.run.set_speed(factor)

    def set_timestep(self, seconds: float) -> None:
        """Another length for the cycles to come, s. Raises Refused: not 1e-6 to 1, or inside a cycle."""
        self.loop.between_cycles("change the time step")
        check_timestep(seconds)
        self.world.set_timestep(seconds)
        self.loop.step_ns = from_seconds(seconds)

    def save(self, name: str) -> None:
        """Keep the whole state of now under a name, for `load`; see snapshots.Snapshots.save for what it raises."""
        self.snapshots.save(name)

    def load(self, name: str) -> None:
        """Be again what was saved under the name. Raises UnknownName, Refused."""
        self.snapshots.load(name)

    def _render_here(self, camera: Camera, pose: Pose, seed: int) -> Pending:
        """Waits for the picture."""
        renderer = self._renderer = self._renderer or RenderProcess()

        def render() -> str:
            renderer.ask(renderer.look(self.world, camera, pose, seed))
            while (picture := renderer.take()) is None:
                pass
            return picture

        return Pending.attempt(render)

    def reset_simulation(self) -> None:
        """Time and world back to the beginning, at once, all or nothing; controllers stay loaded and running.

        Sleeps, waits and deadlines that are running keep what is left of them.
        """
        self.loop.between_cycles("reset")
        clock = self.graph.clock
        before_ns, clock.time_ns, clock.cycles = clock.time_ns, 0, 0
        self.graph.timers.rebase(before_ns, 0)
        self.reset_world()
        self.graph.clock_topic.publish_now(0)

    def reset_world(self) -> None:
        """Every robot as it was spawned, time goes on; controllers stay loaded and running.

        Each controller is stopped and started again, so that PID integrators, set points and publishers' clocks begin
        afresh. ros_control leaves these behind.
        """
        self.loop.between_cycles("reset")
        self.run.trouble = ""
        self.loop.history.forget()
        self.faults.restart()
        self.robots.reset()


def _read_here(sources: Sequence[MeshSource]) -> Pending:
    return Pending.of({source: hulls.read(source) for source in sources})
