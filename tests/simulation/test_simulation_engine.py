"""The compiled engine: the same bits as the interpreter, whatever happens, and a choice that tells what it does."""

from __future__ import annotations

import math
import re
import subprocess
from pathlib import Path
from typing import Any

import pytest
from engine_scenes import EFFORT, GAINS, POSITION, Scene, add, add_driven, arm, at_random, mixed, play, switch, usual
from sim_robots import STATES, cart, logged, running_cart

import slidectl
from slidectl.control.controllers.joint_control import JointVelocityController
from slidectl.control.registry import controller
from slidectl.errors import Refused, UsageError
from slidectl.physics import Diverged, EngineError
from slidectl.simulation import Simulation
from slidectl.simulation.compiled import engine, object_file, runner

needs_numba = pytest.mark.skipif(not object_file.is_possible(), reason="numba is not installed")


def assert_same(scene: Scene, driven: bool = False) -> Simulation:
    """Play it on both. Returns the compiled one."""
    plain, _ = play(scene, "plain", driven)
    compiled, simulation = play(scene, "compiled", driven)
    assert str(simulation.engine) == "compiled"
    assert compiled == plain
    return simulation


def count_plain_cycles(simulation: Simulation, name: str) -> list[int]:
    """A list that grows with each cycle of a robot that the interpreter runs whole."""
    cycle = simulation.robots.get(name).parts.cycle
    times: list[int] = []
    read = cycle._read

    def noting(time_ns: int, period_s: float) -> None:
        times.append(time_ns)
        read(time_ns, period_s)

    cycle._read = noting
    return times


@needs_numba
@pytest.mark.parametrize("safety", [False, True])
@pytest.mark.parametrize("listened", [False, True])
def test_every_compiled_controller_gives_the_same_bits(safety: bool, listened: bool) -> None:
    def scene(simulation: Simulation) -> None:
        add(simulation, "a", arm(safety=safety), usual())
        for topic in ("/a/joint_states", "/a/one/state", "/a/two/state", "/a/three/state") if listened else ():
            simulation.heard.listen(topic)  # type: ignore[attr-defined]
        for k in range(12):
            for name, value in (("one", 2.0), ("two", -3.0), ("three", 1.5)):
                simulation.publish(f"/a/{name}/command", {"data": value * (-1) ** k})
            simulation.step(400)

    simulation = assert_same(scene)
    times = count_plain_cycles(simulation, "a")
    simulation.step(1000)
    assert times == []


@needs_numba
@pytest.mark.parametrize("safety", [False, True])
@pytest.mark.parametrize("interface", ["Position", "Velocity"])
def test_positions_and_velocities_with_a_pid_of_the_hardware_give_the_same_bits(interface: str, safety: bool) -> None:
    def scene(simulation: Simulation) -> None:
        add_driven(simulation, "a", interface, safety)
        simulation.heard.listen("/a/joint_states")  # type: ignore[attr-defined]
        for k in range(8):
            for number, value in enumerate((2.0, -4.0, 5.0)):
                simulation.publish(f"/a/goal{number + 1}/command", {"data": value * (-1) ** k})
            simulation.step(300)
            if k == 3:
                simulation.parameters.set("/a/gazebo_ros_control/pid_gains/joint2/p", 11.0)
            if k == 5:
                simulation.reset_world()

    simulation = assert_same(scene)
    times = count_plain_cycles(simulation, "a")
    simulation.step(1000)
    assert times == []


@needs_numba
def test_a_controller_in_python_sends_positions_among_compiled_ones() -> None:
    def scene(simulation: Simulation) -> None:
        add_driven(simulation, "a", "Position")
        switch(simulation, "a", stop=["goal2"])
        simulation.parameters.set("/a/stepper", {"type": "tests/Stepper", "joint": "joint2"})
        assert simulation.call("/a/controller_manager/load_controller", {"name": "stepper"})["ok"]
        switch(simulation, "a", start=["stepper"])
        simulation.publish("/a/goal1/command", {"data": 0.5})
        simulation.step(700)

    simulation = assert_same(scene)
    times = count_plain_cycles(simulation, "a")
    simulation.step(100)
    assert times == []


