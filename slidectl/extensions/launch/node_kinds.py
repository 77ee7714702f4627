"""Finds what to do for each node: its counterpart for `pkg/type`, or the program that rosrun would run.

A program is looked for first where a build installs executables (`PREFIX/lib/PACKAGE`), then anywhere in the package.
The modules of counterparts are imported only when a plan needs them. Nothing is run here.
"""

from __future__ import annotations

import os
import re
import shutil
import sys
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from importlib import import_module
from pathlib import Path

from slidectl import input_files
from slidectl.description.packages import Packages, UnknownPackage, is_file
from slidectl.errors import BadFile, NotThere, closest, listing
from slidectl.extensions.launch.files import below
from slidectl.extensions.launch.plan import LaunchPlan, Node
from slidectl.extensions.launch.task import Task

COUNTERPARTS = {
    **{("gazebo_ros", kind): "gazebo:Gazebo" for kind in ("gazebo", "gzserver", "debug", "perf")},
    ("gazebo_ros", "gzclient"): "left_out:Window",
    ("gazebo_ros", "spawn_model"): "spawn_model:SpawnModel",
    ("controller_manager", "spawner"): "controller_nodes:Spawner",
    ("controller_manager", "unspawner"): "controller_nodes:Unspawner",
    ("controller_manager", "controller_manager"): "controller_nodes:ManagerScript",
    ("controller_manager", "controller_group"): "controller_nodes:GroupScript",
    ("robot_state_publisher", "robot_state_publisher"): "frame_nodes:RobotStatePublisher",
    ("robot_state_publisher", "state_publisher"): "frame_nodes:RobotStatePublisher",
    ("joint_state_publisher", "joint_state_publisher"): "left_out:JointStatePublisher",
    ("joint_state_publisher_gui", "joint_state_publisher_gui"): "left_out:JointStatePublisher",
    ("tf", "static_transform_publisher"): "frame_nodes:StaticTransform",
    ("tf2_ros", "static_transform_publisher"): "frame_nodes:StaticTransform",
    ("topic_tools", "relay"): "topic_tools:Relay",
    ("topic_tools", "throttle"): "topic_tools:Throttle",
    ("topic_tools", "mux"): "topic_tools:Mux",
    ("twist_mux", "twist_mux"): "topic_tools:TwistMux",
}
"""Package and type of nodes with a counterpart. All nodes of rviz and rqt packages are viewers, which are not listed.

RViz itself is run as a program when it can reach the daemon.
"""
RVIZ = ("rviz", "rviz")
_TOOLS = ("rostopic", "rosservice", "rosparam")
_VIEWER = "left_out:Viewer"
_DO_WITHOUT_ARGUMENTS = (_VIEWER, "left_out:Window", "gazebo:Gazebo")


def tasks(
    plan: LaunchPlan,
    packages: Packages,
    gather: bool = False,
    nodes: Sequence[Node] | None = None,
    has_master: bool = False,
) -> list[Task]:
    """The tasks for the nodes of the plan, or for some `nodes` of it, in order. Nothing is started.

    `has_master`: a gateway connects ROS 1 programs with the daemon. Then RViz is run as a program, if it is installed.

    Nodes without a counterpart or program, or whose arguments need missing things, are left out and noted as missing.
    With `gather` the caller raises the error, after looking for more.

    Raises BadFile: a node has invalid arguments. NotThere: something is missing.
    """
    found = []
    for node in plan.nodes if nodes is None else nodes:
        try:
            found.append(_task(node, plan, packages, has_master))
        except NotThere as error:
            loss = f"the node {node.full_name} is left out{_meaning(node)}"
            plan.missing.note(error, loss, not node.absent, node.required)
        except BadFile:
            plan.missing.refuse()
            raise
    if not gather:
        plan.missing.refuse()
    return found


def has_counterpart(package: str, kind: str) -> bool:
    """True when the node is part of the simulation here, and not a program."""
    return _entry(package, kind) is not None


def _entry(package: str, kind: str) -> str | None:
    """The counterpart of a node; a suffix `.py` is ignored."""
    if package.startswith(("rviz", "rqt")):
        return _VIEWER
    return COUNTERPARTS.get((package, kind)) or COUNTERPARTS.get((package, kind.removesuffix(".py")))


