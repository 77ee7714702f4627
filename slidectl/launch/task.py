"""What a node of a plan does here: a task, and the run that it works in.

A task reads its node's arguments when it is made, so that a mistake in them is found before anything is started.
The families of nodes are in nodes/.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

from slidectl.client import Client
from slidectl.description.packages import Packages
from slidectl.errors import NotThere, Refused, SlidectlError
from slidectl.launch.plan import Leaf, Node, Plan
from slidectl.launch.watch import Watch
from slidectl.launch.world import WorldSettings

if TYPE_CHECKING:
    from slidectl.launch.interrupts import Interrupts

SPAWN_LIMIT_S = 30.0
HOOK_LIMIT_S = 5.0
"""How long a call of a shutdown hook may take."""


class Console(Protocol):
    """Where a run says what it does."""

    verbose: int

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

    @property
    def is_live(self) -> bool:
        """Whether `status` shows anything."""


@dataclass(frozen=True)
class Options:
    """What the command line may say about all nodes."""

    output: str | None = None
    """`screen` or `log` for all nodes, whatever they say themselves."""
    all_required: bool = False
    sigint_timeout_s: float = 15.0
    sigterm_timeout_s: float = 2.0


@dataclass
class Run:
    """One run of a plan: the connection to the world, and all that tasks share."""

    plan: Plan
    packages: Packages
    console: Console
    options: Options
    watch: Watch
    interrupts: Interrupts
    folder: str
    """For logs of nodes; made when it is needed."""
    environment: Mapping[str, str] = field(default_factory=dict)
    """What the programs of nodes get beside the environment of this process: how to reach the daemon."""
    settings: WorldSettings = field(default_factory=WorldSettings)
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
    """Robots that this run has put into the world and that are to leave it with the run."""
    _client: Client | None = None
    _heard: Any = None

    @property
    def client(self) -> Client:
        """The connection to the daemon, once there is one."""
        assert self._client is not None
        return self._client

    @property
    def is_connected(self) -> bool:
        return self._client is not None

    def connect(self, client: Client) -> None:
        """From now on tasks work in this world, and its warnings are heard."""
        self._client = client
        self._heard = client.subscribe("/rosout", "rosgraph_msgs/Log")

    def call(self, service: str, request: dict[str, Any] | None = None, timeout: float | None = None) -> dict[str, Any]:
        """Call a service. Raises as Client.call does."""
        return self.client.call(service, request, timeout=timeout)

    def heard(self, level: int = 4) -> list[str]:
        """The warnings and errors of the world since the last time, as text."""
        lines = [self._heard.get(0.0) for _ in range(len(self._heard))] if self._heard is not None else []
        return [str(line["msg"]) for line in lines if line["level"] >= level]

    def parameter(self, name: str) -> Any:
        """The value of a parameter, or None when it is not set."""
        import json

        answer = self.call("/rosapi/get_param", {"name": name, "default": "null"})
        return json.loads(answer["value"])

    def set_parameter(self, name: str, value: Any) -> None:
        """Raises Refused."""
        import json

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
    patience_s = 30.0
    """How long `start` may go on waiting, in wall seconds."""

    def __init__(self, node: Node, plan: Plan) -> None:  # noqa: ARG002 - subclasses write their notices into it
        """Raises BadFile when the node's arguments make no sense."""
        self.node = node

    @property
    def text(self) -> str:
        """What it will do, for `--dry-run`."""
        return f"run {self.node.kind}"

    def look_ahead(self, plan: Plan, packages: Packages, parameters: Mapping[str, Leaf]) -> None:
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
        """The end of the launch has come. Must not raise for a world that has gone."""

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
