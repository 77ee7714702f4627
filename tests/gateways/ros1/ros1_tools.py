"""ROS 1 itself, as Debian packs it: its tools, rospy nodes, a roscore with nodes that stand in slidectl's place.

with Ros(uri) as ros:
    ros.run("rostopic list").stdout
    with ros.started("rostopic echo /clock") as program:
        program.prints("secs")
"""

from __future__ import annotations

import functools
import json
import os
import re
import select
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from daemon_fixture import Runtime
from waiting import eventually

from slidectl.client import Client
from slidectl.errors import SlidectlError
from slidectl.msgs import definitions

PYTHON = "/usr/bin/python3"
NODES = Path(__file__).parent / "nodes"
LIMIT_S = 60.0
NEEDED = (
    *("roscore", "rosmaster", "rostopic", "rosservice", "rosparam", "rosnode", "rosbag"),
    "/usr/lib/robot_state_publisher/robot_state_publisher",
)
TOOLS = {f"/usr/bin/{name}" for name in ("rostopic", "rosservice", "rosparam", "rosnode")}
MODULES = ("rospy", "actionlib", "dynamic_reconfigure.client", "tf2_ros", "genpy")


def need_ros() -> None:
    """Skip the test where ROS 1 is not installed; fail it in CI, which installs it."""
    missing = [program for program in NEEDED if shutil.which(program, path="/usr/bin") is None]
    if not missing:
        imports = subprocess.run([PYTHON, "-c", f"import {', '.join(MODULES)}"], capture_output=True, text=True)
        missing = [imports.stderr.strip().rpartition("\n")[2]] if imports.returncode else []
    if missing:
        (pytest.fail if os.environ.get("CI") else pytest.skip)(f"ROS 1 is not installed: {', '.join(missing)}")


