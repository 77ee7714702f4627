"""`slidectl msg` and `slidectl srv`: show the installed message and service types, without a daemon."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import NamedTuple

import click

from slidectl.cli.commands import Group, group
from slidectl.cli.context import Context
from slidectl.errors import UnknownName, UsageError


class TypeFamily(NamedTuple):
    """Messages or services: the noun for them, and the functions of slidectl.msgs for them."""

    noun: str
    names: Callable[[], Sequence[str]]
    show: Callable[[str], str]
    source: Callable[[str], str]
    md5: Callable[[str], str]


def messages() -> TypeFamily:
    from slidectl import msgs

    return TypeFamily("message type", msgs.type_names, msgs.show, msgs.definition, msgs.md5)


def services() -> TypeFamily:
    from slidectl import msgs

    return TypeFamily("service type", msgs.service_names, msgs.show_service, msgs.service_definition, msgs.service_md5)


def find_types(kind: TypeFamily, name: str) -> list[str]:
    """The types that a name means: one for `pkg/Name`, those of every package for a bare `Name`."""
    if "::" in name or "." in name:
        raise UsageError(f"{name!r} is not a type: write it as package/Type, or Type alone")
    known = kind.names()
    found = [each for each in known if each == name or ("/" not in name and each.endswith("/" + name))]
    if not found:
        raise UnknownName(kind.noun, name, known)
    return found


def definition_text(kind: TypeFamily, found: str, wanted: str, raw: bool) -> str:
    """The fields of a type, or its original definition, as rosmsg prints them; `wanted` is the name from the user."""
    body = (kind.source if raw else kind.show)(found).rstrip("\n")
    return ("" if "/" in wanted else f"[{found}]:\n") + (f"{body}\n\n" if body else "\n")


def _verbs(parent: Group, kind: Callable[[], TypeFamily], example: str) -> None:
    """Add the commands show, list and md5 to the group."""
    tool = f"slidectl {parent.name}"

    def complete(_context: click.Context, _param: click.Parameter, incomplete: str) -> list[str]:
        return [name for name in kind().names() if name.startswith(incomplete)]

    @parent.command("show", examples=[f"{tool} show {example}", f"{tool} show {example.partition('/')[2]}"])
    @click.argument("name", required=False, metavar="TYPE", shell_complete=complete)
    @click.option("-r", "--raw", is_flag=True, help="The definition as it was written, with its comments.")
    @click.pass_obj
    def show(ctx: Context, name: str | None, raw: bool) -> None:
        """Show the fields of a type, those of nested types indented.

        A name without a package is looked up in all packages. Without TYPE, the type is read from stdin.
        JSON keys: type, md5, definition.
        """
        wanted, types = sys.stdin.readline().strip() if name is None else name, kind()
        if not wanted:
            raise UsageError("no TYPE given, and none on stdin")
        for found in find_types(types, wanted):
            record = {"type": found, "md5": types.md5(found), "definition": types.source(found)}
            ctx.emit(record, definition_text(types, found, wanted, raw))

    @parent.command("list", examples=[f"{tool} list", f"{tool} list {example.partition('/')[0]}"])
    @click.argument("package", required=False)
    @click.pass_obj
    def list_types(ctx: Context, package: str | None) -> None:
        """List the types, all or those of a package.

        JSON key: type.
        """
        known = sorted(kind().names())
        packages = sorted({each.partition("/")[0] for each in known})
        if package is not None and package not in packages:
            raise UnknownName("package", package, packages)
        ctx.emit_names([each for each in known if package in (None, each.partition("/")[0])], "type")

    @parent.command("md5", examples=[f"{tool} md5 {example}"])
    @click.argument("name", metavar="TYPE", shell_complete=complete)
    @click.pass_obj
    def md5(ctx: Context, name: str) -> None:
        """Print the md5 sum that ROS 1 peers compare.

        JSON keys: type, md5.
        """
        for found in find_types(kind(), name):
            text = kind().md5(found)
            ctx.emit({"type": found, "md5": text}, text if "/" in name else f"[{found}]: {text}")


@group(examples=["slidectl msg show sensor_msgs/JointState", "slidectl msg list std_msgs"])
def msg() -> None:
    """Show message types."""


@group(examples=["slidectl srv show controller_manager_msgs/SwitchController", "slidectl srv list gazebo_msgs"])
def srv() -> None:
    """Show service types."""


_verbs(msg, messages, "sensor_msgs/JointState")
_verbs(srv, services, "std_srvs/SetBool")
