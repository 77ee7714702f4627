"""Features: what hangs on a simulation. Each attaches its topics and services, and owns its state.

The simulation knows them as data only: `OWN` names ours, and the entry points of installed packages name further ones.
A hook that a feature does not override is never called, so a feature costs what its hooks cost.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import nullcontext
from importlib import import_module
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

from slidectl.control.user_classes import CallbackGuard, import_named, is_of_a_user, watched_for
from slidectl.entry_points import Part, PartError, Registry
from slidectl.errors import BadFile, Refused, SlidectlError, UnknownName
from slidectl.names import OWN_NODE, is_component, join
from slidectl.simulation.clock import EACH_STEP_NS
from slidectl.simulation.cycle import guarded

if TYPE_CHECKING:
    from slidectl.control.node_handle import Message
    from slidectl.control.user_modules import UserCode
    from slidectl.simulation.graph import GraphNode
    from slidectl.simulation.simulation import Simulation
    from slidectl.simulation.spawned_robots import SpawnedRobot

OWN: dict[str, str] = {
    "actions": "slidectl.features.action_server:Actions",
    "rosapi": "slidectl.features.rosapi:Rosapi",
    "lockstep": "slidectl.features.lockstep:LockStepService",
    "services": "slidectl.features.own_services:OwnServices",
    "snapshots": "slidectl.features.snapshot_files:Snapshots",
    "standard_services": "slidectl.features.standard_services:StandardServices",
    "waits": "slidectl.features.waits:Waits",
    "traces": "slidectl.features.joint_traces:JointTraces",
    "gazebo_services": "slidectl.features.gazebo_services:GazeboServices",
    "faults": "slidectl.features.faults:Faults",
    "state_publishers": "slidectl.features.state_publisher:StatePublishers",
    "sensors": "slidectl.features.sensor_topics:Sensors",
    "drives": "slidectl.features.base_drives:Drives",
}
"""Our features, in the order in which they are attached and hear of robots."""


class Feature:
    """One feature of one simulation; the simulation creates it without arguments, then calls `attach`.

    A hook may be left out. No hook but `before_cycle` and `after_cycle` is called within a cycle.
    """

    saved_attributes: ClassVar[tuple[str, ...]] = ()
    """The attributes that a snapshot saves, for a feature that does not override `save_state` and `load_state`. See
    control/saved_classes.py."""
    name: str = ""
    """The name under which the simulation knows it: that of the table or of the entry point. For a class that is given
    to `Simulation` it is this attribute of the class, else the name of the class."""
    node: GraphNode
    """A node handle in the namespace of the same name, below that of the node `/slidectl`. What is advertised through
    it ends when `attach` fails."""

    def attach(self, simulation: Simulation) -> None:
        """Advertise topics and services. The simulation has its world, graph and robots, and no robot yet."""

    def on_spawn(self, robot: SpawnedRobot) -> None:
        """Called with a new robot, which is not in `simulation.robots` yet. An error refuses the spawn."""

    def on_delete(self, robot: SpawnedRobot) -> None:
        """Called when the robot is deleted, and when its spawn fails after `on_spawn`."""

    def reset(self) -> None:
        """Called by a reset, before the world and the robots are set back."""

    def save_state(self) -> Any:
        """The state for a snapshot: numbers, texts, arrays, lists, dicts, and objects of the simulation."""
        return None

    def load_state(self, state: Any) -> None:
        """Take the state that `save_state` returned. The robots and all other objects are restored by then."""

    def save_parts(self) -> list[Any]:
        """Plain data of the objects that came since `attach` and have a state in a snapshot: what makes them again."""
        return []

    def drop_parts(self) -> None:
        """Remove these objects. Called before a snapshot is restored, with the robots as they were."""

    def make_parts(self, parts: list[Any]) -> None:
        """Make the objects again, before their states are restored. Raises Refused: the data are of no such object."""

    def resume(self) -> None:
        """Called at the end of a restore, when all objects have their states, and before the world gets its own."""

    def status(self) -> Message:
        """Fields of `/slidectl/status` of which this feature knows."""
        return {}

    def before_cycle(self, time_ns: int) -> None:
        """Called in each cycle before the robots, at the cycle's time. It makes every cycle begin in the interpreter:
        override it only when `after_cycle` and timers do not serve."""

    def after_cycle(self, time_ns: int) -> None:
        """Called at the end of each cycle, when the physics has made its step."""


F = TypeVar("F", bound=Feature)


class UnknownFeature(UnknownName):
    """No feature has the name, or the simulation was made without it."""

    def __init__(self, name: str, known: Sequence[str]) -> None:
        super().__init__("feature", name, known)


class NotAFeature(BadFile):
    """What an installed package names is no class that is derived from Feature."""

    def __init__(self, what: str, file: str) -> None:
        hint = f"class {what}(slidectl.simulation.Feature): ..."
        super().__init__(f"{what} is not derived from slidectl.simulation.Feature", file, None, hint)


class FeatureNameTaken(Refused):
    """Two features have the same name."""

    def __init__(self, name: str) -> None:
        super().__init__(f"there is a feature {name!r} already", "give the entry point another name")


class BrokenFeature(PartError):
    """A feature of an installed package that a simulation does without; `cause` is the error that it raised."""

    def __init__(self, part: Part, cause: SlidectlError) -> None:
        super().__init__(part, "feature", f"is left out: {cause.message}")
        self.hint = cause.hint
        self.cause = cause


def _expected(found: Any) -> str:
    is_feature = isinstance(found, type) and issubclass(found, Feature)
    return "" if is_feature else "class derived from slidectl.simulation.Feature"


def _bad_name(name: str) -> str:
    return "" if is_component(name) else "a name is a letter, then letters, digits and '_'"


INSTALLED = Registry("slidectl.features", "feature", lambda: OWN, _expected, _bad_name)
"""The features that installed packages name: a name, and `module:Class`."""


def names() -> list[str]:
    """The names of all features: ours in their order, then those of installed packages."""
    return [*OWN, *INSTALLED.parts()]


def _own_class(name: str) -> type[Feature]:
    module, _, cls = OWN[name].partition(":")
    found: type[Feature] = getattr(import_module(module), cls)
    return found


def _installed_class(part: Part, code: UserCode) -> type[Feature]:
    """The class that an installed package names.

    Raises BadFile: its code fails. NotAFeature. Refused: it took too long.
    """
    module = import_named(code, part.module)
    found = vars(module).get(part.attr)
    if not (isinstance(found, type) and issubclass(found, Feature)):
        raise NotAFeature(part.attr, module.__file__ or part.module)
    return found


def _hook(feature: Feature, name: str, code: UserCode) -> Callable[..., Any] | None:
    """The hook of a feature, None when it does not override it.

    An error of a user's hook becomes Refused, or CycleFailed in a hook that is called in each cycle.
    """
    if getattr(type(feature), name) is getattr(Feature, name):
        return None
    method: Callable[..., Any] = getattr(feature, name)
    what = f"{name} of the feature"
    if name in ("before_cycle", "after_cycle"):
        return guarded(method, f"{what} {feature.name}", type(feature), code)
    if not is_of_a_user(type(feature)):
        return method

    def watched(*arguments: Any) -> Any:
        with watched_for(what, feature.name, code):
            return method(*arguments)

    return watched


class Features:
    """The features of one simulation, by name, in the order of their attachment."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._features: dict[str, Feature] = {}
        self.broken: list[PartError] = []
        """Broken features of installed packages."""
        self.resets: list[Callable[[], None]] = []
        """What a reset calls, in this order."""

    def attach_all(self) -> None:
        """Attach our features and those of installed packages. Broken ones of these are in `broken`."""
        for name in OWN:
            self.attach(_own_class(name), name)
        self.broken += INSTALLED.refused()
        for part in INSTALLED.parts().values():
            try:
                self.attach(_installed_class(part, self._simulation.types.code), part.name)
            except SlidectlError as error:
                self.broken.append(BrokenFeature(part, error))

    def log_broken(self) -> None:
        """Log what is left out. A driver calls it when the log has a sink."""
        for trouble in self.broken:
            self._simulation.graph.log("error", OWN_NODE, trouble.message)

    def attach_these(self, chosen: Sequence[str | type[Feature]]) -> None:
        """Attach features given by name or class, in this order.

        Raises UnknownFeature. PartError: several packages claim the name. Else as `attach`.
        """
        for one in chosen:
            if isinstance(one, type):
                if not issubclass(one, Feature):
                    raise NotAFeature(one.__name__, one.__module__)
                self.attach(one, one.name or one.__name__)
            elif one in OWN:
                self.attach(_own_class(one), one)
            elif (part := INSTALLED.find(one)) is not None:
                self.attach(_installed_class(part, self._simulation.types.code), one)
            else:
                raise UnknownFeature(one, names())

    def attach(self, cls: type[F], name: str) -> F:
        """Create a feature of the class and attach it, all or nothing.

        Raises FeatureNameTaken. Refused: the code of a user's class failed, or took too long.
        """
        if name in self._features:
            raise FeatureNameTaken(name)
        simulation, is_users = self._simulation, is_of_a_user(cls)
        node = simulation.graph.node(join(OWN_NODE, name), OWN_NODE)
        if is_users:
            node.guard = CallbackGuard(cls, simulation.types.code, node)
        try:
            with watched_for("the feature", name, simulation.types.code) if is_users else nullcontext():
                feature = cls()
                feature.name, feature.node = name, node
                feature.attach(simulation)
        except SlidectlError:
            node.shutdown()
            raise
        self._features[name] = feature
        self._connect(feature)
        return feature

    def _connect(self, feature: Feature) -> None:
        """Have the hooks called that the feature overrides."""
        simulation, code = self._simulation, self._simulation.types.code
        if (on_spawn := _hook(feature, "on_spawn", code)) is not None:
            simulation.robots.on_spawn.append(on_spawn)
        if (on_delete := _hook(feature, "on_delete", code)) is not None:
            simulation.robots.on_spawn.append(lambda robot: robot.cleanup.callback(on_delete, robot))
        if (reset := _hook(feature, "reset", code)) is not None:
            self.resets.append(reset)
        if (before := _hook(feature, "before_cycle", code)) is not None:
            simulation.loop.add_before_cycle(before)
        if (after := _hook(feature, "after_cycle", code)) is not None:
            clock = simulation.graph.clock
            simulation.graph.timers.every(EACH_STEP_NS, lambda: after(clock.time_ns))

    def __iter__(self) -> Iterator[Feature]:
        return iter(self._features.values())

    def __contains__(self, name: object) -> bool:
        return name in self._features

    def __getitem__(self, name: str) -> Any:
        """The feature of that name. Raises UnknownFeature."""
        if name not in self._features:
            raise UnknownFeature(name, list(self._features))
        return self._features[name]

    def of_class(self, cls: type[F]) -> F:
        """The feature of that class. Raises UnknownFeature."""
        for feature in self:
            if isinstance(feature, cls):
                return feature
        raise UnknownFeature(cls.__name__, list(self._features))

    def with_state(self) -> dict[str, Feature]:
        """The features of which a snapshot saves a state, by name."""
        return {name: feature for name, feature in self._features.items() if _has_state(type(feature))}

    def status(self) -> Message:
        """The fields of `/slidectl/status` that features know."""
        return {field: value for feature in self for field, value in feature.status().items()}


def _has_state(cls: type[Feature]) -> bool:
    return cls.save_state is not Feature.save_state or any(
        vars(base).get(declared) for base in cls.__mro__ for declared in ("saved_attributes", "saved_or_none")
    )
