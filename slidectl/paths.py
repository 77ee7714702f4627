"""Paths of files: the private folder of a daemon instance, and the models and configurations that are shipped.

The checks of owners, modes and links are against: a second user of the machine, who may write in the temporary folder.
Standard library only, and quick to import. Nothing here creates a folder except `make_private`.
"""

from __future__ import annotations

import os
import re
import stat
from typing import TYPE_CHECKING

from slidectl.errors import Refused, UsageError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

DEFAULT_INSTANCE = "default"
_SOCKET = "socket"
_LONGEST_INSTANCE = 64
_INSTANCE = rf"[A-Za-z0-9][A-Za-z0-9_.-]{{0,{_LONGEST_INSTANCE - 1}}}\Z"
# A Unix socket's path is limited by the kernel (sun_path, 108 bytes with its end).
_LONGEST_SOCKET_PATH = 107


class InstancePaths:
    """The files of one daemon instance, in one private folder. `prefix` keeps the files of a named socket apart.

    The paths are texts: every command looks up its socket, and importing pathlib takes longer than using it once.
    """

    __slots__ = ("folder_text", "prefix", "socket_text")

    def __init__(self, folder: str | Path, socket: str | Path, prefix: str = "") -> None:
        self.folder_text = os.fspath(folder)
        self.socket_text = os.fspath(socket)
        self.prefix = prefix

    @property
    def folder(self) -> Path:
        return _path(self.folder_text)

    @property
    def socket(self) -> Path:
        return _path(self.socket_text)

    @property
    def lock(self) -> Path:
        """The file that the running daemon locks; it holds the daemon's process id as text."""
        return self.folder / f"{self.prefix}lock"

    @property
    def page(self) -> Path:
        """The file that a running `slidectl view` locks; it holds its process id and the address of the page."""
        return self.folder / f"{self.prefix}page.lock"

    @property
    def log(self) -> Path:
        """The daemon's log; rotated copies are `log.1` and so on."""
        return self.folder / f"{self.prefix}log"

    @property
    def name(self) -> str:
        """The name of the instance, or of the file of its socket."""
        return self.prefix.rstrip(".") or os.path.basename(self.folder_text)


def _path(text: str) -> Path:
    from pathlib import Path

    return Path(text)


def runtime_folder() -> str:
    """`$XDG_RUNTIME_DIR/slidectl`, else a folder of the user under the temporary folder."""
    base = os.environ.get("XDG_RUNTIME_DIR")
    return os.path.join(os.path.abspath(base), "slidectl") if base else temporary_runtime_folder()


def temporary_runtime_folder() -> str:
    """The folder of all instances when XDG_RUNTIME_DIR is not set."""
    # The temporary folder as tempfile.gettempdir finds it; that module takes longer to import than this one.
    named = (os.environ.get(variable) for variable in ("TMPDIR", "TEMP", "TMP"))
    temporary = next((os.path.abspath(folder) for folder in named if folder and os.path.isdir(folder)), "/tmp")
    return os.path.join(temporary, f"slidectl-{os.getuid()}")


def runtime_folders() -> list[str]:
    """The folders that may hold instances of this user: that of this environment first, and that under the temporary
    folder, where a shell without XDG_RUNTIME_DIR has them."""
    return list(dict.fromkeys((runtime_folder(), temporary_runtime_folder())))


def instances() -> list[InstancePaths]:
    """All instances of this user that have a folder, by name. Links and what belongs to other users are left out."""
    found = []
    for folder in runtime_folders():
        for name in sorted(os.listdir(folder)) if is_ours(folder) else []:
            path = os.path.join(folder, name)
            if re.match(_INSTANCE, name) and is_ours(path):
                found.append(InstancePaths(path, os.path.join(path, _SOCKET)))
    return found


def is_ours(path: str | Path, *kinds: int) -> bool:
    """True for a folder of this user, or for a file of one of the kinds (S_IFREG ...) of this user; not for links."""
    try:
        info = os.lstat(path)
    except OSError:
        return False
    return stat.S_IFMT(info.st_mode) in (kinds or (stat.S_IFDIR,)) and info.st_uid == os.geteuid()


def instance(name: str | None = None, socket: str | None = None) -> InstancePaths:
    """The paths of an instance: by socket path if given, else by name. Environment variables are the defaults.

    Raises:
        UsageError: the name is not a file name, or the socket path is too long for the kernel.
    """
    if socket is None and name is None:
        socket = os.environ.get("SLIDECTL_SOCKET") or None
    if socket == "":
        raise UsageError("the socket's path is empty", "is a variable in it not set?")
    if socket is not None:
        path = os.path.abspath(socket)
        folder, file = os.path.split(path)
        above, name = os.path.split(folder)
        # The socket path of an instance means that instance: lock and log must be the same files.
        is_instances = file == _SOCKET and above in runtime_folders() and re.match(_INSTANCE, name)
        found = InstancePaths(folder, path, "" if is_instances else f"{file}.")
    else:
        name = name if name is not None else os.environ.get("SLIDECTL_INSTANCE") or DEFAULT_INSTANCE
        if not re.match(_INSTANCE, name):
            if len(name) > _LONGEST_INSTANCE:
                raise UsageError(f"instance name {name!r} has {len(name)} characters, more than {_LONGEST_INSTANCE}")
            raise UsageError(f"instance name {name!r} is not a plain file name (letters, digits, '.', '_', '-')")
        folder = os.path.join(runtime_folder(), name)
        found = InstancePaths(folder, os.path.join(folder, _SOCKET))
    if len(os.fsencode(found.socket_text)) > _LONGEST_SOCKET_PATH:
        raise UsageError(
            f"socket path is longer than {_LONGEST_SOCKET_PATH} bytes: {found.socket_text}",
            "set XDG_RUNTIME_DIR to a shorter folder, or give --socket",
        )
    return found


