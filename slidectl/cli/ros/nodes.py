"""A ROS node started by hand: what `slidectl launch` would do for it in a launch file, until it is done or Ctrl-C.

The node's own work is slidectl.launch's; this makes a plan with one node, and prints what it says.
"""

from __future__ import annotations

import os
import re
import signal
from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from slidectl import names
from slidectl.cli import output
from slidectl.cli.context import Context
from slidectl.cli.values import read
from slidectl.errors import Refused, SlidectlError

if TYPE_CHECKING:
    from slidectl.client import Client
    from slidectl.description.packages import Packages
    from slidectl.launch.execution import DaemonAccess
    from slidectl.launch.nodes.gazebo import WorldSettings
    from slidectl.launch.plan import LaunchPlan, Node
    from slidectl.launch.task import Task

_ASSIGNMENT = re.compile(r"(?P<name>[A-Za-z0-9_~/]+):=(?P<value>.*)\Z", re.DOTALL)
_WORLDS = ("gazebo", "gzserver", "debug", "perf")


class Speech:
    """What the node says: its steps on stdout, warnings on stderr."""

    is_live = False

    def __init__(self, context: Context) -> None:
        self.context = context
        self.verbose = context.verbose

    def step(self, event: str, text: str, **details: Any) -> None:
        """The text of a node's step, without the name of the one node that there is."""
        if event == "node":
            output.write(text.removeprefix(f"{details['node']}: "))

    def warn(self, text: str) -> None:
        self.context.warn(text.removeprefix("rosrun: "))

    def output(self, node: str, stream: str, line: str) -> None:
        """Programs are not run through here."""
        raise AssertionError(f"{node} wrote {line!r} to {stream}")

    def status(self, text: str) -> None:
        """Nothing changes in place."""

    def closing(self) -> None:
        """One node leaves nothing behind."""


class Running:
    """The door to a daemon that runs already."""

    def __init__(self, context: Context) -> None:
        self.context = context

    def begin(self, settings: WorldSettings) -> bool:  # noqa: ARG002
        return False

    def connect(self) -> tuple[Client, bool]:
        return self.context.client, False

    def stop(self) -> None:
        """It is not ours."""


def plan_of(ctx: Context, package: str, kind: str, words: Sequence[str]) -> tuple[LaunchPlan, Node]:
    """A plan with the one node, and its private parameters (`_name:=value`). `__name` and `__ns` name it."""
    from slidectl.launch.plan import LaunchPlan, Location, Node, Remap, Setting

    place = Location("rosrun", None)
    given = {match["name"]: match["value"] for word in words if (match := _ASSIGNMENT.match(word))}
    namespace = given.pop("__ns", os.environ.get("ROS_NAMESPACE") or ctx.namespace)
    node = Node(package, kind, given.pop("__name", kind.partition(".")[0]), names.join("/", namespace), place)
    node.words = [word for word in words if not _ASSIGNMENT.match(word)]
    parameters = {name: value for name, value in given.items() if re.match(r"_[^_]", name)}
    node.remaps = tuple(Remap(n, v, place) for n, v in given.items() if n not in parameters and not n.startswith("__"))
    settings = [
        Setting(names.join(node.full_name, name[1:]), place, f"{name}:=", partial(read, value))
        for name, value in parameters.items()
    ]
    return LaunchPlan(settings=settings, nodes=[node]), node


def run(ctx: Context, package: str, kind: str, words: Sequence[str], packages: Packages) -> None:
    """Carry the node out; returns when it is done.

    Raises:
        BadFile: its arguments make no sense. StepFailed: it could not be done. NoDaemon.
    """
    from slidectl.launch.execution import Execution
    from slidectl.launch.node_kinds import tasks
    from slidectl.launch.supervision import Interrupted, Interrupts
    from slidectl.launch.task import Options, Run

    plan, _ = plan_of(ctx, package, kind, words)
    try:
        made = tasks(plan, packages)
    except SlidectlError as error:
        raise _plain(error) from None
    for task in made:
        if task.family == "notice":  # a launch goes on without it; here it was all that was asked for
            raise Refused(f"{package}/{kind} cannot be run here", task.text.removeprefix("left out: "))
    _adapt(made)
    with Interrupts() as interrupts:
        folder = str(ctx.paths.folder / "launch")
        session = Execution(
            Run(plan, packages, Speech(ctx), Options(), interrupts, folder), made, _door(ctx, package, kind)
        )
        try:
            session.bring_up()
            session.watch()
        except Interrupted as interrupted:
            if interrupted.number == signal.SIGINT:
                raise KeyboardInterrupt from None
        except SlidectlError as error:
            raise _plain(error) from None
        finally:
            session.shut_down()


def _adapt(made: Sequence[Task]) -> None:
    """The script goes on after a failure where a launch ends."""
    from slidectl.launch.nodes.controller_nodes import ManagerScript

    for task in made:
        if isinstance(task, ManagerScript):
            task.goes_on = True


def _door(ctx: Context, package: str, kind: str) -> DaemonAccess:
    """A Gazebo brings its world with it; everything else needs one that is there."""
    if package == "gazebo_ros" and kind in _WORLDS:
        from slidectl.cli.launch import LaunchDaemon

        return LaunchDaemon(ctx, child=True, wait=False)
    return Running(ctx)


def _plain(error: SlidectlError) -> SlidectlError:
    """Without the place: there is one node, and no file that it stands in."""
    error.message = re.sub(r"^rosrun: (node \S+ \(\S+\): |\S+: )?", "", error.message)
    return error
