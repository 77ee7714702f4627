"""Programs for rosrun whose command lines and exit codes are their own: what they do is slidectl.launch's work."""

from __future__ import annotations

from collections.abc import Sequence

import click

from slidectl.cli import output
from slidectl.cli.context import Context
from slidectl.cli.ros import nodes
from slidectl.cli.ros.failure import Failure
from slidectl.cli.ros.naming import without_remappings
from slidectl.cli.ros.rosrun import packages
from slidectl.cli.spawn import tell_own_packages
from slidectl.errors import UsageError
from slidectl.writing import write_whole

_WRONG_COUNT = 255
_HELP = frozenset(("-h", "--help"))

_MANAGER_USAGE = """Usage: controller_manager <command> [name...]

Commands:
    load <name>              load the controller
    unload <name>            unload the controller
    start <name>             start the controller
    stop <name>              stop the controller
    spawn | sp <name>        load and start the controller
    kill | kl <name>         stop and unload the controller
    list | lc                list the loaded controllers
    list-types | lt          list the types that can be loaded
    reload-libraries [--restore]
"""
_UNSPAWNER_USAGE = (
    "Usage: unspawner <name>...\n\nStops the controllers as long as it runs, and starts them again at its end.\n"
)
_SPAWNER_USAGE = """usage: spawner [-h] [--stopped] [--wait-for TOPIC] [--namespace NS]
               [--timeout S] [--no-timeout] controllers [controllers ...]

Loads and starts controllers, and stops and unloads them at its end.

controllers         their names, or YAML files whose controllers are meant
--stopped           load them, and do not start them
--wait-for TOPIC    not before a true std_msgs/Bool comes on TOPIC
--namespace NS      where the controller manager is
--timeout S         how long to wait for it, in s (30; 0 is for ever)
--no-timeout        wait for ever
"""
_SPAWN_MODEL_USAGE = """usage: spawn_model [-h] -urdf (-param NAME | -file FILE) -model NAME
                   [-x X] [-y Y] [-z Z] [-R R] [-P P] [-Y Y] [-J JOINT POSITION]
                   [-robot_namespace NS] [-reference_frame FRAME] [-unpause]
                   [-wait MODEL] [-package_to_model] [-b]

Puts a robot into the world: its URDF is in a parameter or a file.

-x -y -z            where, in m
-R -P -Y            roll, pitch and yaw, in rad
-J JOINT POSITION   where a joint begins, in rad or m; may repeat
-unpause            let the world go on afterwards
-wait MODEL         not before there is a robot of that name
-b                  stay, and take the robot away at the end
"""
_STATIC_USAGE = """Puts child_frame_id into frame_id, for as long as it runs. Metres, radians:
Usage: static_transform_publisher x y z yaw pitch roll frame_id child_frame_id{period}
or with a quaternion:
Usage: static_transform_publisher x y z qx qy qz qw frame_id child_frame_id{period}
"""


def controller_manager(ctx: Context, argv: Sequence[str]) -> None:
    """The script `controller_manager`: its usage without a command (0) or with a wrong one (1)."""
    from slidectl.launch.nodes.controller_nodes import is_command

    words = without_remappings(argv)
    if not words or not is_command(words[0]):
        output.write(_MANAGER_USAGE)
        raise click.exceptions.Exit(1 if words else 0)
    nodes.run(ctx, "controller_manager", "controller_manager", argv, packages())


def spawner(ctx: Context, argv: Sequence[str]) -> None:
    """The script `spawner`, which has a help."""
    _run_or_help(ctx, ("controller_manager", "spawner"), argv, _SPAWNER_USAGE)


def spawn_model(ctx: Context, argv: Sequence[str]) -> None:
    """The script `spawn_model`, which has a help."""
    _run_or_help(ctx, ("gazebo_ros", "spawn_model"), argv, _SPAWN_MODEL_USAGE)


def _run_or_help(ctx: Context, program: tuple[str, str], argv: Sequence[str], usage: str) -> None:
    if not _HELP.isdisjoint(argv):
        return output.write(usage)
    return nodes.run(ctx, *program, argv, packages())


def unspawner(ctx: Context, argv: Sequence[str]) -> None:
    """The script `unspawner`: its usage, with code 1, when no controller is named."""
    words = without_remappings(argv)
    if not words or words[0] in _HELP:
        output.write(_UNSPAWNER_USAGE)
        raise click.exceptions.Exit(1)
    nodes.run(ctx, "controller_manager", "unspawner", argv, packages())


def static_transform(ctx: Context, argv: Sequence[str]) -> None:
    """tf's, with a period at the end."""
    _static_transform(ctx, "tf", argv, (9, 10), " period(milliseconds)")


def static_transform_tf2(ctx: Context, argv: Sequence[str]) -> None:
    """tf2_ros's."""
    _static_transform(ctx, "tf2_ros", argv, (8, 9), "")


def _static_transform(ctx: Context, package: str, argv: Sequence[str], counts: Sequence[int], period: str) -> None:
    if len(without_remappings(argv)) not in counts:
        output.write(_STATIC_USAGE.format(period=period))
        raise click.exceptions.Exit(_WRONG_COUNT)
    nodes.run(ctx, package, "static_transform_publisher", argv, packages())


_XACRO_USAGE = """rosrun xacro xacro [-o FILE] MODEL.xacro [name:=value...]

Prints the URDF that a xacro file makes with these arguments, or writes it into FILE.
"""
_XACRO_WITHOUT_EFFECT = ("--inorder", "-i", "-q", "-v", "--xacro-ns", "--check-order", "--debug")


def xacro(ctx: Context, argv: Sequence[str]) -> None:
    """Print the expanded model, or write it into the file of `-o`. Raises what loading it raises; BadFile mostly."""
    from slidectl import description

    if not _HELP.isdisjoint(argv):
        return output.write(_XACRO_USAGE)
    target, words = _target(list(argv))
    arguments = dict(word.split(":=", 1) for word in words if ":=" in word)
    files = [word for word in words if ":=" not in word and not word.startswith("-")]
    unknown = [word for word in words if word.startswith("-") and word not in _XACRO_WITHOUT_EFFECT]
    if unknown or len(files) != 1:
        what = f"xacro: unknown option {unknown[0]}" if unknown else f"xacro takes one file, not {len(files)}"
        raise UsageError(what, _XACRO_USAGE.partition("\n")[0])
    lookup = packages()
    document = description.load(files[0], arguments, lookup)
    tell_own_packages(ctx, lookup)
    for notice in document.report:
        ctx.warn(str(notice))
    if target is None:
        return output.write(document.urdf)
    try:
        write_whole(target, document.urdf)
    except OSError as error:
        raise Failure(f"ERROR: cannot write {target}: {error.strerror}") from None
    return None


def _target(words: list[str]) -> tuple[str | None, list[str]]:
    """The file of `-o`, and the other words."""
    for index, word in enumerate(words):
        if word == "-o" and index + 1 < len(words):
            return words[index + 1], words[:index] + words[index + 2 :]
    return None, words
