"""A journal replays to the same bits: whatever the clients did, whenever it was, and whatever ended the daemon."""

from __future__ import annotations

import json
import os
import random
import re
import resource
import signal
import subprocess
import sys
import threading
import time
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
from daemon_fixture import Runtime
from hypothesis import given, settings
from hypothesis import strategies as st

from slidectl import Client, description
from slidectl.control.user_modules import CodeLimit
from slidectl.daemon import time_limit
from slidectl.daemon.in_process import InProcessWorld
from slidectl.daemon.options import DaemonOptions
from slidectl.daemon.time_limit import TimeLimit
from slidectl.errors import BadFile, SlidectlError
from slidectl.extensions.journal import journal
from slidectl.extensions.journal.journal import Journal
from slidectl.extensions.journal.journal_replay import Replay, ReplayDiffers
from slidectl.extensions.recording.recording_files import opened
from slidectl.physics import rendering
from slidectl.simulation import Simulation
from slidectl.simulation.compiled import object_file
from slidectl.simulation.host import Host

ENGINES = ["plain", pytest.param("compiled", marks=pytest.mark.skipif(not object_file.is_possible(), reason="numba"))]
PIDS = {"p": 100.0, "i": 1.0, "d": 10.0, "i_clamp": 5.0}
CONTROLLERS: dict[str, dict[str, Any]] = {
    "slider": {"joint1_position_controller": {"joint": "joint1", "pid": PIDS}},
    "rrbot": {
        "arm": {"joints": ["joint1", "joint2"], "gains": {"joint1": PIDS, "joint2": PIDS}},
        "joint1_position_controller": {"joint": "joint1", "pid": PIDS},
    },
}
KINDS = {"arm": "effort_controllers/JointTrajectoryController"}


def spawn(client: Client, model: str) -> None:
    """A robot with its controllers loaded, and none started."""
    client.call("/gazebo/spawn_urdf_model", {"model_name": model, "model_xml": description.load(model).xml})
    for name, values in CONTROLLERS[model].items():
        settings = {"type": KINDS.get(name, "effort_controllers/JointPositionController"), **values}
        client.call("/rosapi/set_param", {"name": f"/{model}/{name}", "value": json.dumps(settings)})
        client.call(f"/{model}/controller_manager/load_controller", {"name": name})


def switch(client: Client, model: str, start: list[str], stop: list[str]) -> None:
    request = {"start_controllers": start, "stop_controllers": stop, "strictness": 1}
    client.call(f"/{model}/controller_manager/switch_controller", request)


@contextmanager
def recorded(
    path: Path, engine: str = "plain", imports: tuple[str, ...] = (), limit: CodeLimit | None = None
) -> Iterator[InProcessWorld]:
    """A world in this process whose journal ends with the block."""
    options = DaemonOptions(journal=str(path), engine=engine, paused=True, imports=imports)
    notes = Journal(options, Host(limit))
    try:
        simulation = Simulation(engine=engine, imports=imports, host=notes)
        if engine == "compiled":
            simulation.engine.complete()
        simulation.run.paused = True
        yield InProcessWorld(simulation)
    finally:
        notes.close("the test is over")


def fail(what: str) -> None:
    raise AssertionError(what)


def replayed(path: Path, until: float | None = None) -> Simulation:
    """The world at the end, all of whose states were those of the journal."""
    one = Replay(journal.read(str(path)), until)
    one.run(fail, check=True)
    return one.simulation


# --- random commands --------------------------------------------------------------------------------------------------

NUMBERS = st.floats(-1.5, 1.5, allow_nan=False)
ROBOTS = st.sampled_from(sorted(CONTROLLERS))
FAULTS: dict[str, tuple[str, dict[str, float]]] = {
    "sensor-noise": ("joint1", {"sd": 0.01}),
    "command-loss": ("joint1", {"probability": 0.5}),
    "joint-stuck": ("joint1", {}),
    "controller-slow": ("joint1_position_controller", {"takes": 0.02}),
    "topic-delay": ("joint1_position_controller/command", {"delay": 0.3}),
}
"""Kinds with a target below a robot, and options."""
NAMES = st.sampled_from(["arm", "joint1_position_controller"])
ACTIONS = st.one_of(
    st.tuples(st.just("spawn"), ROBOTS),
    st.tuples(st.just("delete"), ROBOTS),
    st.tuples(st.just("switch"), ROBOTS, NAMES, NAMES),
    st.tuples(st.just("set point"), ROBOTS, NUMBERS),
    st.tuples(st.just("later"), ROBOTS, NUMBERS, st.integers(0, 3000)),
    st.tuples(st.just("trajectory"), NUMBERS, NUMBERS),
    st.tuples(st.just("push"), ROBOTS, NUMBERS),
    st.tuples(st.just("place"), ROBOTS, NUMBERS),
    st.tuples(st.just("gain"), ROBOTS, st.floats(1.0, 200.0)),
    st.tuples(st.just("estop"), st.booleans()),
    st.tuples(st.just("fault"), ROBOTS, st.sampled_from(sorted(FAULTS)), st.floats(0.0, 0.5), st.floats(0.01, 2.0)),
    st.tuples(st.just("clear"), st.just(0)),
    st.tuples(st.just("save"), st.sampled_from("xy")),
    st.tuples(st.just("load"), st.sampled_from("xy")),
    st.tuples(st.just("reset"), st.sampled_from(["/gazebo/reset_world", "/gazebo/reset_simulation"])),
    st.tuples(st.just("run"), st.integers(1, 900)),
    st.tuples(st.just("go"), st.integers(1, 1200)),
    st.tuples(st.just("leave"), st.just(0)),
)


