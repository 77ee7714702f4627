"""Faults on purpose, as a script and a listener see them: on what is read, on commands, joints, controllers, topics."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest
from engine_scenes import EFFORT, FAULT_OPTIONS, STATES, Scene, add, add_driven, arm, mixed, play, usual
from sim_robots import cart, command, configure, logged, running_cart, state, states_of, switch

from slidectl.errors import AmbiguousName, Refused, SlidectlError, UnknownName, UsageError
from slidectl.fault_kinds import KINDS, REQUIRED
from slidectl.simulation import Simulation
from slidectl.simulation.compiled import object_file

needs_numba = pytest.mark.skipif(not object_file.is_possible(), reason="numba is not installed")

TARGETS = {
    "joint": "a/joint2", "moving joint": "b/joint1", "link": "a/part2", "controller": "a/two",
    "topic": "a/joint_states",
}  # fmt: skip


def pushed_cart(joints: int = 1, engine: str = "auto") -> Simulation:
    """A cart of 1 kg whose effort is commanded, with its joint's state a thousand times a second."""
    simulation = Simulation(ground=False, engine=engine)
    states = {"type": STATES, "publish_rate": 1000}
    efforts = {f"effort{k}": {"type": EFFORT, "joint": f"joint{k}"} for k in range(1, joints + 1)}
    add(simulation, "cart", cart(joints=joints, damping=0.0), {"states": states, **efforts})
    simulation.step()
    return simulation


def listen(simulation: Simulation, topic: str) -> list[dict[str, Any]]:
    messages: list[dict[str, Any]] = []
    simulation.subscribe(topic, messages.append)
    return messages


def push(simulation: Simulation, effort: float) -> None:
    simulation.publish("/cart/effort1/command", {"data": effort})


