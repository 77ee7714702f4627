"""What a node of a plan does here: a task, and the run that it works in.

A task reads its node's arguments when it is made, so that a mistake in them is found before anything is started.
The families of nodes are in nodes/.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, NoReturn, Protocol

from slidectl.client import Client
from slidectl.description.packages import Packages
from slidectl.description.report import did_you_mean
from slidectl.errors import BadFile, NotThere, Refused, SlidectlError
from slidectl.launch.plan import LaunchPlan, Leaf, Node
from slidectl.launch.supervision import Interrupts, Watch

SPAWN_LIMIT_S = 30.0
HOOK_LIMIT_S = 5.0
"""How long a call of a shutdown hook may take."""


class Console(Protocol):
    """Where a run says what it does."""

    verbose: int
    is_live: bool
    """Whether `status` shows anything."""

    def step(self, event: str, text: str, **details: Any) -> None:
        """Something was done; `details` are for those who read JSON."""

    def warn(self, text: str) -> None:
        """Something is wrong that is no error."""

    def output(self, node: str, stream: str, line: str) -> None:
        """A line that a node's program has written; `stream` is `stdout` or `stderr`."""

    def status(self, text: str) -> None:
        """How things stand now: one line that the next one replaces. Only a terminal shows it."""

    def closing(self) -> None:
        """The run ends: no more status, and what cannot be said any more is no reason to leave something behind."""


@dataclass(frozen=True)
class Options:
    """What the command line may say about all nodes."""

    output: str | None = None
    """`screen` or `log` for all nodes, whatever they say themselves."""
    all_required: bool = False
    strict: bool = False
    """Whether impossible masses, inertias and shapes are refused instead of mended."""
    sigint_timeout_s: float = 15.0
    sigterm_timeout_s: float = 2.0


@dataclass
class Run:
    """One run of a plan: the connection to the world, and all that tasks share."""

    plan: LaunchPlan
    packages: Packages
    console: Console
    options: Options
    interrupts: Interrupts
    folder: str
    """For logs of nodes; made when it is needed."""
    environment: Mapping[str, str] = field(default_factory=dict)
    """What the programs of nodes get beside the environment of this process: how to reach the daemon."""
    watch: Watch = field(default_factory=Watch)
    owns_daemon: bool = False
    failed: bool = False
    """True at the end of a launch that did not come up, or of which a required node died."""
    parameters: Mapping[str, Leaf] = field(default_factory=dict)
    """Those that the launch files set."""
    tasks: Sequence[Task] = ()
    """All of the launch, started or not."""
    left_out: list[Task] = field(default_factory=list)
    """Those that could not be done, in a launch that keeps going."""
    spawned: list[str] = field(default_factory=list)
    """Robots and models that this run has put into the world and that are to leave it with the run."""
    _client: Client | None = None

    @property
    def client(self) -> Client:
        """The connection to the daemon, once there is one."""
        assert self._client is not None
        return self._client

    @property
    def is_connected(self) -> bool:
        return self._client is not None

    def connect(self, client: Client) -> None:
        """From now on tasks work in this world."""
        self._client = client

    def call(self, service: str, request: dict[str, Any] | None = None, timeout: float | None = None) -> dict[str, Any]:
        """Call a service. Raises as Client.call does."""
        return self.client.call(service, request, timeout=timeout)

    def robots(self, timeout: float | None = None) -> list[dict[str, Any]]:
        """The robots in the world (slidectl/RobotInfo)."""
        return list(self.call("/slidectl/list_robots", {"name": ""}, timeout)["robots"])

    def controlled_robots(self) -> list[dict[str, Any]]:
        """Those of them that have a controller manager: not the models that stand around them."""
        return [robot for robot in self.robots() if robot["kind"] == "robot"]

    def parameter(self, name: str) -> Any:
        """The value of a parameter, or None when it is not set."""
        return json.loads(self.call("/rosapi/get_param", {"name": name, "default": "null"})["value"])

    def set_parameter(self, name: str, value: Any) -> None:
        """Raises Refused."""
        self.call("/rosapi/set_param", {"name": name, "value": json.dumps(value)})


