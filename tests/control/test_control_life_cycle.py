"""The life of a controller: which request leads where, and which hook it calls."""

# ruff: noqa: ARG002 - hooks have their arguments, wanted or not

import pytest
from fake_node import FakeGraph
from fake_robot import FakeRobot, Recorder

from slidectl.control.controller_interface import (
    Controller,
    ControllerBase,
    MissingInterface,
    MultiInterfaceController,
    State,
)
from slidectl.control.hardware_interface import EffortJointInterface, PositionJointInterface, VelocityJointInterface
from slidectl.control.loaded_controller import LoadedController
from slidectl.control.user_modules import UserCode
from slidectl.errors import Refused

HOOKS = {
    State.RUNNING: "starting",
    State.STOPPED: "stopping",
    State.WAITING: "waiting",
    State.ABORTED: "aborting",
}


def initialised(controller, robot=None):
    graph = FakeGraph()
    controller.init_request(robot or FakeRobot(), graph.node("/bot"), graph.node("/bot/c"))
    return controller


def test_a_fresh_controller_is_in_no_state_that_the_manager_knows():
    assert Recorder().state is State.CONSTRUCTED


def test_init_leads_to_initialized():
    assert initialised(Recorder()).state is State.INITIALIZED


@pytest.mark.parametrize("first", HOOKS)
@pytest.mark.parametrize("second", HOOKS)
def test_after_init_every_state_is_reached_from_any_other_by_its_hook(first, second):
    controller = initialised(Recorder())
    for state in (first, second, second):
        controller.enter_state(state, 0)
        assert controller.state is state
        assert controller.calls[-1] == HOOKS[state]
    assert len(controller.calls) == 3


@pytest.mark.parametrize("state", [State.INITIALIZED, *HOOKS])
def test_only_a_running_controller_is_updated(state):
    controller = initialised(Recorder())
    if state in HOOKS:
        controller.enter_state(state, 0)
    LoadedController("c", "test/Recorder", controller, FakeGraph().node("/bot/c"), UserCode()).update_if_running(
        1, 0.001
    )
    assert ("update" in controller.calls) is (controller.state is State.RUNNING)


def test_hooks_that_nobody_filled_in_do_nothing_but_update_must_be_there():
    class Plain(Controller):
        interface_type = EffortJointInterface

    controller = initialised(Plain())
    for state in HOOKS:
        controller.enter_state(state, 0)
    with pytest.raises(NotImplementedError):
        ControllerBase().update(0, 0.0)


def test_a_missing_interface_is_refused_by_naming_those_of_the_robot():
    with pytest.raises(MissingInterface) as refusal:
        initialised(Recorder(), FakeRobot(commands=["velocity"]))
    assert "EffortJointInterface" in str(refusal.value)
    assert "hardware_interface::VelocityJointInterface" in str(refusal.value)


class Both(MultiInterfaceController):
    interface_types = (VelocityJointInterface, EffortJointInterface)

    def init(self, hw, node):
        self.seen = hw.interface_names()
        self.others = hw.get(PositionJointInterface)
        for kind, joint in ((VelocityJointInterface, "joint1"), (EffortJointInterface, "joint2")):
            interface = hw.get(kind)
            if interface is not None:
                interface.get_handle(joint)


class Either(Both):
    allow_optional_interfaces = True


def claims(controller):
    return [
        (claim.hardware_interface.removeprefix("hardware_interface::"), claim.resources)
        for claim in controller.claimed_resources
    ]


def test_several_interfaces_are_claimed_in_the_controllers_own_order():
    robot = FakeRobot(["joint1", "joint2"], ["effort", "position", "velocity"])
    controller = initialised(Both(), robot)
    assert claims(controller) == [("VelocityJointInterface", ("joint1",)), ("EffortJointInterface", ("joint2",))]


def test_a_controller_sees_only_the_interfaces_that_it_listed():
    controller = initialised(Both(), FakeRobot(["joint1", "joint2"], ["effort", "position", "velocity"]))
    assert len(controller.seen) == 2
    assert controller.others is None


def test_each_listed_interface_must_be_there_unless_they_are_optional():
    robot = FakeRobot(["joint1", "joint2"], ["velocity"])
    with pytest.raises(MissingInterface, match="EffortJointInterface"):
        initialised(Both(), robot)
    assert claims(initialised(Either(), robot)) == [("VelocityJointInterface", ("joint1",))]


def test_claims_of_an_init_that_failed_do_not_stick_to_the_next_controller():
    class Clumsy(Recorder):
        def init(self, interface, node):
            interface.get_handle("joint1")
            raise Refused("no")

    robot = FakeRobot(["joint1", "joint2"])
    with pytest.raises(Refused):
        initialised(Clumsy(), robot)
    assert claims(initialised(Recorder(), robot)) == [("EffortJointInterface", ())]