def free_port() -> int:
    """A TCP port that nobody had a moment ago."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        port: int = listener.getsockname()[1]
        return port


class Done(NamedTuple):
    """What a program printed, and how it ended."""

    stdout: str
    stderr: str
    returncode: int


class Program:
    """A program that runs; both of its outputs come into one text."""

    def __init__(self, words: list[str], env: dict[str, str], output: Path) -> None:
        self.words, self._output = words, output
        with output.open("wb") as file:
            self.process = subprocess.Popen(
                words,
                stdin=subprocess.PIPE,
                stdout=file,
                stderr=subprocess.STDOUT,
                env=env,
                cwd=output.parent,
                start_new_session=True,
            )

    @property
    def output(self) -> str:
        return self._output.read_text("utf-8", "replace")

    def prints(self, pattern: str, limit_s: float = LIMIT_S) -> str:
        """Wait until it has printed what fits the pattern; all that it has printed."""

        def is_printed() -> bool:
            return re.search(pattern, self.output, re.MULTILINE) is not None or self.process.poll() is not None

        eventually(is_printed, f"{self.words} did not print {pattern!r}", limit_s)
        output = self.output
        assert re.search(pattern, output, re.MULTILINE), f"{self.words} ended and has printed only:\n{output}"
        return output

    def type(self, text: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(text.encode())
        self.process.stdin.flush()

    def signal(self, number: int) -> None:
        """To the program and all that it has started."""
        with suppress(ProcessLookupError):
            os.killpg(self.process.pid, number)

    def ends(self, limit_s: float = LIMIT_S) -> int:
        """Wait for its end; the exit code."""
        return self.process.wait(limit_s)

    def interrupt(self) -> str:
        """Ctrl-C; all that it has printed."""
        self.signal(signal.SIGINT)
        self.ends()
        return self.output

    def close(self) -> None:
        if self.process.poll() is None:
            self.signal(signal.SIGCONT)
            self.signal(signal.SIGINT)
            with suppress(subprocess.TimeoutExpired):
                self.process.wait(5)
        self.signal(signal.SIGKILL)
        self.process.wait()
        assert self.process.stdin is not None
        with suppress(BrokenPipeError):
            self.process.stdin.close()


class Ros:
    """ROS's programs with this master, in a folder of their own."""

    gateway: Program

    def __init__(self, master_uri: str) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="slidectl-ros-", dir="/tmp"))
        self._serial = 0
        self._programs = ExitStack()
        self._tools: subprocess.Popen[str] | None = None
        self.env = {
            "PATH": "/usr/bin:/bin",
            "HOME": str(self.folder),
            "LC_ALL": "C.UTF-8",
            "TZ": "UTC",
            "PYTHONUNBUFFERED": "1",
            "PYTHONPATH": str(message_packages()),
            "ROS_MASTER_URI": master_uri,
            "ROS_HOSTNAME": "localhost",
            "ROS_HOME": str(self.folder),
            "ROS_LOG_DIR": str(self.folder / "log"),
        }

    def words(self, line: str) -> list[str]:
        """The words of a line. The first is a tool of ROS, a file of `nodes/` (`x.py`), or any path."""
        name, *words = shlex.split(line)
        if name.endswith(".py") and "/" not in name:
            return [PYTHON, str(NODES / name), *words]
        return [name if "/" in name else f"/usr/bin/{name}", *words]

    def run(self, line: str, stdin: str = "", limit_s: float = LIMIT_S) -> Done:
        """Run a line to its end."""
        words = self.words(line)
        if words[0] in TOOLS:
            return self._run_tool(words, stdin, limit_s)
        done = subprocess.run(
            words, input=stdin, capture_output=True, text=True, env=self.env, cwd=self.folder, timeout=limit_s
        )
        return Done(done.stdout, done.stderr, done.returncode)

    def _run_tool(self, words: list[str], stdin: str, limit_s: float) -> Done:
        """Run one of TOOLS in a fork of a process that has its modules imported: much faster than a new interpreter."""
        if self._tools is None:
            self._tools = subprocess.Popen(
                [PYTHON, NODES / "tools.py"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
                env=self.env,
                cwd=self.folder,
                start_new_session=True,
            )
            self._programs.callback(self._end_tools)
        tools = self._tools
        assert tools.stdin is not None
        assert tools.stdout is not None
        files = [self.folder / name for name in ("tool_in", "tool_out", "tool_error")]
        for file, text in zip(files, (stdin, "", ""), strict=True):
            file.write_text(text, "utf-8")
        name = words[0].rpartition("/")[2]
        print(json.dumps([[name, *words[1:]], *map(str, files)]), file=tools.stdin, flush=True)
        is_done = select.select([tools.stdout], [], [], limit_s)[0]
        stdout, stderr = (file.read_text("utf-8", "replace") for file in files[1:])
        if not is_done:
            self._end_tools()
            raise TimeoutError(f"{words} did not end; it printed:\n{stdout}\n{stderr}")
        return Done(stdout, stderr, int(tools.stdout.readline()))

    def _end_tools(self) -> None:
        if self._tools is not None:
            with suppress(ProcessLookupError):
                os.killpg(self._tools.pid, signal.SIGKILL)
            self._tools.communicate()
            self._tools = None

    def ok(self, line: str, stdin: str = "") -> str:
        """Run a line that must succeed; its standard output."""
        done = self.run(line, stdin)
        assert done.returncode == 0, f"{line}: {done}"
        return done.stdout

    def start(self, line: str, env: dict[str, str] | None = None) -> Program:
        """Start a line, which is ended with this object at the latest."""
        self._serial += 1
        program = Program(self.words(line), {**self.env, **(env or {})}, self.folder / f"output{self._serial}.txt")
        self._programs.callback(program.close)
        return program

    def python(self, code: str, *arguments: str) -> Program:
        """Start a node of this Python code, as `start` does."""
        self._serial += 1
        output = self.folder / f"output{self._serial}.txt"
        program = Program([PYTHON, "-c", code, *arguments], self.env, output)
        self._programs.callback(program.close)
        return program

    @contextmanager
    def started(self, line: str) -> Iterator[Program]:
        """The line runs inside the with statement."""
        program = self.start(line)
        try:
            yield program
        finally:
            program.close()

    def close(self) -> None:
        self._programs.close()
        shutil.rmtree(self.folder, ignore_errors=True)

    def __enter__(self) -> Ros:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


@contextmanager
def roscore() -> Iterator[Ros]:
    """The real roscore on a free port."""
    port = free_port()
    with Ros(f"http://localhost:{port}") as ros:
        core = ros.start(f"roscore -p {port}")
        core.prints(r"started core service \[/rosout\]")
        yield ros


@contextmanager
def gateway(runtime: Runtime) -> Iterator[Ros]:
    """`slidectl gateway ros1` for this daemon, on a free port. It is the `gateway` of what is yielded."""
    port = free_port()
    words = [sys.executable, "-m", "slidectl", "gateway", "ros1", "run", "--port", str(port)]
    with Ros(f"http://localhost:{port}") as ros:
        ros.gateway = program = Program(words, runtime.env, ros.folder / "gateway.txt")
        try:
            program.prints(str(port))
            yield ros
        finally:
            program.close()
            print(program.output)  # pytest shows it with a test that failed


# Messages


@functools.cache
def message_packages() -> Path:
    """A folder for PYTHONPATH with the packages of messages that slidectl has and Debian's ROS has not."""
    folder = Path(tempfile.mkdtemp(prefix="slidectl-messages-", dir="/tmp"))
    packages: dict[str, None] = {}
    for kind, names in (("msg", definitions.type_names()), ("srv", definitions.service_names())):
        for name in names:
            package, _, stem = name.partition("/")
            packages[package] = None
            file = folder / "definitions" / package / kind / f"{stem}.{kind}"
            file.parent.mkdir(parents=True, exist_ok=True)
            text = definitions.service_of(name).text if kind == "srv" else definitions.definition_of(name).text
            file.write_text(text, "utf-8")
    made = subprocess.run([PYTHON, NODES / "make_messages.py", folder, *packages], capture_output=True, text=True)
    assert made.returncode == 0, made.stderr
    return folder / "python"


# What stands in slidectl's place

Call = tuple[str, dict[str, Any]]


def graph(client: Client, calls: Iterable[Call] = ()) -> dict[str, Any]:
    """What the daemon's nodes publish, subscribe and serve, with a message of each topic and the answers to calls.

    Services are those that the gateway offers without --allow.
    """
    nodes: dict[str, Any] = {}
    services = client.call("/slidectl/graph")["services"]
    offered = {service["name"] for service in services if service["effects"][0] in ("reads", "writes")}
    for node in client.call("/rosapi/nodes")["nodes"]:
        details = client.call("/rosapi/node_details", {"node": node})
        nodes[node] = {
            "publishes": {topic: _published(client, topic) for topic in details["publishing"]},
            "subscribes": {topic: client.topics()[topic] for topic in details["subscribing"]},
            "services": {
                service: {"type": client.call("/rosapi/service_type", {"service": service})["type"], "answers": []}
                for service in details["services"]
                if service in offered
            },
        }
    answers = {service: found for node in nodes.values() for service, found in node["services"].items()}
    for service, request in calls:
        try:
            answers[service]["answers"].append((request, client.call(service, request), ""))
        except SlidectlError as error:
            answers[service]["answers"].append((request, None, str(error)))
    return {"nodes": nodes, "parameters": json.loads(client.call("/rosapi/get_param", {"name": "/"})["value"])}


def _published(client: Client, topic: str) -> dict[str, Any]:
    """The type of the topic, whether it is latched, and a message of it, where one comes."""
    taken: list[dict[str, Any]] = []
    subscription = client.subscribe(topic, take=taken.append)
    with suppress(SlidectlError):
        client.sleep(0.2)
    subscription.close()
    first = taken[0] if taken else {}
    return {"type": client.topics()[topic], "latch": bool(first.get("latch")), "message": first.get("msg")}


@contextmanager
def stand_in(ros: Ros, recorded: dict[str, Any]) -> Iterator[None]:
    """rospy nodes under the names of the daemon's nodes, which do what was recorded."""
    file = ros.folder / "graph.json"
    file.write_text(json.dumps(recorded), "utf-8")
    programs = [
        ros.start(f"stand_in.py {file} {node}", {"ROS_NAMESPACE": node.rpartition("/")[0] or "/"})
        for node in recorded["nodes"]
    ]
    for program in programs:
        program.prints("^ready")
    yield
    for program in programs:
        program.close()


# Comparing

_NORMAL = [
    (r"https?://[^\s:/]+:\d+/[\w/]*", "http://HOST:PORT/"),
    (r"rosrpc://[^\s:/]+:\d+", "rosrpc://HOST:PORT"),
    (r"(?i)\bpid: \d+", "pid: PID"),
    (r"(_\d+){1,2}_\d{9,}\b", "_PID_TIME"),
    (r"\b(secs|nsecs|seq|sim_time): +[\d.]+", r"\1: N"),
    (r"^\d{6,},\d+,\d{6,},", "TIME,SEQ,TIME,"),
    (r"\[\d+\.\d+\]", "[TIME]"),
    (r"bound \(\d+ - \S+:\d+\) \[\d+\]", "bound"),
]


def normal(text: str) -> str:
    """The text without hosts, ports, process ids, times and sequence numbers."""
    for pattern, replacement in _NORMAL:
        text = re.sub(pattern, replacement, text, flags=re.MULTILINE)
    return text


def both(*actions: Any) -> list[Any]:
    """The results of these calls, made at the same time."""
    results: list[Any] = [None] * len(actions)

    def call(index: int) -> None:
        try:
            results[index] = actions[index]()
        except BaseException as error:
            results[index] = error

    threads = [threading.Thread(target=call, args=(index,)) for index in range(len(actions))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for result in results:
        if isinstance(result, BaseException):
            raise result
    return results
