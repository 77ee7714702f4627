"""Loading, listing and unloading controllers, and what a cycle does with them."""

# ruff: noqa: ARG002, ARG005 - hooks have their arguments, wanted or not

import pytest
from fake_node import FakeGraph
from fake_robot import Bench, FakeRobot, Recorder

from slidectl.control.controller_interface import MultiInterfaceController
from slidectl.control.controller_manager import ControllerManager
from slidectl.control.hardware_interface import EffortJointInterface, PositionJointInterface, VelocityJointInterface
from slidectl.errors import Refused


class VelocityAndEffort(MultiInterfaceController):
    interface_types = (VelocityJointInterface, EffortJointInterface)

    def init(self, hw, node):
        for kind, key in ((VelocityJointInterface, "velocity_joints"), (EffortJointInterface, "effort_joints")):
            for name in node.get_param(key, []):
                hw.get(kind).get_handle(name)

    def update(self, time_ns, period_s):
        pass


class NeedsPosition(VelocityAndEffort):
    interface_types = (PositionJointInterface, EffortJointInterface)


class Optional(NeedsPosition):
    allow_optional_interfaces = True

    def init(self, hw, node):
        hw.get(EffortJointInterface).get_handle("joint1")


class Derived(Recorder):
    """A controller made by deriving from another."""


CONTROLLERS = {
    "mine": {"joints": ["joint2", "joint1"]},
    "other": {"joints": ["joint3"]},
    "lost": {"joints": ["joint9"]},
    "typeless": {"type": 5},
    "unknown": {"type": "test/Nothing"},
    "vel_eff": {"type": "test/VelEff", "velocity_joints": ["joint2", "joint1"], "effort_joints": ["joint3"]},
    "self_conflict": {"type": "test/VelEff", "velocity_joints": ["joint1"], "effort_joints": ["joint1"]},
    "needs_position": {"type": "test/NeedsPosition"},
    "optional": {"type": "test/Optional"},
    "derived": {"type": "test/Derived"},
}


@pytest.fixture
def bench():
    robot = FakeRobot(["joint1", "joint2", "joint3"], ["effort", "velocity"])
    return Bench(
        robot, CONTROLLERS, VelEff=VelocityAndEffort, NeedsPosition=NeedsPosition, Optional=Optional, Derived=Derived
    )


@pytest.mark.parametrize("name", ["mine", "vel_eff", "optional", "derived"])
def test_single_multi_optional_and_derived_controllers_load_and_unload(bench, name):
    bench.load(name)
    assert bench.states() == {name: "initialized"}
    assert bench.manager.unload(name)
    assert bench.states() == {}


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("nowhere", "parameter /bot/nowhere/type is not set"),
        ("typeless", "parameter /bot/typeless/type is not set"),
        ("unknown", "no controller type 'test/Nothing'"),
        ("lost", "no joint 'joint9' in hardware_interface::EffortJointInterface"),
        ("needs_position", "needs hardware_interface::PositionJointInterface"),
        ("no-name", "not a legal name"),
        ("~mine", "not a legal name"),
        ("", "not a legal name"),
    ],
)
def test_what_cannot_be_loaded_is_refused_with_its_reason_and_leaves_nothing(bench, name, reason):
    assert not bench.manager.load(name)
    assert reason in bench.graph.lines("error")
    assert "\n" not in bench.graph.log[-1][1]
    assert bench.manager.list() == []
    assert bench.graph.subscribers == bench.graph.publishers == bench.graph.services == {}


def test_a_controller_is_loaded_only_once(bench):
    bench.load("mine")
    assert not bench.manager.load("mine")
    assert "'mine': it is loaded already" in bench.graph.lines("error")


def test_an_init_that_raises_anything_is_a_load_that_failed(bench):
    class Broken(Recorder):
        def init(self, interface, node):
            node.advertise("state", "std_msgs/Float64")
            raise ZeroDivisionError("oops")

    bench.register(Recorder=Broken)
    assert not bench.manager.load("mine")
    assert "ZeroDivisionError: oops (" in bench.graph.lines("error")
    assert bench.graph.publishers == {}


def test_a_running_controller_is_unloaded_only_after_it_was_stopped(bench):
    bench.start("mine")
    assert not bench.manager.unload("mine")
    assert "running; stop it first" in bench.graph.lines("error")
    bench.request(stop=["mine"])
    bench.run()
    assert bench.manager.unload("mine")


def test_what_is_not_loaded_cannot_be_unloaded(bench):
    bench.load("mine")
    assert not bench.manager.unload("mien")
    assert "Did you mean 'mine'?" in bench.graph.lines("error")


def test_unloading_takes_back_what_the_controller_offered(bench):
    class Offering(Recorder):
        def init(self, interface, node):
            node.subscribe("command", "std_msgs/Float64", lambda message: None)

    bench.register(Recorder=Offering)
    bench.load("mine")
    assert list(bench.graph.subscribers) == ["/bot/mine/command"]
    assert bench.manager.unload("mine")
    assert bench.graph.subscribers == {}


def test_the_list_keeps_the_load_order_and_shows_states_types_and_claims(bench):
    bench.load("vel_eff")
    bench.start("mine")
    assert bench.manager.list() == [
        {
            "name": "vel_eff",
            "state": "initialized",
            "type": "test/VelEff",
            "claimed_resources": [
                {"hardware_interface": "hardware_interface::VelocityJointInterface", "resources": ["joint1", "joint2"]},
                {"hardware_interface": "hardware_interface::EffortJointInterface", "resources": ["joint3"]},
            ],
        },
        {
            "name": "mine",
            "state": "running",
            "type": "test/Recorder",
            "claimed_resources": [
                {"hardware_interface": "hardware_interface::EffortJointInterface", "resources": ["joint1", "joint2"]}
            ],
        },
    ]
    assert bench.manager.names() == ["vel_eff", "mine"]
    assert isinstance(bench.manager.get("mine"), Recorder)
    assert bench.manager.get("nobody") is None
    assert len(bench.manager.running) == 1


