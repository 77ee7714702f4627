"""Whatever fails in the middle of a spawn, a deletion or a reset: the world is as before, or the robot is gone."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import mujoco
import pytest
from sim_robots import cart, command, drive_up, logged, put_probe, state, switch

from slidectl.errors import Refused, SlidectlError
from slidectl.names import join
from slidectl.physics import hulls, world
from slidectl.physics.attached_robot import AttachedRobot
from slidectl.physics.world_spec import WorldSpec
from slidectl.simulation import Simulation, spawned_robots
from slidectl.simulation.compiled import object_file
from slidectl.simulation.loop import Loop
from slidectl.simulation.topics import TypeConflict

needs_numba = pytest.mark.skipif(not object_file.is_possible(), reason="numba is not installed")
ENGINES = ["plain", pytest.param("compiled", marks=needs_numba)]

TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"

LINK = """<link name="{}"><inertial><mass value="1"/>
  <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>"""
WHEEL = '<joint name="{0}" type="{1}"><parent link="base"/><child link="{0}_link"/><axis xyz="0 1 0"/></joint>'
SENSOR = """<gazebo reference="base"><sensor type="{0}" name="{0}"><update_rate>10</update_rate>
  <plugin name="{0}" filename="libgazebo_ros_{1}.so">{2}</plugin></sensor></gazebo>"""
TALKATIVE = f"""<robot name="thing">{LINK.format("base")}
  {
    "".join(
        LINK.format(f"{name}_link") + WHEEL.format(name, kind)
        for name, kind in (("left", "continuous"), ("right", "continuous"), ("mast", "fixed"))
    )
}
  {SENSOR.format("ray", "laser", "<topicName>scan</topicName>")}
  {SENSOR.format("imu", "imu_sensor", "<topicName>imu</topicName>")}
  {
    SENSOR.format(
        "camera",
        "camera",
        "<imageTopicName>image</imageTopicName><cameraInfoTopicName>camera_info</cameraInfoTopicName>",
    )
}
  <gazebo><plugin name="drive" filename="libgazebo_ros_diff_drive.so"><leftJoint>left</leftJoint>
    <rightJoint>right</rightJoint><robotBaseFrame>base</robotBaseFrame></plugin></gazebo></robot>"""
"""A model with sensors, a camera, a drive and a link on a fixed joint."""


@pytest.fixture
def mesh(tmp_path: Path) -> Path:
    path = tmp_path / "tetrahedron.obj"
    path.write_text(TETRAHEDRON, "utf-8")
    return path


def with_mesh(path: Path) -> str:
    """A cart that collides as a mesh file."""
    shape = f'<collision><geometry><mesh filename="file://{path}"/></geometry></collision></link>'
    return cart().replace("</inertial></link>", f"</inertial>{shape}")


def world_with_two(mesh: Path, engine: str) -> Simulation:
    """A cart with a mesh and one without, both driven."""
    simulation = Simulation(ground=False, engine=engine)
    if engine == "compiled":
        simulation.engine.complete()
    simulation.spawn(with_mesh(mesh), "m")
    simulation.spawn(cart(), "other")
    for name in ("m", "other"):
        drive_up(simulation, f"/{name}")
        command(simulation, 1.0, f"/{name}/position1/command")
    simulation.step(100)
    return simulation


def everything(simulation: Simulation) -> Any:
    """All that can be seen of who is there."""
    graph = simulation.graph
    names = (simulation.robots.names(), simulation.world.names(), graph.services.names(), graph.topics.types())
    listed = simulation.call("/slidectl/list_robots")["robots"]
    return (*names, graph.parameters.get("/"), [{**robot, "joints": len(robot["joints"])} for robot in listed])


def course(simulation: Simulation, name: str) -> list[tuple[float, float, float]]:
    """Where a cart goes in the cycles to come."""
    states = []
    for _ in range(20):
        simulation.step(20)
        states.append(state(simulation, name))
    return states


@pytest.mark.parametrize("engine", ENGINES)
def test_no_robot_needs_its_files_any_more_once_it_is_there(mesh: Path, engine: str) -> None:
    simulation, untouched = world_with_two(mesh, engine), world_with_two(mesh, engine)
    mesh.unlink()
    simulation.delete("other")
    assert simulation.robots.names() == simulation.world.names() == ["m"]
    simulation.spawn(cart(), "other")
    simulation.spawn(cart(), "third")
    simulation.reset_world()
    untouched.reset_world()
    assert course(simulation, "m") == course(untouched, "m")
    simulation.delete("m")
    with pytest.raises(SlidectlError, match=r"m.*tetrahedron\.obj"):
        simulation.spawn(with_mesh(mesh), "m")
    assert simulation.robots.names() == simulation.world.names() == ["other", "third"]


def test_a_file_that_has_changed_counts_for_those_who_come_after(mesh: Path) -> None:
    simulation = Simulation()
    simulation.spawn(with_mesh(mesh), "a")
    mesh.write_text(TETRAHEDRON.replace("1", "2", 3).replace("f 2", "f 1"), "utf-8")
    simulation.spawn(with_mesh(mesh), "b")
    (first,), (second,) = (simulation.world.robot(name).hulls.values() for name in "ab")
    assert isinstance(first, hulls.Hull)
    assert first != second


def failing(error: Exception) -> Callable[..., Any]:
    """Fails whenever it is called."""

    def fail(*_: Any, **__: Any) -> Any:
        raise error

    return fail


def fails_once(patch: pytest.MonkeyPatch, owner: Any, name: str) -> None:
    """The first call of a function fails; those on the way back succeed."""
    fails, original = [True], getattr(owner, name)

    def once(*arguments: Any, **keywords: Any) -> Any:
        if fails and fails.pop():
            raise MemoryError(name)
        return original(*arguments, **keywords)

    patch.setattr(owner, name, once)


OF_DELETIONS = {
    "MuJoCo's compilation": (WorldSpec, "compile"),
    "taking it out of the specification": (WorldSpec, "remove"),
    "finding the robots again": (AttachedRobot, "bind"),
    "a listener of a robot": (AttachedRobot, "announce"),
    "the memory of the state": (mujoco, "MjData"),
    "carrying over the state": (world, "carry_over"),
}
OF_SPAWNS = {
    "carrying over the state": (world, "carry_over"),
    "putting it there": (AttachedRobot, "reset_to_spawn"),
    "bringing it up": (spawned_robots.Robots, "_bring_up_control"),
    "its hardware": (spawned_robots, "MujocoRobotHW"),
    "its manager": (spawned_robots, "ControllerManager"),
    "its services": (spawned_robots, "ManagerServices"),
    "telling the loop": (Loop, "set_robots"),
    "its report": (spawned_robots, "_warn_of_overlaps"),
}


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("place", list(OF_DELETIONS))
def test_a_deletion_that_fails_leaves_the_robot_where_it_is(
    mesh: Path, engine: str, place: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    simulation, untouched = world_with_two(mesh, engine), world_with_two(mesh, engine)
    before = everything(simulation)
    with monkeypatch.context() as patch:
        fails_once(patch, *OF_DELETIONS[place])
        with pytest.raises(MemoryError):
            simulation.delete("m")
    assert everything(simulation) == before
    assert course(simulation, "m") == course(untouched, "m")
    assert course(simulation, "other") == course(untouched, "other")
    simulation.delete("m")
    untouched.delete("m")
    assert simulation.robots.names() == simulation.world.names() == ["other"]
    assert course(simulation, "other") == course(untouched, "other")
    simulation.spawn(with_mesh(mesh), "m")


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("place", list(OF_SPAWNS))
def test_a_spawn_that_fails_anywhere_leaves_nothing_behind(
    mesh: Path, engine: str, place: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    simulation, untouched = world_with_two(mesh, engine), world_with_two(mesh, engine)
    before = everything(simulation)
    with monkeypatch.context() as patch:
        fails_once(patch, *OF_SPAWNS[place])
        with pytest.raises(MemoryError):
            simulation.spawn(with_mesh(mesh), "third")
    assert everything(simulation) == before
    for name in ("m", "other"):
        assert course(simulation, name) == course(untouched, name)
    mesh.unlink()  # the world was built anew, and not from the files
    for other in (simulation, untouched):
        other.spawn(cart(), "third")
        other.delete("m")
    for name in ("other", "third"):
        assert course(simulation, name) == course(untouched, name)


@pytest.mark.parametrize("topic", ["imu", "camera_info", "odom", "/tf_static"])
def test_a_topic_that_cannot_be_had_leaves_none_of_the_others_behind(topic: str) -> None:
    simulation = Simulation()
    simulation.graph.topics.advertise(join("/thing", topic), "std_msgs/String", "/other")
    before = everything(simulation)
    with pytest.raises(TypeConflict):
        simulation.spawn(TALKATIVE, "thing")
    assert everything(simulation) == before


@pytest.mark.parametrize("engine", ENGINES)
def test_whoever_fails_when_a_robot_goes_does_not_keep_it(mesh: Path, engine: str) -> None:
    """A controller's stop, what it takes back, a listener: the robot is gone, and the log says what went wrong."""
    simulation = world_with_two(mesh, engine)
    lines = logged(simulation)
    robot = simulation.robots.get("m")
    probe = put_probe(simulation, robot)
    simulation.call("/m/controller_manager/switch_controller", {"stop_controllers": ["position1"], "strictness": 2})
    assert switch(simulation, start=["probe"], namespace="/m")
    loaded: Any = robot.manager.get("probe")
    loaded.stopping = failing(ZeroDivisionError("in stopping"))
    robot.cleanup.callback(failing(MemoryError("in a part")))
    robot.node.watch_param("anything", lambda: None)
    robot.node._closers.append(failing(OSError("in a publisher")))
    simulation.delete("m")
    assert probe is loaded.probe
    assert simulation.robots.names() == simulation.world.names() == ["other"]
    assert not [name for name in simulation.graph.services.names() if name.startswith("/m/")]
    assert "/m" not in simulation.graph.nodes()
    assert not simulation.parameters.has("/m/robot_description")
    told = " ".join(text for severity, text in lines if severity in ("error", "fatal"))
    assert "in stopping" in told
    assert "m is deleted, but not all went well" in told
    simulation.spawn(with_mesh(mesh), "m")
    simulation.step(20)


