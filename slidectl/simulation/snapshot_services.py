"""The services of `/slidectl` for snapshots: save, load, snapshots, delete_snapshots, export_snapshot."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from slidectl.control.node_handle import Message
from slidectl.errors import UsageError
from slidectl.names import OWN_NODE
from slidectl.simulation import snapshot_files
from slidectl.simulation.clock import SECOND
from slidectl.simulation.snapshots import put

if TYPE_CHECKING:
    from slidectl.simulation.simulation import Simulation


class SnapshotServices:
    """Those of one simulation."""

    def __init__(self, simulation: Simulation) -> None:
        """Advertises all of them."""
        self._simulation = simulation
        self._snapshots = simulation.snapshots
        node = simulation.graph.node(OWN_NODE, OWN_NODE)
        node.advertise_service("save", "slidectl/Save", self._save)
        node.advertise_service("load", "slidectl/Load", self._load)
        node.advertise_service("snapshots", "slidectl/ListSnapshots", self._list)
        node.advertise_service("delete_snapshots", "slidectl/DeleteSnapshots", self._delete)
        node.advertise_service("export_snapshot", "slidectl/ExportSnapshot", self._export)

    def _save(self, request: Message) -> Message:
        file = _absolute(request["file"])
        write = partial(snapshot_files.write, path=file) if file else lambda _: None
        snapshot = self._snapshots.save(request["name"], write)
        return {"time": snapshot.time_ns / SECOND}

    def _load(self, request: Message) -> Message:
        name, file = request["name"], _absolute(request["file"])
        if bool(name) == bool(file):
            raise UsageError("give the name of a snapshot that is kept, or a file")
        made = put(self._simulation, snapshot_files.read(file)) if file else self._snapshots.load(name)
        return {"time": self._simulation.graph.clock.seconds, "robots": made}

    def _list(self, _: Message) -> Message:
        infos = [
            {
                "name": name,
                "time": snapshot.time_ns / SECOND,
                "cycles": snapshot.cycles,
                "robots": [robot.name for robot in snapshot.robots],
            }
            for name, snapshot in self._snapshots
        ]
        return {"snapshots": infos}

    def _delete(self, request: Message) -> Message:
        for name in request["names"]:
            self._snapshots.get(name)
        for name in dict.fromkeys(request["names"]):
            self._snapshots.delete(name)
        return {}

    def _export(self, request: Message) -> Message:
        snapshot_files.write(self._snapshots.get(request["name"]), _absolute(request["file"]))
        return {}


def _absolute(file: str) -> str:
    if file and not file.startswith("/"):
        raise UsageError(f"the file {file!r} is not an absolute path")
    return file
