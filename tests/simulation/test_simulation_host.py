"""The host of a world: worlds in one process share nothing of what reaches them, and a test may give its own."""

from __future__ import annotations

import json
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from slidectl import Simulation, description
from slidectl.client import Client
from slidectl.daemon import time_limit
from slidectl.daemon.in_process import InProcessWorld
from slidectl.daemon.options import DaemonOptions
from slidectl.daemon.time_limit import TimeLimit
from slidectl.errors import Refused, UnknownName
from slidectl.extensions.journal.journal import Journal
from slidectl.physics.hulls import MeshSource
from slidectl.simulation.host import Host, HostWrapper
from slidectl.simulation.pending import Pending

PUSH = """
from slidectl.control import Controller, EffortJointInterface{more}

class Push(Controller):
    interface_type = EffortJointInterface

    def init(self, interface, node):
        self.joint = interface.get_handle("joint1")
        return True

    def update(self, time_ns, period_s):
        {update}
"""


def world_of(host: Host | None = None, imports: tuple[str, ...] = ()) -> InProcessWorld:
    """A paused world with a slider."""
    simulation = Simulation(engine="plain", imports=imports, host=host)
    simulation.run.paused = True
    simulation.spawn(description.load("slider").xml, "slider")
    return InProcessWorld(simulation)


def load(client: Client, file: Path) -> None:
    """Load and start the controller of a file."""
    request = {"robot": "slider", "name": "push", "file": str(file), "class_name": "Push"}
    assert client.call("/slidectl/load_controller_file", request)["ok"]
    start = {"start_controllers": ["push"], "stop_controllers": [], "strictness": 2}
    assert client.call("/slider/controller_manager/switch_controller", start)["ok"]


def write(folder: Path, gain: float, more: str = "", update: str = "self.joint.command = helper_gain.GAIN") -> Path:
    """A controller's file and the module beside it, which all such files import under one name."""
    folder.mkdir()
    (folder / "helper_gain.py").write_text(f"GAIN = {gain}\n", "utf-8")
    file = folder / "push.py"
    file.write_text(PUSH.format(more=more or "\nimport helper_gain", update=update), "utf-8")
    return file


def command(world: InProcessWorld) -> float:
    """What the controller has written to its joint."""
    controller: Any = world.simulation.robots.get("slider").manager.get("push")
    value: float = controller.joint.command
    return value


def journal(path: Path) -> Journal:
    return Journal(DaemonOptions(journal=str(path), engine="plain", paused=True))


def entries(path: Path, kind: str) -> list[Any]:
    return [entry[kind] for entry in map(json.loads, path.read_text("utf-8").splitlines()) if kind in entry]


def types_of(client: Client) -> list[str]:
    found: list[str] = client.call("/slider/controller_manager/list_controller_types")["types"]
    return found


def test_a_journal_has_the_imports_of_its_own_world_only(tmp_path: Path) -> None:
    file = write(tmp_path / "one", 3.0)
    notes = journal(tmp_path / "one.journal"), journal(tmp_path / "two.journal")
    worlds = [world_of(host) for host in notes]
    with worlds[0].client() as client:
        load(client, file)
    for host in notes:
        host.close("the test is over")
    assert [name for name, *_ in entries(tmp_path / "one.journal", "module")] == ["helper_gain"]
    assert entries(tmp_path / "one.journal", "read")[-1] == f"code of {file}"
    assert entries(tmp_path / "two.journal", "module") == entries(tmp_path / "two.journal", "read") == []


def test_a_module_that_another_world_has_imported_is_in_the_journal_all_the_same(tmp_path: Path) -> None:
    file = write(tmp_path / "one", 3.0)
    notes = journal(tmp_path / "one.journal"), journal(tmp_path / "two.journal")
    for host in notes:
        with world_of(host).client() as client:
            load(client, file)
    for host in notes:
        host.close("the test is over")
    modules = entries(tmp_path / "one.journal", "module")
    assert modules == entries(tmp_path / "two.journal", "module")
    assert modules == [["helper_gain", str(file.parent / "helper_gain.py"), "GAIN = 3.0\n", False]]


