"""The command line: it parses, calls the client and prints. No other room imports this one.

`entry` is the console script. It must stay cheap to import: the command's own module, YAML, rich and the
rest are imported inside the functions that need them.
"""

from __future__ import annotations

import _signal  # type: ignore[import-not-found]  # what signal wraps into classes, which takes a millisecond
import gc
import os
import sys

TYPE_CHECKING = False  # typing takes milliseconds in which nobody would take a Ctrl-C
if TYPE_CHECKING:
    from typing import NoReturn

_INTERRUPTED = 130
_MOMENT_S = 0.001
# New objects between two looks for garbage: more than a short command makes (a tenth of its time went into looking),
# and still few enough for one that follows a topic for days.
_GARBAGE_THRESHOLD = 100_000


def entry() -> NoReturn:
    """Run the command line of this process and leave with its exit code. Of several Ctrl-C the first is enough."""
    code = _INTERRUPTED
    try:
        try:  # noqa: SIM105 (contextlib takes too long here)
            code = _run()
        except KeyboardInterrupt:
            pass
        _ignore_interrupts()
    except KeyboardInterrupt:  # a second one, on the way to the line above
        _ignore_interrupts()
    leave(code)


def _run() -> int:
    if sys.getfilesystemencoding() == "ascii" and sys.executable:
        _become_utf8()
    gc.set_threshold(_GARBAGE_THRESHOLD)
    sys.unraisablehook = _unheard
    if None in (sys.stdin, sys.stdout, sys.stderr):
        _stand_in()
    from slidectl.cli.main import run

    return run(sys.argv[1:])


def _become_utf8() -> None:
    """Begin again in Python's UTF-8 mode: the locale knows ASCII only, and what is typed is UTF-8 all the same."""
    os.execv(sys.executable, [sys.executable, "-X", "utf8", *sys.orig_argv[1:]])


def _unheard(unraisable: sys.UnraisableHookArgs) -> None:
    """A Ctrl-C that came in a finalizer, where nobody can hear it: raise it again in a moment, elsewhere."""
    if unraisable.exc_type is not KeyboardInterrupt:
        sys.__unraisablehook__(unraisable)
        return
    _signal.signal(_signal.SIGALRM, _signal.default_int_handler)
    _signal.setitimer(_signal.ITIMER_REAL, _MOMENT_S)


def _ignore_interrupts() -> None:
    _signal.signal(_signal.SIGINT, _signal.SIG_IGN)


def _stand_in() -> None:
    """Put /dev/null in the place of standard streams that were closed, before a socket gets their number."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115


def leave(code: int) -> NoReturn:
    """Flush and end the process at once: an orderly teardown of the interpreter costs more than most commands."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except (OSError, ValueError, KeyboardInterrupt):
            continue
    os._exit(code)
