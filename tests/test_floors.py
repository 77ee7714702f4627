"""The floors of the house: each room imports only from those below it, and some libraries stay out of some rooms."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from graphlib import TopologicalSorter
from itertools import chain
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parent.parent / "slidectl"

FLOORS = {
    "command_steps": 0, "confined": 0, "effects": 0, "entry_points": 0, "errors": 0,
    "names": 0, "expressions": 0, "fault_kinds": 0, "input_files": 0,
    "operating_system": 0, "paths": 0, "wire": 0,
    "logfile": 1, "processes": 1,
    "event_loop": 0, "rotations": 0, "web_access": 0, "writing": 0, "msgs": 0, "measures": 1, "rasteriser": 1,
    "description": 1, "control": 1, "client": 1, "recording": 1,
    "physics": 2, "launch": 2, "open_page": 1, "supervision": 1, "traces": 2,
    "transform_tree": 1, "typed_values": 2,
    "simulation": 3, "check": 3, "features": 4,
    "daemon": 4, "journal": 4, "viewing": 4, "gateways": 4,
    "scenarios": 5,
    "cli": 6,
    "pytest_plugin": 7,
}  # fmt: skip

# Beside each other, and all the same one of them is below the other.
# The client reads a robot's files for `Client.spawn`, inside of functions: a script that spawns none starts without it.
SAME_FLOOR = {
    ("client", "description"),
    ("viewing", "gateways"),
    ("supervision", "client"),
    ("open_page", "processes"),
    ("journal", "daemon"),
    ("control", "description"),
    ("web_access", "effects"),
    *(("wire", room) for room in ("names", "paths")),
    *(("msgs", room) for room in ("expressions", "names")),
    *((room, below) for room in FLOORS if not FLOORS[room] for below in ("errors", "operating_system")),
}

FORBIDDEN = {
    "command_steps": {"click", "lxml", "mujoco", "numpy", "rosbags", "yaml", "socket"},
    "entry_points": {"click", "lxml", "mujoco", "numpy", "rosbags", "yaml", "socket"},
    "confined": {"click", "lxml", "mujoco", "numpy", "rosbags", "yaml", "socket", "threading"},
    "effects": {"click", "lxml", "mujoco", "numpy", "rosbags", "yaml", "socket"},
    "errors": {"click", "lxml", "mujoco", "numpy", "rosbags", "yaml", "socket"},
    "logfile": {"click", "lxml", "mujoco", "numpy", "rosbags", "yaml", "socket"},
    "processes": {"click", "lxml", "mujoco", "numpy", "rosbags", "yaml", "socket"},
    "event_loop": {"click", "lxml", "mujoco", "numpy", "rosbags", "yaml", "socket"},
    "names": {"click", "lxml", "mujoco", "numpy", "rosbags", "yaml", "socket"},
    "expressions": {"click", "lxml", "mujoco", "numpy", "rosbags", "yaml", "socket"},
    "fault_kinds": {"click", "lxml", "mujoco", "numpy", "rosbags", "yaml", "socket"},
    "input_files": {"click", "lxml", "mujoco", "numpy", "rosbags", "yaml", "socket"},
    "operating_system": {"asyncio", "click", "lxml", "mujoco", "numpy", "rosbags", "yaml"},
    "paths": {"click", "lxml", "mujoco", "numpy", "rosbags", "yaml", "socket"},
    "rotations": {"click", "lxml", "mujoco", "numpy", "rosbags", "yaml", "socket"},
    "web_access": {"click", "lxml", "mujoco", "numpy", "rosbags", "yaml"},
    "wire": {
        "asyncio",
        "click",
        "lxml",
        "mujoco",
        "numpy",
        "rosbags",
        "select",
        "selectors",
        "socket",
        "threading",
        "websockets",
        "yaml",
    },
    "writing": {"click", "lxml", "mujoco", "numpy", "rosbags", "yaml", "socket"},
    "rasteriser": {"click", "lxml", "mujoco", "rosbags", "yaml", "socket"},
    "measures": {"click", "mujoco", "rosbags", "yaml", "socket"},
    "open_page": {"click", "lxml", "mujoco", "numpy", "rosbags", "yaml", "socket", "asyncio", "threading"},
    "supervision": {"click", "lxml", "mujoco", "numpy", "rosbags", "yaml", "socket", "asyncio", "threading"},
    "transform_tree": {"click", "lxml", "mujoco", "numpy", "rosbags", "yaml", "socket", "asyncio", "threading"},
    "typed_values": {"click", "lxml", "mujoco", "numpy", "rosbags", "socket"},
    "traces": {"click", "mujoco", "rosbags", "yaml", "socket"},
    "msgs": {"click", "mujoco", "socket"},
    "description": {"click", "mujoco", "socket"},
    "control": {"click", "mujoco", "socket"},
    "client": {"asyncio", "click", "mujoco", "numpy", "yaml", "rosbags", "lxml", "threading"},
    "recording": {"click", "mujoco", "socket", "yaml"},
    "physics": {"click", "socket", "select", "threading"},
    "features": {"click", "mujoco", "socket", "select", "time", "threading", "asyncio"},
    "simulation": {"click", "mujoco", "socket", "select", "time", "threading", "asyncio"},
    "launch": {"asyncio", "click", "mujoco", "socket", "threading"},
    "check": {"click", "mujoco", "socket"},
    "daemon": {"click", "asyncio", "threading"},
    "journal": {"click", "asyncio", "threading"},
    "viewing": {"asyncio", "click", "threading"},
    "gateways": {"click", "mujoco"},
    "scenarios": {"asyncio", "click", "mujoco", "socket"},
    "cli": {"mujoco", "asyncio"},
    "pytest_plugin": {"asyncio", "click", "mujoco", "numpy", "socket", "threading", "yaml"},
}

MAY_USE = {"client/async_client.py": {"asyncio"}}
"""Files that may use what the rest of their room may not."""

# What Linux has and macOS has not.
LINUX_ONLY = {
    "CDLL.prctl", "CDLL.mallopt",
    *(f"os.{name}" for name in (
        "EFD_CLOEXEC", "P_PIDFD", "SCHED_BATCH", "copy_file_range", "eventfd", "getrandom", "getxattr", "memfd_create",
        "pidfd_open", "pipe2", "posix_fadvise", "posix_fallocate", "sched_getaffinity", "sched_setaffinity",
        "sched_setscheduler", "setns", "setxattr", "splice", "timerfd_create", "unshare", "waitid",
    )),
    *(f"select.{name}" for name in ("POLLRDHUP", "epoll")),
    *(f"signal.{name}" for name in ("pidfd_send_signal", "sigtimedwait", "sigwaitinfo", "SIGPWR", "SIGRTMIN")),
    *(f"socket.{name}" for name in (
        "AF_NETLINK", "AF_PACKET", "AF_VSOCK", "MSG_CMSG_CLOEXEC", "MSG_NOSIGNAL", "SOCK_CLOEXEC", "SOCK_NONBLOCK",
        "SO_BINDTODEVICE", "SO_DOMAIN", "SO_PASSCRED", "SO_PEERCRED", "SO_PEERSEC", "SO_PROTOCOL", "TCP_KEEPIDLE",
        "TCP_QUICKACK", "TCP_USER_TIMEOUT",
    )),
    *(f"fcntl.{name}" for name in ("F_ADD_SEALS", "F_GETPIPE_SZ", "F_NOTIFY", "F_OFD_SETLK", "F_SETLEASE",
                                   "F_SETPIPE_SZ")),
    *(f"resource.{name}" for name in ("RLIMIT_NICE", "RLIMIT_RTPRIO", "RLIMIT_SIGPENDING", "prlimit")),
    *(f"time.{name}" for name in ("CLOCK_BOOTTIME", "CLOCK_TAI")),
}  # fmt: skip
LINUX_PATHS = ("/proc/", "/sys/", "/dev/shm")

# Rooms that the command line reaches through the client only.
NOT_FOR_CLI = {"control", "event_loop", "features", "physics", "rasteriser", "simulation"}

EXTENSIONS = {"gateways", "journal", "launch", "recording", "ros_commands", "scenarios", "viewing"}
# What imports an extension from outside of it, and why.
REACHES = {
    ("check", "launch"): "launch files are checked too",
    ("cli", "gateways"): "`daemon start --ros1` and the like start gateways, and `daemon list` shows them",
    ("cli", "launch"): "PACKAGE FILE names a file as in launch",
    ("cli", "recording"): "`assert` measures recordings as well as a running world",
    ("cli", "viewing"): "`controller plot` draws",
    ("journal", "recording"): "a replay is recorded into the same files",
    ("launch", "gateways"): "a launch starts the gateways that it is asked for",
    ("launch", "recording"): "a node `rosbag` of a launch file records",
    ("ros_commands", "launch"): "roslaunch and rosrun",
    ("ros_commands", "recording"): "rosbag",
    ("scenarios", "journal"): "a scenario that fails leaves a journal",
    ("scenarios", "recording"): "a scenario that fails leaves a recording, and is compared with one",
    ("traces", "recording"): "a trace may come from a recording",
    ("viewing", "gateways"): "the page is behind the guard of the WebSocket gateway",
    ("viewing", "recording"): "recordings are plotted, and made on the page",
}


@cache
def modules() -> list[Path]:
    return [
        path
        for path in sorted(PACKAGE.rglob("*.py"))
        if path.parent not in (PACKAGE, PACKAGE / "extensions") or path.stem not in ("__init__", "__main__")
    ]


def room(parts: tuple[str, ...]) -> str:
    """The room of a module, given by the parts of its name below `slidectl`.

    An extension is a room. Its commands, and those of ROS, are in the room of the command line; its check is in that
    of the checks.
    """
    if parts[0] != "extensions" or len(parts) == 1:
        return parts[0]
    if parts[-1].endswith("_check"):
        return "check"
    if "commands" in parts[2:3] or parts[1] == "ros_commands":
        return "cli"
    return "pytest_plugin" if "pytest_plugin" in parts else parts[1]


def room_of(path: Path) -> str:
    return room(path.relative_to(PACKAGE).with_suffix("").parts)


@cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


@cache
def imported(path: Path, types: bool = True) -> frozenset[str]:
    """Dotted names of all that the file imports, inside functions too; `types`: for type checking too."""
    found: set[str] = set()
    parts: list[ast.AST] = [
        node
        for node in tree_of(path).body
        if types or not (isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test))
    ]
    for node in chain.from_iterable(map(ast.walk, parts)):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            assert node.level == 0, f"{path}: relative import"
            found.add(node.module)
            if node.module.split(".")[0] == "slidectl":
                found.update(f"{node.module}.{alias.name}" for alias in node.names)
    return frozenset(found)


@cache
def rooms_used(path: Path) -> set[str]:
    rooms = {room(tuple(name.split(".")[1:])) for name in imported(path) if name.startswith("slidectl.")}
    return rooms & FLOORS.keys()


@pytest.fixture(scope="module", autouse=True)
def forget_the_trees() -> Iterator[None]:
    """The trees of all files take 140 MB."""
    yield
    tree_of.cache_clear()


def test_each_room_imports_only_from_lower_floors() -> None:
    upward = [
        f"{path.relative_to(PACKAGE)} imports {used}"
        for path in modules()
        for used in rooms_used(path) - {room_of(path)}
        if FLOORS[used] >= FLOORS[room_of(path)] and (room_of(path), used) not in SAME_FLOOR
    ]
    assert not upward


def test_each_room_keeps_out_the_libraries_that_it_must_not_know() -> None:
    known = {
        str(path.relative_to(PACKAGE)): {name.split(".")[0] for name in imported(path)}
        & FORBIDDEN[room_of(path)] - MAY_USE.get(str(path.relative_to(PACKAGE)), set())
        for path in modules()
    }
    assert not {path: libraries for path, libraries in known.items() if libraries}


def test_the_client_imports_the_description_of_robots_only_when_a_robot_is_spawned() -> None:
    code = "import sys, slidectl.client; assert not any('description' in name for name in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_importing_the_client_imports_none_of_what_it_must_not_know() -> None:
    code = f"import sys, slidectl.client; assert not {FORBIDDEN['client']!r} & sys.modules.keys()"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def linux_only(source: str) -> set[str]:
    """What of LINUX_ONLY and LINUX_PATHS a source uses. Doc strings and comments may name all of it."""
    tree = ast.parse(source)
    found: set[str] = set()
    names = {name.partition(".")[2] for name in LINUX_ONLY}
    texts = {node.value for node in ast.walk(tree) if isinstance(node, ast.Expr)}  # a text that stands alone
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute):
            owner = ast.unparse(node.value)
            full = f"{'CDLL' if 'CDLL(' in owner else owner}.{node.attr}"
            if full in LINUX_ONLY or (owner == "select" and node.attr.startswith("EPOLL")):
                found.add(full)
        elif isinstance(node, ast.ImportFrom):
            found |= {f"{node.module}.{alias.name}" for alias in node.names} & LINUX_ONLY
        elif isinstance(node, ast.Call) and ast.unparse(node.func) in ("getattr", "hasattr"):
            found |= {part.value for part in node.args if isinstance(part, ast.Constant)} & names
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and node not in texts:
            found |= {path for path in LINUX_PATHS if node.value.startswith(path)}
        elif isinstance(node, ast.Call) and ast.unparse(node.func).rpartition(".")[2] in ("bind", "connect"):
            found |= {"an abstract socket" for part in ast.walk(node)
                      if isinstance(part, ast.Constant) and str(part.value)[:1] == "\0"}  # fmt: skip
    return found


def test_what_linux_alone_has_is_used_in_one_module() -> None:
    """And in web_access.py, which asks there whether it may: elsewhere whose a connection is cannot be told."""
    used = {str(path.relative_to(PACKAGE)): linux_only(path.read_text(encoding="utf-8")) for path in modules()}
    assert {name for name, found in used.items() if found} == {"operating_system.py", "web_access.py"}, used
    assert used["web_access.py"] == {"socket.AF_NETLINK", "/proc/"}


def test_the_search_for_what_linux_alone_has_finds_it() -> None:
    for source, found in (
        ("os.pidfd_open(1)", "os.pidfd_open"),
        ("from os import memfd_create", "os.memfd_create"),
        ("select.EPOLLIN", "select.EPOLLIN"),
        ("getattr(os, 'splice')", "splice"),
        ("ctypes.CDLL(None).prctl(1)", "CDLL.prctl"),
        ("open(f'/proc/{pid}/comm')", "/proc/"),
        ("one.bind('\\0name')", "an abstract socket"),
    ):
        assert linux_only(source) == {found}, source
    assert linux_only('def one():\n    """/proc/ is not used."""\n    os.pipe()  # not os.pipe2') == set()


def test_every_room_has_a_floor() -> None:
    assert {room_of(path) for path in modules()} <= set(FLOORS)


def test_the_page_on_the_architecture_has_every_room_on_its_floor() -> None:
    page = (PACKAGE.parent / "docs" / "architecture.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (\d) \| ([^|]+) \|", page, re.MULTILINE)
    told = {name: int(floor) for floor, names in rows for name in re.findall(r"`(\w+)", names)}
    assert told == FLOORS


def test_the_command_line_has_no_private_door() -> None:
    doors = {
        f"slidectl.daemon.{door}"
        for door in (
            "cleaning",
            "health",
            "instances",
            "lifecycle",
            "options",
        )
    }
    for path in (path for path in modules() if room_of(path) == "cli"):
        assert not rooms_used(path) & NOT_FOR_CLI, path
        inside = {".".join(name.split(".")[:3]) for name in imported(path) if name.startswith("slidectl.daemon.")}
        assert inside <= doors, path


def place_of(path: Path) -> str:
    """The room of a module, where the commands of an extension are a part of it."""
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    return parts[1] if parts[0] == "extensions" else parts[0]


def test_an_extension_is_reached_from_outside_only_where_a_reason_is_given() -> None:
    """So that any of them can be left out, and the spine is read without them."""
    extensions = {path.name for path in (PACKAGE / "extensions").iterdir() if (path / "__init__.py").exists()}
    assert extensions == EXTENSIONS
    reaches = {
        (place_of(path), parts[2])
        for path in modules()
        for parts in (name.split(".") for name in imported(path))
        if parts[:2] == ["slidectl", "extensions"] and len(parts) > 2 and parts[2] != place_of(path)
    }
    assert reaches == REACHES.keys()


def test_no_files_import_each_other_in_a_circle() -> None:
    """Inside of functions neither; only the names of types may lead back."""
    files = {".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts): path for path in modules()}
    graph = {name: imported(path, types=False) & files.keys() - {name} for name, path in files.items()}
    TopologicalSorter(graph).prepare()


def test_a_class_name_and_a_module_name_stand_once_in_the_package() -> None:
    """A class inside of another one has the name of that one before its own."""
    places: dict[str, list[str]] = {}
    for path in modules():
        file = str(path.relative_to(PACKAGE))
        tree = tree_of(path)
        inner = {node for outer in ast.walk(tree) if isinstance(outer, ast.ClassDef) for node in outer.body}
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_") and node not in inner:
                places.setdefault(node.name, []).append(file)
        if not path.stem.startswith("__"):
            places.setdefault(path.stem, []).append(file)
    assert not {name: files for name, files in places.items() if len(files) > 1}, "give one of them another name"
