"""Checks whether this machine and this account can run slidectl, with remedies.

Each check is a function that yields its findings. A failed check is a finding too: the others go on.
"""

from __future__ import annotations

import os
import platform
import resource
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import NamedTuple

from slidectl import __version__, paths
from slidectl.client import Client
from slidectl.daemon import lifecycle
from slidectl.errors import SlidectlError
from slidectl.operating_system import set_timer_slack
from slidectl.paths import InstancePaths, command, install_command

OK, LOOK, BROKEN = "ok", "look here", "broken"
_PYTHON = (3, 11)
_NEEDED = {
    "click": "click", "mujoco": "mujoco", "numpy": "numpy", "pyyaml": "yaml", "rich": "rich", "rosbags": "rosbags",
    "xacro": "xacro", "yourdfpy": "yourdfpy",
}  # fmt: skip
"""Distribution -> module."""
_EXTRAS = {
    "numba": ("numba", "machine code for the cycle", "fast"),
    "mcap": ("mcap", "recordings as .mcap", "mcap"),
}
"""Distribution -> module, use, extra."""
_LITTLE_DISK, _NO_DISK = 200 << 20, 1 << 20
_FEW_FILES, _MANY_FILES = 256, 4096
_WAKE_UPS = 200
_WAIT_S = 0.001
_LATE_S = 0.001
"""A one-millisecond wait that ends this late costs a cycle at 1 kHz."""


class Finding(NamedTuple):
    """One line of the report. `remedy` says what to do; empty when nothing is to be done."""

    check: str
    state: str
    finding: str
    remedy: str = ""


def findings(find: Callable[[], InstancePaths]) -> Iterator[Finding]:
    """The findings of all checks, in order, for the machine and the instance that `find` returns. Raises nothing."""
    for name, check in _OF_MACHINE.items():
        yield from _finding(name, check)
    try:
        instance = find()
    except SlidectlError as error:
        yield Finding("sockets", BROKEN, error.message, error.hint or "")
        return
    for name, look in _OF_INSTANCE.items():
        yield from _finding(name, partial(look, instance))


def _finding(name: str, check: Callable[[], _Found]) -> Iterator[Finding]:
    try:
        for one in check():
            yield Finding(name, *one)
    except SlidectlError as error:
        yield Finding(name, BROKEN, error.message, error.hint or "")
    except Exception as error:  # a machine may be broken in any way, and the report must be complete
        yield Finding(name, BROKEN, f"{type(error).__name__}: {error}")


_Found = Iterator[tuple[str, ...]]
"""State, finding, remedy."""


def _python() -> _Found:
    here = f"{platform.python_version()} at {sys.executable}"
    if sys.version_info < _PYTHON:
        yield BROKEN, here, f"slidectl needs Python {'.'.join(map(str, _PYTHON))} or newer"
    elif sys.platform != "linux":
        yield LOOK, f"{here}; slidectl {__version__}, on {sys.platform}", "slidectl is tested on Linux only"
    else:
        yield OK, f"{here}; slidectl {__version__}"


def _libraries() -> _Found:
    there = []
    for name, module in _NEEDED.items():
        try:
            import_module(module)
            there.append(f"{name} {version(name)}")
        except (ImportError, PackageNotFoundError, OSError) as error:
            yield (BROKEN, f"{name}: {error}", "in the clone of slidectl: pip install --force-reinstall .")
    yield OK, ", ".join(there)
    for name, (module, use, extra) in _EXTRAS.items():
        try:
            import_module(module)
            yield OK, f"{name} {version(name)}: {use}"
        except (ImportError, PackageNotFoundError, OSError):
            yield OK, f"without {name}: {use}", f"where you want that: {install_command(extra)}"


def _mujoco() -> _Found:
    from slidectl.simulation.simulation import Simulation

    Simulation().step(10)
    yield OK, "a world was made and stepped"


def _cameras() -> _Found:
    """Render a picture, in a process as cameras of robots have it."""
    from slidectl.description.robot import Pose as Origin
    from slidectl.description.sensors import Camera
    from slidectl.physics import World, rendering
    from slidectl.rotations import ORIGIN
    from slidectl.simulation.host import Host

    host, world = Host(), World()
    camera = Camera("camera", "link", "image_raw", "link", 1.0, Origin(), 0.0, width=16, height=16)
    done = host.render(world, camera, ORIGIN, 0)
    if done.error is not None:  # OpenGL has ended the process, and software draws the next one
        done = host.render(world, camera, ORIGIN, 0)
    done.result()
    remedy = "" if host.drawn_by() == rendering.BY_OPENGL else f"for smoother pictures: {rendering.INSTALL}"
    yield OK, f"drawn by {host.drawn_by()}", remedy


def _compiled() -> _Found:
    from slidectl.simulation.compiled import object_file

    if not object_file.is_possible():
        yield OK, "none: cycles run in the interpreter, with the same results"
    elif object_file.is_there():
        yield OK, f"in {object_file.folder()}"
    else:
        yield OK, "none yet: the first daemon compiles it, in a process of its own"


def _sockets(instance: InstancePaths) -> _Found:
    was_there = instance.folder.exists()
    paths.make_private(instance.folder)  # raises with the reason
    if not was_there:
        with suppress(OSError):
            instance.folder.rmdir()
    yield OK, instance.socket_text


