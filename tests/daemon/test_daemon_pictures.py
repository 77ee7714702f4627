"""Pictures of cameras in a daemon: they come beside the world, and what renders them ends with the daemon."""

from __future__ import annotations

import base64
from pathlib import Path

import pytest
from daemon_fixture import running_daemon

from slidectl import Client
from slidectl.physics import rendering

ROBOT = """<robot name="watcher"><link name="base"><inertial><mass value="1"/>
  <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
  <gazebo reference="base"><sensor type="camera" name="eye"><update_rate>20</update_rate><camera>
  <image><width>64</width><height>48</height></image></camera>
  <plugin name="c" filename="libgazebo_ros_camera.so"/></sensor></gazebo></robot>"""


def renders(process: str) -> bool:
    """Whether a process is one that renders."""
    try:
        return b"slidectl.physics.rendering" in Path(f"/proc/{process}/cmdline").read_bytes()
    except OSError:  # it has ended
        return False


@pytest.mark.skipif(not rendering.gl_backend(), reason="there is no OpenGL on this machine")
def test_pictures_come_while_the_world_goes_on_and_after_others_have_come_to_it(tmp_path: Path) -> None:
    file = tmp_path / "watcher.urdf"
    file.write_text(ROBOT)
    with running_daemon() as daemon, daemon.environment(), Client(timeout=60.0) as client:
        client.spawn(str(file), at=(0, 0, 1))
        with client.subscribe("/watcher/image_raw") as pictures:
            first = pictures.get()
            assert len(base64.b64decode(first["data"])) == first["height"] * first["step"] == 48 * 64 * 3
            client.spawn("slider", at=(3, 0, 0))  # the world is another one now
            later = [pictures.get() for _ in range(3)]
        assert later[-1]["data"] != first["data"]
        children = Path(f"/proc/{daemon.pid}/task/{daemon.pid}/children").read_text().split()
        (renderer,) = filter(renders, children)
    assert not renders(renderer)