def readings(simulation: Simulation, cycles: int) -> list[tuple[int, float, float]]:
    """Time in ms, the true position, and the one that was read, of cycles to come."""
    messages = listen(simulation, "/cart/joint_states")
    found = []
    for _ in range(cycles):
        true = state(simulation)[0]
        simulation.step()
        found.append((simulation.time_ns // 1_000_000, true, messages[-1]["position"][0]))
    return found


# -- both engines, every run -------------------------------------------------------------------------------------------


def one_fault(kind: str) -> Scene:
    """Three robots, and for a while one of them has a fault."""

    def scene(simulation: Simulation) -> None:
        add(simulation, "a", arm(safety=True), usual())
        add(simulation, "b", arm(), mixed())
        add_driven(simulation, "c", "Velocity", gains=False)
        for topic in ("/a/joint_states", "/b/joint_states", "/a/one/state"):
            simulation.heard.listen(topic)  # type: ignore[attr-defined]
        options = {name: FAULT_OPTIONS[name] for name in KINDS[kind].options}
        simulation.faults.add(TARGETS[KINDS[kind].target], kind, 0.05, 0.2, seed=3, **options)
        for target in (0.7, -0.4, 0.2):
            for topic in ("/a/one/command", "/a/two/command", "/a/three/command", "/c/goal1/command"):
                simulation.publish(topic, {"data": target})
            simulation.step(100)
        [fault] = simulation.faults.messages()
        assert fault["count"] > 0
        assert fault["state"] == "over"
        simulation.heard.messages.append(("fault", repr(fault)))  # type: ignore[attr-defined]

    return scene


@needs_numba
@pytest.mark.parametrize("kind", sorted(KINDS))
def test_every_kind_does_the_same_to_the_bit_on_both_engines(kind: str) -> None:
    seen, _ = play(one_fault(kind), "plain")
    again, simulation = play(one_fault(kind), "compiled")
    assert seen == again
    if KINDS[kind].target != "topic" and not kind.startswith("controller"):
        simulation.driven = True
        simulation.step(32)
        assert simulation.loop.runner.compiled_controllers(simulation.robots.get("a")), (
            "it is compiled when the fault is over"
        )


@needs_numba
@pytest.mark.parametrize(
    ("kind", "options"),
    [
        ("sensor-frozen", {}),
        ("sensor-delay", {"delay": 0.02}),
        ("command-loss", {"probability": 1.0}),
        ("command-delay", {"delay": 0.02}),
    ],
)
def test_a_fault_that_begins_now_knows_the_last_cycle_on_both_engines(kind: str, options: dict[str, float]) -> None:
    def scene(simulation: Simulation) -> None:
        add(simulation, "a", arm(), usual())
        simulation.heard.listen("/a/joint_states")  # type: ignore[attr-defined]
        simulation.publish("/a/two/command", {"data": 0.5})
        simulation.step(100)
        simulation.faults.add("a/joint2", kind, end=0.2, **options)
        simulation.step(200)

    plain, simulation = play(scene, "plain", driven=True)
    assert simulation.faults.messages()[0]["count"] == 99
    assert plain == play(scene, "compiled", driven=True)[0]


def test_a_seed_decides_and_so_does_the_simulated_time() -> None:
    def noise(seed: int, then: Callable[[Simulation], None] = lambda _: None) -> list[tuple[int, float, float]]:
        simulation = pushed_cart()
        simulation.faults.add("joint1", "sensor-noise", 0.01, 0.03, seed=seed, sd=0.1)
        simulation.step(3)
        then(simulation)
        return readings(simulation, 40)

    assert noise(1) == noise(1) != noise(2)
    assert noise(1, lambda simulation: simulation.robots.get("cart").read_joints()) == noise(1)


def test_the_noise_is_gaussian() -> None:
    simulation = pushed_cart()
    simulation.faults.add("joint1", "sensor-noise", sd=0.5)
    errors = [read - true for _, true, read in readings(simulation, 4000)]
    mean = sum(errors) / len(errors)
    assert mean == pytest.approx(0.0, abs=4 * 0.5 / math.sqrt(4000))
    assert math.sqrt(sum((error - mean) ** 2 for error in errors) / 4000) == pytest.approx(0.5, rel=0.05)


# -- what is read ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "options", "expected"),
    [
        ("sensor-bias", {"bias": 0.25}, lambda ms, past: past[ms] + 0.25),
        ("sensor-drift", {"rate": 2.0}, lambda ms, past: past[ms] + 2.0 * (ms - 20) / 1000),
        ("sensor-quantisation", {"step": 0.01}, lambda ms, past: 0.01 * math.floor(past[ms] / 0.01 + 0.5)),
        ("sensor-delay", {"delay": 0.007}, lambda ms, past: past[ms - 7]),
        ("sensor-frozen", {}, lambda _, past: past[19]),
        ("sensor-dropout", {"probability": 1.0}, lambda _, past: past[19]),
    ],
)
def test_a_sensor_is_wrong_as_its_kind_says_from_the_first_cycle_to_the_last(
    kind: str, options: dict[str, Any], expected: Callable[[int, dict[int, float]], float]
) -> None:
    simulation = pushed_cart()
    push(simulation, 50.0)
    simulation.faults.add("cart/joint1", kind, 0.02, 0.04, **options)
    past: dict[int, float] = {}
    for ms, true, read in readings(simulation, 60):
        past[ms] = true
        assert read == pytest.approx(expected(ms, past) if 20 <= ms < 40 else true, rel=1e-12, abs=1e-15), ms
    [fault] = simulation.faults.messages()
    assert fault["state"] == "over"
    assert fault["count"] in (19, 20), "a drift begins with nothing"


def test_readings_that_fail_now_and_then_keep_the_last_one() -> None:
    simulation = pushed_cart()
    push(simulation, 50.0)
    simulation.faults.add("joint1", "sensor-dropout", probability=0.5)
    simulation.step(9)
    found, last, kept = readings(simulation, 400), math.nan, 0
    for _, true, read in found:
        assert read in (true, last) or math.isnan(last)
        kept += read != true
        last = read
    assert 150 < kept < 250


def test_faults_of_one_joint_act_in_the_order_in_which_they_were_added() -> None:
    def read(*kinds: tuple[str, dict[str, float]]) -> float:
        simulation = pushed_cart()
        for kind, options in kinds:
            simulation.faults.add("joint1", kind, **options)
        return readings(simulation, 1)[0][2]

    bias, steps = ("sensor-bias", {"bias": 0.07}), ("sensor-quantisation", {"step": 0.1})
    assert read(bias, steps) == pytest.approx(0.1)
    assert read(steps, bias) == pytest.approx(0.07)


def test_an_angle_is_unwrapped_from_what_was_truly_read() -> None:
    def turned(bias: float) -> list[float]:
        simulation = Simulation(ground=False)
        add(simulation, "arm", arm(("continuous",)), {"states": {"type": STATES, "publish_rate": 1000}})
        simulation.world.set_joint("arm", "joint1", 0.0, 30.0)
        if bias:
            simulation.faults.add("joint1", "sensor-bias", bias=bias)
        messages = listen(simulation, "/arm/joint_states")
        simulation.step(1500)
        return [message["position"][0] for message in messages]

    true = turned(0.0)
    assert true[-1] > 2 * math.pi
    assert turned(20.0) == [position + 20.0 for position in true]


# -- commands ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "options", "expected"),
    [
        ("command-reversed", {}, lambda ms: -float(ms)),
        ("command-saturation", {"limit": 25.0}, lambda ms: min(float(ms), 25.0)),
        ("command-delay", {"delay": 0.005}, lambda ms: ms - 5.0),
        ("command-loss", {"probability": 1.0}, lambda _: 19.0),
    ],
)
def test_a_command_reaches_the_joint_as_its_kind_says(
    kind: str, options: dict[str, Any], expected: Callable[[int], float]
) -> None:
    simulation = pushed_cart()
    simulation.faults.add("joint1", kind, 0.02, 0.04, **options)
    for ms in range(2, 60):
        push(simulation, float(ms))  # for the cycle of that time
        simulation.step()
        assert state(simulation)[2] == (expected(ms) if 20 <= ms < 40 else ms)


