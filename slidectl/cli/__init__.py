"""The command line: it parses, calls the client and prints. No other package of slidectl imports this one.

It exports the names that authors of commands import, as in `from slidectl.cli import command`; they are imported on
first use. `entry` is the console script. It must stay cheap to import: the command's own module, YAML, rich and the
rest are imported inside the functions that need them.
"""

from __future__ import annotations

import gc
import os
import sys

TYPE_CHECKING = False  # the import of typing takes milliseconds in which no code handles Ctrl-C
if TYPE_CHECKING:
    from typing import Any, NoReturn

    from slidectl.cli.commands import Command, Group, command, group
    from slidectl.cli.context import Context
    from slidectl.command_steps import CommandStep, StepEffects

__all__ = ["Command", "CommandStep", "Context", "Group", "StepEffects", "command", "entry", "group"]

_INTERRUPTED = 130
# New objects between two garbage collections: more than a short command makes (collections took a tenth of its time),
# and few enough for a command that follows a topic for days.
_GARBAGE_THRESHOLD = 100_000


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module 'slidectl.cli' has no attribute {name!r}")
    from slidectl import command_steps
    from slidectl.cli import commands, context

    return next(getattr(module, name) for module in (context, command_steps, commands) if hasattr(module, name))


def entry() -> NoReturn:
    """Run the command line of this process and exit with its exit code. Every Ctrl-C after the first is ignored."""
    code = _INTERRUPTED
    try:
        try:  # noqa: SIM105 (contextlib takes too long here)
            code = _run()
        except KeyboardInterrupt:
            pass
        _ignore_interrupts()
    except KeyboardInterrupt:  # a second Ctrl-C before the line above
        _ignore_interrupts()
    leave(code)


def _run() -> int:
    import signal

    gc.set_threshold(_GARBAGE_THRESHOLD)
    # Shells start the background commands of a script with SIGINT ignored. SIGINT must end those commands too.
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:  # it was closed; without this a socket gets its number
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115
    from slidectl.cli.main import run

    return run(sys.argv[1:])


def _ignore_interrupts() -> None:
    import signal

    signal.signal(signal.SIGINT, signal.SIG_IGN)


def leave(code: int) -> NoReturn:
    """Flush and end the process at once. The interpreter's normal shutdown takes longer than most commands."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except (OSError, ValueError, KeyboardInterrupt):
            continue
    os._exit(code)
