"""`slidectl graph`: a world with RRBot, and a client that closes the circle from its joints to a command."""

from __future__ import annotations

import itertools
import json
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from command_line import CommandLine
from daemon_fixture import running_daemon

STATES = "/rrbot/joint_states"
COMMAND = "/rrbot/joint1_position_controller/command"
SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture(scope="module")
def run() -> Iterator[CommandLine]:
    with running_daemon(paused=True) as runtime:
        slidectl = CommandLine(runtime.folder)
        controllers = ("joint_state_controller", "joint1_position_controller")
        slidectl.ok("spawn", "rrbot", "--controllers", "config/rrbot_control.yaml", "--start", *controllers)
        with slidectl.client() as client:
            client.advertise(COMMAND, "std_msgs/Float64")
            client.subscribe(STATES)
            yield slidectl


def client_of(slidectl: CommandLine) -> str:
    found = json.loads(slidectl.ok("topic", "info", COMMAND, "--json"))
    return str(found["publishers"][0])


def test_the_tree_shows_each_node_with_its_topics_and_who_is_at_their_other_end(run: CommandLine) -> None:
    me = client_of(run)
    text = run.ok("graph")
    gazebo = text.partition("/rrbot/gazebo\n")[0].splitlines()
    assert gazebo[:2] == ["/gazebo", "  publishes"]
    assert f"    {STATES} [sensor_msgs/JointState] -> {me}" in gazebo
    assert f"    {COMMAND} [std_msgs/Float64] <- {me}" in gazebo
    assert text.endswith(
        f"{me}\n  publishes\n    {COMMAND} [std_msgs/Float64] -> /gazebo\n"
        f"  subscribes\n    {STATES} [sensor_msgs/JointState] <- /gazebo\n"
    )
    assert "/rosapi" not in text
    assert "\n/rosapi\n  provides\n    /rosapi/action_servers\n" in run.ok("graph", "--all")


def test_a_name_leaves_what_is_joined_to_it(run: CommandLine) -> None:
    me = client_of(run)
    [topic] = json.loads(run.ok("graph", "joint_states", "--json"))["topics"]
    assert topic == {"topic": STATES, "type": "sensor_msgs/JointState", "publishers": ["/gazebo"], "subscribers": [me]}
    robot = json.loads(run.ok("graph", "rrbot", "--json", "--all"))
    names = [topic["topic"] for topic in robot["topics"]]
    assert [name for name in names if not name.startswith("/rrbot/")] == ["/tf", "/tf_static"]
    assert {"service": "/rrbot/controller_manager/list_controllers", "node": "/gazebo"} in robot["services"]
    unknown = run("graph", "joint_stat")
    assert unknown.returncode == 1
    assert "Did you mean '/rrbot/joint_states'?" in unknown.stderr


def test_dot_and_mermaid_have_the_edges_of_the_graph(run: CommandLine, tmp_path: Path) -> None:
    data = json.loads(run.ok("graph", "--json"))
    expected = {(node, one["topic"]) for one in data["topics"] for node in one["publishers"]}
    expected |= {(one["topic"], node) for one in data["topics"] for node in one["subscribers"]}
    dot = run.ok("graph", "--dot")
    assert set(re.findall(r'"[nt](\S+)" -> "[nt](\S+)"', dot)) == expected
    mermaid = run.ok("graph", "--mermaid")
    labels = dict(re.findall(r'^  (\w+)\W*"(.*?)"', mermaid, re.MULTILINE))
    assert {(labels[a], labels[b]) for a, b in re.findall(r"^  (\w+) --> (\w+)", mermaid, re.MULTILINE)} == expected
    for ending, text in ((".DOT", dot), (".md", f"```mermaid\n{mermaid}```\n")):
        run.ok("graph", "-o", str(tmp_path / f"graph{ending}"))
        assert (tmp_path / f"graph{ending}").read_text() == text
    assert run("graph", "-o", ".svg").returncode == 2


def test_the_picture_has_every_name_apart_from_the_others_and_arrows_between_them(
    run: CommandLine, tmp_path: Path
) -> None:
    said = run.ok("graph", "--all", "-o", str(tmp_path / "graph.svg"))
    data = json.loads(run.ok("graph", "--all", "--json"))
    assert f"graph.svg: {len(data['nodes'])} nodes, {len(data['topics'])} topics" in said
    picture = ET.parse(tmp_path / "graph.svg").getroot()
    names, boxes = [], []
    for group in picture.iter(f"{SVG}g"):
        shape = {key: float(value) for key, value in group[1].attrib.items() if key not in ("fill", "stroke")}
        if "cx" in shape:
            left, right, middle = shape["cx"] - shape["rx"], shape["cx"] + shape["rx"], shape["cy"]
        else:
            left, right = shape["x"], shape["x"] + shape["width"]
            middle = shape["y"] + shape["height"] / 2
        names.append(group[2].text)
        boxes.append((left, right, middle))
        assert 0 <= left < right <= float(picture.attrib["width"])
    topics = [topic["topic"] for topic in data["topics"]]
    assert names == [*data["nodes"], *topics, *(service["service"] for service in data["services"])]
    for (left, right, y), (other_left, other_right, other_y) in itertools.combinations(boxes, 2):
        assert right < other_left or other_right < left or abs(y - other_y) > 30
    ends = [re.findall(r"([\d.]+) ([\d.]+)(?=C|$)", path.attrib["d"]) for path in picture.findall(f"{SVG}path")]
    sides = np.array([(x, y) for left, right, y in boxes for x in (left, right)])
    for point in np.array([(one[0], one[-1]) for one in ends], dtype=float).reshape(-1, 2):
        assert np.abs(sides - point).max(axis=1).min() < 0.2
    uses = sum(len(topic["publishers"]) + len(topic["subscribers"]) for topic in data["topics"])
    assert len(ends) == uses + len(data["services"])


def test_what_cannot_be_written_is_told(run: CommandLine) -> None:
    for words, code, says in (
        (("-o", "graph.png"), 2, "kinds: .svg, .dot, .md"),
        (("-o", "/no/such/graph.svg"), 1, "cannot write /no/such/graph.svg"),
        (("--dot", "--json"), 2, "exclude each other"),
    ):
        done = run("graph", *words)
        assert done.returncode == code
        assert says in done.stderr
