"""What sensors measure, odometry and paths in the scene; and the ghost of a goal. Browsers speak viser's protocol."""

from __future__ import annotations

import base64
import math
from collections.abc import Iterator
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from page_browser import CommandLine, PageBrowser, served_page
from waiting import eventually

SCANNER = """<robot name="scanner"><link name="world"/><joint name="j" type="fixed"><parent link="world"/>
<child link="mast"/><origin xyz="5 0 0.5" rpy="0 0 3.141592653589793"/></joint>
<link name="mast"><inertial><mass value="2"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
<visual><geometry><box size="0.2 0.2 0.2"/></geometry></visual></link>
<link name="wall"><inertial><mass value="2"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
<collision><geometry><box size="0.2 4 4"/></geometry></collision></link>
<joint name="k" type="fixed"><parent link="world"/><child link="wall"/><origin xyz="2.9 0 0"/></joint>
<gazebo reference="mast"><sensor type="ray" name="eye"><update_rate>20</update_rate><ray><scan><horizontal>
<samples>3</samples><min_angle>-0.5</min_angle><max_angle>0.5</max_angle></horizontal></scan>
<range><min>0.15</min><max>10</max></range></ray><plugin name="p" filename="libgazebo_ros_laser.so">
<topicName>scan</topicName><frameName>mast</frameName></plugin></sensor></gazebo>
<gazebo><plugin name="c" filename="libgazebo_ros_control.so"><robotNamespace>/scanner</robotNamespace></plugin></gazebo>
</robot>"""


def show(browser: PageBrowser, topic: str, shown: bool = True) -> None:
    browser.page("sensor", topic=topic, shown=shown)


def trouble(browser: PageBrowser, topic: str) -> str:
    """Why nothing is drawn of a topic that is shown."""
    return str(browser.page("state")["view"]["sensors"][topic])


def points(browser: PageBrowser, node: str, name: str = "points") -> np.ndarray:
    """Points of a node: n x 3."""
    return np.array(browser.nodes[node][name]).reshape(-1, 3)


@pytest.fixture
def scanner(world: CommandLine, tmp_path: Path) -> Iterator[str]:
    """The topic of a laser at x = 5 that looks at a wall 2 m away, at x = 3."""
    (tmp_path / "scanner.urdf").write_text(SCANNER, "utf-8")
    world.ok("spawn", str(tmp_path / "scanner.urdf"))
    yield "/scanner/scan"
    if "scanner" in world.ok("robots"):
        world.ok("delete", "scanner")


def test_a_laser_is_drawn_in_its_frame_while_it_is_shown(
    world: CommandLine, page: str, scanner: str, browser: PageBrowser
) -> None:
    node = "/sensors/scanner.scan"
    with world.client() as client:

        def subscribers() -> list[str]:
            return list(client.call("/rosapi/subscribers", {"topic": scanner})["subscribers"])

        browser.wait_for(lambda: "/robots/scanner/mast" in browser.nodes)
        assert not subscribers()
        show(browser, scanner)
        browser.wait_for(subscribers)
        assert trouble(browser, scanner) == "No message has come yet."
        browser.wait_for(lambda: client.step(100) and browser.nodes.get(node, {}).get("visible"))
        assert trouble(browser, scanner) == ""
        assert points(browser, node)[1] == pytest.approx((2.0, 0.0, 0.0), abs=1e-5)
        browser.wait_for(lambda: np.allclose(browser.nodes[node]["position"], (5.0, 0.0, 0.5)))
        browser.close()
        eventually(lambda: not subscribers(), "the page still listens, and no browser is there")
        with PageBrowser(page) as again:
            again.wait_for(subscribers)
            show(again, scanner, False)
            again.wait_for(lambda: node not in again.nodes and not subscribers())


def test_a_robot_that_goes_takes_its_sensors_along(world: CommandLine, scanner: str, browser: PageBrowser) -> None:
    show(browser, scanner)
    with world.client() as client:
        browser.wait_for(lambda: client.step(100) and "/sensors/scanner.scan" in browser.nodes)
        world.ok("delete", "scanner")
        browser.wait_for(lambda: "/sensors/scanner.scan" not in browser.nodes)
        assert browser.page("state")["view"]["sensors"] == {}
        assert "no topic" in browser.refusal("sensor", topic=scanner, shown=True)
        assert "is not drawn in the scene" in browser.refusal("sensor", topic="/clock", shown=True)