@needs_numba
def test_a_joint_with_several_transmissions_gives_the_same_bits() -> None:
    def scene(simulation: Simulation) -> None:
        xml = arm(("prismatic", "revolute")).replace('<joint name="joint2"><hardware', '<joint name="joint1"><hardware')
        own = {f"e{k}": {"type": EFFORT, "joint": "joint1"} for k in (1,)}
        add(simulation, "a", xml, own)
        simulation.publish("/a/e1/command", {"data": 7.0})
        simulation.step(500)

    assert_same(scene)


@needs_numba
def test_motors_follow_another_time_step() -> None:
    def scene(simulation: Simulation) -> None:
        add_driven(simulation, "a", "Velocity", gains=False)
        for timestep in (0.001, 0.002, 0.0005):
            simulation.set_timestep(timestep)
            simulation.publish("/a/goal1/command", {"data": 1000 * timestep})
            simulation.step(100)

    assert_same(scene)


@needs_numba
@pytest.mark.parametrize("interface", ["Position", "Velocity"])
def test_joints_with_motors_and_those_that_publish_their_pid_are_the_interpreters(interface: str) -> None:
    def scene(simulation: Simulation) -> None:
        add_driven(simulation, "a", interface, gains=False)
        add(simulation, "b", arm(), usual())
        simulation.parameters.set("/c/gazebo_ros_control/pid_gains/joint1/publish_state", True)
        add_driven(simulation, "c", interface)
        for name in "ac":
            simulation.publish(f"/{name}/goal1/command", {"data": 0.5})
        simulation.step(300)

    assert_same(scene)


@needs_numba
def test_an_emergency_stop_of_driven_joints_gives_the_same_bits() -> None:
    def scene(simulation: Simulation) -> None:
        plugin = "<eStopTopic>/stop</eStopTopic>"
        for name, interface in (("a", "Position"), ("b", "Velocity")):
            simulation.parameters.set(f"/{name}/gazebo_ros_control/pid_gains", {"joint1": GAINS, "joint2": GAINS})
            kind = f"{interface.lower()}_controllers/Joint{interface}Controller"
            xml = arm(("prismatic", "revolute"), plugin=plugin, interface=interface)
            add(simulation, name, xml, {"goal": {"type": kind, "joint": "joint2"}})
            simulation.publish(f"/{name}/goal/command", {"data": 0.8})
        for stopped in (False, True, False):
            simulation.publish("/stop", {"data": stopped}, "std_msgs/Bool")
            simulation.step(200)

    assert_same(scene)


@needs_numba
def test_the_cycles_are_compiled_ones_while_listeners_are_served() -> None:
    _, simulation = play(lambda simulation: add(simulation, "a", arm(), usual()), "compiled")
    heard: list[Any] = []
    simulation.graph.topics.subscribe("/a/one/state", None, "/listener", heard.append)
    times = count_plain_cycles(simulation, "a")
    simulation.step(1000)
    assert times == []
    assert len(heard) == 100


@needs_numba
def test_a_controller_in_python_works_among_compiled_ones() -> None:
    def scene(simulation: Simulation) -> None:
        add(simulation, "a", arm(), mixed())
        simulation.heard.listen("/a/swing/told")  # type: ignore[attr-defined]
        for value in (1.0, -1.0, 0.3):
            simulation.publish("/a/swing/target", {"data": value})
            simulation.publish("/a/three/command", {"data": 4 * value})
            simulation.step(777)

    simulation = assert_same(scene)
    times = count_plain_cycles(simulation, "a")
    simulation.step(100)
    assert times == []


@controller("tests/Reversed")
class Reversed(JointVelocityController):
    """Inherits what is compiled, but not how it updates."""

    def update(self, time_ns: int, period_s: float) -> None:
        super().update(time_ns, period_s)
        self._joint.command = -self._joint.command