def test_controllers_slower_than_the_world_find_their_commands_as_they_left_them() -> None:
    simulation = Simulation(ground=False)
    slow = cart("<controlPeriod>0.01</controlPeriod>", damping=0.0)
    add(simulation, "cart", slow, {"effort1": {"type": EFFORT, "joint": "joint1"}})
    push(simulation, 3.0)
    simulation.step(20)
    simulation.faults.add("joint1", "command-reversed")
    for _ in range(25):
        simulation.step()
        assert state(simulation)[2] == -3.0


# -- joints, links -----------------------------------------------------------------------------------------------------


def test_a_stuck_joint_stays_whatever_pushes_it_and_moves_again_afterwards() -> None:
    simulation = pushed_cart()
    push(simulation, 50.0)
    simulation.faults.add("joint1", "joint-stuck", 0.05, 0.1)
    simulation.faults.add("box1", "push", 0.06, 0.08, force=(900.0, 0.0, 0.0))
    simulation.step(48)
    messages = listen(simulation, "/cart/joint_states")
    simulation.step()
    where = state(simulation)[0]
    simulation.step(49)
    assert state(simulation)[:2] == (where, 0.0)
    assert messages[-1]["effort"] == [50.0], "what holds it is no effort of its actuator"
    simulation.step(2)
    assert state(simulation)[1] == pytest.approx(50.0 * 0.002, rel=1e-6)


def test_a_stuck_joint_that_is_driven_by_a_motor_takes_no_positions() -> None:
    simulation = Simulation(ground=False)
    add_driven(simulation, "d", "Position", gains=False)
    simulation.step(5)
    simulation.faults.add("joint1", "joint-stuck", name="jam")
    simulation.publish("/d/goal1/command", {"data": 1.0})
    simulation.step(100)
    assert state(simulation, "d")[0] == 0.0
    simulation.faults.remove("jam")
    simulation.step(2000)
    assert state(simulation, "d")[0] == pytest.approx(1.0)


def test_dry_friction_holds_a_joint_up_to_its_size() -> None:
    simulation = pushed_cart(joints=2)
    simulation.faults.add("joint1", "joint-friction", friction=10.0, damping=4.0)
    push(simulation, 9.0)
    simulation.step(500)
    assert abs(state(simulation)[1]) < 0.01, "a friction of MuJoCo's creeps"
    push(simulation, 22.0)
    simulation.step(5000)
    assert state(simulation)[1] == pytest.approx((22.0 - 10.0) / 4.0, rel=1e-3)
    assert state(simulation, joint="joint2")[:2] == (0.0, 0.0)