def _task(node: Node, plan: LaunchPlan, packages: Packages, has_master: bool) -> Task:
    entry = _entry(node.package, node.type)
    if has_master and (node.package, node.type) == RVIZ and not node.absent and (rviz := _rviz(node, packages)):
        from slidectl.extensions.launch.nodes.programs import Process

        return Process(node, plan, [rviz])
    if node.absent and entry not in _DO_WITHOUT_ARGUMENTS:
        raise node.absent[0]
    if entry is not None:
        only_for_processes = {"respawn": node.respawn, "launch-prefix": node.launch_prefix, "cwd": node.cwd}
        for attribute, value in only_for_processes.items() if entry != _VIEWER else ():
            if value:
                text = f"{attribute} has no effect: the node is part of the simulation here"
                plan.notice("ignored", node.place, node.full_name, text)
        module, name = entry.split(":")
        kind: type[Task] = getattr(import_module(f"slidectl.extensions.launch.nodes.{module}"), name)
        return kind(node, plan)
    from slidectl.extensions.launch.nodes.programs import Process, ToolProcess

    if node.package == node.type and node.type in _TOOLS:
        return ToolProcess(node, plan)
    program = find(node, packages.starting_at(os.path.dirname(node.file) or "/"))
    return Process(node, plan, [str(program)])


def _rviz(node: Node, packages: Packages) -> str | None:
    """The path of RViz: some distributions have it on the PATH, ROS has it in its folders."""
    program = shutil.which(node.type)
    if program is None:
        with suppress(BadFile):
            program = str(find(node, packages))
    return program


# --- what the absence of a node means to the user ---------------------------------------------------------------------

_UNPAUSES = re.compile(r"un_?pause")
_POSES = re.compile(r"(^|_)(home|homing|init|initial|initialize|stand|standup|tuck|untuck|pose|posture)(_|\d|$)")
_MEANINGS = (
    (re.compile(r"joy|teleop|keyboard|ps[34]_|xbox|spacenav|game_?pad"),
     "no joystick and no keyboard drives the robot: slidectl teleop does"),
    (re.compile(r"marker"), "no markers in RViz drive the robot: slidectl teleop does"),
    (re.compile(r"localization|amcl|ekf|ukf|gmapping|slam|cartographer|map_server|hector_mapping|fake_loc"),
     "nobody publishes the frame of the map or a filtered odometry"),
    (re.compile(r"move_base|navigation|planner_server"), "nobody plans a way: slidectl pub and teleop drive"),
    (re.compile(r"move_group|moveit"), "nobody plans motions: slidectl trajectory moves arms"),
    (re.compile(r"play_motion"), "no motions are played: slidectl trajectory moves arms"),
    (re.compile(r"nodelet|image_proc|pointcloud|depth|laserscan|laser_filter"), "nobody processes its sensors' data"),
    (re.compile(r"diagnostic|aggregator"), "nobody collects diagnostics"),
)  # fmt: skip
"""Patterns for `package/type name`, in lower case, and what the absence means; the first one counts."""


def _meaning(node: Node) -> str:
    """`: ` and what the absence of the node means; empty when its name does not tell."""
    name, kind = node.name.lower(), node.type.lower()
    if _UNPAUSES.search(kind) or _UNPAUSES.search(name):
        return ": nobody resumes the world by itself: slidectl sim resume"
    text = f"{node.package}/{node.type} {node.name}".lower()
    for pattern, means in _MEANINGS:
        if pattern.search(text):
            return f": {means}"
    if _POSES.search(kind.partition(".")[0]) or _POSES.search(name):
        return ": nobody sends the start pose: slidectl trajectory moves arms"
    return ""


# --- programs --------------------------------------------------------------------------------------------------------

_FILES = {"rospy": ("rospy/__init__.py", "rospy.py"), "roscpp": ("libroscpp.so",)}
_IMPORTS_ROSPY = re.compile(rb"^(import\s+(\w[\w., ]*,\s*)?|from\s+)rospy\b", re.MULTILINE)
"""For scripts that cannot be parsed. The time is linear: no blank fits two parts of it."""
_MOST_BYTES = 1 << 26
_MOST_PARSED = 1 << 20
"""The largest script that is parsed, bytes; parsing takes hundreds of times its size in memory."""
_LIKELY = ("scripts", "nodes", "bin", "src", "")


class NeedsRos(NotThere):
    """A program exists, but needs ROS 1, which is not installed."""


def find(node: Node, packages: Packages) -> Path:
    """Find the executable of a node.

    Raises NotThere: no such package, no such program in it, or the program is not executable. NeedsRos.
    """
    try:
        folders = packages.candidates(node.package) or [packages.find(node.package)]
    except UnknownPackage as error:
        near = closest(node.kind, ["/".join(known) for known in COUNTERPARTS])
        here = f"did you mean {near!r}, which has a counterpart here?" if near else "it has no counterpart here either"
        message = f"node {node.full_name} ({node.kind}): {error.message}"
        if near and "Did you mean" not in message:
            message = f"{message} Did you mean {near!r}?"
        raise node.place.absence(message, f"{here}\n{error.hint}", f"package {node.package}") from None
    found = [path for folder in folders for path in _named(node, folder)]
    for path in found:
        if os.access(path, os.X_OK):
            _check_ros(node, path)
            return path
    raise node.place.absence(*_why_not(node, folders, found), f"program {node.kind}")


