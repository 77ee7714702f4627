"""Names that are suggested for one that does not exist: only those that look like the same name mistyped."""

from __future__ import annotations

import pytest

from slidectl.errors import closest


@pytest.mark.parametrize(
    ("name", "known", "suggested"),
    [
        ("jonit1_position_controller", "joint1_position_controller", True),
        ("joint1_controller", "joint1_position_controller", True),
        ("pid/d_gain", "pid/d", True),
        ("rrbot_descripton", "rrbot_description", True),
        ("flir_camera_description", "pointgrey_camera_description", False),
        ("robot_localization", "rb1_base_localization", False),
        ("joy/joy_node", "topic_tools/relay", False),
    ],
)
def test_only_a_name_that_is_near_is_suggested(name: str, known: str, suggested: bool) -> None:
    assert closest(name, [known]) == (known if suggested else None)
