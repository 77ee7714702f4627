"""From an exception to lines on stderr and an exit code. The only place that decides either.

With `--json` the lines are one object with the keys error, hint (null when there is none) and exit_code.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from contextlib import suppress

import click

from slidectl.cli.context import Context, paint
from slidectl.cli.output import ClosedPipe, as_json, reader_has_gone
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


def guard(action: Callable[[], None], context: Context, words: Sequence[str] = ()) -> int:
    """Run the action; the exit code. Errors are printed, with a traceback when `-v` was given twice.

    `words` are those of the command line. An error may say that they are two commands.
    """
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
        return EXIT_DONE if reader_has_gone() else _report(NoDaemon(f"the connection broke: {error}"), context, ())
    except Exception as error:
        return EXIT_INTERRUPTED if _was_interrupted(error) else _report(error, context, words)


def _was_interrupted(error: BaseException | None) -> bool:
    """Python dresses an interrupt that comes while it makes a class as a RuntimeError; what it was is the cause."""
    while isinstance(error, Exception):
        error = error.__cause__
    return error is not None


def _report(error: Exception, context: Context, words: Sequence[str]) -> int:
    if context.verbose >= 2:
        import traceback

        traceback.print_exception(error)
    message, hint, code = describe(error)
    hint = _two_commands(error, words) or hint
    with suppress(OSError):  # stderr may be a full disk, and the exit code is all that is left then
        if context.format == "json" or _asks_for_json(error, words):
            record = {"error": _shortened(message), "hint": hint, "exit_code": code}
            print(as_json(record), file=sys.stderr, flush=True)
        else:
            text = f"{message}\n{hint}" if hint else message
            lines = [_shortened(line) for line in text.rstrip().splitlines()]
            print(paint("error:", "red"), "\n".join(lines), file=sys.stderr, flush=True)
    return code


def _asks_for_json(error: Exception, words: Sequence[str]) -> bool:
    """Of a command line that cannot be read, the option may not have been reached."""
    return isinstance(error, click.UsageError) and "--json" in words and words[0] != "ros"


def _two_commands(error: Exception, words: Sequence[str]) -> str | None:
    """The hint for a line that holds a second command, because a line break was lost."""
    from slidectl.cli.main import COMMANDS

    begins = None
    if isinstance(error, SlidectlError | click.UsageError) and "slidectl" in words[1:]:
        begins = words.index("slidectl", 1)
        second = words[begins + 1 :]
    elif isinstance(error, click.UsageError) and error.ctx is not None and "extra argument" in error.message:
        depth = len(error.ctx.command_path.split()) - 1
        begins = next((index for index in range(depth, len(words)) if words[index] in COMMANDS), None)
        second = words[begins:] if begins is not None else []
    if begins is None or (second and second[0] not in COMMANDS):
        return None
    from shlex import quote

    lines = [" ".join(["slidectl", *map(quote, each)]) for each in (words[:begins], second)]
    return f"these are two commands; each needs a line of its own, or a ';' between them: {'; '.join(lines)}"


def _shortened(line: str) -> str:
    """A line that quotes something endless loses its middle."""
    if len(line) <= _LONGEST_LINE:
        return line
    half = _LONGEST_LINE // 2
    return f"{line[:half]} ... ({len(line) - 2 * half} characters more) ... {line[-half:]}"


def describe(error: Exception) -> tuple[str, str | None, int]:
    """What failed, what to do next (if that is known), and the exit code of an error."""
    if isinstance(error, SlidectlError):
        return error.message, error.hint, error.exit_code
    if isinstance(error, click.UsageError):
        see = f"see '{error.ctx.command_path} --help'" if error.ctx is not None else None
        return error.format_message().replace("\n\t", " "), see, EXIT_USAGE
    if isinstance(error, click.ClickException):
        return error.format_message(), None, error.exit_code
    if isinstance(error, OSError) and error.errno in NoDescriptors.ERRNOS:
        lacking = NoDescriptors("slidectl")
        return lacking.message, lacking.hint, lacking.exit_code
    fault = "this is a fault of slidectl; give -v twice to see where it happened"
    return f"{type(error).__name__}: {error}", fault, EXIT_REFUSED