def _named(node: Node, folder: Path) -> Iterator[Path]:
    """Candidates for the program, the most likely first."""
    prefixes = [folder.parent.parent] if folder.parent.name == "share" else []
    prefixes += [Path(prefix) for prefix in os.environ.get("CMAKE_PREFIX_PATH", "").split(os.pathsep) if prefix]
    built = [prefix / "lib" / node.package / node.type for prefix in prefixes]
    yield from (path for path in [*built, *(folder / part / node.type for part in _LIKELY)] if is_file(path))
    if "/" not in node.type:
        yield from (path for path in below(folder) if path.name == node.type)


def _why_not(node: Node, folders: list[Path], found: list[Path]) -> tuple[str, str]:
    what = f"node {node.full_name} ({node.kind})"
    if found:
        return f"{what}: {found[0]} is not executable", f"chmod +x '{found[0]}'"
    known = sorted({path.name for folder in folders for path in below(folder) if _is_program(path)})
    near = closest(node.type, [*known, *(kind for package, kind in COUNTERPARTS if package == node.package)])
    suggestion = f" Did you mean {near!r}?" if near else ""
    message = f"{what}: no program {node.type!r} in the package, and no counterpart here.{suggestion}"
    return message, f"programs in {folders[0]}: {listing(known)}{_compiled(node, folders)}"


def _is_program(path: Path) -> bool:
    """True for an executable script or binary. Copies from other systems have everything marked as executable."""
    if not os.access(path, os.X_OK) or ".so" in path.suffixes:
        return False
    try:
        with input_files.opened(path) as file:
            return file.read(4).startswith((b"#!", b"\x7fELF"))
    except (BadFile, OSError):
        return False


def _compiled(node: Node, folders: list[Path]) -> str:
    """A hint if a build of the package would make the program."""
    built = re.compile(rf"add_executable\(\s*{re.escape(node.type)}\s")
    for folder in folders:
        with suppress(BadFile):
            if built.search(input_files.read_bytes(folder / "CMakeLists.txt").decode("utf-8", "replace")):
                return "\nit is compiled from C++ (CMakeLists.txt), and with roscpp it needs ROS 1 and its master"
    return ""


def _check_ros(node: Node, program: Path) -> None:
    """Raise NeedsRos when the program needs a library of ROS 1 that is not installed."""
    if not (library := _ros_library(program)):
        return
    environment = {**os.environ, **dict(node.environment)}
    if any(is_file(folder / file) for folder in _library_folders(program, environment) for file in _FILES[library]):
        return
    what = "is linked with roscpp" if library == "roscpp" else "imports rospy"
    message = f"node {node.full_name} ({node.kind}): {program.name} {what}, which needs ROS 1 and its master"
    hint = "neither is here; a script may use slidectl.client instead of rospy"
    raise NeedsRos(message, node.place.file, node.place.line, hint, f"{library} for {node.kind}")


def _ros_library(program: Path) -> str:
    """`rospy` for a script that requires it, `roscpp` for a program linked with it, else empty."""
    try:
        with input_files.opened(program) as file:
            content = file.read(_MOST_BYTES)
    except (BadFile, OSError):  # reported when the program is run
        return ""
    if content.startswith(b"\x7fELF"):
        return "roscpp" if b"libroscpp.so" in content else ""
    is_script = program.suffix == ".py" or b"python" in content.partition(b"\n")[0]
    return "rospy" if is_script and b"rospy" in content and _imports_rospy(content) else ""


def _imports_rospy(script: bytes) -> bool:
    """True when a script imports rospy at its start. An import in a `try` does not count, as it is optional."""
    import ast

    try:
        if len(script) > _MOST_PARSED:
            raise ValueError
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the user cannot act on Python's warnings about this code
            statements = ast.parse(script).body
    except (SyntaxError, ValueError, RecursionError, MemoryError):  # usually a script for Python 2
        return _IMPORTS_ROSPY.search(script) is not None
    for statement in statements:
        names = [alias.name for alias in statement.names] if isinstance(statement, ast.Import) else []
        names += [statement.module or ""] if isinstance(statement, ast.ImportFrom) and not statement.level else []
        if any(name.partition(".")[0] == "rospy" for name in names):
            return True
    return False


def _library_folders(program: Path, environment: Mapping[str, str]) -> Iterator[Path]:
    """The folders where a program finds libraries: of the environment, beside a script, and of ROS 1 installations."""
    for variable in ("PYTHONPATH", "LD_LIBRARY_PATH"):
        yield from (Path(entry) for entry in environment.get(variable, "").split(os.pathsep) if entry)
    yield program.parent
    yield from Path("/opt/ros").glob("*/lib/python*/dist-packages")
    yield from Path("/opt/ros").glob("*/lib")
    yield from (Path(entry) for entry in sys.path if entry)
