"""Tasks: how each node of a plan is carried out, and the run that they share.

A task reads its node's arguments when it is made, so that errors in them are found before anything is started.
The tasks for the kinds of nodes are in nodes/.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, NoReturn, Protocol

from slidectl.client import Client
from slidectl.description.packages import Packages
from slidectl.description.report import did_you_mean
from slidectl.errors import BadFile, NotThere, Refused, SlidectlError
from slidectl.extensions.launch.plan import LaunchPlan, Leaf, Node
from slidectl.supervision import Interrupts, Watch

if TYPE_CHECKING:
    from slidectl.msgs.typed import Call, RobotInfoMsg

SPAWN_LIMIT_S = 30.0
HOOK_LIMIT_S = 5.0
"""The longest time of a call in a shutdown hook, s."""


class Console(Protocol):
    """The output of a run."""

    verbose: int
    is_live: bool
    """True when `status` shows its text."""

    def step(self, event: str, text: str, **details: Any) -> None:
        """Report that something was done; `details` are for JSON output."""

    def warn(self, text: str) -> None:
        """Report a problem that is not an error."""

    def output(self, node: str, stream: str, line: str) -> None:
        """Show a line of output of a node's program; `stream` is `stdout` or `stderr`."""

    def status(self, text: str) -> None:
        """Show the present state, on a line that the next call replaces. Only a terminal shows it."""

    def closing(self) -> None:
        """The run ends: no more status. Output errors are ignored from now on, so that the cleanup is complete."""


@dataclass(frozen=True)
class Options:
    """Options of the command line for all nodes."""

    output: str | None = None
    """`screen` or `log` for all nodes; overrides their own setting."""
    all_required: bool = False
    strict: bool = False
    """True: refuse impossible masses, inertias and shapes instead of correcting them."""
    sigint_timeout_s: float = 15.0
    sigterm_timeout_s: float = 2.0


@dataclass
class Run:
    """One run of a plan: the connection to the world, and the data that tasks share."""

    plan: LaunchPlan
    packages: Packages
    console: Console
    options: Options
    interrupts: Interrupts
    folder: str
    """The folder for logs of nodes; made on first use."""
    environment: Mapping[str, str] = field(default_factory=dict)
    """Environment variables for the programs of nodes, beside our own: how to reach the daemon."""
    watch: Watch = field(default_factory=Watch)
    owns_daemon: bool = False
    has_page: bool = False
    """True when the launch opens the page: it takes the place of windows."""
    is_held: bool = False
    """True while the world stands still until the robots' controllers run: no arm falls meanwhile."""
    resumes: bool = True
    """True when a held world goes on afterwards: unless the launch asks for a paused one and nothing resumes it."""
    failed: bool = False
    """True at the end of a launch that did not come up, or whose required node died."""
    parameters: Mapping[str, Leaf] = field(default_factory=dict)
    """The parameters that the launch files set."""
    tasks: Sequence[Task] = ()
    """All tasks of the launch, started or not."""
    left_out: list[Task] = field(default_factory=list)
    """The tasks that failed, in a launch that keeps going."""
    spawned: list[str] = field(default_factory=list)
    """Robots and models that this run has spawned and that are deleted at its end."""
    _client: Client | None = None

    def __post_init__(self) -> None:
        self.interrupts.wake(self.watch)

    @property
    def client(self) -> Client:
        """The connection to the daemon. It must be open."""
        assert self._client is not None
        return self._client

    @property
    def is_connected(self) -> bool:
        return self._client is not None

    def connect(self, client: Client) -> None:
        """Set the connection that tasks use."""
        self._client = client

    @property
    def call(self) -> Call:
        """`Client.call` of the task's client."""
        return self.client.call

    def robots(self, timeout: float | None = None) -> list[RobotInfoMsg]:
        """The robots in the world (slidectl/RobotInfo)."""
        return self.call("/slidectl/list_robots", {"name": ""}, timeout=timeout)["robots"]

    def controlled_robots(self) -> list[RobotInfoMsg]:
        """The robots with a controller manager, without other models."""
        return [robot for robot in self.robots() if robot["kind"] == "robot"]

    def parameter(self, name: str) -> Any:
        """The value of a parameter, or None when it is not set."""
        return json.loads(self.call("/rosapi/get_param", {"name": name, "default": "null"})["value"])

    def resume(self) -> None:
        """Let the world go on, now or when it is not held any more."""
        if self.is_held:
            self.resumes = True
        else:
            self.call("/gazebo/unpause_physics")

    def set_parameter(self, name: str, value: Any) -> None:
        """Set a parameter. Raises Refused."""
        self.call("/rosapi/set_param", {"name": name, "value": json.dumps(value)})


