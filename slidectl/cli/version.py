"""`slidectl version`: print the installed versions, without a daemon."""

from __future__ import annotations

import sys

import click

from slidectl import __version__
from slidectl.cli.commands import command
from slidectl.cli.context import Context

_LIBRARIES = ("mujoco", "click", "numpy", "rosbags", "xacro")


@command(step=None, examples=["slidectl version", "slidectl version --json"])
@click.pass_obj
def version(ctx: Context) -> None:
    """Print the version.

    With -v the versions of the libraries too. JSON keys: slidectl, python, and with -v the libraries' names.
    """
    record = {"slidectl": __version__, "python": sys.version.split()[0]}
    if ctx.verbose:
        record |= {name: _library(name) for name in _LIBRARIES}
    ctx.emit(record, None if ctx.verbose else f"slidectl {__version__}")


def _library(name: str) -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"
