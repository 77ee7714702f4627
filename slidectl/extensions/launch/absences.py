"""What the absence of a node means for the user: one clause for the frequent kinds of nodes of other people's packages.

It judges by package, type and name alone. Nothing is read or started here.
"""

from __future__ import annotations

import re

from slidectl.extensions.launch.plan import Node

_UNPAUSES = re.compile(r"un_?pause")
_POSES = re.compile(r"(^|_)(home|homing|init|initial|initialize|stand|standup|tuck|untuck|pose|posture)(_|\d|$)")
_MEANINGS = (
    (re.compile(r"joy|teleop|keyboard|ps[34]_|xbox|spacenav|game_?pad"),
     "no joystick and no keyboard drives the robot: slidectl teleop does"),
    (re.compile(r"marker"), "no markers in RViz drive the robot: slidectl teleop does"),
    (re.compile(r"localization|amcl|ekf|ukf|gmapping|slam|cartographer|map_server|hector_mapping|fake_loc"),
     "nobody publishes the frame of the map or a filtered odometry"),
    (re.compile(r"move_base|navigation|planner_server"), "nobody plans a way: slidectl pub and teleop drive"),
    (re.compile(r"move_group|moveit"), "nobody plans motions: slidectl trajectory moves arms"),
    (re.compile(r"play_motion"), "no motions are played: slidectl trajectory moves arms"),
    (re.compile(r"nodelet|image_proc|pointcloud|depth|laserscan|laser_filter"), "nobody processes its sensors' data"),
    (re.compile(r"diagnostic|aggregator"), "nobody collects diagnostics"),
)  # fmt: skip
"""Patterns for `package/type name`, in lower case, and what the absence means; the first one counts."""


def unpauses(node: Node) -> bool:
    """True when the node is there to let a paused world go on."""
    return _UNPAUSES.search(node.type.lower()) is not None or _UNPAUSES.search(node.name.lower()) is not None


def meaning(node: Node) -> str:
    """`: ` and what the absence of the node means; empty when its name does not tell."""
    if unpauses(node):
        return ": nobody resumes the world by itself: slidectl sim resume"
    name, kind = node.name.lower(), node.type.lower().partition(".")[0]
    text = f"{node.package}/{node.type} {node.name}".lower()
    for pattern, means in _MEANINGS:
        if pattern.search(text):
            return f": {means}"
    if _POSES.search(kind) or _POSES.search(name):
        return ": nobody sends the start pose: slidectl trajectory moves arms"
    return ""
