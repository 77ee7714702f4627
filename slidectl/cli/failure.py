"""From an exception to lines on stderr and an exit code. The only place that decides either."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import suppress

import click

from slidectl.cli.context import Context, paint
from slidectl.cli.output import ClosedPipe, reader_has_gone
from slidectl.errors import (
    EXIT_DONE,
    EXIT_INTERRUPTED,
    EXIT_REFUSED,
    EXIT_USAGE,
    NoDaemon,
    NoDescriptors,
    SlidectlError,
)

_LONGEST_LINE = 4000


def guard(action: Callable[[], None], context: Context) -> int:
    """Run the action; the exit code. Errors are printed, with a traceback when `-v` was given twice."""
    try:
        action()
        return EXIT_DONE
    except click.exceptions.Exit as leaving:
        return leaving.exit_code
    except ClosedPipe:
        return EXIT_DONE
    except (KeyboardInterrupt, click.Abort):
        return EXIT_INTERRUPTED
    except BrokenPipeError as error:
        return EXIT_DONE if reader_has_gone() else _report(NoDaemon(f"the connection broke: {error}"), context)
    except Exception as error:
        return EXIT_INTERRUPTED if _was_interrupted(error) else _report(error, context)


def _was_interrupted(error: BaseException | None) -> bool:
    """Python dresses an interrupt that comes while it makes a class as a RuntimeError; what it was is the cause."""
    while isinstance(error, Exception):
        error = error.__cause__
    return error is not None


def _report(error: Exception, context: Context) -> int:
    if context.verbose >= 2:
        import traceback

        traceback.print_exception(error)
    text, code = describe(error)
    with suppress(OSError):  # stderr may be a full disk, and the exit code is all that is left then
        lines = [_shortened(line) for line in text.rstrip().splitlines()]
        print(paint("error:", "red"), "\n".join(lines), file=sys.stderr, flush=True)
    return code


def _shortened(line: str) -> str:
    """A line that quotes something endless loses its middle."""
    if len(line) <= _LONGEST_LINE:
        return line
    half = _LONGEST_LINE // 2
    return f"{line[:half]} ... ({len(line) - 2 * half} characters more) ... {line[-half:]}"


def describe(error: Exception) -> tuple[str, int]:
    """The lines for the user and the exit code of an error."""
    if isinstance(error, SlidectlError):
        return str(error), error.exit_code
    if isinstance(error, click.UsageError):
        return error.format_message().replace("\n\t", " ") + _where_to_look(error), EXIT_USAGE
    if isinstance(error, click.ClickException):
        return error.format_message(), error.exit_code
    if isinstance(error, OSError) and error.errno in NoDescriptors.ERRNOS:
        return str(NoDescriptors("slidectl")), EXIT_REFUSED
    name = type(error).__name__
    return f"{name}: {error}\nthis is a fault of slidectl; give -v twice to see where it happened", EXIT_REFUSED


def _where_to_look(error: click.UsageError) -> str:
    return f"\nsee '{error.ctx.command_path} --help'" if error.ctx is not None else ""
