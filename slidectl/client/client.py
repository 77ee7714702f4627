"""`Client`, the blocking client: the public Python API for scripts. Standard library only.

connection.py calls, publishes and subscribes. Here is what is done to the world: robots, time, snapshots, faults,
lock-step; all of it is calls of services. parameter_client.py and manager.py have parameters and controllers.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any

from slidectl import names
from slidectl.client.connection import GraphClient
from slidectl.client.manager import Manager
from slidectl.client.parameter_client import Params
from slidectl.errors import NoDaemon, Refused, UsageError, listing
from slidectl.wire.messages import Message

if TYPE_CHECKING:
    from slidectl.client.action_client import Action
    from slidectl.msgs.typed import RobotInfoMsg, SnapshotInfoMsg


class Client(GraphClient):
    """A connection to a daemon. Use it as a context manager: leaving it waits until the daemon has taken what was
    published.

    Leaving it raises MessageRefused for a refused message, and for a topic none of whose messages reached a subscriber.
    A name without a leading slash is the unique end of a full name, as on the command line.

    Args:
        instance: the daemon's name; by default `SLIDECTL_SOCKET`, `SLIDECTL_INSTANCE` or `default` decide.
        socket: the path of the daemon's socket, instead of `instance`.
        timeout: default limit of each wait in wall seconds; `inf` for no limit.
        link: an existing connection to use instead of a new one.

    Use a client from one thread only: threads that share one take each other's answers. Give each thread its own.

    Raises:
        NoDaemon: no daemon answers. Refused: the socket's folder is not private, or the daemon is another user's.
    """

    def spawn(
        self,
        model: str,
        name: str | None = None,
        at: Sequence[float] = (),
        controllers: str | None = None,
        start: Sequence[str] = (),
        joints: Mapping[str, float] | None = None,
        transmissions: str | None = None,
        robot_namespace: str | None = None,
        **xacro_arguments: str,
    ) -> RobotInfoMsg:
        """Spawn a robot, or all models of a file, as `slidectl spawn` does.

        Returns slidectl/RobotInfo; for a world, that of the first model.

        Args:
            name: any text; what is no graph name becomes one, with a warning.
            model: a shipped model's name, the path of a .xacro, .urdf, .sdf or .world file, or `model://NAME`.
            at: x, y, z in m, or these and roll, pitch, yaw in rad.
            controllers: the YAML file of its controllers' parameters; by default those that a robot of ROS 2 names.
            start: controllers to load and start.
            joints: start positions of joints, rad or m.
            transmissions: `gazebo` or `real`; overrides the model.
            robot_namespace: that of its controllers; by default the model's.

        Raises:
            BadFile, UnknownName, UsageError: nothing has been changed. Refused: with the daemon's reason.
        """
        # Imported here because it reads robot files: a script that spawns nothing starts without it.
        from slidectl.client import spawning

        if name is not None and (remark := names.remark_on_robot(name)):
            import warnings

            warnings.warn(remark, stacklevel=2)
        place = spawning.pose(at)
        if spawning.is_scene(model):
            spawning.check_scene_options(
                xacro_arguments, controllers, start, joints or {}, transmissions, robot_namespace
            )
            plan = spawning.scene_plan(spawning.scene(model).named(name), place)
        else:
            document = spawning.document(model, xacro_arguments, name)
            given = {f"{argument}:=" for argument in xacro_arguments}
            for notice in document.report:
                if notice.subject in given:
                    raise UsageError(f"{model}: {notice.subject} {notice.text}")
            plan = spawning.robot_plan(
                document, place, name, joints=joints, transmissions=transmissions, namespace=robot_namespace
            )
            plan.controllers = list(start)
            files = plan.own_files if controllers is None else [controllers]
            plan.parameters = spawning.controller_parameters(files, plan.namespace)
            for text in plan.warnings if controllers is None else ():
                import warnings

                warnings.warn(text, stacklevel=2)
        spawn = spawning.Spawn(self, plan)
        for unknown in spawn.unknown_controllers():
            raise unknown
        robots, _ = spawn.apply()
        manager = Manager(self, plan.namespace)
        spawn.bring_up(manager, spawn.ask_to_load(manager))
        return spawn.robot() if start else robots[0]

    def delete(self, name: str) -> None:
        """Delete a robot from the world. Raises UnknownName, Refused."""
        full = self.resolve("robot", name)["name"]
        answer = self.call("/gazebo/delete_model", {"model_name": full})
        if not answer["success"]:
            raise Refused(f"cannot delete {full}: {answer['status_message']}")

    def robots(self) -> list[RobotInfoMsg]:
        """The robots (slidectl/RobotInfo), by name: `name`, `namespace`, `pose`, `links`, `joints`, `controllers`."""
        return sorted(self.call("/slidectl/list_robots")["robots"], key=lambda robot: robot["name"])

    def add_fault(
        self,
        target: str,
        kind: str,
        start: float | None = None,
        end: float | None = None,
        *,
        seed: int = 0,
        name: str = "",
        namespace: str = "/",
        **options: Any,
    ) -> Message:
        """Add a fault from one simulated time (s; by default now) to another (by default until it is removed).

        Returns slidectl/Fault, with its options as a dict.

        Args:
            target: a joint, link (`robot/joint`), controller or topic; the unique end of its name is enough.
            kind: `sensor-noise`, `joint-stuck` ...; `slidectl fault kinds` lists them with their options.
            seed: the seed of its random numbers.
            name: the fault's name in lists; by default the daemon makes one.
            namespace: where the target is looked for first.

        Raises:
            Refused: with the daemon's reason.
        """
        request = {"target": target, "kind": kind, "seed": seed, "name": name, "namespace": namespace}
        times = {field: [] if time is None else [time] for field, time in (("start", start), ("end", end))}
        answer = self.call("/slidectl/fault/add", {**request, **times, "options": json.dumps(options)})
        return _with_options(answer["fault"])

    def faults(self) -> list[Message]:
        """All faults, each as slidectl/Fault, with their effects so far and their options as a dict."""
        return [_with_options(fault) for fault in self.call("/slidectl/fault/list")["faults"]]

    def remove_faults(self, *names: str) -> list[str]:
        """Remove these faults, or all without names. Returns the names. Raises Refused: a fault does not exist."""
        return list(self.call("/slidectl/fault/remove", {"names": names})["names"])

    def pause(self) -> None:
        """Pause the world; it stays as it is. As `slidectl sim pause`."""
        self.call("/gazebo/pause_physics")

    def resume(self) -> None:
        """Let the world go on. Raises Refused: an error has stopped it, and only `reset` goes on."""
        self.call("/gazebo/unpause_physics")

    def reset(self, *, time: bool = False) -> None:
        """Put robots and models back where they were spawned, at rest; with `time` also the clock to 0."""
        self.call("/gazebo/reset_simulation" if time else "/gazebo/reset_world")

    def step(self, cycles: int | None = None, *, seconds: float = 0.0, until: float = 0.0) -> float:
        """Pause the world and run `cycles` cycles (1 by default), `seconds` simulated seconds, or up to the time
        `until`.

        Returns the simulated time in s.

        Raises:
            Refused: the time has passed or is no whole number of cycles away, or the steps were interrupted.
        """
        if (cycles is not None) + bool(seconds) + bool(until) > 1:
            raise UsageError("step takes one of cycles, seconds and until")
        count = 1 if cycles is None and not (seconds or until) else cycles or 0
        request = {"cycles": count, "seconds": seconds, "until": until}
        answer = self.call("/slidectl/step", request, timeout=math.inf)
        if not answer["success"]:
            raise Refused(answer["message"])
        return float(answer["time"])

    def sleep(self, seconds: float, *, timeout: float | None = None) -> float:
        """Wait until `seconds` of simulated time have passed. Returns the simulated time in s.

        `timeout` is in wall seconds; the default is 60 plus ten times `seconds`. Raises TimedOut, also for a paused
        world.
        """
        limit = 60.0 + 10.0 * seconds if timeout is None else timeout
        return float(self.call("/slidectl/sleep", {"duration": seconds}, timeout=limit)["time"])

    def save(self, name: str, file: str | None = None) -> float:
        """Save the whole state of the world under a name, and also to `file` if given.

        Returns the simulated time in s. Raises Refused: a switch is in progress, or a class has state that a snapshot
        cannot hold.
        """
        return float(self.call("/slidectl/save", {"name": name, "file": _absolute(file)})["time"])

    def load(self, name: str | None = None, file: str | None = None) -> float:
        """Restore the world from the snapshot `name` or from the file. Returns the simulated time in s.

        Raises Refused: no such snapshot, one of another version, truncated or damaged, or a switch is in progress.
        """
        return float(self.call("/slidectl/load", {"name": name or "", "file": _absolute(file)})["time"])

    def snapshots(self) -> list[SnapshotInfoMsg]:
        """The daemon's snapshots (slidectl/SnapshotInfo), oldest first."""
        return self.call("/slidectl/snapshots")["snapshots"]

    @contextmanager
    def lockstep(self, period: float = 0.0, timeout: float = 5.0) -> Iterator[LockStep]:
        """Run the world in lock-step inside the context: it advances only by `step` of the LockStep that this gives.

        Each step is one period. With several clients in lock-step, the world advances when all have called `step`.

        Args:
            period: simulated seconds, a whole number of cycles; one cycle by default.
            timeout: wall seconds that the world waits for this client; then it goes on without it.

        Raises:
            Refused: the period is no whole number of cycles.
        """
        seconds = period or float(self.call("/slidectl/status")["timestep"])
        joined = self.call("/slidectl/lockstep", {"period": seconds, "timeout": timeout})
        lock = LockStep(self, float(joined["time"]))
        try:
            yield lock
        finally:
            with suppress(NoDaemon, Refused):  # the daemon has already ended this client's lock-step
                self.call("/slidectl/lockstep", {"leave": True})

    def wait(
        self,
        target: str,
        *,
        near: float | None = None,
        above: float | None = None,
        below: float | None = None,
        equals: Any = None,
        tol: float = 0.01,
        within: float = 0.0,
        for_: float = 0.0,
        timeout: float | None = None,
    ) -> Any:
        """Wait until a field of a topic (`joint_states/position[0]`) meets one condition. Returns its value.

        Args:
            tol: tolerance of `near`.
            within: simulated seconds after which it fails; 0 for no limit.
            for_: simulated seconds that the condition must hold.
            timeout: limit in wall seconds; by default 60 plus ten times the simulated ones.

        Raises:
            Refused: not met `within`. TimedOut. UnknownName, Unused: no such topic or field.
        """
        conditions = {"near": near, "above": above, "below": below, "equals": equals}
        given = {kind: value for kind, value in conditions.items() if value is not None}
        if len(given) != 1:
            raise UsageError("give exactly one of near, above, below and equals")
        ((condition, value),) = given.items()
        found = self.resolve("topic", target, role="publishers", with_field=True)
        request = {
            "topic": found["name"], "field": found["field"], "condition": condition, "value": json.dumps(value),
            "tolerance": tol, "hold": for_, "within": within,
        }  # fmt: skip
        limit = 60.0 + 10.0 * (within + for_) if timeout is None else timeout
        answer = self.call("/slidectl/wait", request, timeout=limit)
        if not answer["success"]:
            raise Refused(f"{target} was not {condition} {value}: {answer['message']}")
        return json.loads(answer["last"])

    def controllers(self, namespace: str | None = None) -> Manager:
        """The controller manager of a robot's namespace, by default the only one: load, start, stop, switch, list.

        Raises:
            UsageError: no namespace is given, and there is no controller manager, or more than one.
        """
        if namespace is None:
            found = self.managers()
            if len(found) != 1:
                known = listing([manager.namespace for manager in found])
                raise UsageError(
                    f"which controller manager? known namespaces: {known}", "name one, for example '/slider'"
                )
            return found[0]
        return Manager(self, names.join("/", namespace).rstrip("/") or "/")

    def managers(self) -> list[Manager]:
        """All controller managers, by namespace."""
        request, name = {"type": "controller_manager_msgs/ListControllers"}, "/controller_manager/list_controllers"
        services = self.call("/rosapi/services_for_type", request)["services"]
        return [Manager(self, one.removesuffix(name) or "/") for one in sorted(services) if one.endswith(name)]

    def action(self, name: str) -> Action:
        """An action by its name, or by the name of a controller with one action: send goals, follow and cancel them.

        Raises:
            UnknownName, AmbiguousName.
        """
        from slidectl.client.action_client import Action

        return Action(self, name)

    @property
    def params(self) -> Params:
        """The parameters, as a mapping of names to values."""
        return Params(self)


def _with_options(fault: Mapping[str, Any]) -> Message:
    return {**fault, "options": json.loads(fault["options"])}


def _absolute(file: str | None) -> str:
    """The absolute path, since the daemon works in another folder; empty for None."""
    return os.path.abspath(file) if file else ""


class LockStep:
    """A client in lock-step with the world; see Client.lockstep. `time` is the simulated time of the world in s."""

    def __init__(self, client: GraphClient, time: float) -> None:
        self._client = client
        self._under_way: str | None = None
        """The id of a step call that timed out."""
        self.time = time

    def step(self, timeout: float = math.inf) -> float:
        """Report this client as done and wait until its next period is over. Returns the simulated time in s.

        All messages of the period have arrived then.

        Raises:
            TimedOut: not within `timeout` wall seconds: other clients are not done, or the world is paused. The next
                `step` waits on for the same period. Refused: the daemon ended this client's lock-step, because the
                world waited longer than its time-out.
        """
        client = self._client
        call = self._under_way = self._under_way or client.call_async("/slidectl/lockstep")
        client.wait_until(lambda: client.is_answered(call), timeout, "the period was not over")
        self._under_way = None
        self.time = float(client.answer(call)["time"])
        return self.time