def test_a_payload_is_as_if_the_model_had_it() -> None:
    """The shipped arm drops for a while: with the mass in its URDF, and with a fault from the beginning."""
    load = '<link name="load"><inertial><mass value="2.5"/><inertia {}/></inertial></link>'.format(
        " ".join(
            f'{axis}="{1e-12 if axis[1] == axis[2] else 0}"' for axis in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
        )
    )
    on = '<joint name="on" type="fixed"><parent link="part1"/><child link="load"/><origin xyz="0.3 -0.1 0.2"/></joint>'

    def dropped(xml: str, is_fault: bool) -> list[float]:
        simulation = Simulation(ground=False, engine="plain")
        simulation.spawn(xml, "arm")
        if is_fault:
            simulation.faults.add("arm/part1", "payload", mass=2.5, at=(0.3, -0.1, 0.2))
        found = []
        for _ in range(50):
            simulation.step(10)
            found += state(simulation, "arm")
        return found

    for kind in ("continuous", "prismatic"):
        bare = arm((kind,))
        with_load = bare.replace("<transmission", f"{load}{on}<transmission", 1)
        expected = dropped(with_load, is_fault=False)
        assert dropped(bare, is_fault=True) == pytest.approx(expected, rel=1e-6, abs=1e-9)
        assert kind == "prismatic" or dropped(bare, is_fault=False) != pytest.approx(expected, rel=1e-3)


def test_a_push_accelerates_while_it_lasts() -> None:
    simulation = pushed_cart()
    simulation.faults.add("box1", "push", 0.1, 0.15, force=(40.0, 0.0, 0.0))
    simulation.step(99 - 1)
    assert state(simulation)[1] == 0.0
    simulation.step(200)
    assert state(simulation)[1] == pytest.approx(40.0 * 0.05)


def test_faults_go_on_when_other_robots_come_and_go() -> None:
    def played(comes: bool) -> tuple[float, ...]:
        simulation = pushed_cart(joints=2)
        push(simulation, 50.0)
        simulation.faults.add("joint1", "joint-friction", friction=20.0)
        simulation.faults.add("box1", "payload", mass=3.0)
        simulation.faults.add("joint2", "joint-stuck")
        simulation.faults.add("box2", "push", force=(20.0, 0.0, 0.0))
        simulation.step(10)
        if comes:
            simulation.spawn(cart(), "other", pose=((0.0, 20.0, 0.0), (0.0, 0.0, 0.0, 1.0)))
        simulation.step(10)
        if comes:
            simulation.delete("other")
        simulation.step(100)
        return state(simulation)[:2] + state(simulation, joint="joint2")

    assert played(comes=True) == pytest.approx(played(comes=False), rel=1e-9)


# -- controllers -------------------------------------------------------------------------------------------------------


def test_a_controller_raises_once_and_can_be_started_again() -> None:
    simulation = running_cart()
    lines = logged(simulation)
    simulation.faults.add("cart/position1", "controller-raise", 0.01, name="bad_day")
    simulation.step(20)
    assert states_of(simulation)["position1"] == "aborted"
    assert ("fatal", "controller 'position1' failed and is aborted: fault 'bad_day' made it raise") in lines
    assert switch(simulation, start=["position1"])
    simulation.step(20)
    assert states_of(simulation)["position1"] == "running"
    [fault] = simulation.faults.messages()
    assert (fault["state"], fault["count"]) == ("over", 1)


def test_a_killed_controller_is_unloaded_and_leaves_its_last_command() -> None:
    simulation = pushed_cart()
    push(simulation, 5.0)
    simulation.faults.add("effort1", "controller-kill", 0.01)
    simulation.step(20)
    assert states_of(simulation) == {"states": "running"}
    assert state(simulation)[2] == 5.0


def test_a_slow_controller_holds_up_the_cycle_of_its_robot_alone() -> None:
    simulation = pushed_cart()
    add(simulation, "other", cart(), {"states": {"type": STATES, "publish_rate": 1000}})
    mine, others = listen(simulation, "/cart/joint_states"), listen(simulation, "/other/joint_states")
    simulation.faults.add("effort1", "controller-slow", 0.1, 0.2, takes=0.009)
    simulation.step(98)
    push(simulation, 7.0)
    simulation.step(9)  # at 0.1 s the joints are read, and nothing else happens
    assert state(simulation)[2] == 0.0
    simulation.step()
    assert state(simulation)[2] == 7.0
    simulation.step(200)
    assert len(others) - len(mine) == pytest.approx(90, abs=3), "one update in ten cycles, for a hundred"
    assert state(simulation)[2] == 7.0