@controller("tests/Wandering")
class Wandering(JointVelocityController):
    """Inherits how it updates, but not where to."""

    @property
    def set_point(self) -> float:
        return math.sin(3.0 * self._joint.position) + 1.0

    @set_point.setter
    def set_point(self, value: float) -> None:
        pass


@controller("tests/Meddling")
class Meddling(JointVelocityController):
    """Inherits how it updates; when it tells its state it does more than that."""

    def publish(self, time_ns: int, period_s: float) -> None:
        super().publish(time_ns, period_s)
        self._joint.command = 3.0


@needs_numba
@pytest.mark.parametrize("kind", ["Reversed", "Wandering", "Meddling"])
def test_a_class_with_ways_of_its_own_is_not_mistaken_for_its_parent(kind: str) -> None:
    def scene(simulation: Simulation) -> None:
        own = usual()
        own["three"]["type"] = f"tests/{kind}"
        add(simulation, "a", arm(), own)
        simulation.heard.listen("/a/three/state")  # type: ignore[attr-defined]
        simulation.step(1000)

    assert_same(scene)


@needs_numba
def test_a_controller_that_fails_is_aborted_and_the_others_go_on() -> None:
    def scene(simulation: Simulation) -> None:
        own = mixed()
        own["swing"]["fails_at"] = 300_000_000
        add(simulation, "a", arm(), own)
        simulation.step(1000)
        listed = {entry["name"]: entry["state"] for entry in simulation.robots.get("a").manager.list()}
        assert listed == {"states": "running", "one": "running", "swing": "aborted", "three": "running"}

    assert_same(scene)


@needs_numba
def test_a_subscriber_that_fails_aborts_the_publishing_controller_in_both() -> None:
    def scene(simulation: Simulation) -> None:
        add(simulation, "a", arm(), usual())
        simulation.subscribe("/a/one/state", lambda message: 1 / (1 if message["header"]["seq"] < 20 else 0))
        simulation.step(1000)

    assert_same(scene)


@needs_numba
@pytest.mark.parametrize("target", ["/a/one/command", "/a/two/command", "/b/one/command", "/c/one/command"])
def test_a_command_from_within_a_cycle_takes_effect_in_the_same_place(target: str) -> None:
    def scene(simulation: Simulation) -> None:
        for name in "abc":
            add(simulation, name, arm(), usual())

        def answer(message: dict[str, Any]) -> None:
            simulation.publish(target, {"data": message["process_value"] + 0.3})

        simulation.subscribe("/b/two/state", answer)
        simulation.step(1000)

    assert_same(scene)


@needs_numba
def test_a_switch_asked_for_within_a_cycle_happens_at_its_end() -> None:
    def scene(simulation: Simulation) -> None:
        for name in "ab":
            add(simulation, name, arm(), usual())
        states = iter(range(1000))

        def act(_: dict[str, Any]) -> None:
            if next(states) == 20:
                switch(simulation, "a", stop=["three"])
                switch(simulation, "b", stop=["one"])

        simulation.subscribe("/a/two/state", act)
        simulation.step(700)

    assert_same(scene, driven=True)


@needs_numba
@pytest.mark.parametrize("effort", [5.0, 1000.0])
def test_motors_run_compiled_within_their_efforts_and_beside_robots_without(effort: float) -> None:
    def scene(simulation: Simulation) -> None:
        driven = arm().replace("EffortJointInterface", "VelocityJointInterface")
        driven = re.sub(r'effort="[^"]*"', f'effort="{effort}"', driven)
        go = {f"go{k}": {"type": "velocity_controllers/JointVelocityController", "joint": f"joint{k}"} for k in (1, 2)}
        add(simulation, "a", arm(), usual())
        add(simulation, "v", driven, go)
        held = driven.replace("VelocityJointInterface", "PositionJointInterface")
        add(simulation, "p", held, {"go": {"type": "position_controllers/JointPositionController", "joint": "joint1"}})
        simulation.publish("/v/go1/command", {"data": 0.4})
        simulation.publish("/v/go2/command", {"data": -0.6})
        simulation.publish("/p/go/command", {"data": 0.7})
        simulation.step(700)
        simulation.world.add_wrench("v", "part1", (5.0, 0.0, 0.0), (0.0, 0.1, 0.0), 800_000_000, 100_000_000)
        simulation.step(700)

    simulation = assert_same(scene)
    times = [count_plain_cycles(simulation, name) for name in "avp"]
    simulation.step(100)
    assert times == [[], [], []]