def act(world: InProcessWorld, client: Client, action: tuple[Any, ...]) -> None:
    """One command of a client. Many of them are refused, as in life."""
    kind, *values = action
    if kind == "spawn":
        spawn(client, values[0])
        switch(client, values[0], ["joint1_position_controller"], [])
    elif kind == "delete":
        client.call("/gazebo/delete_model", {"model_name": values[0]})
    elif kind == "switch":
        switch(client, values[0], [values[1]], [values[2]])
    elif kind == "set point":
        client.publish(f"/{values[0]}/joint1_position_controller/command", {"data": values[1]})
    elif kind == "later":
        at = world.simulation.time_ns + values[2] * 1_000_000
        client.publish_at(f"/{values[0]}/joint1_position_controller/command", {"data": values[1]}, at)
    elif kind == "trajectory":
        points = [{"positions": [value, -value], "time_from_start": {"secs": k + 1}} for k, value in enumerate(values)]
        client.publish("/rrbot/arm/command", {"joint_names": ["joint1", "joint2"], "points": points})
    elif kind == "push":
        request = {"joint_name": f"{values[0]}::joint1", "effort": 10 * values[1], "duration": {"nsecs": 300_000_000}}
        client.call("/gazebo/apply_joint_effort", request)
    elif kind == "place":
        request = {"model_name": values[0], "joint_names": ["joint1"], "joint_positions": [values[1] / 2]}
        client.call("/gazebo/set_model_configuration", request)
    elif kind == "gain":
        request = {"name": f"/{values[0]}/joint1_position_controller/pid/p", "value": str(values[1])}
        client.call("/rosapi/set_param", request)
    elif kind == "estop":
        client.call("/slidectl/estop", {"stop": values[0]})
    elif kind == "fault":
        (target, options), now = FAULTS[values[1]], world.simulation.time_ns / 1e9
        client.add_fault(f"{values[0]}/{target}", values[1], now + values[2], now + values[2] + values[3], **options)
    elif kind == "clear":
        client.remove_faults()
    elif kind == "save":
        client.save(values[0])
    elif kind == "load":
        client.load(values[0])
    elif kind == "reset":
        client.call(values[0])
    elif kind == "run":
        client.call("/slidectl/step", {"cycles": values[0]})
    elif kind == "go":
        client.call("/gazebo/unpause_physics")
        client.call("/slidectl/sleep", {"duration": values[0] * 1e-3})
        client.call("/gazebo/pause_physics")
    else:
        client.close()