def header(frame: str) -> dict[str, Any]:
    return {"seq": 0, "stamp": {"secs": 0, "nsecs": 0}, "frame_id": frame}


def cloud(count: int, frame: str = "link2") -> dict[str, Any]:
    """A sensor_msgs/PointCloud2 of points at x = 1, the first of which are red."""
    data = np.zeros(count, dtype=[("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("rgb", "<u4")])
    data["x"], data["z"], data["rgb"] = 1.0, np.arange(count) / count, 0x00FF0000
    fields = [
        {"name": name, "offset": 4 * place, "datatype": 7, "count": 1} for place, name in enumerate(data.dtype.names)
    ]
    return {
        "header": header(frame), "height": 1, "width": count, "fields": fields, "is_bigendian": False, "point_step": 16,
        "row_step": 16 * count, "data": base64.b64encode(data.tobytes()).decode(), "is_dense": True,
    }  # fmt: skip


RANGE = {"header": header("link2"), "field_of_view": 0.5, "min_range": 0.1, "max_range": 4.0, "range": 1.5}
WRENCH = {
    "header": header("link2"),
    "wrench": {"force": {"x": 0.0, "y": 0.0, "z": 9.0}, "torque": {"x": 1.0, "y": 0.0, "z": 0.0}},
}
PATH = {
    "header": header("world"),
    "poses": [{"header": header("world"), "pose": {"position": {"x": float(x), "y": 0.0, "z": 0.0}}} for x in range(5)],
}


@pytest.mark.parametrize(
    ("kind", "message", "prop", "count"),
    [
        ("sensor_msgs/PointCloud2", cloud(50), "points", 50),
        ("sensor_msgs/PointCloud2", cloud(50_001), "points", 16_667),  # each third
        ("sensor_msgs/Range", RANGE, "vertices", 26),
        ("geometry_msgs/WrenchStamped", WRENCH, "points", 4),
        ("nav_msgs/Path", PATH, "points", 8),
    ],
)
def test_a_message_is_drawn(
    world: CommandLine, browser: PageBrowser, kind: str, message: dict[str, Any], prop: str, count: int
) -> None:
    with world.client() as client:
        client.advertise("/seen", kind, latch=True)
        client.publish("/seen", message, kind, latch=True)
        client.flush()
        show(browser, "/seen")
        browser.wait_for(lambda: prop in browser.nodes.get("/sensors/seen", {}))
        assert len(points(browser, "/sensors/seen", prop)) == count
        assert trouble(browser, "/seen") == ""
        show(browser, "/seen", False)
        browser.wait_for(lambda: "/sensors/seen" not in browser.nodes)


@pytest.mark.parametrize(
    ("kind", "message", "told"),
    [
        ("sensor_msgs/PointCloud2", {**cloud(5), "fields": []}, "has no fields x, y and z"),
        ("sensor_msgs/PointCloud2", {**cloud(5), "width": 500, "row_step": 8000}, "does not have the data"),
        ("sensor_msgs/PointCloud2", {**cloud(5), "height": 4_000_000_000, "row_step": 0}, "row_step is too small"),
        ("sensor_msgs/PointCloud2", {**cloud(5), "point_step": 0}, "does not have the data"),
        ("sensor_msgs/PointCloud2", cloud(5, "nowhere"), "There is no frame 'nowhere'"),
        ("nav_msgs/Path", {**PATH, "poses": [{"pose": {"position": {"x": math.nan}}}] * 3}, "is nan"),
        (
            "sensor_msgs/PointCloud2",
            {**cloud(5), "fields": [{**one, "datatype": 0} for one in cloud(5)["fields"]]},
            "does not have the data",
        ),
    ],
)
def test_what_cannot_be_drawn_is_told_in_one_sentence(
    world: CommandLine, browser: PageBrowser, kind: str, message: dict[str, Any], told: str
) -> None:
    with world.client() as client:
        client.publish("/seen", message, kind, latch=True)
        client.flush()
        show(browser, "/seen")
        browser.wait_for(lambda: told in trouble(browser, "/seen"), f"it does not tell {told}")
        show(browser, "/seen", False)


def test_an_odometry_goes_on_after_a_place_that_is_nan(world: CommandLine, browser: PageBrowser) -> None:
    with world.client() as client:
        for x in (math.nan, 0.0, 1.0, 2.0):
            place = {"header": header("world"), "pose": {"pose": {"position": {"x": x}, "orientation": {"w": 1.0}}}}
            client.publish("/way", place, "nav_msgs/Odometry", latch=True)
            client.flush()
            if math.isnan(x):
                show(browser, "/way")
                browser.wait_for(lambda: "is nan" in trouble(browser, "/way"))
            else:
                browser.wait_for(lambda: trouble(browser, "/way") == "")
                browser.take(0.3)
        browser.wait_for(lambda: points(browser, "/sensors/way")[-1][0] == 2.0)
        show(browser, "/way", False)


def test_a_topic_is_shown_once_by_any_of_its_names(world: CommandLine, browser: PageBrowser) -> None:
    with world.client() as client:
        client.publish("/seen", cloud(5), "sensor_msgs/PointCloud2", latch=True)
        client.flush()
        show(browser, "seen")
        show(browser, "/seen")
        assert list(browser.page("state")["view"]["sensors"]) == ["/seen"]
        show(browser, "/seen", False)


def test_frames_of_tf_are_found(world: CommandLine, browser: PageBrowser) -> None:
    """A frame below a link, and one above the robot, as `odom` is."""
    with world.client() as client:
        stamped = {"header": header("link2"), "child_frame_id": "eye",
                   "transform": {"translation": {"x": 0.0, "y": 0.5, "z": 0.0}, "rotation": {"w": 1.0}}}  # fmt: skip
        client.publish("/tf_static", {"transforms": [stamped]}, "tf2_msgs/TFMessage", latch=True)
        client.publish("/seen", cloud(5, "eye"), "sensor_msgs/PointCloud2", latch=True)
        client.flush()
        show(browser, "/seen")
        browser.wait_for(lambda: "position" in browser.nodes.get("/sensors/seen", {}))
        x, y, _ = browser.nodes["/robots/slider/link2"]["position"]
        browser.wait_for(lambda: np.allclose(browser.nodes["/sensors/seen"]["position"][:2], (x, y + 0.5)))
        show(browser, "/seen", False)


def test_the_way_of_a_base_begins_where_it_stands(world: CommandLine, browser: PageBrowser) -> None:
    """The frames of both bases are called odom."""
    car = ("--controllers", "config/car_control.yaml", "--start", "base_controller")
    world.ok("spawn", "car", "--at", "0", "3", "0", *car)
    world.ok("spawn", "car", "-n", "other", "--at", "0", "-3", "0", *car)
    try:
        topic, node = "/car/base_controller/odom", "/sensors/car.base_controller.odom"
        others = "/sensors/other.base_controller.odom"
        with world.client() as client:
            browser.wait_for(lambda: {"/robots/car/body", "/robots/other/body"} <= browser.nodes.keys())
            show(browser, topic)
            show(browser, "/other/base_controller/odom")

            def has_come_far() -> bool:
                for name in ("car", "other"):
                    client.publish(f"/{name}/base_controller/cmd_vel", {"linear": {"x": 1.0}})
                client.step(100)
                seen = [one for one in (node, others) if "points" in browser.nodes.get(one, {})]
                return len(seen) == 2 and all(points(browser, one)[-1][0] > 0.3 for one in seen)

            browser.wait_for(has_come_far)
            # The scene and the message may be a step apart.
            assert browser.nodes[node]["position"] == pytest.approx((0.0, 3.0, 0.0), abs=0.15)
            assert browser.nodes[others]["position"] == pytest.approx((0.0, -3.0, 0.0), abs=0.15)
            assert not client.call("/rosapi/subscribers", {"topic": "/tf"})["subscribers"]
    finally:
        world.ok("delete", "car")
        world.ok("delete", "other")


def test_the_ghost_of_a_goal_is_where_the_arm_will_be(world: CommandLine, browser: PageBrowser) -> None:
    world.ok("spawn", "arm", "--at", "2", "0", "0", "--controllers", "config/arm_control.yaml")
    try:
        browser.wait_for(lambda: "/robots/arm/flange" in browser.nodes)
        positions = {"joint1": math.pi / 2, "joint2": 0.5}

        def is_shown() -> bool:
            browser.page("ghost", robot="arm", positions=positions)
            return bool(browser.nodes.get("/ghost/flange", {}).get("visible"))

        browser.wait_for(is_shown)
        with world.client() as client:
            for joint, position in positions.items():
                request = {"model_name": "arm", "joint_names": [joint], "joint_positions": [position]}
                client.call("/gazebo/set_model_configuration", request)
        goal = browser.nodes["/ghost/flange"]["position"]
        browser.wait_for(lambda: np.allclose(browser.nodes["/robots/arm/flange"]["position"], goal, atol=1e-4))
        browser.wait_for(lambda: not browser.nodes["/ghost/flange"]["visible"])  # it would flicker with the arm
        browser.wait_for(lambda: "/ghost/flange" not in browser.nodes)  # no browser has asked for it for 3 s
        assert "no joint" in browser.refusal("ghost", robot="arm", positions={"no_joint": 1.0})
        assert "no robot" in browser.refusal("ghost", robot="nobody", positions={})
        positions["joint1"] = 0.0
        browser.wait_for(is_shown)
        browser.page("ghost", robot="")
        browser.wait_for(lambda: "/ghost/flange" not in browser.nodes)
    finally:
        world.ok("delete", "arm")


def box(node: dict[str, Any]) -> np.ndarray:
    """Where the name of a frame is seen by the camera of a PageBrowser: left, upper, right, lower edge in pixels."""
    right, ahead = np.array((-1.0, 1.0, 0.0)) / math.sqrt(2), np.array((-1.0, -1.0, -1.0)) / math.sqrt(3)
    x, y, depth = np.array((right, np.cross(ahead, right), ahead)) @ (np.array(node["position"]) - 3.0)
    middle = np.array((x, y)) / depth * 300 / math.tan(0.5)
    size = np.array((6.5 * len(node["text"]), 14.0))
    corner = middle - size * {"bottom-center": (0.5, 1.0), "top-center": (0.5, 0.0), "center-left": (0.0, 0.5),
                              "center-right": (1.0, 0.5)}[node["anchor"]]  # fmt: skip
    return np.concatenate((corner, corner + size))


def test_names_of_frames_do_not_overlap(world: CommandLine) -> None:
    with served_page(world) as url, PageBrowser(url) as first:  # the page moves the camera of the first
        for number in range(6):
            world.ok("spawn", "slider", "--name", f"s{number}", "--at", "0", f"{0.02 * number}", "0")
        try:
            first.wait_for(lambda: "/robots/s5/link2" in first.nodes)
            with PageBrowser(url) as browser:
                browser.page("view", frames=True)
                browser.wait_for(lambda: any(name.startswith("/labels/") for name in browser.nodes))
                browser.take(1.0)
                seen = [one for name, one in browser.nodes.items() if name.startswith("/labels/") and one["visible"]]
                boxes = [box(one) for one in seen if "text" in one]
                assert 2 <= len(boxes) < 14  # of 14 frames
                for one, other in combinations(boxes, 2):
                    assert (one[:2] >= other[2:]).any() or (other[:2] >= one[2:]).any()
                browser.page("view", frames=False)
                browser.wait_for(lambda: not any("text" in node for node in browser.nodes.values()))
        finally:
            for number in range(6):
                world.ok("delete", f"s{number}")


def test_shadows_are_on_as_long_as_no_browser_draws_by_software(browser: PageBrowser) -> None:
    def has_shadows(name: str, by_software: bool) -> bool:
        return bool(browser.page("state", browser=name, draws_by_software=by_software)["view"]["has_shadows"])

    assert has_shadows("quick", False)
    assert not has_shadows("slow", True)
    browser.page("view", shadows="on")
    assert has_shadows("slow", True)
    browser.page("view", shadows="off")
    assert not has_shadows("quick", False)
    assert "choice of shadows" in browser.refusal("view", shadows="some")
    browser.page("view", shadows="auto")
    browser.wait_for(lambda: has_shadows("quick", False))  # the slow one has gone
