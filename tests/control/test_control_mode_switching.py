"""A robot whose joints change between command interfaces, and vetoes some changes: groups start, stop and swap."""

# ruff: noqa: ARG002 - hooks have their arguments, wanted or not

from collections.abc import Sequence

import pytest
from fake_robot import COMMAND_INTERFACES, Bench, FakeRobot

from slidectl.control.controller_interface import Controller, MultiInterfaceController

MODES = {"joint_pv": "pv", "joint_pe": "pe", "joint_ve": "ve"}
"""The interfaces (position, velocity, effort) that each joint can really switch to."""


def letter(claim):
    return claim.hardware_interface.removeprefix("hardware_interface::")[0].lower()


class SwitchableRobot(FakeRobot):
    """Every joint is in all interfaces. It refuses what a joint cannot do, steps down to a mode of an earlier
    letter, and joint_pe on efforts beside joint_ve on velocities."""

    def __init__(self):
        super().__init__(MODES, ["position", "velocity", "effort"])
        self.modes: dict[str, str] = {}
        self.started: set[str] = set()

    def prepare_switch(self, start: Sequence, stop: Sequence) -> bool:
        after = {joint: mode for joint, mode in self.modes.items() if joint not in joints_of(stop)}
        for joint, mode in wanted_by(start):
            if mode not in MODES[joint] or mode < self.modes.get(joint, mode):
                return False
            after[joint] = mode
        return (after.get("joint_pe"), after.get("joint_ve")) != ("e", "v")

    def do_switch(self, start: Sequence, stop: Sequence) -> None:
        starting, stopping = {info.name for info in start}, {info.name for info in stop}
        assert not starting & stopping
        assert not starting & self.started
        assert stopping <= self.started
        self.started = (self.started - stopping) | starting
        for joint in joints_of(stop):
            del self.modes[joint]
        self.modes.update(wanted_by(start))


def wanted_by(infos):
    return [(joint, letter(claim)) for info in infos for claim in info.claimed_resources for joint in claim.resources]


def joints_of(infos):
    return {joint for joint, _ in wanted_by(infos)}


def group(kind):
    class Group(Controller):
        interface_type = COMMAND_INTERFACES[kind]

        def init(self, interface, node):
            for name in node.get_param("joints"):
                interface.get_handle(name)

        def update(self, time_ns, period_s):
            pass

    return Group


GROUPS = {
    "group_pos": ("Pos", ["joint_pv", "joint_pe"]),
    "another_group_pos": ("Pos", ["joint_pv", "joint_pe"]),
    "group_vel": ("Vel", ["joint_pv", "joint_ve"]),
    "group_eff": ("Eff", ["joint_ve", "joint_pe"]),
    "single_eff": ("Eff", ["joint_pe"]),
    "single_pos": ("Pos", ["joint_pe"]),
    "invalid_group_pos": ("Pos", ["joint_ve", "joint_pe"]),
}


@pytest.fixture
def bench():
    controllers = {name: {"type": f"test/{kind}", "joints": joints} for name, (kind, joints) in GROUPS.items()}
    bench = Bench(SwitchableRobot(), controllers, Pos=group("position"), Vel=group("velocity"), Eff=group("effort"))
    bench.load(*GROUPS)
    return bench


def switch(bench, start=(), stop=()):
    """Ask for a strict switch and let a cycle pass. True when it was accepted."""
    accepted = bench.request(start, stop)
    bench.run()
    return accepted


def running(bench):
    return {name for name, state in bench.states().items() if state == "running"}


def test_what_is_not_configured_does_not_load(bench):
    assert not bench.manager.load("a_group_of_nobody")


def test_an_interface_that_a_joint_cannot_switch_to_is_vetoed(bench):
    assert not switch(bench, ["invalid_group_pos"])
    assert running(bench) == set()


def test_groups_that_share_a_joint_do_not_start_together(bench):
    assert not switch(bench, ["group_pos", "group_vel"])


@pytest.mark.parametrize("name", ["group_pos", "group_vel", "group_eff", "single_pos", "single_eff"])
def test_each_group_starts_and_stops(bench, name):
    assert switch(bench, [name])
    assert running(bench) == bench.robot.started == {name}
    assert switch(bench, stop=[name])
    assert running(bench) == bench.robot.started == set()


def test_a_group_is_swapped_for_another_of_the_same_kind(bench):
    assert switch(bench, ["group_pos"])
    assert switch(bench, ["another_group_pos"], ["group_pos"])
    assert running(bench) == bench.robot.started == {"another_group_pos"}


def test_a_change_up_is_allowed_and_one_down_is_not(bench):
    assert switch(bench, ["group_eff"])
    assert switch(bench, ["group_vel"], ["group_eff"])
    assert not switch(bench, ["group_eff"], ["group_vel"])
    assert running(bench) == {"group_vel"}


def test_combinations_are_refused_by_claims_or_by_the_hardware(bench):
    assert not switch(bench, ["single_pos", "group_eff"])
    assert "resource conflict" in bench.graph.lines("error")
    assert not switch(bench, ["single_eff", "group_vel"])
    assert "hardware cannot run" in bench.graph.lines("error")
    assert switch(bench, ["single_pos", "group_vel"])
    assert running(bench) == {"single_pos", "group_vel"}
    assert switch(bench, stop=["single_pos", "group_vel"])
    assert bench.robot.modes == {}


def test_a_running_group_cannot_be_restarted_by_one_switch(bench):
    assert switch(bench, ["group_pos"])
    assert not switch(bench, ["group_pos"], ["group_pos"])
    assert running(bench) == {"group_pos"}


def test_a_controller_that_conflicts_with_itself_does_not_start(bench):
    class Selfish(MultiInterfaceController):
        interface_types = (COMMAND_INTERFACES["velocity"], COMMAND_INTERFACES["effort"])

        def init(self, hw, node):
            for kind in self.interface_types:
                hw.get(kind).get_handle("joint_ve")

    bench.register(Selfish=Selfish)
    bench.graph.set("/bot/selfish", {"type": "test/Selfish"})
    bench.load("selfish")
    assert not switch(bench, ["selfish"])
    assert "joint_ve is claimed by selfish and selfish" in bench.graph.lines("error")
