"""What `rosmsg` and `rossrv` have in common: show, list, md5, package and packages of one kind of type.

They ask no daemon; only `show -b` reads a bag.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence

from slidectl.cli import output
from slidectl.cli.context import Context
from slidectl.cli.msg import Kind
from slidectl.cli.ros.arguments import Arguments, Option, Parser
from slidectl.cli.ros.failure import Failure
from slidectl.cli.ros.verbs import NO_SUCH_VERB, Tool, Verb
from slidectl.errors import UnknownName, closest

_PLEASE = "Please refer to msg/srv types as 'package_name/Type'."
_SINGLE_LINE = Option(("-s",), "single_line", "all on one line")


def tool(name: str, what: str) -> Tool:
    """The verbs of `rosmsg` or `rossrv`, whose functions are in the module of that name."""
    helps = {
        "show": f"show the fields of a {what}",
        "info": "the same as show",
        "list": f"list all {what}s",
        "md5": f"print the md5 sum of a {what}",
        "package": f"list the {what}s of a package",
        "packages": f"list the packages that have {what}s",
    }
    places = {"info": "show", "list": "list_types"}
    verbs = {verb: Verb(f"{name}:{places.get(verb, verb)}", text) for verb, text in helps.items()}
    return Tool(name, f"{name} shows {what}s.", verbs, without=0, help_options=("-h", "--help"))


class Types:
    """The verbs for one kind: `noun` is `message` or `service`, `suffix` that of its files."""

    def __init__(self, name: str, noun: str, suffix: str, kind: Callable[[], Kind]) -> None:
        self.name = name
        self._noun = noun
        self._suffix = suffix
        self._kind = kind

    def show(self, ctx: Context, argv: Sequence[str]) -> None:  # noqa: ARG002
        """Fields, nested ones indented, or with -r the definition as it was written."""
        parser = Parser(
            self.name,
            f"{self.name} show [options] <{self._noun} type>",
            [
                Option(("-r", "--raw"), "raw", "the definition as it was written"),
                Option(("-b", "--bag"), "bag", "as a bag has it", "BAGFILE"),
            ],
        )
        given = parser.parse(argv)
        wanted = self._wanted(parser, given)
        if given.bag:
            from slidectl.cli.ros import bag

            return output.write(bag.definition(given.bag, wanted, given.raw).rstrip("\n") + "\n\n")
        kind = self._kind()
        text = kind.source if given.raw else kind.show
        for found in self._found(kind, wanted):
            body = text(found).rstrip("\n")
            heading = "" if "/" in wanted else f"[{found}]:\n"
            output.write(heading + (f"{body}\n\n" if body else "\n"))
        return None

    def _wanted(self, parser: Parser, given: Arguments) -> str:
        """The type that was given, or the one on stdin. A usage error for what cannot be one."""
        if len(given.words) > 1:
            parser.error(f"you may only specify one {self._noun} type")
        wanted = given.words[0] if given.words else sys.stdin.readline().strip()
        if not wanted:
            parser.error(f"no {self._noun} type given, and none on stdin")
        if "::" in wanted:
            parser.error(f"{self.name} does not understand C++-style namespaces (i.e. '::').\n{_PLEASE}")
        if "." in wanted:
            parser.error(f"invalid {self._noun} type '{wanted}'.\n{_PLEASE}")
        return wanted

    def _found(self, kind: Kind, wanted: str) -> list[str]:
        """The types that are meant: one, or those of every package for a bare name. Raises Failure."""
        trouble = "Unable to load msg" if self._suffix == "msg" else "Unknown srv type"
        if _is_invalid(wanted):
            raise Failure(f"{trouble} [{wanted}]: invalid name [{wanted}]\n{_PLEASE}")
        if "/" in wanted and _exists(kind, wanted):
            return [wanted]
        known = kind.names()
        if "/" not in wanted:
            found = [each for each in known if each.endswith("/" + wanted)]
            return found or _fail(f"Could not find {self._suffix} '{wanted}'{_suggestion(wanted, known)}")
        raise Failure(f"{trouble} [{wanted}]: {self._not_located(wanted)}{_suggestion(wanted, known)}")

    def _not_located(self, wanted: str) -> str:
        package, _, word = wanted.partition("/")
        packages = _packages()
        if package not in packages:
            return f"Cannot locate message [{word}]: unknown package [{package}] on search path [{packages}]"
        from slidectl import msgs

        folder = os.path.join(os.path.dirname(msgs.__file__), "data", package, self._suffix)
        return f"Cannot locate message [{word}] in package [{package}] with paths [[{folder!r}]]"

    def list_types(self, ctx: Context, argv: Sequence[str]) -> None:  # noqa: ARG002
        """All of them."""
        Parser(self.name, f"{self.name} list").parse(argv)
        output.write("\n".join(sorted(self._kind().names())))

    def md5(self, ctx: Context, argv: Sequence[str]) -> None:  # noqa: ARG002
        """The sum that peers compare."""
        parser = Parser(self.name, f"{self.name} md5 <{self._noun} type>")
        given = parser.parse(argv)
        wanted = self._wanted(parser, given)
        if _is_invalid(wanted):
            raise Failure(f"Invalid type: 'invalid name [{wanted}]'\n{_PLEASE}", NO_SUCH_VERB)
        kind = self._kind()
        try:
            found = self._found(kind, wanted)
        except Failure:
            raise Failure(f"Cannot locate [{wanted}]{_suggestion(wanted, kind.names())}") from None
        for each in found:
            output.write(kind.md5(each) if "/" in wanted else f"[{each}]: {kind.md5(each)}")

    def package(self, ctx: Context, argv: Sequence[str]) -> None:  # noqa: ARG002
        """Those of one package."""
        parser = Parser(self.name, f"{self.name} package <package>", [_SINGLE_LINE])
        given = parser.parse(argv)
        (package,) = parser.at_most(given, 1, "you may only specify one package")
        if package is None:
            parser.error("package name must be specified")
        known = _packages()
        if package not in known:
            raise Failure(f"Invalid package: {package}\npackages: {' '.join(known)}", NO_SUCH_VERB)
        mine = sorted(name for name in self._kind().names() if name.startswith(f"{package}/"))
        output.write((" " if given.single_line else "\n").join(mine))

    def packages(self, ctx: Context, argv: Sequence[str]) -> None:  # noqa: ARG002
        """The packages that have any."""
        parser = Parser(self.name, f"{self.name} packages", [_SINGLE_LINE])
        given = parser.parse(argv)
        known = sorted({name.partition("/")[0] for name in self._kind().names()})
        output.write((" " if given.single_line else "\n").join(known))


def _is_invalid(wanted: str) -> bool:
    return wanted.count("/") > 1 or wanted.startswith("/") or wanted.endswith("/")


def _exists(kind: Kind, wanted: str) -> bool:
    """Without the list of all types, which takes longer than everything else here."""
    try:
        kind.source(wanted)
    except UnknownName:
        return False
    return True


def _fail(text: str) -> list[str]:
    raise Failure(text)


def _packages() -> list[str]:
    """All packages that have types of any kind."""
    from slidectl import msgs

    return sorted({name.partition("/")[0] for name in [*msgs.type_names(), *msgs.service_names()]})


def _suggestion(wanted: str, known: Sequence[str]) -> str:
    near = closest(wanted, known)
    return f"\nDid you mean {near!r}?" if near else ""