@pytest.mark.parametrize(
    "update",
    [
        "self.joint.command = helper_gain.GAIN",
        "import helper_gain as again; self.joint.command = again.GAIN",  # late, while the other world is there
    ],
)
def test_each_world_has_its_own_module_of_a_name_though_they_run_in_turns(tmp_path: Path, update: str) -> None:
    worlds = {gain: world_of() for gain in (3.0, 5.0)}
    for gain, world in worlds.items():
        load(world.client(), write(tmp_path / str(gain), gain, update=update))
    for _ in range(3):
        for gain, world in worlds.items():
            world.client().call("/slidectl/step", {"cycles": 10})
            assert command(world) == gain


def test_the_types_of_a_module_are_listed_in_the_world_that_has_imported_it(tmp_path: Path) -> None:
    file = write(tmp_path / "one", 3.0, "\nimport helper_gain\nfrom slidectl.control import controller")
    text = file.read_text("utf-8").replace("class Push", '@controller("my_laws/Other")\nclass Push')
    file.write_text(text, "utf-8")
    with world_of(imports=(str(file),)).client() as one, world_of().client() as other:
        assert {"push/Push", "my_laws/Other"} <= set(types_of(one))
        assert not {"push/Push", "my_laws/Other"} & set(types_of(other))
        with pytest.raises(UnknownName):
            Simulation().types.find("push/Push")


def test_a_module_that_a_script_has_imported_itself_is_the_same_for_its_worlds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "laws_of_a_script.py").write_text(PUSH.format(more="", update="pass"), "utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    laws: Any = __import__("laws_of_a_script")
    for _ in range(2):
        simulation = Simulation(imports=["laws_of_a_script"])
        assert simulation.types.find("laws_of_a_script/Push") is laws.Push
    assert sys.modules["laws_of_a_script"] is laws


def test_the_limit_on_code_holds_in_each_world_and_ends_the_code_of_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(time_limit, "LIMIT_S", 0.3)
    endless = write(tmp_path / "endless", 3.0, update="while time_ns > 20_000_000: pass")
    sound = write(tmp_path / "sound", 5.0)
    worlds = [world_of(Host(TimeLimit())) for _ in range(3)]
    signal.signal(signal.SIGALRM, lambda *_: None)  # as other code of a process may use it
    clients = [world.client() for world in worlds]
    for client, file in zip(clients, (endless, sound, endless), strict=True):
        load(client, file)
    states = []
    for client in clients:
        client.call("/slidectl/step", {"cycles": 100})
        states += [one["state"] for one in client.call("/slider/controller_manager/list_controllers")["controller"]]
    assert states == ["aborted", "running", "aborted"]
    assert "ran longer than 0.3 s" in "\n".join(worlds[2].log)
    assert not worlds[1].simulation.types.code.cut_off
    for world in worlds:
        world.simulation.host.close("the end of the test")


class Absent(HostWrapper):
    """A host without a disk: files are not read and meshes are missing. Notes what was asked for."""

    def __init__(self, inner: Host) -> None:
        super().__init__(inner)
        self.asked: list[str] = []

    def read(self, what: str, look: Callable[[], Any]) -> Any:
        del look
        self.asked.append(what)
        return "", "there is no disk"

    def read_meshes(self, sources: Any) -> Pending:
        self.asked += [source.path for source in sources]
        return Pending()


def test_all_that_a_world_reads_goes_through_its_host(tmp_path: Path) -> None:
    host = Absent(Host())
    with world_of(host).client() as client:
        host.reports.append(lambda: {"instance": "of a test"})
        assert client.call("/slidectl/status")["instance"] == "of a test"
        request = {"robot": "slider", "name": "push", "file": "/push.py", "class_name": "Push"}
        with pytest.raises(Refused, match="there is no disk"):
            client.call("/slidectl/load_controller_file", request)
        with pytest.raises(Refused, match="there is no disk"):
            client.call("/slidectl/load", {"file": str(tmp_path / "a.snapshot")})
    assert host.asked == ["code of /push.py", f"snapshot {tmp_path / 'a.snapshot'}"]
    source = MeshSource("/a.stl", (1.0, 1.0, 1.0))
    assert not host.read_meshes([source]).done
