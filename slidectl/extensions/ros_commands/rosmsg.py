"""`rosmsg` and `rossrv`: show message and service types.

They use no daemon; only `show -b` reads a bag.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

from slidectl.cli import output
from slidectl.cli.context import Context
from slidectl.cli.msg import TypeFamily, definition_text, messages, services
from slidectl.errors import UnknownName, closest
from slidectl.extensions.ros_commands.arguments import NO_SUCH_VERB, Failure, Parser, Tool, option

_PLEASE = "Please refer to msg/srv types as 'package_name/Type'."
_SINGLE_LINE = option("-s", "all on one line", dest="single_line")


class _Types:
    """The verbs for one kind of type. `suffix` is the suffix of its files."""

    def __init__(self, name: str, suffix: str, kind: TypeFamily) -> None:
        self.name = name
        self._suffix = suffix
        self._kind = kind

    def __call__(self, ctx: Context, argv: Sequence[str]) -> None:
        noun = self._kind.noun
        verbs = {
            "show": (self.show, f"show the fields of a {noun}"),
            "info": (self.show, "the same as show"),
            "list": (self.list_types, f"list all {noun}s"),
            "md5": (self.md5, f"print the md5 sum of a {noun}"),
            "package": (self.package, f"list the {noun}s of a package"),
            "packages": (self.packages, f"list the packages that have {noun}s"),
        }
        Tool(self.name, f"{self.name} shows {noun}s.", verbs, without=0, help_options=("-h", "--help"))(ctx, argv)

    def show(self, ctx: Context, argv: Sequence[str]) -> None:  # noqa: ARG002
        """Print the fields, nested ones indented, or with -r the original definition."""
        parser = Parser(
            self.name,
            f"{self.name} show [options] <{self._kind.noun}>",
            option("-r --raw", "the definition as it was written"),
            option("-b --bag", "the definition in a bag", "BAGFILE"),
        )
        given = parser.parse(argv, most=1, extra=f"you may only specify one {self._kind.noun}")
        wanted = self._wanted(parser, given.words)
        if given.bag:
            from slidectl.extensions.ros_commands import rosbag as bag

            return output.write(bag.definition(given.bag, wanted, bool(given.raw)).rstrip("\n") + "\n\n")
        for found in self._resolve(wanted):
            output.write(definition_text(self._kind, found, wanted, bool(given.raw)))
        return None

    def list_types(self, ctx: Context, argv: Sequence[str]) -> None:  # noqa: ARG002
        """Print all types."""
        Parser(self.name, f"{self.name} list").parse(argv)
        output.write("\n".join(sorted(self._kind.names())))

    def md5(self, ctx: Context, argv: Sequence[str]) -> None:  # noqa: ARG002
        """Print the md5 sum of a type."""
        parser = Parser(self.name, f"{self.name} md5 <{self._kind.noun}>")
        words = parser.parse(argv, most=1, extra=f"you may only specify one {self._kind.noun}").words
        wanted = self._wanted(parser, words)
        if _is_invalid(wanted):
            raise Failure(f"Invalid type: 'invalid name [{wanted}]'\n{_PLEASE}", NO_SUCH_VERB)
        try:
            found = self._resolve(wanted)
        except Failure:
            raise Failure(f"Cannot locate [{wanted}]{self._suggestion(wanted)}") from None
        for each in found:
            output.write(("" if "/" in wanted else f"[{each}]: ") + self._kind.md5(each))

    def package(self, ctx: Context, argv: Sequence[str]) -> None:  # noqa: ARG002
        """Print the types of one package."""
        parser = Parser(self.name, f"{self.name} package <package>", _SINGLE_LINE)
        given = parser.parse(argv, 1, 1, "package name must be specified", "you may only specify one package")
        (package,) = given.words
        known = _packages()
        if package not in known:
            raise Failure(f"Invalid package: {package}\npackages: {' '.join(known)}", NO_SUCH_VERB)
        mine = sorted(name for name in self._kind.names() if name.startswith(f"{package}/"))
        output.write((" " if given.single_line else "\n").join(mine))

    def packages(self, ctx: Context, argv: Sequence[str]) -> None:  # noqa: ARG002
        """Print the packages that have types of this kind."""
        given = Parser(self.name, f"{self.name} packages", _SINGLE_LINE).parse(argv)
        known = sorted({name.partition("/")[0] for name in self._kind.names()})
        output.write((" " if given.single_line else "\n").join(known))

    def _wanted(self, parser: Parser, words: Sequence[str]) -> str:
        """The type given in the words, or on stdin. Raises a usage error for text that cannot be a type."""
        noun = self._kind.noun
        wanted = words[0] if words else sys.stdin.readline().strip()
        if not wanted:
            parser.error(f"no {noun} given, and none on stdin")
        if "::" in wanted:
            parser.error(f"{self.name} does not understand C++-style namespaces (i.e. '::').\n{_PLEASE}")
        if "." in wanted:
            parser.error(f"invalid {noun} '{wanted}'.\n{_PLEASE}")
        return wanted

    def _resolve(self, wanted: str) -> list[str]:
        """The types that `wanted` means: one, or those of every package for a bare name. Raises Failure."""
        if "/" not in wanted:
            found = [each for each in self._kind.names() if each.endswith("/" + wanted)]
            if found:
                return found
            raise Failure(f"Could not find {self._suffix} '{wanted}'{self._suggestion(wanted)}")
        trouble = f"{'Unable to load msg' if self._suffix == 'msg' else 'Unknown srv type'} [{wanted}]"
        if _is_invalid(wanted):
            raise Failure(f"{trouble}: invalid name [{wanted}]\n{_PLEASE}")
        try:
            self._kind.source(wanted)  # reading the list of all types would take longer than the rest of the command
            return [wanted]
        except UnknownName:
            package, _, word = wanted.partition("/")
            packages = _packages()
            unknown = f": unknown package [{package}] on search path [{packages}]"
            where = f" in package [{package}]" if package in packages else unknown
            raise Failure(f"{trouble}: Cannot locate message [{word}]{where}{self._suggestion(wanted)}") from None

    def _suggestion(self, wanted: str) -> str:
        near = closest(wanted, self._kind.names())
        return f"\nDid you mean {near!r}?" if near else ""


def _is_invalid(wanted: str) -> bool:
    return wanted.count("/") > 1 or wanted.startswith("/") or wanted.endswith("/")


def _packages() -> list[str]:
    """All packages that have types of any kind."""
    from slidectl import msgs

    return sorted({name.partition("/")[0] for name in [*msgs.type_names(), *msgs.service_names()]})


def rosmsg(ctx: Context, argv: Sequence[str]) -> None:
    """Run a verb on message types."""
    _Types("rosmsg", "msg", messages())(ctx, argv)


def rossrv(ctx: Context, argv: Sequence[str]) -> None:
    """Run a verb on service types."""
    _Types("rossrv", "srv", services())(ctx, argv)