def test_faults_of_joints_and_links_begin_and_end_while_a_controller_is_slow() -> None:
    simulation = pushed_cart()
    simulation.faults.add("effort1", "controller-slow", 0.1, takes=0.5)
    simulation.faults.add("box1", "push", 0.2, 0.3, force=(5.0, 0.0, 0.0))
    simulation.faults.add("joint1", "joint-stuck", 0.05, 0.15)
    simulation.step(400)
    assert state(simulation)[1] == pytest.approx(0.5)
    assert [fault["count"] for fault in simulation.faults.messages()] == [1, 100, 100]


# -- topics ------------------------------------------------------------------------------------------------------------


def test_messages_get_lost_and_those_who_publish_do_not_notice() -> None:
    simulation = pushed_cart()
    heard = listen(simulation, "/cart/joint_states")
    simulation.faults.add("joint_states", "topic-loss", 0.1, 0.6, seed=5, probability=0.3)
    simulation.step(999)
    lost = simulation.faults.messages()[0]["count"]
    assert 100 < lost < 200
    assert len(heard) == pytest.approx(1000 - lost, abs=1)
    numbers = [message["header"]["seq"] for message in heard]
    assert numbers == sorted(set(numbers))
    late = listen(simulation, "/cart/joint_states")
    simulation.step(10)
    assert len(late) == 10, "who comes later gets all that come"


def test_a_message_comes_late_and_the_next_may_overtake_it() -> None:
    simulation = pushed_cart()
    simulation.faults.add("effort1/command", "topic-delay", 0.1, 0.2, delay=0.15)
    simulation.step(99)
    push(simulation, 1.0)
    simulation.step(101)
    push(simulation, 2.0)
    simulation.step(2)
    assert state(simulation)[2] == 2.0
    simulation.step(50)
    assert state(simulation)[2] == 1.0
    simulation.faults.remove()
    push(simulation, 3.0)
    simulation.step()
    assert state(simulation)[2] == 3.0


def test_who_hears_a_late_message_may_remove_its_fault_and_others_go_on() -> None:
    simulation = pushed_cart()
    topic = "/cart/effort1/command"
    gone = simulation.faults.add(topic, "topic-delay", simulation.time_ns / 1e9, delay=0.01)["name"]
    heard: list[float] = []

    def hear(message: dict[str, Any]) -> None:
        heard.append(message["data"])
        if len(heard) == 1:
            simulation.faults.remove(gone)

    simulation.subscribe(topic, hear)
    push(simulation, 1.0)
    push(simulation, 2.0)
    simulation.step(20)
    assert heard == [1.0]
    push(simulation, 3.0)
    assert heard == [1.0, 3.0]


def test_late_messages_that_wait_are_bounded_with_a_warning() -> None:
    simulation = pushed_cart()
    heard, warned = listen(simulation, "/cart/effort1/command"), logged(simulation)
    simulation.faults.add(
        "effort1/command", "topic-delay", simulation.time_ns / 1e9, simulation.time_ns / 1e9 + 1, delay=2.0
    )
    for _ in range(10_002):
        push(simulation, 1.0)
    assert [text for _, text in warned if "late messages" in text] == [
        "10000 late messages of /cart/effort1/command wait, the most: others get lost"
    ]
    simulation.step(2010)
    assert len(heard) == 10_000


# -- coming and going --------------------------------------------------------------------------------------------------


