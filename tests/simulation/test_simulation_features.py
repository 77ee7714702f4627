"""Features: which ones a simulation has, their hooks, their state, and those of installed packages."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from pip_installed import install
from sim_robots import cart, running_cart, state

from slidectl import Simulation
from slidectl.control.node_handle import Message
from slidectl.errors import Refused, SlidectlError
from slidectl.features.faults import Faults
from slidectl.features.snapshots import restore
from slidectl.simulation import Feature, SpawnedRobot
from slidectl.simulation.compiled import object_file
from slidectl.simulation.cycle import CycleFailed, Stages
from slidectl.simulation.feature import OWN, FeatureNameTaken, NotAFeature, UnknownFeature

EXAMPLE = Path(__file__).parent.parent.parent / "examples" / "spawn_counter"
ENGINES = ["plain", *(["compiled"] if object_file.is_possible() else [])]


class Ticking(Feature):
    """Counts calls of a timer, the third of which fails."""

    def attach(self, _: Simulation) -> None:
        self.ticks = 0
        self.node.call_every(10_000_000, self.tick)

    def tick(self) -> None:
        self.ticks += 1
        if self.ticks == 3:
            raise ValueError("the third")


def test_an_error_in_a_timer_of_a_feature_is_in_the_log_and_the_world_goes_on() -> None:
    simulation = Simulation(features=[Ticking])
    simulation.step(100)
    assert simulation.feature(Ticking).ticks == 10
    [line] = [line for line in simulation.host.lines if "ValueError" in line]
    assert line.startswith("error [0.030] /slidectl: /slidectl/Ticking: ValueError: the third (")


class Diary(Feature):
    """Notes which of its hooks were called."""

    name = "diary"

    def attach(self, simulation: Simulation) -> None:
        self.simulation = simulation
        self.lines: list[Any] = []
        self.node.advertise_service("read", "std_srvs/Trigger", self.read)

    def read(self, _: Message) -> Message:
        return {"success": True, "message": " ".join(map(str, self.lines))}

    def on_spawn(self, robot: SpawnedRobot) -> None:
        self.lines.append(f"+{robot.name}")

    def on_delete(self, robot: SpawnedRobot) -> None:
        self.lines.append(f"-{robot.name}")

    def reset(self) -> None:
        self.lines.append("reset")

    def save_state(self) -> Any:
        return {"lines": list(self.lines)}

    def load_state(self, state: Any) -> None:
        self.lines = state["lines"]


# -- which ones --------------------------------------------------------------------------------------------------------


def test_a_simulation_has_all_features_by_default_and_they_are_attributes_of_it() -> None:
    simulation = Simulation()
    assert [feature.name for feature in simulation.features][: len(OWN)] == list(OWN)
    assert simulation.faults is simulation.feature(Faults) is simulation.features["faults"]
    with pytest.raises(AttributeError, match="no feature of that name"):
        _ = simulation.fault


def test_chosen_features_alone_are_there() -> None:
    simulation = Simulation(features=["services", Diary])
    simulation.spawn(cart(), "cart")
    simulation.step(10)
    simulation.reset_world()
    assert simulation.call("/slidectl/diary/read")["message"] == "+cart reset"
    assert simulation.call("/slidectl/status")["robots"] == ["cart"]
    services = simulation.graph.services.names()
    assert not [
        name for name in services if name.startswith(("/gazebo", "/rosapi", "/slidectl/fault", "/slidectl/save"))
    ]
    with pytest.raises(UnknownFeature, match="no feature 'snapshots'"):
        simulation.save("here")


def test_a_feature_that_does_not_exist_is_refused_with_those_that_do() -> None:
    with pytest.raises(UnknownFeature, match=r"no feature 'fault'.*faults"):
        Simulation(features=["fault"])
    with pytest.raises(NotAFeature, match="int is not derived from"):
        Simulation(features=[int])  # type: ignore[list-item]
    with pytest.raises(FeatureNameTaken):
        Simulation(features=[Diary, Diary])


def test_without_the_feature_for_them_a_controller_with_an_action_is_refused() -> None:
    simulation = Simulation(features=["services"])
    simulation.spawn(cart(), "cart")
    with pytest.raises(Refused, match="no feature 'actions'"):
        simulation.robots.get("cart").node.advertise_action("go", "control_msgs/JointTrajectory", print, print)


def test_features_do_not_change_the_bits_of_a_robot() -> None:
    states = []
    for simulation in (Simulation(), Simulation(features=[])):
        simulation.spawn(cart(), "cart")
        simulation.robots.set_joints("cart", ["joint1"], [0.3])
        simulation.step(500)
        states.append(state(simulation))
    assert states[0] == states[1]


# -- hooks -------------------------------------------------------------------------------------------------------------


def test_a_feature_hears_of_robots_and_of_resets() -> None:
    simulation = Simulation(features=[Diary])
    simulation.spawn(cart(), "a")
    simulation.spawn(cart(), "b", "/b")
    simulation.reset_simulation()
    simulation.delete("a")
    assert simulation.diary.lines == ["+a", "+b", "reset", "-a"]


def test_an_error_at_a_spawn_refuses_it_and_nothing_is_left() -> None:
    class Picky(Feature):
        name = "picky"

        def on_spawn(self, robot: SpawnedRobot) -> None:
            raise ValueError(f"not {robot.name}")

    simulation = Simulation(features=[Diary, Picky])
    with pytest.raises(Refused, match=r"on_spawn of the feature picky: ValueError: not cart \(.*test_simulation_feat"):
        simulation.spawn(cart(), "cart")
    assert simulation.diary.lines == ["+cart", "-cart"]
    assert simulation.robots.names() == []


def test_a_reset_that_fails_in_one_feature_is_complete_all_the_same() -> None:
    class Stubborn(Feature):
        name = "stubborn"

        def reset(self) -> None:
            raise ValueError("not now")

    simulation = Simulation(features=[Stubborn, Diary])
    simulation.spawn(cart(), "cart")
    start = state(simulation)
    simulation.step(300)
    with pytest.raises(Refused, match="reset of the feature stubborn: ValueError: not now"):
        simulation.reset_world()
    assert simulation.diary.lines == ["+cart", "reset"]
    assert state(simulation)[0] == start[0]


class Cycles(Feature):
    """Notes the times of cycles, and where the joint is before and after each."""

    name = "cycles"

    def attach(self, simulation: Simulation) -> None:
        self.simulation = simulation
        self.seen: list[tuple[str, int, float]] = []
        self.fails_ns = -1

    def note(self, when: str, time_ns: int) -> None:
        self.seen.append((when, time_ns, state(self.simulation)[0]))

    def before_cycle(self, time_ns: int) -> None:
        if time_ns == self.fails_ns:
            raise ValueError("no more")
        self.note("before", time_ns)

    def after_cycle(self, time_ns: int) -> None:
        self.note("after", time_ns)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_feature_is_called_before_and_after_each_cycle(engine: str) -> None:
    simulation = running_cart(engine=engine)
    cycles = simulation.features.attach(Cycles, "cycles")
    alone = running_cart(engine=engine)
    begun_ns = simulation.time_ns
    for one in (simulation, alone):
        if engine == "compiled":
            one.engine.complete()
        one.publish("/cart/position1/command", {"data": 0.5})
        one.step(40)
    assert [(when, time_ns) for when, time_ns, _ in cycles.seen] == [
        (when, begun_ns + number * 1_000_000) for number in range(1, 41) for when in ("before", "after")
    ]
    assert all(later[2] == earlier[2] for later, earlier in zip(cycles.seen[2::2], cycles.seen[1::2], strict=False))
    assert state(simulation) == state(alone)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_hook_that_fails_in_a_cycle_holds_the_world_until_it_goes_on(engine: str) -> None:
    simulation = running_cart(engine=engine)
    cycles = simulation.features.attach(Cycles, "cycles")
    cycles.fails_ns = simulation.time_ns + 5_000_000
    with pytest.raises(CycleFailed, match="before_cycle of the feature cycles: ValueError: no more"):
        simulation.step(40)
    assert "no more" in simulation.run.trouble
    simulation.resume()
    assert simulation.step(40) == 40


def test_two_features_that_change_the_messages_of_one_topic_both_do() -> None:
    simulation = running_cart()
    topics, heard = simulation.graph.topics, []

    def doubled(message: Message) -> None:
        topics.hand_on("/number", {"data": 2 * message["data"]}, doubled)

    def one_more(message: Message) -> None:
        topics.hand_on("/number", {"data": 1 + message["data"]}, one_more)

    simulation.publish("/number", {"data": 0}, "std_msgs/Int32")
    simulation.subscribe("/number", lambda message: heard.append(message["data"]))
    for interceptor, begins in ((doubled, True), (one_more, True), (doubled, False), (one_more, False)):
        topics.intercept("/number", interceptor, begins)
        simulation.publish("/number", {"data": 10})
    assert heard == [20, 21, 11, 10]


def test_faults_and_another_feature_change_the_cycle_of_one_robot_together() -> None:
    reads: list[int] = []

    def counting(own: Stages) -> Stages:
        def read(time_ns: int, period_s: float) -> None:
            reads.append(time_ns)
            own.read(time_ns, period_s)

        return own._replace(read=read)

    simulation = running_cart()
    cycle = simulation.robots.get("cart").cycle
    cycle.intercept("counter", counting)
    simulation.faults.add("joint1", "sensor-bias", bias=1.0)
    simulation.step(10)
    bias = simulation.robots.get("cart").hardware.handles("joint1")[0].position - state(simulation)[0]
    assert bias == pytest.approx(1.0, abs=0.01)
    simulation.faults.remove()
    simulation.step(10)
    cycle.intercept("counter", None)
    simulation.step(10)
    assert len(reads) == 20
    assert not cycle.is_intercepted


# -- state -------------------------------------------------------------------------------------------------------------


class Tally(Feature):
    """Declares which attributes are saved of it."""

    name = "tally"
    saved_attributes = ("count", "names")

    def attach(self, simulation: Simulation) -> None:
        self.simulation = simulation
        self.count, self.names, self.other = 0, ["none"], 0


def test_the_state_of_features_is_in_snapshots_and_in_their_files(tmp_path: Path) -> None:
    simulation = Simulation(features=["services", "snapshots", Diary, Tally])
    simulation.spawn(cart(), "cart")
    simulation.tally.count, simulation.tally.names, simulation.tally.other = 7, ["one", "two"], 1
    file = str(tmp_path / "here.snapshot")
    simulation.call("/slidectl/save", {"name": "here", "file": file})
    simulation.spawn(cart(), "second", "/second")
    simulation.tally.count, simulation.tally.other = 8, 2
    simulation.tally.names.append("three")
    simulation.load("here")
    assert simulation.diary.lines == ["+cart"]
    assert (simulation.tally.count, simulation.tally.names, simulation.tally.other) == (7, ["one", "two"], 2)

    another = Simulation(features=["snapshots", Tally, Diary])
    another.call("/slidectl/load", {"file": file})
    assert another.diary.lines == ["+cart"]
    assert (another.tally.count, another.tally.names) == (7, ["one", "two"])


def test_a_snapshot_from_before_a_feature_was_there_lets_it_begin_anew(tmp_path: Path) -> None:
    file = str(tmp_path / "old.snapshot")
    old = Simulation(features=["snapshots", "faults"])
    old.spawn(cart(), "cart")
    old.faults.add("joint1", "sensor-noise", sd=0.1)
    old.call("/slidectl/save", {"name": "old", "file": file})
    new = Simulation(features=["snapshots", "faults", Diary])
    new.call("/slidectl/load", {"file": file})
    assert new.diary.lines == ["reset", "+cart"]
    assert new.faults.messages() == old.faults.messages()


def test_a_file_from_before_there_were_features_is_read(tmp_path: Path) -> None:
    file = tmp_path / "old.snapshot"
    old = Simulation()
    old.spawn(cart(), "cart")
    old.faults.add("joint1", "sensor-noise", sd=0.1, seed=3)
    old.faults.add("joint1", "joint-stuck", 0.1)
    old.step(50)
    old.call("/slidectl/save", {"name": "old", "file": str(file)})
    magic, about, content = file.read_bytes().split(b"\n", 2)
    values = json.loads(zlib.decompress(content))
    values["faults"] = values.pop("parts")["faults"]
    assert values.pop("features") == ["faults"]
    content = zlib.compress(json.dumps(values).encode())
    told = {**json.loads(about), "size": len(content), "sha256": hashlib.sha256(content).hexdigest()}
    file.write_bytes(b"\n".join([magic, json.dumps(told).encode(), content]))

    new = Simulation()
    new.call("/slidectl/load", {"file": str(file)})
    for simulation in (old, new):
        simulation.step(100)
    assert new.faults.messages() == old.faults.messages()
    assert state(new) == state(old)


def test_a_fault_of_a_file_that_no_client_can_add_is_refused_and_nothing_has_changed() -> None:
    simulation = Simulation()
    simulation.spawn(cart(), "cart")
    simulation.faults.add("joint1", "sensor-noise", sd=0.1)
    simulation.save("here")
    before = simulation.faults.messages()
    [noise] = simulation.snapshots.get("here").parts["faults"]
    for wrong in (noise._replace(seed=1.5), noise._replace(name="no name"), noise._replace(options={"sd": "much"})):
        changed = replace(simulation.snapshots.get("here"), parts={"faults": [wrong]}, is_from_file=True)
        with pytest.raises(SlidectlError):
            restore(simulation, changed)
        assert simulation.faults.messages() == before


def test_a_snapshot_with_the_state_of_a_feature_that_is_not_there_is_refused(tmp_path: Path) -> None:
    file = str(tmp_path / "more.snapshot")
    Simulation(features=["snapshots", Diary]).call("/slidectl/save", {"name": "more", "file": file})
    fewer = Simulation(features=["snapshots", "faults"])
    with pytest.raises(UnknownFeature, match="no feature 'diary'"):
        fewer.call("/slidectl/load", {"file": file})


# -- installed packages ------------------------------------------------------------------------------------------------


def run(code: str, *folders: Path) -> Any:
    """What a program prints as JSON, with the packages in these folders installed."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, folders))}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.process
