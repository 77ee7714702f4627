"""The base class of kinds of steps that are no commands. Installed packages add them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

if TYPE_CHECKING:
    from slidectl.client import Client


class StepKind:
    """What a step does whose key is the name of this kind, and whose value is of any form that YAML has.

    One instance serves all steps of a process, in several cases one after the other: it keeps nothing between them.
    """

    help: ClassVar[str] = ""
    """One sentence, for editors."""
    schema: ClassVar[Mapping[str, Any]] = {}
    """The JSON schema of the value, for editors; `check` is what counts."""
    may_add_controllers: ClassVar[bool] = False
    """True when controllers, or their parameters, may come from such a step."""

    def check(self, value: Any) -> None:
        """Raise UsageError for a value that is wrong in any world, before anything runs. Variables are replaced."""

    def run(self, value: Any, client: Client) -> Mapping[str, Any] | None:
        """Do the step by a client of the world. Waits of the client let the world run, up to the limit of the step.

        Returns a record for the output, or None. Raises SlidectlError where the step fails: Refused, for example.
        """
        raise NotImplementedError