def test_what_was_removed_left_no_trace() -> None:
    simulation = running_cart(joints=2)
    model = simulation.world.model
    names = [name for name in dir(model) if name.startswith(("body_", "dof_", "jnt_", "geom_"))]

    def numbers() -> dict[str, bytes]:
        return {name: getattr(model, name).tobytes() for name in names}

    simulation.step(20)
    before, links = numbers(), dict(simulation.world.robot("cart").links)
    for kind, target in (("joint-stuck", "joint1"), ("joint-friction", "joint2"), ("payload", "box1")):
        options = {name: FAULT_OPTIONS[name] for name in KINDS[kind].options}
        simulation.faults.add(target, kind, **options)
    simulation.faults.add("joint1", "sensor-bias", bias=5.0)
    simulation.faults.add("box2", "push", force=(10.0, 0.0, 0.0))
    simulation.faults.add("joint_states", "topic-loss", probability=1.0)
    simulation.step(20)
    assert numbers() != before
    handle = simulation.robots.get("cart").hardware.driven()[0].handle
    assert handle.position == pytest.approx(state(simulation)[0] + 5.0)
    assert len(simulation.faults.remove()) == 6
    assert handle.position == state(simulation)[0]
    simulation.step(20)
    assert numbers() == before
    assert simulation.world.robot("cart").links == links
    assert simulation.faults.messages() == []
    assert not simulation.world.applied_forces.has_forces
    heard = listen(simulation, "/cart/joint_states")
    simulation.step(100)
    assert len(heard) == 5


def test_a_reset_of_the_time_repeats_the_faults_to_the_bit() -> None:
    simulation = running_cart(engine="plain")
    simulation.faults.add("joint1", "sensor-noise", 0.1, 0.3, seed=1, sd=0.1)
    simulation.faults.add("box1", "push", 0.2, 0.25, force=(100.0, 0.0, 0.0))
    simulation.faults.add("joint1", "joint-stuck", 0.35, 0.4)
    simulation.faults.add("position1", "controller-raise", 0.45)

    def run() -> tuple[list[tuple[float, float, float]], list[dict[str, Any]]]:
        simulation.reset_simulation()
        assert {fault["state"] for fault in simulation.faults.messages()} == {"waiting"}
        switch(simulation, start=["position1"], strictness=1)
        command(simulation, 1.0)
        seen = []
        for _ in range(60):
            simulation.step(10)
            seen.append(state(simulation))
        return seen, simulation.faults.messages()

    assert run() == run()


def test_a_reset_of_the_world_alone_lets_the_faults_go_on() -> None:
    simulation = pushed_cart()
    push(simulation, 10.0)
    simulation.faults.add("joint1", "joint-stuck", 0.1)
    simulation.faults.add("box1", "push", force=(10.0, 0.0, 0.0))
    simulation.step(200)
    assert state(simulation)[0] > 0.0
    simulation.reset_world()
    assert state(simulation)[:2] == (0.0, 0.0)
    simulation.step(100)
    assert state(simulation)[:2] == (0.0, 0.0)
    simulation.faults.remove("joint_stuck_1")
    simulation.step(100)
    assert state(simulation)[1] > 0.5


def test_a_slow_controller_is_slow_again_after_a_reset_of_the_time() -> None:
    simulation = pushed_cart()
    simulation.faults.add("effort1", "controller-slow", 0.001, 0.1, takes=0.01)
    simulation.step(2000)
    simulation.reset_simulation()
    push(simulation, 4.0)
    simulation.step(10)
    assert state(simulation)[2] == 0.0
    simulation.step()
    assert state(simulation)[2] == 4.0


def test_a_fault_goes_with_its_robot() -> None:
    simulation = running_cart()
    simulation.faults.add("joint1", "joint-stuck")
    simulation.faults.add("box1", "payload", mass=1.0)
    simulation.step(5)
    simulation.delete("cart")
    assert simulation.faults.messages() == []
    simulation.spawn(cart(), "cart")
    configure(simulation)
    simulation.step(5)


def test_a_controller_cannot_add_a_fault_in_the_middle_of_a_cycle() -> None:
    simulation = pushed_cart()
    refused: list[str] = []

    def take(_: dict[str, Any]) -> None:
        try:
            simulation.faults.add("joint1", "joint-stuck")
        except Refused as error:
            refused.append(str(error))

    simulation.subscribe("/cart/joint_states", take)
    simulation.step()
    assert refused == [
        "cannot add a fault in the middle of a control cycle\ndo it after the cycle: graph.timers.soon(...)"
    ]