class Task:
    """A node as it is carried out here. Subclasses say what `start` and `stop` do."""

    family: ClassVar[str] = ""
    """A word for JSON: what kind of counterpart it is."""
    keeps_running = True
    """False when nothing of it is left once it has started."""
    needs_presence = False
    """True when it ends with the process that runs the launch."""
    comes_last: ClassVar[bool] = False
    """True when it starts after all that do not."""
    waits_lightly: ClassVar[bool] = False
    """True when a launch runs although this is still waiting."""
    manager_namespace: str | None = None
    """The namespace of the controller manager that it speaks to, if it does."""
    patience_s = 30.0
    """How long `start` may go on waiting, in wall seconds."""

    def __init__(self, node: Node, plan: LaunchPlan) -> None:  # noqa: ARG002 - subclasses write their notices into it
        """Raises BadFile when the node's arguments make no sense."""
        self.node = node

    def error(self, message: str, hint: str | None = None) -> BadFile:
        """An error at the node's place, to be raised."""
        return self.node.place.error(f"{self.node.full_name}: {message}", hint)

    @property
    def text(self) -> str:
        """What it will do, for `--dry-run`."""
        return f"run {self.node.kind}"

    def look_ahead(self, plan: LaunchPlan, packages: Packages, parameters: Mapping[str, Leaf]) -> None:
        """Note in `plan.missing` what it needs and is not there, as far as the files tell. Nothing is started."""

    def start(self, run: Run) -> str | None:
        """Do it. Returns None when it is done or runs, else what it waits for: then it is asked again.

        Raises:
            SlidectlError: it cannot be done, and the launch ends.
        """
        raise NotImplementedError

    def goes_on_waiting(self, run: Run) -> bool:  # noqa: ARG002
        """Asked when its patience is over: whether it waits on all the same, which it says itself."""
        return False

    def afterwards(self, run: Run) -> None:
        """What there is to say or do when all other nodes have started."""

    def stop(self, run: Run) -> None:
        """The launch ends. Must not raise for a world that is gone."""

    def settled(self, run: Run, text: str, **details: Any) -> None:
        """Say that something was done."""
        place = self.node.place
        run.console.step(
            "node", f"{self.node.full_name}: {text}", node=self.node.full_name, kind=self.family,
            file=place.file, line=place.line, **details,
        )  # fmt: skip

    def leave_out(self, run: Run, what: str, error: SlidectlError) -> None:
        """Note that something of the node was not to be had: `what` is left out. For a launch that keeps going."""
        place, message = self.node.place, f"{self.node.full_name}: {error.message}"
        run.plan.missing.note(NotThere(message, place.file, place.line, error.hint), f"{what} is left out")

    def warn(self, run: Run, text: str) -> None:
        """Point something out, with the place of the node."""
        run.console.warn(f"{self.node.place}: {self.node.full_name}: {text}")


class StepFailed(Refused):
    """A step of a launch did not succeed. It names the step and its place."""

    def __init__(self, task: Task, error: SlidectlError) -> None:
        node = task.node
        super().__init__(f"{node.place}: node {node.full_name} ({node.kind}): {error.message}", error.hint)


# --- the arguments of a node -----------------------------------------------------------------------------------------


@dataclass
class Words:
    """Options by name, each with its values every time that it was given, and what is left."""

    node: Node
    given: dict[str, list[list[str]]]
    rest: list[str]

    def has(self, option: str) -> bool:
        return option in self.given

    def one(self, option: str, default: str = "") -> str:
        """The value of an option that has one; of several the last."""
        return self.given[option][-1][0] if option in self.given else default

    def number(self, option: str, default: float) -> float:
        """The same as a finite number. Raises BadFile."""
        return number(self.node, option, self.one(option)) if option in self.given else default


def number(node: Node, what: str, text: str) -> float:
    """A finite number. Raises BadFile at the node."""
    value = _float(text)
    if value is None or not math.isfinite(value):
        raise node.place.error(f"{node.full_name}: {what} is a number, not {text!r}")
    return value


def parse(node: Node, known: Mapping[str, int]) -> Words:
    """The words of a node. `known` says how many values each option takes; names come with their dashes.

    Raises:
        BadFile: an unknown option, or values missing.
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
    # ROS takes `from:=to` out before a script sees its arguments. A blank before a number has argparse take `-1e-3` for
    # a value, as it does with `-1.5`.
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
    """None for what is no number."""
    try:
        return float(text)
    except ValueError:
        return None
