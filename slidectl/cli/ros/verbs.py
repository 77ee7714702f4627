"""A ROS tool with verbs: `rostopic echo ...` finds the function for `echo`, in a module that is imported then.

Without a verb, or with one that there is not, it prints the list of them on stdout, as the tools do.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import NamedTuple

import click

from slidectl.cli import output
from slidectl.cli.context import Context

NO_SUCH_VERB = 64
"""EX_USAGE of sysexits.h, which most of the tools give."""


class Verb(NamedTuple):
    """Where the function of a verb is: `module:function` in this package. No help: it is left out of the list."""

    place: str
    help: str


class Tool(NamedTuple):
    """A tool. `without` and `unknown` are the exit codes for no verb and for one that there is not."""

    name: str
    about: str
    verbs: Mapping[str, Verb]
    without: int = NO_SUCH_VERB
    unknown: int = NO_SUCH_VERB
    help_options: Sequence[str] = ()
    """Words that ask for the list and are success."""

    def run(self, ctx: Context, argv: Sequence[str]) -> None:
        """Run the verb with the words behind it. Raises what it raises, and click's Exit."""
        verb = self.verbs.get(argv[0]) if argv else None
        if verb is None:
            output.write(self.usage())
            raise click.exceptions.Exit(self._code(argv))
        module, _, function = verb.place.partition(":")
        getattr(import_module(f"slidectl.cli.ros.{module}"), function)(ctx, list(argv[1:]))

    def _code(self, argv: Sequence[str]) -> int:
        if not argv:
            return self.without
        return 0 if argv[0] in self.help_options else self.unknown

    def usage(self) -> str:
        """The list of the verbs."""
        shown = {name: verb.help for name, verb in self.verbs.items() if verb.help}
        width = max(map(len, shown))
        lines = [f"\t{self.name} {name:<{width}}  {text}" for name, text in shown.items()]
        return "\n".join(
            [self.about, "", "Commands:", *lines, "", f"'{self.name} <command> -h' tells more of one of them.", ""]
        )
