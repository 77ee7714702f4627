"""Whatever is thrown at the readers, they answer with a robot or with an error of ours."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from slidectl.description import load, parse, with_root_fixed, with_root_free, yaml_tree
from slidectl.errors import BadFile, SlidectlError

RRBOT = load("rrbot").xml
TOKENS = re.compile(r'"[^"]*"|[<>/=]|[A-Za-z_]\w*|\s+|[^\s"<>/=\w]+')
ODDITIES = [
    "",
    "nan",
    "1e999",
    "1,5",
    "-1",
    "0",
    "world",
    "link1",
    "joint1",
    "<",
    ">",
    '"',
    "&amp;",
    "\x00",
    "é",
    "\ud800",
    "9" * 50,
]

fuzzing = settings(max_examples=150, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))


@contextlib.contextmanager
def errors_of_ours_only() -> Iterator[None]:
    with contextlib.suppress(SlidectlError):
        yield


def parse_any(xml: str | bytes) -> None:
    with errors_of_ours_only():
        parse(xml)
    for change in (with_root_fixed, with_root_free):
        with errors_of_ours_only():
            change(xml if isinstance(xml, str) else xml.decode("latin-1"))


@fuzzing
@given(st.one_of(st.text(), st.binary()))
def test_any_text_and_any_bytes(source: str | bytes) -> None:
    parse_any(source)


@fuzzing
@given(st.data())
def test_a_robot_with_some_tokens_replaced_dropped_or_doubled(data: st.DataObject) -> None:
    tokens = TOKENS.findall(RRBOT)
    for _ in range(data.draw(st.integers(1, 4))):
        place = data.draw(st.integers(0, len(tokens) - 1))
        odd = data.draw(st.sampled_from(ODDITIES))
        tokens[place] = data.draw(st.sampled_from(["", tokens[place] * 2, odd, f'"{odd}"', f"<{odd}/>"]))
    parse_any("".join(tokens))


@fuzzing
@given(st.data())
def test_a_robot_with_whole_lines_moved_about(data: st.DataObject) -> None:
    lines = RRBOT.splitlines()
    for _ in range(data.draw(st.integers(1, 6))):
        lines.insert(data.draw(st.integers(1, len(lines))), lines[data.draw(st.integers(1, len(lines) - 1))])
    parse_any("\n".join(lines))


NAMES = st.sampled_from(["a", "b", "world", "j", ""])
TREES = st.recursive(
    st.builds(
        lambda tag, attributes: f"<{tag} {attributes}/>",
        st.sampled_from(["parent", "child", "limit", "axis", "mass", "inertia", "mesh", "box", "mimic", "type"]),
        st.sampled_from(
            ['link="a"', 'link="b"', 'xyz="0 0 1"', 'value="1"', 'joint="j"', 'size="1 1 1"', 'filename="x"', ""]
        ),
    ),
    lambda inner: st.builds(
        lambda tag, name, parts: f'<{tag} name="{name}" type="fixed">{"".join(parts)}</{tag}>',
        st.sampled_from(
            [
                "link",
                "joint",
                "inertial",
                "visual",
                "collision",
                "geometry",
                "material",
                "transmission",
                "gazebo",
                "actuator",
            ]
        ),
        NAMES,
        st.lists(inner, max_size=5),
    ),
    max_leaves=30,
)


@fuzzing
@given(st.lists(TREES, max_size=8))
def test_any_tree_of_known_tags(parts: list[str]) -> None:
    parse_any(f'<robot name="r">{"".join(parts)}</robot>')


XACRO = st.sampled_from(
    [
        "<xacro:property name='p' value='${q}'/>",
        "<xacro:property name='q' value='1'/>",
        "<xacro:macro name='m' params='x *b'><link name='${x}'/><xacro:insert_block name='b'/></xacro:macro>",
        "<xacro:m x='1'><a/></xacro:m>",
        "<xacro:m/>",
        "<xacro:if value='${p}'><link name='w'/></xacro:if>",
        "<xacro:unless/>",
        "<xacro:arg name='a' default='1'/>",
        "<link name='$(arg a)'/>",
        "<xacro:include filename='$(find x)/y'/>",
        "<xacro:include/>",
        "<xacro:call macro='m'/>",
        "<xacro:element xacro:name='link' name='z'/>",
        "<xacro:attribute name='n' value='v'/>",
        "<link name='${[i for i in range(3)]}'/>",
        "${",
        "$(",
        "$$(x)",
    ]
)


@fuzzing
@given(st.lists(XACRO, max_size=8))
def test_any_sequence_of_xacro_tags(parts: list[str]) -> None:
    with errors_of_ours_only():
        document = load(f'<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">{"".join(parts)}</robot>')
        parse(document.xml)


@fuzzing
@given(st.one_of(st.text(), st.binary(), st.text(alphabet="ab:-[]{},&*<!|>\n '\"#%?~0.e")))
def test_any_yaml(source: str | bytes) -> None:
    with errors_of_ours_only():
        yaml_tree.read(source, "c.yaml")


def chain(count: int) -> str:
    inertia = '<inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'
    links = "".join(f'<link name="l{index}">{inertia}</link>' for index in range(count))
    joints = "".join(
        f'<joint name="j{index}" type="fixed"><parent link="l{index}"/><child link="l{index + 1}"/></joint>'
        for index in range(count - 1)
    )
    return f'<robot name="long">{links}{joints}</robot>'


def test_a_long_chain_of_links_is_read_to_its_end() -> None:
    assert len(parse(chain(1001)).joints) == 1000


def test_a_longer_chain_than_the_physics_takes_is_refused_by_joint() -> None:
    with pytest.raises(BadFile, match="joint 'j1000': its child hangs more than 1000 joints below the root"):
        parse(chain(5_000))