def test_an_installed_feature_has_a_topic_and_a_service_counts_is_saved_and_reset(tmp_path: Path) -> None:
    install(EXAMPLE, tmp_path / "site")
    code = """
import json
from slidectl import Simulation, description

simulation = Simulation()
heard = []
simulation.subscribe("/slidectl/spawn_counter/count", lambda message: heard.append(message["data"]))
for name in ("a", "b"):
    simulation.spawn(description.load("slider").xml, name, f"/{name}")
simulation.save("two")
simulation.spawn(description.load("slider").xml, "c", "/c")
simulation.load("two")
loaded = simulation.spawn_counter.count
answer = simulation.call("/slidectl/spawn_counter/forget")["message"]
simulation.load("two")
simulation.reset_world()
print(json.dumps([heard, loaded, answer, simulation.spawn_counter.count, len(simulation.features.broken)]))
"""
    heard, loaded, answer, count, broken = run(code, tmp_path / "site")
    assert heard[:3] == [1, 2, 3]
    assert (loaded, answer, count, broken) == (2, "2 spawns forgotten", 0, 0)


@pytest.mark.process
def test_broken_features_of_packages_are_named_and_the_world_starts_without_them(tmp_path: Path) -> None:
    package = tmp_path / "package"
    package.mkdir()
    (package / "pyproject.toml").write_text(
        """
[project]
name = "broken-ones"
version = "1.0"

[project.entry-points."slidectl.features"]
gone = "no_such_module:Feature"
typo = "with_a_typo:Feature"
number = "well_written:NUMBER"
faults = "well_written:Good"
bad-name = "well_written:Good"
raises = "well_written:Raises"
good = "well_written:Good"
""",
        encoding="utf-8",
    )
    (package / "with_a_typo.py").write_text("def f(:\n", encoding="utf-8")
    (package / "well_written.py").write_text(
        """
from slidectl.simulation import Feature

NUMBER = 3


class Good(Feature):
    pass


class Raises(Feature):
    def attach(self, simulation):
        self.node.advertise_service("half", "std_srvs/Empty", lambda _: {})
        raise KeyError("later")
""",
        encoding="utf-8",
    )
    install(package, tmp_path / "site")
    code = """
import json
from slidectl import Simulation, description

simulation = Simulation()
simulation.spawn(description.load("slider").xml, "slider")
simulation.step(10)
found = simulation.features.broken
broken = {error.part.name: [error.message, type(getattr(error, "cause", error)).__name__] for error in found}
half = simulation.graph.services.exists("/slidectl/raises/half")
print(json.dumps([broken, half, "good" in simulation.features, type(simulation.faults).__module__]))
"""
    broken, half, is_good_there, faults = run(code, tmp_path / "site")
    assert {name: cause for name, (_, cause) in broken.items()} == {
        "gone": "BadFile",
        "typo": "BadFile",
        "number": "NotAFeature",
        "faults": "NameOfSlidectl",
        "bad-name": "BadPartName",
        "raises": "Refused",
    }
    assert all(f"the feature {name!r} of broken-ones 1.0 is " in text for name, (text, _) in broken.items())
    assert "slidectl has one of that name" in broken["faults"][0]
    assert "a name is a letter" in broken["bad-name"][0]
    assert "with_a_typo.py:1: " in broken["typo"][0]
    assert "KeyError: 'later'" in broken["raises"][0]
    assert (half, is_good_there, faults) == (False, True, "slidectl.features.faults")
