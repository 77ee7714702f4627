"""`slidectl urdf`: what xacro makes of a model, as plain URDF, without a daemon."""

from __future__ import annotations

import click

from slidectl.cli import live, output
from slidectl.cli.commands import command
from slidectl.cli.context import Context
from slidectl.cli.spawn import in_package, package_lookup, standard_input, tell_own_packages
from slidectl.errors import BadFile


@command(
    examples=[
        "slidectl urdf robot.urdf.xacro width:=0.2 -o robot.urdf",
        "slidectl urdf slider | check_urdf /dev/stdin",
        "slidectl urdf rrbot_description rrbot.xacro",
    ]
)
@click.argument("model", shell_complete=live.models)
@click.argument("arguments", nargs=-1, metavar="[FILE] [KEY:=VALUE]...")
@click.option("-o", "--output", "target", metavar="FILE", help="Write the URDF into a file.")
@click.option("--package", "packages", multiple=True, metavar="NAME=PATH", help="Where a ROS package is; may repeat.")
@click.pass_obj
def urdf(ctx: Context, model: str, arguments: tuple[str, ...], target: str | None, packages: tuple[str, ...]) -> None:
    """Print the URDF that xacro makes of a model, without a daemon.

    MODEL, FILE and KEY:=VALUE are as for spawn. Any URDF parser reads what is printed; meshes keep the names that the
    model gives them. JSON keys: urdf, file.
    """
    from slidectl import description
    from slidectl.writing import write_whole

    places = package_lookup(packages, "urdf")
    source, given = in_package(model, arguments, places, "urdf")
    title = "<stdin>" if source == "-" else None
    text = standard_input() if source == "-" else source
    document = description.load(text, given, places, title=title, as_written=True)
    tell_own_packages(ctx, places)
    for notice in document.report:
        ctx.warn(str(notice))
    if target is None:
        if ctx.format == "text":
            output.write(document.urdf.rstrip("\n"))
        else:
            ctx.emit({"urdf": document.urdf, "file": document.file})
        return
    try:
        write_whole(target, document.urdf)
    except OSError as error:
        raise BadFile(f"cannot be written: {error.strerror or error}", target) from None
    ctx.done({"file": target}, f"{target}: written")