@needs_numba
def test_forces_from_outside_act_and_show_as_they_do_in_python() -> None:
    def scene(simulation: Simulation) -> None:
        add(simulation, "a", arm(), usual())
        add(simulation, "b", arm(), usual())
        for topic in ("/a/joint_states", "/b/joint_states"):
            simulation.heard.listen(topic)  # type: ignore[attr-defined]
        simulation.world.add_joint_force("a", "joint2", 3.0, 100_000_000, 150_000_000)
        simulation.world.add_wrench("b", "part1", (5.0, 0.0, 0.0), (0.0, 0.1, 0.0), 200_000_000, 250_000_000)
        simulation.step(900)

    assert_same(scene)


@needs_numba
def test_the_interpreter_runs_a_robot_under_an_emergency_stop() -> None:
    plugin = "<eStopTopic>/stop</eStopTopic>"

    def scene(simulation: Simulation) -> None:
        add(simulation, "a", arm(plugin=plugin), usual())
        for stopped in (False, True, True, False):
            simulation.publish("/stop", {"data": stopped})
            simulation.step(250)

    assert_same(scene)


@needs_numba
def test_controllers_slower_than_the_simulation_keep_their_period() -> None:
    def scene(simulation: Simulation) -> None:
        add(simulation, "a", arm(plugin="<controlPeriod>0.0037</controlPeriod>"), usual())
        simulation.heard.listen("/a/one/state")  # type: ignore[attr-defined]
        simulation.step(1234)
        simulation.set_timestep(0.0005)
        simulation.step(1000)

    assert_same(scene)


@needs_numba
@pytest.mark.parametrize("driven", [False, True])
@pytest.mark.parametrize("seed", range(6))
def test_whatever_happens_both_engines_do_the_same(seed: int, driven: bool) -> None:
    assert_same(at_random(seed), driven)


@needs_numba
def test_a_clock_that_is_listened_to_ticks_once_a_cycle() -> None:
    def scene(simulation: Simulation) -> None:
        add(simulation, "a", arm(), usual())
        for topic in ("/clock", "/a/joint_states", "/a/two/state"):
            simulation.heard.listen(topic)  # type: ignore[attr-defined]
        simulation.graph.timers.every(33_000_000, lambda: None)
        assert simulation.step(500) == 500

    assert_same(scene)


@needs_numba
def test_what_diverges_is_noticed_in_the_same_cycle() -> None:
    def scene(simulation: Simulation) -> None:
        add(simulation, "a", arm(), usual())
        simulation.step(100)
        simulation.world.data.qvel[0] = 1e11
        with pytest.raises(Diverged):
            simulation.step(5000)
        assert simulation.cycles == 101

    plain, compiled = (play(scene, name)[1] for name in ("plain", "compiled"))
    assert plain.time_ns == compiled.time_ns


@needs_numba
def test_an_error_of_the_physics_is_an_error_and_no_end_of_the_process() -> None:
    _, simulation = play(lambda simulation: add(simulation, "a", arm(), usual()), "compiled", driven=True)
    simulation.step(10)
    cycles = simulation.engine.compiled
    assert cycles is not None
    from ctypes import addressof, c_void_p, cast, create_string_buffer

    from slidectl.physics.mujoco_library import _library

    text = create_string_buffer(b"no room for contacts")
    cycles._progress.step = cast(_library().mju_error, c_void_p).value or 0  # type: ignore[union-attr]
    cycles._progress.model = addressof(text)
    with pytest.raises(EngineError, match="no room for contacts"):
        cycles.run(5)
    assert simulation.cycles == 11


