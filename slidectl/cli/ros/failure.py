"""How a ROS command ends badly: its own words on stderr, and an exit code.

Text is printed as it stands. What the shared code raises is put behind `ERROR: `, as the tools do.
"""

from __future__ import annotations

from slidectl.errors import EXIT_REFUSED, NoDaemon, SlidectlError

UNABLE = "ERROR: Unable to communicate with master!"


class Failure(SlidectlError):
    """An end with an exit code; the text is complete."""

    def __init__(self, text: str, exit_code: int = EXIT_REFUSED) -> None:
        super().__init__(text)
        self.exit_code = exit_code


def told(error: SlidectlError, prefix: str = "ERROR: ") -> str:
    """What a tool prints about an error; `prefix` stands before what is not in its own words."""
    if isinstance(error, Failure):
        return error.message
    if isinstance(error, NoDaemon):
        return f"{UNABLE}\n{error}"
    return f"{prefix}{error}"