def make_private(folder: Path) -> None:
    """Create the folder with mode 0700, or check that it is ours and closed to others.

    Raises:
        Refused: it cannot be made, belongs to another user, is a link, or is open to others. Or another user could
            replace it: that is checked for the folder that holds all instances.
    """
    above = folder.parent
    hint = "set XDG_RUNTIME_DIR to a folder of your own"
    # Any user may put a link into the temporary folder.
    if _is_ours_to_name(folder) and above.is_symlink() and (uid := above.lstat().st_uid) != os.geteuid():
        raise Refused(f"{above} is a symbolic link of another user (uid {uid})", hint)
    try:
        above.mkdir(mode=0o700, parents=True, exist_ok=True)
        folder.mkdir(mode=0o700, exist_ok=True)
    except FileExistsError:
        raise Refused(f"{folder} is not a folder") from None
    except OSError as error:
        raise Refused(f"cannot make the folder {folder}: {error.strerror or error}", hint) from None
    if _is_ours_to_name(folder):
        info = above.stat()
        if info.st_uid != os.geteuid():
            raise Refused(f"{above} belongs to another user (uid {info.st_uid})", hint)
        if stat.S_IMODE(info.st_mode) & 0o022:
            raise Refused(f"{above} can be written by other users", f"chmod go-w {above}")
    check_private(folder)


def is_named_by_instance(paths: InstancePaths) -> bool:
    """True when `--instance` leads there in this environment; else only `--socket` does."""
    return not paths.prefix and _is_ours_to_name(paths.folder_text)


def check_socket(paths: InstancePaths) -> None:
    """Check, before connecting, that nobody else may have put the socket there. Raises Refused, OSError."""
    if paths.prefix:
        os.lstat(paths.socket_text)  # a missing socket is an OSError, whatever the folder's permissions are
    check_private(paths.folder_text)


def command(paths: InstancePaths, words: str) -> str:
    """The shell command that runs `words` on this instance."""
    if not is_named_by_instance(paths):
        return f"slidectl --socket {paths.socket_text} {words}"
    name = paths.name
    return f"slidectl {words}" if name == DEFAULT_INSTANCE else f"slidectl -i {name} {words}"


def _is_ours_to_name(folder: str | Path) -> bool:
    """True for the folder of an instance. The user is responsible for the folder of a named socket."""
    return os.path.dirname(os.fspath(folder)) == runtime_folder()


def check_private(folder: str | Path) -> None:
    """Raise Refused unless the folder is a real one, owned by us and closed to others."""
    info = os.lstat(folder)
    if not stat.S_ISDIR(info.st_mode):
        raise Refused(f"{folder} is not a folder")
    if info.st_uid != os.geteuid():
        raise Refused(
            f"{folder} belongs to another user (uid {info.st_uid})", "choose another --instance or XDG_RUNTIME_DIR"
        )
    if stat.S_IMODE(info.st_mode) & 0o077:
        # Never advise to close a folder that may serve others too, such as /tmp, a home or the root.
        own = "put the socket into a folder of your own, made with: mkdir -m 700 FOLDER"
        raise Refused(f"{folder} is open to other users", f"chmod 700 {folder}" if _is_ours_to_name(folder) else own)


def shown(path: str) -> str:
    """The path as text for messages; bytes that are not UTF-8 are written as `\\xff`."""
    return os.fsencode(path).decode("utf-8", "backslashreplace")


def with_package(environment: Mapping[str, str]) -> dict[str, str]:
    """An environment in which Python finds slidectl even when it runs from its checkout without being installed."""
    root = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    if os.path.basename(root) in ("site-packages", "dist-packages"):
        return dict(environment)
    path = os.pathsep.join(filter(None, [root, environment.get("PYTHONPATH")]))
    return {**environment, "PYTHONPATH": path}


def share(kind: str) -> Path:
    """The folder of the shipped `models`, `config` or `launch` files: inside the wheel, else beside the package."""
    package = _path(__file__).parent
    inside = package / "share" / kind
    return inside if inside.is_dir() else package.parent / kind


def install_command(extra: str) -> str:
    """The command line that adds an extra, such as `view`, to this installation: from the clone or wheel it came from.

    slidectl is on no package index, where another project might have its name.
    """
    from importlib.metadata import PackageNotFoundError, distribution
    from json import loads
    from shlex import quote
    from urllib.parse import unquote, urlsplit

    try:
        origin = loads(distribution("slidectl").read_text("direct_url.json") or "{}")
        place = urlsplit(origin.get("url", ""))
        clone = unquote(place.path)
        is_editable = bool(origin.get("dir_info", {}).get("editable"))
    except (PackageNotFoundError, ValueError, AttributeError):
        return f"pip install '.[{extra}]' in a clone of slidectl"
    is_wheel = clone.endswith(".whl") and os.path.isfile(clone)
    if place.scheme != "file" or not (is_wheel or os.path.isfile(os.path.join(clone, "pyproject.toml"))):
        return f"pip install '.[{extra}]' in a clone of slidectl"
    words = quote(f"{clone}[{extra}]")
    return f"pip install {'-e ' if is_editable else ''}{words}"
