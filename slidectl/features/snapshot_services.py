"""The snapshots of a simulation by name, and the services that save, load, list, delete and export them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import TYPE_CHECKING, ClassVar

from slidectl import names
from slidectl.control.node_handle import Message
from slidectl.effects import Effect
from slidectl.errors import BadName, Refused, UnknownName, UsageError
from slidectl.features import snapshot_files
from slidectl.features.own_services import absolute_path
from slidectl.features.snapshots import Snapshot, capture, restore
from slidectl.simulation.clock import SECOND
from slidectl.simulation.feature import Feature
from slidectl.simulation.services import Handler

if TYPE_CHECKING:
    from slidectl.simulation.simulation import Simulation


class Snapshots(Feature):
    """The snapshots of one simulation, by name, in the order of their saving."""

    MOST: ClassVar[int] = 1000

    def attach(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._kept: dict[str, Snapshot] = {}
        node = simulation.graph.node(names.OWN_NODE, names.OWN_NODE)
        offers: dict[str, tuple[Effect, str, Handler]] = {
            "save": (Effect.WRITES, "Save", self._save),
            "load": (Effect.WRITES, "Load", self._load),
            "snapshots": (Effect.READS, "ListSnapshots", self._list),
            "delete_snapshots": (Effect.WRITES, "DeleteSnapshots", self._delete_several),
            "export_snapshot": (Effect.FILES, "ExportSnapshot", self._export),
        }
        for name, (effect, kind, handler) in offers.items():
            file_field = "file" if name in ("save", "load") else ""
            node.advertise_service(name, f"slidectl/{kind}", handler, effect, file_field)

    def __iter__(self) -> Iterator[tuple[str, Snapshot]]:
        return iter(tuple(self._kept.items()))

    def get(self, name: str) -> Snapshot:
        """The snapshot. Raises UnknownName."""
        if name not in self._kept:
            raise UnknownName("snapshot", name, list(self._kept))
        return self._kept[name]

    def save(self, name: str, first: Callable[[Snapshot], None] = lambda _: None) -> Snapshot:
        """Save the present state under the name, after `first` was called with it. An older one is replaced.

        Raises as `capture`, the errors of `first`, and BadName; then nothing has changed.
        """
        if not names.is_component(name):
            raise BadName(name, "name of a snapshot: letters, digits and '_', and the first is a letter")
        if len(self._kept) >= self.MOST and name not in self._kept:
            raise Refused(f"there are {self.MOST} snapshots already, the maximum", "slidectl sim delete NAME")
        snapshot = capture(self._simulation)
        first(snapshot)
        self._kept.pop(name, None)
        self._kept[name] = snapshot
        return snapshot

    def load(self, name: str) -> list[str]:
        """Restore a snapshot. Returns the names of the robots spawned again. Raises UnknownName, and as `restore`."""
        return restore(self._simulation, self.get(name))

    def delete(self, name: str) -> None:
        """Delete a snapshot. Raises UnknownName."""
        self.get(name)
        del self._kept[name]

    def _save(self, request: Message) -> Message:
        file = request["file"] and absolute_path(request["file"])
        write = partial(snapshot_files.write, path=file, host=self._simulation.host) if file else lambda _: None
        return {"time": self.save(request["name"], write).time_ns / SECOND}

    def _load(self, request: Message) -> Message:
        name, file = request["name"], request["file"]
        if bool(name) == bool(file):
            raise UsageError("give the name of a snapshot that is kept, or a file")
        simulation = self._simulation
        snapshot = self.get(name) if name else snapshot_files.read(absolute_path(file), simulation.host)
        made = restore(simulation, snapshot)
        return {"time": simulation.graph.clock.seconds, "robots": made}

    def _list(self, _: Message) -> Message:
        infos = [
            {
                "name": name,
                "time": snapshot.time_ns / SECOND,
                "cycles": snapshot.cycles,
                "robots": [robot.name for robot in snapshot.robots],
            }
            for name, snapshot in self
        ]
        return {"snapshots": infos}

    def _delete_several(self, request: Message) -> Message:
        for name in request["names"]:
            self.get(name)
        for name in dict.fromkeys(request["names"]):
            self.delete(name)
        return {}

    def _export(self, request: Message) -> Message:
        snapshot_files.write(self.get(request["name"]), absolute_path(request["file"]), self._simulation.host)
        return {}