def test_a_deleted_robot_takes_its_forces_along_and_one_that_stays_keeps_them(mesh: Path) -> None:
    simulation = world_with_two(mesh, "plain")
    for name in ("m", "other"):
        simulation.world.add_joint_force(name, "joint1", 3.0, simulation.time_ns, -1)
    simulation.step(1)
    simulation.delete("m")
    simulation.step(1)
    assert [force.robot for force in simulation.world.applied_forces.joint_forces] == ["other"]
    simulation.delete("other")
    assert simulation.world.steps_alone
    simulation.step(1)


def test_a_reset_reaches_every_robot_even_if_one_of_them_fails(mesh: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    simulation = world_with_two(mesh, "plain")
    monkeypatch.setattr(simulation.robots.get("m").hardware, "reset", failing(MemoryError("in the hardware")))
    with pytest.raises(MemoryError):
        simulation.reset_simulation()
    assert simulation.time_ns == 0
    assert state(simulation, "other") == (0.0, 0.0, 0.0)
    assert simulation.robots.get("other").cycle.last_update_ns == 0


def test_properties_of_the_physics_are_set_all_or_not_at_all(mesh: Path) -> None:
    simulation = world_with_two(mesh, "plain")
    before = simulation.call("/gazebo/get_physics_properties")
    asked = {"time_step": 0.002, "max_update_rate": 100.0, "gravity": {"z": -1.0}}
    for wrong in ({"time_step": 0.0}, {"max_update_rate": -1.0}, {"gravity": {"z": float("nan")}}):
        with suppress(SlidectlError):
            assert not simulation.call("/gazebo/set_physics_properties", asked | wrong)["success"]
        assert simulation.call("/gazebo/get_physics_properties") == before
    answers: list[Any] = []
    probe = put_probe(simulation, simulation.robots.get("m"))
    simulation.call("/m/controller_manager/switch_controller", {"stop_controllers": ["position1"], "strictness": 2})
    assert switch(simulation, start=["probe"], namespace="/m")
    probe.act = lambda _: answers.append(
        simulation.graph.services.call("/gazebo/set_physics_properties", asked).result()
    )
    simulation.step(1)
    assert not answers[0]["success"]
    assert simulation.call("/gazebo/get_physics_properties") == before


def test_a_refusal_of_a_part_comes_after_the_mesh_was_read_and_leaves_nothing(mesh: Path) -> None:
    simulation = world_with_two(mesh, "plain")
    before = everything(simulation)
    simulation.robots.on_spawn.append(failing(Refused("not with me")))
    answer = simulation.call("/gazebo/spawn_urdf_model", {"model_name": "third", "model_xml": with_mesh(mesh)})
    assert not answer["success"]
    assert "not with me" in answer["status_message"]
    assert everything(simulation) == before
