"""The table of slidectl's own commands. It is data: to name a command and its help imports nothing.

The module of a command has a click command of the command's name (`assert_`: a keyword; `ros_commands`: ros-commands).
"""

from __future__ import annotations

import os
from importlib import import_module
from keyword import iskeyword
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    import click


class Entry(NamedTuple):
    """One line of the command table: the section of the help, the whole name of the module, and the help.

    `help` is equal to the first sentence of the command's own help (a test compares them).
    """

    section: str
    module: str
    help: str


_PACKAGE = os.path.dirname(os.path.dirname(__file__))
_SECTIONS = {
    "The daemon": {
        "daemon": ("cli.daemon", "Start, stop and watch the daemon that holds the world."),
        "sim": ("cli.sim", "Control the simulation: status, pause, step, reset, snapshots."),
        "replay": ("extensions.journal.commands.replay", "Repeat the run of a journal, with the same bits."),
    },
    "Robots": {
        "spawn": ("cli.spawn", "Put a robot into the world."),
        "delete": ("cli.robots", "Take robots out of the world."),
        "robots": ("cli.robots", "List the robots, or show one with its joints."),
        "estop": ("cli.robots", "Stop robots at once, or release them."),
        "fault": ("cli.fault", "Inject faults into joints, links, controllers and topics."),
        "check": ("cli.check", "Check a model, a launch file or controllers, without a daemon."),
        "urdf": ("cli.spawn", "Print the URDF that xacro makes of a model, without a daemon."),
        "controller": ("cli.controller", "Load, start, stop and list controllers."),
        "trajectory": ("cli.trajectory", "Trajectory controllers: send, plan, hold, cancel, state."),
        "launch": ("extensions.launch.commands.launch", "Run a launch file as roslaunch does."),
    },
    "Topics, services, parameters": {
        "pub": ("cli.pub", "Publish a message."),
        "echo": ("cli.echo", "Print the messages of a topic."),
        "wait": ("cli.wait", "Wait until a field of a topic has a value."),
        "assert": ("cli.assertion", "Check conditions, and measure motions."),
        "record": ("extensions.recording.commands.record", "Record topics into a file."),
        "play": ("extensions.recording.commands.play", "Publish the messages of recordings again."),
        "bag": ("extensions.recording.commands.bag", "Recordings: info, diff, filter, export, reindex."),
        "plot": ("extensions.viewing.commands.plot", "Plot fields over simulated time."),
        "topic": ("cli.topic", "List, inspect and measure topics."),
        "hz": ("cli.topic_measure", "Measure the rate of messages."),
        "service": ("cli.service", "List, inspect and call services."),
        "action": ("cli.action", "Goals of actions: list, inspect, send, cancel, follow."),
        "param": ("cli.param", "Get, set, load and dump parameters."),
        "tf": ("cli.tf", "Show the frames and the transforms between them."),
        "msg": ("cli.msg", "Show message types."),
        "srv": ("cli.msg", "Show service types."),
    },
    "Seeing": {
        "view": ("extensions.viewing.commands.view", "Show the world in a browser."),
        "gui": ("extensions.viewing.commands.view", "Show the world in a browser."),
        "render": ("extensions.viewing.commands.render", "Draw the world into a picture."),
        "video": ("extensions.viewing.commands.render", "Draw the world into a video."),
        "top": ("extensions.viewing.commands.top", "Watch controllers, joints, topics and the log."),
        "teleop": ("extensions.viewing.commands.teleop", "Drive a base, or move a joint, by keys."),
        "graph": ("extensions.viewing.commands.node_graph", "Show the graph of nodes and topics."),
    },
    "Other protocols": {
        "gateway": (
            "extensions.gateways.commands.gateway_commands",
            "Connect ROS 1 nodes, rosbridge clients and Foxglove.",
        ),
    },
    "The ROS commands": {
        "ros": ("extensions.ros_commands.command", "Run a ROS command word for word."),
        "ros-commands": ("extensions.ros_commands.command", "Print shell functions named as the ROS commands."),
    },
    "slidectl": {
        "test": ("extensions.scenarios.commands.test", "Run scenarios: files of steps that a robot must pass."),
        "shell": ("cli.shell", "Run many commands in one process."),
        "doctor": ("cli.doctor", "Check this installation."),
        "completion": ("cli.completion", "Print the completion script of a shell."),
        "version": ("cli.doctor", "Print the version."),
    },
}
"""Section of the help -> command -> its module, below `slidectl`, and its help."""


def has_module(name: str) -> bool:
    """True for a module of slidectl, named below `slidectl`; False for one of an extension that is left out."""
    parts = name.split(".")
    return parts[0] != "extensions" or os.path.isdir(os.path.join(_PACKAGE, *parts[:2]))


COMMANDS = {
    name: Entry(section, f"slidectl.{module}", text)
    for section, commands in _SECTIONS.items()
    for name, (module, text) in commands.items()
    if has_module(module)
}

WINDOWS = {
    "rviz": ("rviz", "rviz"),
    "rqt": ("rqt_gui", "rqt_gui"),
    "rqt_gui": ("rqt_gui", "rqt_gui"),
    **{
        name: (name, name)
        for name in ("rqt_plot", "rqt_graph", "rqt_console", "rqt_bag", "rqt_reconfigure", "rqt_controller_manager")
    },
    "gzclient": ("gazebo_ros", "gzclient"),
}
"""Windows of ROS and Gazebo that have commands of their own in a shell: command -> package and program."""


def load(name: str) -> click.Command:
    """Import the module of a command, and return the command."""
    attribute = name.replace("-", "_") + "_" * iskeyword(name)
    command: click.Command = getattr(import_module(COMMANDS[name].module), attribute)
    return command