def _daemons(instance: InstancePaths) -> _Found:
    """Check the daemon of the instance, and other daemons of this user."""
    pid = lifecycle.running(instance)
    if pid is None:
        yield OK, f"{instance.name}: does not run"
        if instance.socket.exists():
            yield LOOK, f"{instance.socket_text} was left by a daemon that was killed", "the next start replaces it"
    else:
        yield from _daemon(instance, pid, BROKEN)
    for one in filter(paths.is_named_by_instance, paths.instances()):
        if one.socket_text != instance.socket_text and one.socket.exists():
            pid = lifecycle.running(one)
            if pid is None:
                yield LOOK, f"{one.name}: was killed, its files are left", command(one, "daemon clean")
            else:
                yield from _daemon(one, pid, LOOK)


def _daemon(instance: InstancePaths, pid: int, silent: str) -> _Found:
    """Check a running daemon. `silent` is the state to report when it does not answer."""
    theirs: list[str] = []
    try:
        with Client(socket=instance.socket_text, timeout=5.0) as client:
            client.on_other_version = theirs.append
            status = client.call("/slidectl/status")
    except SlidectlError as error:
        yield silent, f"{instance.name}: process {pid}: {error.message}", error.hint or ""
        return
    where = f"{instance.name}: process {pid}, {status['time']:.3f} s, {status['engine']}"
    if theirs:
        remedy = command(instance, "daemon restart")
        yield LOOK, f"{where}; it is of version {theirs[0]}, this command of {__version__}", remedy
    else:
        yield OK, where
    if status.get("trouble"):
        yield LOOK, f"{instance.name}: {status['trouble']}", command(instance, "daemon logs")


def _disk(instance: InstancePaths) -> _Found:
    from slidectl.simulation.compiled import object_file

    places = {"runtime folder": instance.folder, "compiled code": object_file.folder(), "this folder": Path.cwd()}
    for what, folder in places.items():
        there = next(each for each in (folder, *folder.parents) if each.exists())
        free = shutil.disk_usage(there).free
        text = f"{what} ({there}): {free / 1e9:.1f} GB free"
        if not os.access(there, os.W_OK):
            yield (
                (LOOK if what == "this folder" else BROKEN),
                f"{text}, and it cannot be written",
                f"see: ls -ld {there}",
            )
        elif free < _LITTLE_DISK:
            yield (BROKEN if free < _NO_DISK else LOOK), text, "make room"
        else:
            yield OK, text


def _descriptors() -> _Found:
    most, largest = resource.getrlimit(resource.RLIMIT_NOFILE)
    if most < _FEW_FILES:
        more = _MANY_FILES if largest == resource.RLIM_INFINITY else min(largest, _MANY_FILES)
        remedy = f"ulimit -n {more}" if more > most else "raise the hard limit: nofile in /etc/security/limits.conf"
        yield LOOK, f"at most {most} open files; each connection takes one", remedy
    else:
        yield OK, f"at most {most} open files"


def _punctuality() -> _Found:
    """Measure how late a wait of one millisecond ends, with the timer slack that the daemon requests."""
    before = set_timer_slack(1)
    late = []
    for _ in range(_WAKE_UPS):
        began = time.perf_counter()
        time.sleep(_WAIT_S)
        late.append(time.perf_counter() - began - _WAIT_S)
    set_timer_slack(before)
    late.sort()
    median, most = late[len(late) // 2], late[int(0.99 * len(late))]
    text = f"wakes up {1e6 * median:.0f} us late, 99 % within {1e6 * most:.0f} us; timer slack {before / 1000:g} us"
    if most > _LATE_S:
        remedy = "this machine is busy or virtual: cycles at real time will be late; free-running ones do not mind"
        yield LOOK, f"{text}; load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores", remedy
    else:
        yield OK, text


def _packages() -> _Found:
    for variable in ("SLIDECTL_PACKAGE_PATH", "ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH", "GAZEBO_MODEL_PATH"):
        folders = [folder for folder in os.environ.get(variable, "").split(os.pathsep) if folder]
        gone = [folder for folder in folders if not os.path.isdir(folder)]
        if gone:
            yield (
                LOOK,
                f"{variable}: not found: {', '.join(gone)}",
                "set it anew; folders that are not there are passed over",
            )
        elif folders:
            yield OK, f"{variable}: {os.pathsep.join(folders)}"
        else:
            yield OK, f"{variable} is not set"


def _ros() -> _Found:
    here = {name: os.environ[name] for name in ("ROS_DISTRO", "ROS_MASTER_URI", "ROS_NAMESPACE") if name in os.environ}
    text = ", ".join(f"{name}={value}" for name, value in here.items()) or "no variables of ROS"
    tool = shutil.which("rostopic")
    if tool:
        yield LOOK, f"{text}; {tool} is ROS's own", "it does not reach this daemon: slidectl ros rostopic ... does"
    else:
        yield OK, text


_OF_MACHINE: dict[str, Callable[[], _Found]] = {
    "python": _python, "libraries": _libraries, "mujoco": _mujoco, "cameras": _cameras, "compiled": _compiled,
    "files": _descriptors, "timers": _punctuality, "packages": _packages, "ros": _ros,
}  # fmt: skip
_OF_INSTANCE: dict[str, Callable[[InstancePaths], _Found]] = {
    "sockets": _sockets, "daemons": _daemons, "disk": _disk,
}  # fmt: skip