def test_types_come_with_their_base_classes(bench):
    types, bases = bench.manager.types(), bench.manager.base_classes()
    assert {"joint_state_controller/JointStateController", "effort_controllers/JointPositionController"} <= set(types)
    assert "test/Recorder" in types
    assert len(types) == len(bases)
    assert set(bases) == {"controller_interface::ControllerBase"}


def test_controllers_are_updated_in_load_order_and_only_while_running(bench):
    order = []

    def noting(name):
        class Noting(Recorder):
            def update(self, time_ns, period_s):
                order.append((name, time_ns, period_s))

        return Noting

    for name in ("other", "mine", "derived"):
        bench.register(Recorder=noting(name), Derived=noting(name))
        bench.load(name)
    bench.request(start=["mine", "other"])
    bench.run()
    assert order == []
    bench.run()
    assert order == [("other", 2_000_000, 0.001), ("mine", 2_000_000, 0.001)]


def test_a_reset_stops_and_starts_each_running_controller_before_its_update(bench):
    bench.start("mine", "other")
    bench.load("derived")
    bench.run(reset_controllers=True)
    assert bench.calls("mine") == bench.calls("other") == ["starting", "stopping", "starting", "update"]
    assert bench.calls("derived") == []


class TestFailingControllers:
    """What a controller's code raises ends that controller, and nothing else."""

    @pytest.fixture
    def failing(self, bench):
        class Failing(Recorder):
            fails_in = ()

            def _called(self, hook):
                self.calls.append(hook)
                if hook in self.fails_in:
                    raise ValueError(f"broken {hook}")

            def starting(self, time_ns):
                self._called("starting")

            def update(self, time_ns, period_s):
                self._called("update")

            def stopping(self, time_ns):
                self._called("stopping")

            def aborting(self, time_ns):
                self._called("aborting")

        bench.register(Derived=Failing)
        return Failing

    def test_a_failing_update_aborts_its_controller_and_the_others_go_on(self, bench, failing):
        bench.start("mine", "derived", "other")
        failing.fails_in = ("update",)
        bench.run(2)
        assert bench.states() == {"mine": "running", "derived": "aborted", "other": "running"}
        assert bench.calls("derived") == ["starting", "update", "aborting"]
        assert bench.calls("mine") == bench.calls("other") == ["starting", "update", "update"]
        fatal = bench.graph.lines("fatal")
        assert "'derived' failed in update and is aborted: ValueError: broken update" in fatal
        assert fatal.count("\n") == 0

    def test_two_failures_in_one_cycle_abort_both(self, bench, failing):
        failing.fails_in = ("update",)
        bench.register(Recorder=failing)
        bench.start("mine", "other")
        bench.run()
        assert bench.states() == {"mine": "aborted", "other": "aborted"}

    @pytest.mark.parametrize("hook", ["starting", "stopping"])
    def test_a_failing_hook_aborts_its_controller(self, bench, failing, hook):
        failing.fails_in = (hook,)
        bench.start("derived")
        bench.run(reset_controllers=True)
        assert bench.states() == {"derived": "aborted"}

    def test_a_controller_that_fails_even_while_aborting_is_aborted(self, bench, failing):
        bench.start("derived")
        failing.fails_in = ("update", "aborting")
        bench.run()
        assert bench.states() == {"derived": "aborted"}
        assert "failed while aborting: ValueError: broken aborting" in bench.graph.lines("fatal")

    def test_an_aborted_controller_can_be_started_again(self, bench, failing):
        bench.start("derived")
        failing.fails_in = ("update",)
        bench.run()
        failing.fails_in = ()
        assert bench.request(start=["derived"])
        bench.run()
        assert bench.states() == {"derived": "running"}


class TestReload:
    def test_an_empty_manager_has_nothing_in_the_way(self, bench):
        assert bench.manager.reload_libraries(force_kill=False)

    def test_loaded_controllers_are_in_the_way(self, bench):
        bench.load("mine", "other")
        assert not bench.manager.reload_libraries(force_kill=False)
        assert "2 controllers are loaded" in bench.graph.lines("error")

    def test_force_stops_and_unloads_them(self, bench):
        bench.start("mine")
        bench.load("other")
        mine = bench.manager.get("mine")
        assert bench.manager.reload_libraries(force_kill=True)
        assert bench.manager.list() == []
        assert mine.calls == ["starting", "stopping"]


def test_a_manager_of_a_robot_without_interfaces_has_no_controllers_but_works():
    graph = FakeGraph()
    manager = ControllerManager(FakeRobot(joints=(), commands=()), graph.node("/bot"))
    manager.update(1_000_000, 0.001)
    assert manager.list() == []
    assert not manager.switching


def test_a_refusing_controller_gives_its_reason_on_one_line(bench):
    class Refusing(Recorder):
        def init(self, interface, node):
            raise Refused("not today", "come back tomorrow")

    bench.register(Recorder=Refusing)
    bench.manager.load("mine")
    assert bench.graph.log[-1] == ("error", "cannot load controller 'mine': not today; come back tomorrow")