@pytest.mark.parametrize("engine", ENGINES)
@settings(max_examples=12)
@given(actions=st.lists(st.tuples(st.integers(0, 2), ACTIONS), max_size=15))
def test_random_commands_of_three_clients_replay_to_the_same_bits(
    engine: str, actions: list[tuple[int, tuple[Any, ...]]], tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.mktemp("random") / "run.journal"
    refused = 0
    with recorded(path, engine) as world:
        clients: dict[int, Client] = {}
        for number, action in [(0, ("spawn", "slider")), (1, ("spawn", "rrbot")), *actions, (0, ("run", 700))]:
            client = clients.get(number) or clients.setdefault(number, world.client())
            try:
                act(world, client, action)
            except SlidectlError:
                refused += 1
            if action[0] == "leave":
                del clients[number]
    again = replayed(path)
    assert again.world.numbers() == world.simulation.world.numbers()
    assert (again.time_ns, again.cycles) == (world.simulation.time_ns, world.simulation.cycles)
    lists = [
        [simulation.call(f"/{robot.name}/controller_manager/list_controllers") for robot in simulation.robots]
        for simulation in (again, world.simulation)
    ]
    assert lists[0] == lists[1]
    assert again.faults.messages() == world.simulation.faults.messages()


# --- what is read of files --------------------------------------------------------------------------------------------

SPRING = """
from slidectl.control import Controller, EffortJointInterface

class Spring(Controller):
    interface_type = EffortJointInterface
    def init(self, interface, node):
        self.joint = interface.get_handle("joint1")
        return True
    def update(self, time_ns, period_s):
        self.joint.command = {stiffness} * (0.5 - self.joint.position) - 10.0 * self.joint.velocity
"""


@pytest.fixture(params=ENGINES)
def engine(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def load_spring(client: Client, file: Path, name: str = "spring") -> None:
    request = {"robot": "slider", "name": name, "file": str(file), "class_name": "Spring"}
    assert client.call("/slidectl/load_controller_file", request)["ok"]
    switch(client, "slider", [name], ["joint1_position_controller"])


def test_calls_that_only_read_are_not_in_the_journal_and_those_that_write_are(journal_file: Path) -> None:
    """A page or a script that looks all the time must not make the file grow."""
    with recorded(journal_file) as world, world.client() as client:
        spawn(client, "rrbot")
        reading = [
            name for name in client.call("/rosapi/services")["services"]
            if world.simulation.graph.services.effects_of(name) == ["reads"] and not name.endswith("/wait")
        ]  # fmt: skip
        assert {"/slidectl/graph", "/slidectl/joint_states", "/rosapi/topics"} <= set(reading)
        before = journal_file.stat().st_size
        for name in reading:
            with suppress(SlidectlError):  # some want a name
                client.call(name)
        assert journal_file.stat().st_size == before
        client.call("/gazebo/unpause_physics")
        assert journal_file.stat().st_size > before
    assert replayed(journal_file).robots.names() == ["rrbot"]


def test_controllers_of_users_are_as_they_were_when_they_were_read(tmp_path: Path, engine: str) -> None:
    imported, loaded = tmp_path / "imported.py", tmp_path / "loaded.py"
    imported.write_text(SPRING.format(stiffness=1.0), "utf-8")
    with recorded(tmp_path / "run.journal", engine, (str(imported),)) as world, world.client() as client:
        spawn(client, "slider")
        loaded.write_text(SPRING.format(stiffness=50.0), "utf-8")
        load_spring(client, loaded)
        client.call("/slidectl/step", {"cycles": 1500})
        loaded.write_text(SPRING.format(stiffness=90.0), "utf-8")
        client.call("/slidectl/reload_controller", {"robot": "slider", "name": "spring"})
        client.call("/slidectl/step", {"cycles": 1500})
        loaded.write_text("broken(", "utf-8")
        with pytest.raises(SlidectlError):
            client.call("/slidectl/reload_controller", {"robot": "slider", "name": "spring"})
        client.call("/slidectl/step", {"cycles": 100})
    for file in (imported, loaded):
        file.unlink()
    again = replayed(tmp_path / "run.journal")
    assert again.world.numbers() == world.simulation.world.numbers()
    assert again.cycles == 3100


def test_modules_that_code_of_users_imports_are_as_they_were(
    tmp_path: Path, runtime: Runtime, engine: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A module beside the file, a package, one without a file of its own, and one that is imported late."""
    monkeypatch.setattr(sys, "path", [*sys.path])
    files = {
        "spring_gains.py": "from spring_parts import middle\nSTIFFNESS = 10.0 * middle.FACTOR\n",
        "spring_parts/__init__.py": "",
        "spring_parts/middle.py": "from .deep import FACTOR\n",
        "spring_parts/deep.py": "FACTOR = 3.0\n",
        "spring_space/late.py": "DAMPING = 5.0\n",
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text, "utf-8")
    spring = tmp_path / "spring.py"
    late = "        import spring_space.late\n        self.damping = spring_space.late.DAMPING\n        return True"
    text = SPRING.format(stiffness="spring_gains.STIFFNESS").replace("        return True", late)
    text = text.replace("10.0 * self.joint.velocity", "self.damping * self.joint.velocity")
    spring.write_text(f"import sys\nsys.path.append({str(tmp_path)!r})\nimport spring_gains\n{text}", "utf-8")
    with recorded(tmp_path / "run.journal", engine, (str(spring),)) as world, world.client() as client:
        spawn(client, "slider")
        client.call("/rosapi/set_param", {"name": "/slider/spring/type", "value": '"spring/Spring"'})
        client.call("/slider/controller_manager/load_controller", {"name": "spring"})
        switch(client, "slider", ["spring"], ["joint1_position_controller"])
        client.call("/slidectl/step", {"cycles": 1500})
    assert world.simulation.world.joint_state("slider", "joint1")[0] > 0.1
    spring.unlink()
    for name in files:
        (tmp_path / name).unlink()
    (tmp_path / "spring_gains.py").write_text("STIFFNESS = 99.0\n", "utf-8")
    again = replayed(tmp_path / "run.journal")  # where they are imported already
    assert again.world.numbers() == world.simulation.world.numbers()
    assert command(runtime, "replay", str(tmp_path / "run.journal"), "--check").returncode == 0


def test_models_that_sdf_includes_may_be_gone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GAZEBO_MODEL_PATH", str(tmp_path))
    inner = tmp_path / "inner" / "model.sdf"
    inner.parent.mkdir()
    shape = "<collision name='c'><geometry><box><size>1 1 1</size></box></geometry></collision>"
    link = f"<link name='l'><inertial><mass>1</mass></inertial>{shape}</link>"
    inner.write_text(f"<sdf version='1.6'><model name='inner'>{link}</model></sdf>", "utf-8")
    with recorded(tmp_path / "run.journal") as world, world.client() as client:
        for name in ("nowhere", "inner"):
            xml = f"<sdf version='1.6'><include><uri>model://{name}</uri></include></sdf>"
            request = {"model_name": name, "model_xml": xml, "initial_pose": {"position": {"z": 2.0}}}
            assert client.call("/gazebo/spawn_sdf_model", request)["success"] == (name == "inner")
        client.call("/slidectl/step", {"cycles": 1500})
    inner.unlink()
    monkeypatch.delenv("GAZEBO_MODEL_PATH")
    again = replayed(tmp_path / "run.journal")
    assert again.world.numbers() == world.simulation.world.numbers()


def test_a_controller_that_was_ended_by_the_time_limit_is_ended_in_the_same_cycle(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(time_limit, "LIMIT_S", 0.3)
    file = tmp_path / "endless.py"
    endless = SPRING.format(stiffness=50.0) + "        while time_ns == 1_234_000_000:\n            pass\n"
    file.write_text(endless, "utf-8")
    with recorded(tmp_path / "run.journal", limit=TimeLimit()) as world, world.client() as client:
        spawn(client, "slider")
        load_spring(client, file)
        client.call("/slidectl/step", {"cycles": 3000})
        [_, spring] = client.call("/slider/controller_manager/list_controllers")["controller"]
    assert spring["state"] == "aborted"
    again = replayed(tmp_path / "run.journal")
    assert again.world.numbers() == world.simulation.world.numbers()


# --- a daemon ---------------------------------------------------------------------------------------------------------


def command(runtime: Runtime, *words: str) -> subprocess.CompletedProcess[str]:
    line = [sys.executable, "-m", "slidectl", *words]
    return subprocess.run(line, env=runtime.env, capture_output=True, text=True, check=False, timeout=300)


def answer(done: subprocess.CompletedProcess[str]) -> dict[str, Any]:
    """What a command printed with --json."""
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def play_about(runtime: Runtime, seed: int) -> None:
    """Set points at random wall times."""
    chance = random.Random(seed)
    with runtime.client() as client:
        for _ in range(25):
            client.publish("/slider/joint1_position_controller/command", {"data": chance.uniform(-0.9, 0.9)})
            client.flush()
            time.sleep(chance.uniform(0.0, 0.08))  # no condition is waited for: this is the randomness


@pytest.fixture
def journal_file(tmp_path: Path) -> Path:
    return tmp_path / "run.journal"


def test_two_clients_at_real_time_replay_to_the_same_bits_after_a_kill(runtime: Runtime, journal_file: Path) -> None:
    pid, _ = runtime.start(journal=str(journal_file))
    with runtime.client() as client:
        spawn(client, "slider")
        switch(client, "slider", ["joint1_position_controller"], [])
        others = [threading.Thread(target=play_about, args=(runtime, seed)) for seed in (1, 2)]
        for other in others:
            other.start()
        for other in others:
            other.join()
        client.call("/slidectl/sleep", {"duration": 1.1})
        assert client.call("/slidectl/status")["journal"] == str(journal_file)
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
    entries = journal.read(str(journal_file)).entries
    moments = {entry["cycle"] for entry in entries if b'"publish"' in entry.get("line", b"")}
    assert len(moments) > 20
    found = answer(command(runtime, "replay", str(journal_file), "--check", "--json"))
    assert found["states"] >= 2
    assert (found["entries"], found["whole"], found["differs"]) == (len(entries), True, "")


def test_meshes_that_are_gone_are_there_in_a_replay(runtime: Runtime, journal_file: Path, tmp_path: Path) -> None:
    mesh = tmp_path / "block.obj"
    mesh.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n", "utf-8")
    inertial = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    shape = f'<collision><geometry><mesh filename="file://{mesh}"/></geometry></collision>'
    xml = f'<robot name="m"><link name="base">{inertial}{shape}</link></robot>'
    runtime.start(journal=str(journal_file), rtf=5.0)
    with runtime.client() as client:
        pose = {"position": {"z": 0.5}, "orientation": {"x": 0.3, "w": 1.0}}
        client.call("/gazebo/spawn_urdf_model", {"model_name": "block", "model_xml": xml, "initial_pose": pose})
        mesh.unlink()
        client.call("/slidectl/sleep", {"duration": 2.0})
        client.call("/gazebo/pause_physics")
        [there] = client.call("/slidectl/list_robots")["robots"]
    runtime.stop()
    [here] = answer(command(runtime, "replay", str(journal_file), "--check", "--json"))["robots"]
    assert here["pose"] == there["pose"]
    assert abs(here["pose"][2] - 0.5) > 0.01


EYE = """<robot name="eye"><link name="base"><inertial><mass value="1"/>
  <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <gazebo reference="base"><sensor type="camera" name="eye"><update_rate>20</update_rate>
  <camera><image><width>32</width><height>24</height><format>R8G8B8</format></image>
  <noise><type>gaussian</type><stddev>0.05</stddev></noise></camera>
  <plugin name="c" filename="libgazebo_ros_camera.so"><cameraName>eye</cameraName></plugin></sensor></gazebo></robot>"""

LOOKING = "import zlib\n" + SPRING.format(stiffness="self.stiffness").replace(
    "        return True",
    "        self.stiffness = 10.0\n"
    "        node.subscribe('/eye/image_raw', 'sensor_msgs/Image', self.look)\n"
    "        return True\n"
    "    def look(self, image):\n"
    "        self.stiffness = 10.0 + zlib.crc32(image['data'].encode()) % 80",
)
"""Its stiffness follows from the last picture that came."""


@pytest.mark.skipif(not rendering.gl_backend(), reason="there is no OpenGL on this machine")
def test_code_of_users_that_looks_at_pictures_gets_them_in_the_same_cycles(
    runtime: Runtime, journal_file: Path, tmp_path: Path
) -> None:
    file = tmp_path / "looking.py"
    file.write_text(LOOKING, "utf-8")
    runtime.start(journal=str(journal_file))
    with runtime.client() as client, runtime.client() as viewer:
        client.call("/gazebo/spawn_urdf_model", {"model_name": "eye", "model_xml": EYE})
        spawn(client, "slider")
        pictures = viewer.subscribe("/eye/image_raw", "sensor_msgs/Image")
        pictures.get(timeout=60.0)
        load_spring(client, file)
        for _ in range(5):
            pictures.get(timeout=60.0)
        client.call("/slidectl/sleep", {"duration": 1.0})
    runtime.stop()
    found = answer(command(runtime, "replay", str(journal_file), "--check", "--json"))
    assert (found["differs"], found["whole"]) == ("", True)
    assert len([one for one in journal.read(str(journal_file)).entries if "picture" in one]) >= 6


def test_a_client_that_was_let_go_from_the_lockstep_is_let_go_again(runtime: Runtime, journal_file: Path) -> None:
    runtime.start(journal=str(journal_file), rtf=10.0)
    with runtime.client() as client, runtime.client() as other:
        spawn(client, "slider")
        switch(client, "slider", ["joint1_position_controller"], [])
        other.call("/slidectl/lockstep", {"period": 0.01, "timeout": 0.2})
        client.call("/slidectl/sleep", {"duration": 0.5})
        switch(client, "slider", [], ["joint1_position_controller"])
        switch(client, "slider", ["joint1_position_controller"], [])
        client.publish("/slider/joint1_position_controller/command", {"data": 0.5})
        client.call("/slidectl/sleep", {"duration": 2.0})
    runtime.stop()
    assert any("let_go" in entry for entry in journal.read(str(journal_file)).entries)
    assert answer(command(runtime, "replay", str(journal_file), "--check", "--json"))["states"] >= 3


def test_a_replay_is_recorded_without_a_change_of_its_bits(
    runtime: Runtime, journal_file: Path, tmp_path: Path
) -> None:
    runtime.start(journal=str(journal_file), paused=True)
    with runtime.client() as client:
        for kind in ("std_msgs/Float64", "std_msgs/String"):  # a topic that comes again as another one
            with client.another() as other:
                other.advertise("/mine", kind, latch=True)
                other.publish("/mine", {"data": 1.5 if kind.endswith("64") else "text"})
                other.flush()
        spawn(client, "slider")
        client.publish("/slider/joint1_position_controller/command", {"data": 0.5})
        switch(client, "slider", ["joint1_position_controller"], [])
        client.step(seconds=1.0)
        client.save("there")
        client.step(seconds=0.5)
        client.load("there")
        client.step(seconds=1.0)
    runtime.stop()
    whole, end = tmp_path / "run.bag", tmp_path / "end.mcap"
    words = ("replay", str(journal_file), "--check", "--json", "--record")
    found = answer(command(runtime, *words, str(whole)))
    with opened(whole) as recording:
        summary = recording.summary()
        channels = {channel.topic for channel in recording.channels}
    assert found["messages"] == summary.counts.total()
    assert summary.end_ns == 2_000_000_000
    assert summary.counts["/slider/joint1_position_controller/command"] == 1
    assert summary.counts["/slider/joint1_position_controller/state"] >= 240  # at 100 Hz
    assert not channels & {"/clock", "/gazebo/link_states"}
    assert answer(command(runtime, *words, str(end), "--last", "0.25"))["states"] == found["states"]
    with opened(end) as recording:
        assert recording.summary().counts["/slider/joint1_position_controller/state"] in (25, 26)
    again = command(runtime, "replay", str(journal_file), "--record", str(end))
    assert (again.returncode, again.stderr.split(",")[0].splitlines()[0]) == (1, f"error: {end} already exists")


def test_the_last_seconds_before_a_time_are_recorded_though_the_clock_was_set_back(
    runtime: Runtime, journal_file: Path, tmp_path: Path
) -> None:
    runtime.start(journal=str(journal_file), paused=True)
    with runtime.client() as client:
        spawn(client, "slider")
        switch(client, "slider", ["joint_state_controller"], [])
        client.step(seconds=2.2)
        client.call("/gazebo/reset_simulation")
        client.step(seconds=3.0)
    runtime.stop()
    for number, (words, begin_s, end_s) in enumerate(
        (
            (("--last", "0.5", "--to", "1.9"), 1.4, 1.9),
            (("--last", "0.5", "--to", "2.9"), 2.4, 2.9),
            (("--last", "2.9"), 0.0, 3.0),  # from 2.3 s on, which there is not in the first run of the clock
        )
    ):
        file = tmp_path / f"{number}.bag"
        answer(command(runtime, "replay", str(journal_file), "--json", "--record", str(file), *words))
        with opened(file) as recording:
            summary = recording.summary()
        assert (summary.begin_ns * 1e-9, summary.end_ns * 1e-9) == pytest.approx((begin_s, end_s), abs=0.03)


def test_a_replay_ends_at_a_time_and_may_stay_in_a_daemon(runtime: Runtime, journal_file: Path) -> None:
    runtime.start(journal=str(journal_file), paused=True)
    with runtime.client() as client:
        spawn(client, "slider")
        switch(client, "slider", ["joint1_position_controller"], [])
        positions = []
        for value in (0.5, -0.5):
            client.publish("/slider/joint1_position_controller/command", {"data": value})
            client.call("/slidectl/step", {"cycles": 1000})
            positions.append(client.call("/gazebo/get_joint_properties", {"joint_name": "joint1"})["position"])
    runtime.stop()
    found = answer(command(runtime, "replay", str(journal_file), "--to", "1", "--json"))
    [joint] = [joint for joint in found["robots"][0]["joints"] if joint["name"] == "joint1"]
    assert (found["time"], [joint["position"]]) == (1.0, positions[0])
    refused = command(runtime, "replay", str(journal_file), "--to", "2.5")
    assert (refused.returncode, refused.stderr) == (1, "error: the journal ends at 2 s, before 2.5 s\n")
    kept = answer(command(runtime, "replay", str(journal_file), "--to", "1.0", "--keep", "--json"))
    assert (kept["time"], kept["pid"]) == (1.0, runtime.pid)
    with runtime.client() as client:
        assert client.call("/slidectl/status")["paused"]
        # What was commanded at this time counts: the world goes on as it went on then.
        client.call("/slidectl/step", {"cycles": 1000})
        assert client.call("/gazebo/get_joint_properties", {"joint_name": "joint1"})["position"] == positions[1]
    runtime.stop()


def test_a_full_disk_ends_the_journal_and_nothing_else(runtime: Runtime, journal_file: Path) -> None:
    pid, _ = runtime.start(journal=str(journal_file), paused=True)
    with runtime.client() as client:
        spawn(client, "slider")
        switch(client, "slider", ["joint1_position_controller"], [])
        full = journal_file.stat().st_size + 3000
        resource.prlimit(pid, resource.RLIMIT_FSIZE, (full, full))
        for _ in range(50):
            client.publish("/slider/joint1_position_controller/command", {"data": 0.5})
            client.call("/slidectl/step", {"cycles": 100})
        status = client.call("/slidectl/status")
    assert (status["journal_trouble"], status["cycles"]) == ("File too large", 5000)
    assert "the journal" in command(runtime, "daemon", "status").stdout.replace("journal:", "the journal")
    assert f"the journal {journal_file} ends at cycle" in runtime.log
    runtime.stop()
    found = answer(command(runtime, "replay", str(journal_file), "--check", "--json"))
    assert found["whole"]
    assert 100 < found["cycles"] < 5000


def test_a_file_that_is_there_is_not_written_over(runtime: Runtime, journal_file: Path) -> None:
    journal_file.write_text("precious", "utf-8")
    refused = command(runtime, "daemon", "start", "--journal", str(journal_file))
    assert (refused.returncode, journal_file.read_text("utf-8")) == (1, "precious")
    assert refused.stderr.splitlines() == [
        f"error: the file {journal_file} already exists",
        "give the journal another name, or remove that file",
    ]
    runtime.start()
    assert command(runtime, "daemon", "restart", "--journal", str(journal_file)).returncode == 1
    assert runtime.pid is not None
    runtime.stop()


def test_a_scenario_that_failed_leaves_a_journal(runtime: Runtime, tmp_path: Path) -> None:
    lines = (
        "steps:",
        "- spawn: slider --controllers config/slider_control.yaml --start joint_state_controller",
        "- wait: joint_states/position[0] --near 0.9 --within 2",
    )
    (tmp_path / "far.yaml").write_text("\n".join(lines), "utf-8")
    failed = command(runtime, "test", str(tmp_path / "far.yaml"), "--keep-failed", str(tmp_path / "failed"))
    assert failed.returncode == 1
    [file] = (tmp_path / "failed").glob("*.journal")
    assert answer(command(runtime, "replay", str(file), "--check", "--json"))["time"] >= 1.5


# --- journals that are none -------------------------------------------------------------------------------------------


@pytest.fixture
def short(journal_file: Path) -> Path:
    """A journal of some seconds of the slider."""
    with recorded(journal_file) as world, world.client() as client:
        spawn(client, "slider")
        switch(client, "slider", ["joint1_position_controller"], [])
        client.publish("/slider/joint1_position_controller/command", {"data": 0.5})
        for _ in range(4):
            client.call("/slidectl/step", {"cycles": 1000})
    return journal_file


def sealed(entry: dict[str, Any]) -> bytes:
    """An entry with its checksum."""
    body = json.dumps(entry, separators=(",", ":"))[:-1].encode()
    return b'%b,"crc":"%08x"}' % (body, zlib.crc32(body))


SPOILT: dict[str, tuple[Callable[[bytes], bytes], str]] = {
    "empty": (lambda _: b"", "it is empty: the daemon ended before it wrote anything"),
    "another file": (
        lambda _: b"<robot/>\n",
        "not a journal of slidectl\none is written by: slidectl daemon start",
    ),
    "a binary file": (lambda _: bytes(range(256)) * 50, "it is not a journal of slidectl"),
    "a bit of the first line": (lambda text: text[:80], "it is cut off in its first line"),
    "of a later version": (
        lambda text: sealed({"slidectl_journal": 2, "version": "9.1"}) + text[text.index(b"\n") :],
        "it is of format 2, written by slidectl 9.1; this is",
    ),
    "with other options": (
        lambda _: sealed({"slidectl_journal": 1, "version": "9.1", "options": {"wind": 3}}) + b"\n",
        "slidectl 9.1 wrote it with options that",
    ),
    "damaged": (
        lambda text: text.replace(b'"data":0.5', b'"data":0.6'),
        ":{line}: this entry is damaged: checksum mismatch\nthe entries before it can be replayed: head -n ",
    ),
}


@pytest.mark.parametrize("how", SPOILT)
def test_what_is_no_journal_is_refused_with_the_reason(short: Path, runtime: Runtime, how: str) -> None:
    spoil, said = SPOILT[how]
    content = short.read_bytes()
    line = content[: content.index(b'"data":0.5')].count(b"\n") + 1
    short.write_bytes(spoil(content))
    refused = command(runtime, "replay", str(short))
    assert refused.returncode == 2
    assert refused.stderr.startswith(f"error: {short}")
    assert said.format(line=line) in refused.stderr


NO_CYCLE = "'cycle' is not the number of a cycle"
STRANGE: dict[str, tuple[dict[str, Any] | bytes, str]] = {
    "no cycle": ({"gone": 1}, NO_CYCLE),
    "a cycle in floats": ({"cycle": 1e308, "limit": ""}, NO_CYCLE),
    "a cycle before the first": ({"cycle": -1, "limit": ""}, NO_CYCLE),
    "a cycle beyond all time": ({"cycle": 2**70, "limit": ""}, NO_CYCLE),
    "a line beyond all time": (b'{"cycle":99999999999999999999,"client":1,"line":{}', NO_CYCLE),
    "a cycle in the past": ({"cycle": 1, "state": ""}, "in cycle 1: the world is already at cycle 4000"),
    "a cycle in years": ({"cycle": 10**12, "state": ""}, "its cycle 1000000000000 is more than 2 s after the cycle"),
    "an unknown record": ({"cycle": 4000, "wind": 3}, "the world did not ask for the next entry of the journal"),
    "a client by name": ({"cycle": 4000, "client": "me", "node": "/me"}, "invalid entry: TypeError"),
    "a client twice": ({"cycle": 4000, "client": 1, "node": "/me"}, "there was a client 1 before"),
    "a client that is not there": ({"cycle": 4000, "gone": 77}, "in cycle 4000: there is no client 77"),
    "a state of words": ({"cycle": 4000, "state": "not base64!"}, "invalid entry: Error"),
    "a module of numbers": ({"cycle": 1, "module": [1, 2, 3]}, "invalid entry: "),
    "meshes of numbers": ({"cycle": 4000, "meshes": [1]}, "invalid entry: TypeError"),
    "a hull of another name": (
        {"cycle": 4000, "meshes": [{"path": "a", "scale": [1, 1, 1], "name": "a.stl", "hull": "eJwDAAAAAAE="}]},
        "the hull of a is cut off",
    ),
    "only a cycle": ({"cycle": 4000}, "the world did not ask for the next entry of the journal"),
    "a client without a node": ({"cycle": 4000, "client": 9}, "invalid entry: KeyError('node')"),
    "a node without a name": ({"cycle": 4000, "client": 9, "node": "not//legal"}, "is not the name of a node"),
    "a node that is a number": ({"cycle": 4000, "client": 9, "node": 5}, "invalid entry: TypeError"),
    "a read of something else": ({"cycle": 4000, "read": "the mind", "found": 1}, "the world did not ask for"),
    "meshes that are a number": ({"cycle": 4000, "meshes": 5}, "invalid entry: TypeError"),
    "a hull of words": (
        {"cycle": 4000, "meshes": [{"path": "a", "scale": [1, 1, 1], "name": "a.stl", "hull": "?"}]},
        "the hull of a is cut off",
    ),
    "a picture": ({"cycle": 4000, "picture": None}, "no camera waits for a picture now"),
    "nested without end": (b'{"cycle":1,"limit":' + b"[" * 200_000, "invalid entry: maximum recursion depth"),
    "no JSON": (b'{"cycle":1,"limit":', "invalid entry: Expecting value"),
}


@pytest.mark.parametrize("how", STRANGE)
def test_an_entry_with_its_checksum_that_no_daemon_writes_is_refused_with_its_line(short: Path, how: str) -> None:
    entry, said = STRANGE[how]
    content = short.read_bytes()
    end = content.rindex(b'{"cycle":4000')
    line = content[:end].count(b"\n") + 1
    body = sealed(entry) if isinstance(entry, dict) else b'%b,"crc":"%08x"}' % (entry, zlib.crc32(entry))
    short.write_bytes(content[:end] + body + b"\n" + content[end:])
    with pytest.raises((BadFile, ReplayDiffers)) as refused:
        replayed(short)
    assert str(refused.value).startswith(f"{short}:{line}: ")
    assert said in str(refused.value)


def test_the_command_says_file_line_and_what_is_wrong_with_an_entry(short: Path, runtime: Runtime) -> None:
    content = short.read_bytes()
    short.write_bytes(content + sealed({"cycle": 1e308, "gone": 1}) + b"\n")
    refused = command(runtime, "replay", str(short))
    place = f"{short}:{content.count(b'}' + bytes([10])) + 1}"
    assert (refused.returncode, refused.stdout) == (2, "")
    assert refused.stderr == (f"error: {place}: invalid entry: 'cycle' is not the number of a cycle\n")


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("timestep", "x"),
        ("timestep", 10**400),
        ("gravity", [1, 2]),
        ("gravity", 5),
        ("imports", 5),
        ("imports", [5]),
        ("chosen", "all"),
        ("engine", []),
        ("paused", "yes"),
        ("rtf", None),
        ("wind", 3),
        ("journal", "/tmp/other"),
    ],
)
def test_odd_options_of_the_world_are_refused_in_the_first_line(short: Path, name: str, value: Any) -> None:
    first, _, rest = short.read_bytes().partition(b"\n")
    header = json.loads(first)
    del header["crc"]
    header["options"][name] = value
    short.write_bytes(sealed(header) + b"\n" + rest)
    unknown = "wrote it with options that .* does not know"
    said = f"{unknown}: {name}" if name in ("wind", "journal") else f"its options are not valid: .*{name[-4:]}"
    with pytest.raises(BadFile, match=f":1: .*{said}"):
        journal.read(str(short))


def test_modules_of_a_journal_replace_none_that_this_process_runs_on(short: Path) -> None:
    lines = short.read_bytes().splitlines(keepends=True)
    before = dict(sys.modules)
    named = ("os", "json", "numpy", "slidectl.errors", "sys", "mujoco")
    entries = [sealed({"cycle": 0, "module": [name, "/x.py", "1/0", False]}) + b"\n" for name in named]
    short.write_bytes(b"".join([lines[0], *entries, *lines[1:]]))
    assert replayed(short).cycles == 4000
    assert [name for name in named if sys.modules.get(name) is not before[name]] == []


def test_a_journal_without_its_end_is_replayed_as_far_as_it_goes(short: Path, runtime: Runtime) -> None:
    content = short.read_bytes()
    short.write_bytes(content[: content.index(b'{"cycle":3000,"state"') + 40])
    done = command(runtime, "replay", str(short), "--check", "--json")
    found = answer(done)
    assert (found["cycles"], found["whole"], found["states"]) == (2000, False, 2)
    assert "its end is missing" in done.stderr


def test_a_check_says_the_first_second_and_the_joint_that_differ(short: Path, runtime: Runtime) -> None:
    lines = short.read_bytes().splitlines()
    [at] = [at for at, line in enumerate(lines) if b'"data":0.5' in line]
    entry = json.loads(lines[at])
    entry["line"]["msg"]["data"] = 0.25
    lines[at] = sealed({key: entry[key] for key in ("cycle", "client", "line")})
    short.write_bytes(b"\n".join(lines) + b"\n")
    refused = command(runtime, "replay", str(short), "--check")
    assert refused.returncode == 1
    where = r"error: the state differs at 1 s \(cycle 1000\): slider, joint1: "
    said = re.match(rf"{where}position is (\S+) now and (\S+) in the journal, and ", refused.stderr)
    assert said is not None
    assert float(said[1]) != float(said[2])
    lenient = command(runtime, "replay", str(short), "--json")
    assert "the state differs at 1 s" in lenient.stderr
    assert answer(lenient)["cycles"] == 4000


def test_code_of_users_that_draws_random_numbers_is_found(tmp_path: Path, journal_file: Path) -> None:
    file = tmp_path / "spring.py"
    text = SPRING.replace("from slidectl", "import random\nfrom slidectl").replace(
        "{stiffness}", "random.uniform(1, 90)"
    )
    file.write_text(text, "utf-8")
    with recorded(journal_file) as world, world.client() as client:
        spawn(client, "slider")
        load_spring(client, file)
        client.call("/slidectl/step", {"cycles": 1000})
    with pytest.raises(ReplayDiffers, match=r"at 1 s .*slider, joint1: position.*\n.*random numbers"):
        replayed(journal_file)


def test_what_a_uri_was_read_as_is_in_the_journal(tmp_path: Path, journal_file: Path) -> None:
    """A file whose mesh is looked up too."""
    import trimesh  # heavy

    trimesh.creation.cone(0.3, 1.0).export(tmp_path / "cone.stl")
    file = tmp_path / "cone.urdf"
    inertial = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    collision = '<collision><geometry><mesh filename="cone.stl"/></geometry></collision>'
    file.write_text(f'<robot name="cone"><link name="l">{inertial}{collision}</link></robot>', "utf-8")
    asked = {
        "entity_resource": {"uri": file.as_uri()},
        "allow_renaming": True,
        "initial_pose": {"pose": {"position": {"z": 2.0}}},
    }
    with recorded(journal_file) as world, world.client() as client:
        for name in ("cone", "cone_1"):
            assert client.call("/slidectl/spawn_entity", asked)["entity_name"] == name
        client.call("/slidectl/step_simulation", {"steps": 1500})
    file.unlink()
    (tmp_path / "cone.stl").unlink()
    again = replayed(journal_file)
    assert again.robots.names() == ["cone", "cone_1"]
    assert again.world.numbers() == world.simulation.world.numbers()
