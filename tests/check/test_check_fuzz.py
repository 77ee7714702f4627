"""Whatever a file holds, a check ends with findings or with an error for people, never with a traceback."""

from __future__ import annotations

import contextlib
from typing import Any

import yaml
from check_texts import CONTROLLERS, driven_cart
from hypothesis import given, settings
from hypothesis import strategies as st

from slidectl.check import Findings
from slidectl.check.controllers import check as check_controllers
from slidectl.check.dispatch import check
from slidectl.check.model import Model, check_text
from slidectl.control import registry
from slidectl.description import Packages, parse
from slidectl.errors import BadFile, SlidectlError
from slidectl.extensions.launch.launch_check import check as check_launch

SOUND = check_text(driven_cart(), "bot.urdf", Findings())
assert isinstance(SOUND, Model)

NAMES = st.sampled_from([
    "bot", "type", "joint", "joints", "pid", "p", "i", "i_clamp", "antiwindup", "extra_joints", "name", "publish_rate",
    "joint_limits", "gazebo_ros_control", "pid_gains", "slide", "has_velocity_limits", "max_velocity", "a/b", "/", "",
    "_ns", "é x", "[0]",
])  # fmt: skip
SCALARS = st.one_of(
    st.sampled_from([*registry.common.types(), "slide", "1e-3", ".nan", True, False, 0, -1, 0.0, 1.0, float("inf")]),
    st.floats(),
    st.text(max_size=5),
)
TREES: st.SearchStrategy[Any] = st.recursive(
    SCALARS,
    lambda inner: st.one_of(st.dictionaries(NAMES, inner, max_size=5), st.lists(inner, max_size=3)),
    max_leaves=20,
)


@settings(max_examples=80, deadline=None, derandomize=True)
@given(tree=st.dictionaries(NAMES, TREES, max_size=4), with_robot=st.booleans())
def test_any_tree_of_parameters_can_be_checked(tree: dict[str, Any], with_robot: bool) -> None:
    text = yaml.safe_dump(tree, allow_unicode=True).encode()
    findings = Findings()
    with contextlib.suppress(SlidectlError):
        check_controllers("control.yaml", SOUND if with_robot else None, findings, text)
    assert all(notice.line for notice in findings.sorted())


@settings(max_examples=100, deadline=None, derandomize=True)
@given(cut=st.integers(0, len(CONTROLLERS)), put=st.text(max_size=4))
def test_any_slip_of_the_pen_in_a_file_of_controllers_can_be_checked(cut: int, put: str) -> None:
    text = (CONTROLLERS[:cut] + put + CONTROLLERS[cut:]).encode("utf-8", "replace")
    with contextlib.suppress(SlidectlError):
        check_controllers("control.yaml", SOUND, Findings(), text)


PIECES = [
    '""',
    '"nan"',
    '"1 2"',
    "slide",
    "cart",
    "<",
    ">",
    "/>",
    "<gazebo>",
    "</gazebo>",
    "<mimic joint='slide'/>",
    "0",
]


@settings(max_examples=100, deadline=None, derandomize=True)
@given(start=st.integers(0, 900), length=st.integers(0, 30), put=st.sampled_from(PIECES))
def test_any_slip_of_the_pen_in_a_model_can_be_checked(start: int, length: int, put: str) -> None:
    text = driven_cart('<gazebo reference="cart"><mu1>1</mu1><mu2>2</mu2></gazebo>')
    text = text[:start] + put + text[start + length :]
    findings = Findings()
    try:
        check_text(text, "bot.urdf", findings)
    except SlidectlError as error:
        findings.refuse(BadFile(error.message))
    assert all(notice.file == "bot.urdf" and notice.line for notice in findings.sorted())
    assert bool(findings.broken) >= is_refused(text)


def is_refused(text: str) -> bool:
    try:
        parse(text)
    except SlidectlError:
        return True
    return False


@settings(max_examples=80, deadline=None, derandomize=True)
@given(start=st.sampled_from([b"", b"<robot>", b"<launch>", b"bot: ", b"\xef\xbb\xbf"]), text=st.binary(max_size=60))
def test_any_bytes_can_be_checked(start: bytes, text: bytes) -> None:
    with contextlib.suppress(SlidectlError):
        check(["<stdin>"], {}, Packages(), text=start + text)


LAUNCH = """<launch>
<arg name="a" default="b"/>
<param name="robot_description" textfile="bot.urdf"/>
<node name="spawn" pkg="gazebo_ros" type="spawn_model" args="-urdf -model bot -param robot_description"/>
<rosparam>
bot:
  c: {type: joint_state_controller/JointStateController, publish_rate: 50}
</rosparam>
<group ns="bot" if="true"><remap from="joint_states" to="x"/>
<node name="ctl" pkg="controller_manager" type="spawner" args="c"/></group>
<node name="rsp" pkg="robot_state_publisher" type="robot_state_publisher"/>
</launch>
"""
LAUNCH_PIECES = [
    '"',
    "$(",
    ")",
    "$(arg a)",
    "<group>",
    "</group>",
    "/>",
    "ns='//'",
    "~",
    "-J x",
    "true",
    "[",
    ": ",
    "é",
]


@settings(max_examples=80, deadline=None, derandomize=True)
@given(start=st.integers(0, len(LAUNCH)), length=st.integers(0, 12), put=st.sampled_from(LAUNCH_PIECES))
def test_any_slip_of_the_pen_in_a_launch_file_can_be_checked(start: int, length: int, put: str) -> None:
    text = (LAUNCH[:start] + put + LAUNCH[start + length :]).encode()
    with contextlib.suppress(SlidectlError):
        check_launch(["bot.launch"], {}, Packages(), Findings(), text)
