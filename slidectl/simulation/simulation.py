"""The simulation: a world, a graph, robots, and a loop that moves them. Batch scripts and the daemon hold one.

Knows no wall time, no sockets and no threads: the same calls give the same bits.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from numbers import Integral
from typing import TYPE_CHECKING, Any, ClassVar

from slidectl.control.duration import from_seconds
from slidectl.control.node_handle import Message, MessageCallback
from slidectl.control.registry import ControllerTypes
from slidectl.control.user_modules import UserCode
from slidectl.errors import Refused
from slidectl.physics import World
from slidectl.rotations import ORIGIN, Pose
from slidectl.simulation.compiled.engine import Engine
from slidectl.simulation.feature import F, Feature, Features
from slidectl.simulation.graph import Graph
from slidectl.simulation.host import Host
from slidectl.simulation.loop import Loop, RunState, check_timestep
from slidectl.simulation.parameters import Parameters
from slidectl.simulation.pending import Pending
from slidectl.simulation.spawned_robots import Robots, SpawnedRobot
from slidectl.simulation.topics import TopicSubscription

SCRIPT_NODE = "/script"
"""The node under which calls of `publish` and `subscribe` appear."""


class Simulation:
    """Build it, spawn a robot, load controllers, `step(n)`, read.

    Args:
        timestep: seconds of one cycle, 1e-6 to 1.
        gravity: m/s².
        ground: True for a floor at height 0.
        engine: the engine that runs the cycles: `plain` (the interpreter), `compiled` (machine code; needs numba) or
            `auto`, which changes to compiled as soon as possible. The results are the same to the bit.
        imports: modules with the user's controllers and hardware, by dotted name or as files (`FILE.py`), imported
            first.
        strict: a robot whose state is no longer a number stops the world, with Diverged; else that robot is held at
            rest until a reset, and the others go on.
        host: all that reaches the world from outside: files, users' modules, meshes, pictures, log. That of a plain
            script by default.
        features: what hangs on the simulation, in this order: names of features (`feature.names()`), or classes that
            are derived from Feature. None: all of slidectl and of installed packages. A feature of a package that is
            broken is then left out, and in `features.broken`.

    A feature is an attribute too, under its name: `simulation.faults`.

    In callbacks of `subscribe` and of `graph.timers` the objects of a robot that the script holds (controllers, joint
    handles) are up to date. A node of the graph that listens in another way must take them from `robots` each time.

    Raises:
        Refused: the time step is invalid, or the engine is `compiled` without numba. BadFile: a module cannot be found,
            its code fails, or it has no controller. UnknownFeature: no feature has a name in `features`.
    """

    saved_attributes: ClassVar[None] = None

    def __init__(
        self,
        timestep: float = 0.001,
        gravity: tuple[float, float, float] = (0.0, 0.0, -9.8),
        ground: bool = True,
        engine: str = "auto",
        imports: Sequence[str] = (),
        strict: bool = True,
        host: Host | None = None,
        features: Sequence[str | type[Feature]] | None = None,
    ) -> None:
        check_timestep(timestep)
        self.host = host or Host()
        self.types = ControllerTypes(UserCode(self.host))
        """The types of controllers and hardware that this world knows, and the users' code of it."""
        for module in imports:
            self.types.add_module(module)
        self.world = World(timestep, gravity, ground)
        self.graph = Graph()
        self.graph.log.sink = self.host.log
        self.loop = Loop(self.graph, self.world, from_seconds(timestep), engine)
        self.loop.strict = strict
        self.robots = Robots(self.world, self.loop, self.types)
        self.chosen: set[str] = set()
        """The settings (`speed`, `timestep`, `gravity`) that the user has set. A world file does not change them."""
        self.world.clock = self.graph.clock.now_ns
        self.run.on_halt.append(self.robots.settle_switches)
        self.graph.parameters.set("/use_sim_time", True, derived=True)
        self.features = Features(self)
        if features is None:
            self.features.attach_all()
        else:
            self.features.attach_these(features)
        self.host.attach(self)

    if not TYPE_CHECKING:  # a misspelt attribute is an error for the type checker; typed code calls `feature`

        def __getattr__(self, name: str) -> Any:
            """The feature of that name: `simulation.faults`, say."""
            features = vars(self).get("features", ())
            if name in features:
                return features[name]
            raise AttributeError(f"a simulation has no {name!r}, and no feature of that name", name=name, obj=self)

    def feature(self, cls: type[F]) -> F:
        """The feature of that class. Raises UnknownFeature: the simulation was made without it."""
        return self.features.of_class(cls)

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
        """The engine that runs the cycles."""
        return self.loop.engine

    @property
    def run(self) -> RunState:
        """The requested run state of the world."""
        return self.loop.run

    @property
    def driven(self) -> bool:
        """True when a driver calls `step` as `run` says. When False, time moves only by calls to this object.

        A driver must read controllers and joints through robots, topics and services only: handles that it keeps may
        be out of date while the compiled engine runs.
        """
        return self.loop.driven

    @driven.setter
    def driven(self, value: bool) -> None:
        self.loop.driven = value
        self.loop.settle()

    def step(self, cycles: int = 1) -> int:
        """Run `cycles` cycles. Returns the number run: fewer only when the physics diverges and `driven`.

        Raises Diverged: the state of a robot is no longer a number, and not `driven`. Refused: a bad number of cycles.
        """
        if not isinstance(cycles, Integral) or cycles < 0:
            raise Refused(f"the number of cycles must be a whole number of 0 or more, not {cycles!r}")
        return self.loop.step(int(cycles))

    def request_steps(self, cycles: int, reader: str = "") -> Pending:
        """Pause and run `cycles` more cycles: now, or when the driver does. Resolved with their number.

        For `reader` see RunState.request_steps. Raises Diverged: the world cannot go on before a reset.
        """
        if reader:
            self.run.holders.add(reader)
        elif not cycles:
            self.pause()
        if not cycles:
            return Pending.of(0)
        self.check_trouble()
        if self.driven:
            return self.run.request_steps(cycles, reader)
        return Pending.attempt(lambda: self.step(cycles))

    def spawn(self, xml: str, name: str, namespace: str | None = None, pose: Pose = ORIGIN) -> SpawnedRobot:
        """Spawn a robot from the text of its URDF; its meshes are read in this call. See Robots.spawn."""
        return self.robots.spawn(xml, name, namespace, pose)

    def delete(self, name: str) -> None:
        """Remove a robot from the world. Raises UnknownName."""
        self.robots.delete(name)

    def call(self, service: str, request: Message | None = None) -> Message:
        """Call a service and return its response. If it needs simulated time, cycles are run, unless `driven`.

        Raises SlidectlError: the call failed. Refused: it needs simulated time, which only the driver may advance.
        """
        pending = self.graph.services.call(service, request)
        while not pending.done:
            if self.driven or not self.step():
                pending.cancel()
                raise Refused(f"{service} needs simulated time to pass before it can answer")
        response: Message = pending.result()
        return response

    def publish(self, topic: str, message: Any, type_name: str | None = None) -> None:
        """Publish a message, complete or partial. Raises BadMessage, UnknownName, or the error of a subscriber."""
        self.graph.topics.publish(topic, type_name, message, SCRIPT_NODE)

    def subscribe(self, topic: str, callback: MessageCallback, type_name: str | None = None) -> TopicSubscription:
        """Call `callback` with each message. Raises UnknownName when the topic does not exist and no type is given."""

        def receive(message: Message) -> None:
            if not self.driven:
                self.loop.settle()
            callback(message)

        return self.graph.topics.subscribe(topic, type_name, SCRIPT_NODE, receive)

    def pause(self) -> None:
        """Pause the world. Requested steps are abandoned; controller switches that wait for a cycle are finished."""
        self.run.pause()

    def resume(self) -> None:
        """Let the world go on. Raises Diverged: it cannot go on before a reset."""
        self.check_trouble()
        self.run.resume()

    def check_trouble(self) -> None:
        """Raise Diverged when the world was held for divergence and its state is still diverged."""
        if self.run.trouble:
            self.world.check()

    def set_speed(self, factor: float) -> None:
        """Set the real-time factor, 0 for as fast as possible. Raises Refused for anything else."""
        self.run.set_speed(factor)

    def set_timestep(self, seconds: float) -> None:
        """Set the period of the cycles to come, in s. Raises Refused: not 1e-6 to 1, or inside a cycle."""
        self.loop.between_cycles("change the time step")
        check_timestep(seconds)
        self.world.set_timestep(seconds)
        self.loop.step_ns = from_seconds(seconds)

    def save(self, name: str) -> None:
        """Save the whole present state under a name, for `load`. Raises as features/snapshot_files.py."""
        self.features["snapshots"].save(name)

    def load(self, name: str) -> None:
        """Restore the state that was saved under the name. Raises UnknownName, Refused."""
        self.features["snapshots"].load(name)

    def reset_simulation(self) -> None:
        """Set time and world back to the beginning, in one call, all or nothing; controllers stay loaded and running.

        Sleeps, waits and deadlines that are running keep their remaining time.
        """
        self.loop.between_cycles("reset")
        clock = self.graph.clock
        before_ns, clock.time_ns, clock.cycles = clock.time_ns, 0, 0
        self.graph.timers.rebase(before_ns, 0)
        self.reset_world()
        self.graph.clock_topic.publish(0)

    def reset_world(self) -> None:
        """Set every robot back to its state at spawn; time goes on, and controllers stay loaded and running.

        Each controller is stopped and started again, so that PID integrators, set points and publishers' clocks start
        again. ros_control does not do this.
        """
        self.loop.between_cycles("reset")
        self.run.trouble = ""
        self.loop.history.forget()
        with ExitStack() as resetting:  # calls in reverse order, and all of them even if one fails
            resetting.callback(self.robots.reset)
            for reset in reversed(self.features.resets):
                resetting.callback(reset)