@needs_numba
def test_what_is_told_between_steps_counts_and_what_is_shown_is_new() -> None:
    simulation = running_cart()
    simulation.engine.complete()
    simulation.step(200)
    robot = simulation.robots.get("cart")
    handle = robot.hardware.driven()[0].handle
    assert handle.position == pytest.approx(simulation.world.joint_state("cart", "joint1")[0], abs=1e-3)
    simulation.driven = True
    simulation.publish("/cart/position1/command", {"data": 1.0})
    for _ in range(500):
        simulation.step(1)
    assert robot.manager.get("position1")._pid.p == 100.0  # type: ignore[union-attr]
    assert handle.command == pytest.approx(simulation.world.joint_state("cart", "joint1")[2])


@needs_numba
def test_a_robot_that_comes_or_switches_leaves_the_others_in_their_rows() -> None:
    _, simulation = play(lambda simulation: add(simulation, "a", arm(), usual()), "compiled", driven=True)
    simulation.step(10)
    cycles = simulation.engine.compiled
    assert cycles is not None
    settled = cycles._rows_of[simulation.robots.get("a")]
    simulation.step(10)
    add(simulation, "b", arm(("continuous",)), {"one": {"type": POSITION, "joint": "joint1", "pid": GAINS}})
    simulation.step(10)
    switch(simulation, "b", stop=["one"])
    simulation.step(10)
    assert cycles._rows_of[simulation.robots._robots["a"]] is settled
    assert settled.is_loaded


@needs_numba
def test_rows_that_are_left_over_do_not_pile_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runner, "_FEW_ROWS", 10)

    def scene(simulation: Simulation) -> None:
        add(simulation, "a", arm(), usual())
        add(simulation, "b", arm(), mixed())
        for _ in range(40):
            for change in ("stop", "start"):
                switch(simulation, "b", **{change: ["one", "three"]})
                simulation.publish("/b/one/command", {"data": 0.7})
                simulation.step(20)

    simulation = assert_same(scene)
    cycles = simulation.engine.compiled
    assert cycles is not None
    assert sum(map(len, cycles._tables.content.values())) < 20_000


@needs_numba
def test_robots_that_come_and_go_between_two_cycles() -> None:
    def scene(simulation: Simulation) -> None:
        for name in "abc":
            add(simulation, name, arm(), usual())
        simulation.step(100)
        simulation.delete("b")
        add(simulation, "d", arm(), mixed())
        simulation.step(100)
        add(simulation, "b", arm(("continuous",)), {"one": {"type": POSITION, "joint": "joint1", "pid": GAINS}})
        simulation.delete("b")
        simulation.step(100)
        simulation.delete("d")
        simulation.delete("a")
        simulation.step(100)

    assert_same(scene, driven=True)
    assert_same(scene)


# Which engine it is.


def test_there_are_three_engines() -> None:
    with pytest.raises(UsageError, match="plain, compiled, auto"):
        Simulation(engine="warp")


def test_without_numba_auto_is_plain_and_compiled_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(object_file, "is_possible", lambda: False)
    assert str(Simulation(engine="auto").engine) == "plain"
    with pytest.raises(Refused, match=r"\[fast\]"):
        Simulation(engine="compiled")


class Compilation:
    """A process that compiles, or fails to."""

    def __init__(self) -> None:
        self.code: int | None = None

    def poll(self) -> int | None:
        return self.code


