"""Cameras of robots: pictures at their rate while somebody listens, each with the time at which it was taken.

A picture comes when it is rendered; while one is being rendered the next ones are left out. So how many there are
depends on the machine, and what is on them does not.
"""

from __future__ import annotations

import math
import zlib
from typing import TYPE_CHECKING

from slidectl import names
from slidectl.control.duration import header_of
from slidectl.control.node_handle import Message
from slidectl.description.robot import Camera
from slidectl.physics import rendering, sensing
from slidectl.simulation.clock import period_ns_of
from slidectl.simulation.pending import Pending
from slidectl.simulation.spawned_robots import SpawnedRobot
from slidectl.simulation.topics import PeriodicTopic

if TYPE_CHECKING:
    from slidectl.simulation.simulation import Simulation

_CHANNELS = {"mono8": 1, "rgb8": 3, "bgr8": 3}


class CameraTopics:
    """The picture and the geometry of one camera, on their topics until `close`."""

    def __init__(self, simulation: Simulation, robot: SpawnedRobot, camera: Camera) -> None:
        self._simulation = simulation
        self._robot = robot
        self._camera = camera
        self._is_busy = self._has_failed = self._is_broken = self._is_closed = False
        if not rendering.gl_backend():
            text = f"{robot.name}: camera {camera.name} makes no pictures, there is no OpenGL: {rendering.INSTALL}"
            robot.warnings.append(text)
            robot.node.log("warn", text)
            self._is_broken = True
        node = names.join(robot.namespace, "gazebo")
        period_ns = period_ns_of(camera.rate_hz)
        topic, info = (_inside(robot.namespace, topic) for topic in (camera.topic, camera.info_topic))
        self._pictures = PeriodicTopic(simulation.graph, topic, "sensor_msgs/Image", node, period_ns, self._take)
        self._info = PeriodicTopic(simulation.graph, info, "sensor_msgs/CameraInfo", node, period_ns, self._geometry)

    def close(self) -> None:
        """Take the topics back."""
        self._is_closed = True
        self._pictures.close()
        self._info.close()

    def _header(self) -> Message:
        return header_of(self._simulation.time_ns, self._camera.frame)

    def _take(self) -> None:
        """Begin a picture of now; it is published when it is there."""
        if self._is_busy or self._is_broken:
            return
        simulation, camera, robot = self._simulation, self._camera, self._robot.name
        pose = sensing.sensor_pose(simulation.world, robot, camera)
        header, seed = self._header(), zlib.crc32(f"{robot}/{camera.name}/{simulation.time_ns}".encode())
        pending = simulation.render(camera, pose, seed)
        self._is_busy = True
        pending.then(lambda done: self._publish(header, done))

    def _publish(self, header: Message, done: Pending) -> None:
        self._is_busy = False
        if self._is_closed:
            return
        if done.error is not None:  # a process that was killed is started again, once
            self._has_failed, self._is_broken = True, self._has_failed
            last = "; it makes no more pictures" if self._is_broken else ""
            self._robot.node.log("error", f"camera {self._camera.name}: {done.error}{last}")
            return
        self._has_failed = False
        camera = self._camera
        self._pictures.publish(
            {
                "header": header,
                "height": camera.height,
                "width": camera.width,
                "encoding": camera.encoding,
                "is_bigendian": 0,
                "step": camera.width * _CHANNELS[camera.encoding],
                "data": done.result(),
            }
        )

    def _geometry(self) -> Message:
        camera = self._camera
        length = camera.width / (2.0 * math.tan(camera.field_of_view / 2.0))
        x, y = (camera.width + 1) / 2.0, (camera.height + 1) / 2.0
        return {
            "header": self._header(),
            "height": camera.height,
            "width": camera.width,
            "distortion_model": "plumb_bob",
            "D": [0.0] * 5,
            "K": [length, 0.0, x, 0.0, length, y, 0.0, 0.0, 1.0],
            "R": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
            "P": [length, 0.0, x, -length * camera.baseline, 0.0, length, y, 0.0, 0.0, 0.0, 1.0, 0.0],
            "binning_x": 0,
            "binning_y": 0,
            "roi": {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False},
        }


def _inside(namespace: str, topic: str) -> str:
    """The topic in the namespace of the robot, which a model that is spawned in the root names itself."""
    return names.join("/" if f"/{topic}".startswith(f"{namespace}/") else namespace, topic)