class Task:
    """The task for a node. Subclasses implement `start` and `stop`."""

    family: ClassVar[str] = ""
    """The kind of task, in JSON output."""
    keeps_running = True
    """False when nothing runs on after the start."""
    needs_presence = False
    """True when it ends with the process that runs the launch."""
    comes_last: ClassVar[bool] = False
    """True when it starts after all other tasks."""
    waits_lightly: ClassVar[bool] = False
    """True when the launch counts as up although this task still waits."""
    manager_namespace: str | None = None
    """The namespace of the controller manager that it uses, or None."""
    patience_s = 30.0
    """The longest time that `start` may wait, in wall seconds."""

    def __init__(self, node: Node, plan: LaunchPlan) -> None:  # noqa: ARG002 - subclasses write their notices into it
        """Raise BadFile when the node's arguments are not valid."""
        self.node = node

    def error(self, message: str, hint: str | None = None) -> BadFile:
        """An error at the node's place, to be raised."""
        return self.node.place.error(f"{self.node.full_name}: {message}", hint)

    @property
    def text(self) -> str:
        """A description of what it will do, for `--dry-run`."""
        return f"run {self.node.kind}"

    def find_missing(self, plan: LaunchPlan, packages: Packages, parameters: Mapping[str, Leaf]) -> None:
        """Note missing things that it needs in `plan.missing`, as far as files tell. Nothing is started."""

    def start(self, run: Run) -> str | None:
        """Do it. Returns None when it is done or runs, else what it waits for: then it is called again.

        Raises SlidectlError: it failed, and the launch ends.
        """
        raise NotImplementedError

    def goes_on_waiting(self, run: Run) -> bool:  # noqa: ARG002
        """Called after `patience_s`. Returns True to wait on; then it reports that itself."""
        return False

    def afterwards(self, run: Run) -> None:
        """Called when all other nodes have started."""

    def stop(self, run: Run) -> None:
        """Called when the launch ends. It must not raise when the world is gone."""

    def settled(self, run: Run, text: str, **details: Any) -> None:
        """Report that something was done."""
        place = self.node.place
        run.console.step(
            "node", f"{self.node.full_name}: {text}", node=self.node.full_name, kind=self.family,
            file=place.file, line=place.line, **details,
        )  # fmt: skip

    def leave_out(self, run: Run, what: str, error: SlidectlError) -> None:
        """Note that a part of the node failed: `what` is left out. For a launch that keeps going."""
        place, message = self.node.place, f"{self.node.full_name}: {error.message}"
        run.plan.missing.note(NotThere(message, place.file, place.line, error.hint), f"{what} is left out")

    def warn(self, run: Run, text: str) -> None:
        """Print a warning with the place of the node."""
        run.console.warn(f"{self.node.place}: {self.node.full_name}: {text}")


class StepFailed(Refused):
    """A step of a launch has failed. The message names the step and its place."""

    def __init__(self, task: Task, error: SlidectlError) -> None:
        node = task.node
        super().__init__(f"{node.place}: node {node.full_name} ({node.kind}): {error.message}", error.hint)


# --- the arguments of a node -----------------------------------------------------------------------------------------


@dataclass
class Words:
    """Parsed arguments: the values of each option for each time it was given, and the remaining words."""

    node: Node
    given: dict[str, list[list[str]]]
    rest: list[str]

    def has(self, option: str) -> bool:
        return option in self.given

    def one(self, option: str, default: str = "") -> str:
        """The value of an option with one value; the last one counts."""
        return self.given[option][-1][0] if option in self.given else default

    def number(self, option: str, default: float) -> float:
        """The value of an option as a finite number. Raises BadFile."""
        return number(self.node, option, self.one(option)) if option in self.given else default


def number(node: Node, what: str, text: str) -> float:
    """Convert a text to a finite number. Raises BadFile at the node."""
    value = _float(text)
    if value is None or not math.isfinite(value):
        raise node.place.error(f"{node.full_name}: {what} is a number, not {text!r}")
    return value


def parse(node: Node, known: Mapping[str, int]) -> Words:
    """Parse the words of a node. `known` maps each option, with its dashes, to its count of values.

    Raises BadFile: an unknown option, or values missing.
    """
    import argparse

    class NodeArguments(argparse.ArgumentParser):
        def error(self, message: str) -> NoReturn:
            raise node.place.error(f"{node.full_name}: {message}")

    parser = NodeArguments(add_help=False)
    for option, count in known.items():
        if count:
            parser.add_argument(option, dest=option, action="append", nargs=count)
        else:
            parser.add_argument(option, dest=option, action="append_const", const=[])
    parser.add_argument("rest", nargs="*")
    # ROS removes `from:=to` before a script sees its arguments. With a blank before it, argparse takes `-1e-3` for a
    # value, as it does with `-1.5`.
    words = [word if _float(word) is None else f" {word}" for word in node.words if not _is_remap(word)]
    found, unknown = parser.parse_known_intermixed_args(words)
    for word in unknown:
        name = word.partition("=")[0]
        meant = did_you_mean(name, known, "{}")
        hint = f"options: {', '.join(known)}" if known else "it takes no options"
        raise node.place.error(f"{node.full_name}: {node.kind} has no option {name!r} here{meant}", hint)
    given = {option: [_bare(values) for values in vars(found)[option]] for option in known if vars(found)[option]}
    return Words(node, given, _bare(found.rest))


def _bare(words: Sequence[str]) -> list[str]:
    return [word if _float(word) is None else word.removeprefix(" ") for word in words]


def _is_remap(word: str) -> bool:
    name, sign, _ = word.partition(":=")
    return bool(sign) and bool(name) and not word.startswith("-") and " " not in name


def _float(text: str) -> float | None:
    """The text as a float, or None."""
    try:
        return float(text)
    except ValueError:
        return None