@pytest.mark.parametrize(
    ("words", "options", "cause", "text"),
    [
        (("joint7", "joint-stuck"), {}, UnknownName, "no moving joint 'joint7'. Did you mean '/cart/joint"),
        (("nobody", "controller-kill"), {}, UnknownName, "controllers: /cart/effort1, /cart/effort2, /cart/states"),
        (("/nowhere", "topic-loss"), {"probability": 1}, UnknownName, "/cart/joint_states"),
        (("joint1", "sensor-nose"), {}, UnknownName, "Did you mean 'sensor-noise'?"),
        (("joint1", "sensor-noise"), {}, UsageError, "sensor-noise needs sd (standard deviation"),
        (("joint1", "sensor-noise"), {"sd": 1.0, "mass": 1.0}, UsageError, "no option mass\nsensor-noise takes sd, of"),
        (("joint1", "sensor-noise"), {"sd": -1.0}, UsageError, "is at least 0, not -1"),
        (("joint1", "sensor-noise"), {"sd": math.nan}, UsageError, "is a finite number, not nan"),
        (("joint1", "sensor-bias"), {"bias": 1.0, "of": "speed"}, UsageError, "position, velocity, effort and all"),
        (("joint1", "command-loss"), {"probability": 1.5}, UsageError, "is 0 to 1, not 1.5"),
        (("box1", "push"), {"force": 3.0}, UsageError, "is three numbers, not 3.0"),
        (("box1", "push"), {}, UsageError, "push changes nothing without force or torque"),
        (("box1", "push"), {"force": (0.0, 1e300, 0.0)}, UsageError, "is -1e+12 to 1e+12, not 1e+300"),
        (("box1", "payload"), {"mass": 1e300}, UsageError, "is 1e-09 to 1e+09, not 1e+300"),
        (("joint1", "joint-stuck"), {"name": "a/b"}, UsageError, "'a/b' is not a name for a fault"),
        (("joint1", "joint-stuck", 0.05), {}, Refused, "it is 0.1 s already: a fault cannot begin at 0.05 s"),
        (("joint1", "joint-stuck", 0.5, 0.4), {}, Refused, "from 0.5 s to 0.4 s never acts"),
        (("joint1", "joint-stuck", 0.5, math.nan), {}, UsageError, "nan s is not a valid duration"),
        (("joint1", "joint-stuck"), {"name": "taken"}, Refused, "there is a fault 'taken' already"),
        (("joint2", "joint-friction", 0.5), {"friction": 1.0}, Refused, "joint-stuck 'taken' is on /cart/joint2"),
    ],
)
def test_what_cannot_be_is_refused_with_the_reason(
    words: tuple[Any, ...], options: dict[str, Any], cause: type[SlidectlError], text: str
) -> None:
    simulation = pushed_cart(joints=2)
    simulation.step(99)
    simulation.faults.add("joint2", "joint-stuck", 0.2, name="taken")
    with pytest.raises(cause) as caught:
        simulation.faults.add(*words, **options)
    assert text in str(caught.value)
    assert len(simulation.faults.messages()) == 1


def test_one_after_the_other_exclude_each_other_no_more() -> None:
    simulation = pushed_cart()
    simulation.faults.add("joint1", "joint-stuck", 0.1, 0.2)
    simulation.faults.add("joint1", "joint-friction", 0.2, 0.3, friction=1.0)
    simulation.faults.add("joint1", "joint-stuck", 0.3)
    simulation.step(400)
    assert [fault["count"] for fault in simulation.faults.messages()] == [100, 100, 102]


def test_a_name_that_several_robots_have_is_ambiguous() -> None:
    simulation = pushed_cart()
    simulation.spawn(cart(), "second", pose=((0.0, 9.0, 0.0), (0.0, 0.0, 0.0, 1.0)))
    with pytest.raises(AmbiguousName):
        simulation.faults.add("joint1", "joint-stuck")
    assert simulation.faults.add("joint1", "joint-stuck", namespace="/second")["target"] == "/second/joint1"


def test_every_option_that_a_kind_needs_is_asked_for() -> None:
    simulation = pushed_cart()
    needy = {kind for kind, about in KINDS.items() if REQUIRED in about.options.values()}
    for kind in needy:
        with pytest.raises(UsageError, match=f"{kind} needs"):
            simulation.faults.add("joint1", kind)