@pytest.fixture
def compilation(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Compilation:
    """Nothing is compiled yet, and a compilation takes as long as the test wants."""
    made = Compilation()
    monkeypatch.setattr(object_file, "is_possible", lambda: True)
    monkeypatch.setattr(object_file, "place", lambda: tmp_path / "cycle.o")
    monkeypatch.setattr(engine, "_begin_to_compile", lambda: made)
    return made


def test_the_interpreter_runs_the_cycles_until_the_code_is_there(compilation: Compilation) -> None:
    simulation = Simulation(engine="auto")
    simulation.driven = True
    simulation.step(3)
    assert str(simulation.engine) == "auto: compiling, plain meanwhile"
    assert simulation.cycles == 3
    compilation.code = 1
    simulation.step(3)
    assert str(simulation.engine).startswith("plain: compiling failed")
    simulation.step(3)
    assert simulation.cycles == 9


def test_a_compiler_that_was_killed_is_named_by_what_killed_it(compilation: Compilation) -> None:
    simulation = Simulation(engine="auto")
    lines = logged(simulation)
    simulation.driven = True
    simulation.step(3)
    compilation.code = -9
    simulation.step(3)
    assert str(simulation.engine) == "plain: the compiler was ended by SIGKILL"
    assert ("warn", "cycles run in the interpreter: the compiler was ended by SIGKILL") in lines


@pytest.mark.usefixtures("compilation")
def test_code_that_is_no_code_leaves_the_interpreter(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken() -> None:
        raise OSError("no such code")

    monkeypatch.setattr(object_file, "load", broken)
    simulation = Simulation(engine="auto")
    object_file.write(object_file.place(), b"nonsense")
    simulation.step(3)
    assert str(simulation.engine) == "plain: the compiled code cannot be loaded: no such code"


@pytest.mark.usefixtures("compilation")
def test_a_few_steps_are_not_worth_compiling(monkeypatch: pytest.MonkeyPatch) -> None:
    begun: list[int] = []
    monkeypatch.setattr(engine, "_begin_to_compile", lambda: begun.append(1) or subprocess.Popen(["true"]))
    simulation = Simulation(engine="auto")
    simulation.step(100)
    assert not begun


@needs_numba
def test_the_engine_changes_between_two_cycles_and_nothing_else_does() -> None:
    def scene(simulation: Simulation) -> None:
        add(simulation, "a", arm(), usual())
        simulation.publish("/a/one/command", {"data": 1.0})
        simulation.step(600)

    plain, _ = play(scene, "plain")
    late = Simulation(ground=False, engine="auto")
    late.engine.is_settled = True
    add(late, "a", arm(), usual())
    late.publish("/a/one/command", {"data": 1.0})
    late.step(300)
    late.engine.complete()
    late.step(300)
    data = late.world.data
    assert [array.tobytes() for array in (data.qpos, data.qvel, data.qfrc_applied, data.qacc_warmstart)] == plain[2]


@needs_numba
def test_many_robots_and_one_that_talks() -> None:
    def scene(simulation: Simulation) -> None:
        for number in range(8):
            states = {"type": STATES, "publish_rate": 100}
            add(simulation, f"r{number}", cart(), {"states": states, "one": usual()["one"]})
        simulation.heard.listen("/r3/joint_states")  # type: ignore[attr-defined]
        logged(simulation)
        for number in range(8):
            simulation.publish(f"/r{number}/one/command", {"data": 0.1 * number})
        simulation.step(500)

    assert_same(scene)


def test_numba_is_imported_by_the_process_that_compiles_and_by_nothing_else() -> None:
    package = Path(slidectl.__file__).parent
    users = [path.name for path in package.rglob("*.py") if "import numba" in path.read_text(encoding="utf-8")]
    assert users == ["compiler.py"]


@pytest.mark.parametrize("engine", ["plain", "compiled"])
@pytest.mark.parametrize("place", ["timer", "subscriber"])
def test_what_a_script_holds_is_true_in_its_callbacks(engine: str, place: str) -> None:
    simulation = Simulation(ground=False, engine=engine)
    if engine == "compiled":
        simulation.engine.complete()
    add(simulation, "a", arm(), usual())
    robot = simulation.robots.get("a")
    held, handle = robot.manager.get("one"), robot.hardware.driven()[0].handle
    seen: list[bool] = []

    def look(*_: object) -> None:
        seen.append(handle.position == simulation.world.joint_state("a", handle.name)[0] or place == "subscriber")
        held.set_command(1.0)

    if place == "timer":
        simulation.graph.timers.every(100_000_000, look)
    else:
        simulation.subscribe("/a/two/state", look)
    simulation.publish("/a/one/command", {"data": 0.3})
    simulation.step(1000)
    assert held.set_point == 1.0
    assert len(seen) >= 9
    assert simulation.world.joint_state("a", "joint1")[0] > 0.9
