"""`slidectl shell`: command lines from a terminal, a file or a pipe, all on one connection and in one process.

It reads lines, on a terminal with a prompt, a history and the completion of names from the daemon, runs each with the
root command, and decides when to stop.
"""

from __future__ import annotations

import io
import os
import shlex
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

import click

from slidectl.cli import completion, output
from slidectl.cli.commands import command
from slidectl.cli.context import Context
from slidectl.cli.main import guard, invoke, root
from slidectl.errors import EXIT_DONE, EXIT_INTERRUPTED, EXIT_NO_DAEMON, UsageError
from slidectl.input_files import opened_text
from slidectl.paths import with_package
from slidectl.typed_values import bounded

_LEAVE = ("exit", "quit")
_DAEMON_CHANGES = frozenset(("daemon", "launch"))
PROMPT = "slidectl> "
_MOST_HISTORY = 1000


def _words(line: str) -> list[str]:
    """The words of a line, split as in a shell, without a leading `slidectl`. Raises UsageError."""
    try:
        words = shlex.split(line, comments=True)
    except ValueError as error:
        raise UsageError(f"cannot read the line: {error}") from None
    return words[1:] if words[:1] == ["slidectl"] else words


@command(
    step=None,
    examples=[
        "slidectl shell",
        "slidectl shell < script",
        "printf 'pub command 1.0\\nsim step 1000\\n' | slidectl --json shell",
    ],
)
@click.argument("file", required=False, shell_complete=completion.files)
@click.option("--keep-going", is_flag=True, help="Continue after a failure; the exit code is that of the first.")
@click.pass_context
def shell(click_context: click.Context, file: str | None, keep_going: bool) -> None:
    """Run many commands in one process.

    One command a line, without 'slidectl' in front, from FILE or from stdin; '#' begins a comment. It stops at the
    first command that fails, with its exit code. All lines share one connection, so each takes about a
    millisecond. Options before 'shell' hold for every line.

    On a terminal there is a prompt with history and completion; 'exit' or Ctrl-D ends it.
    """
    context: Context = click_context.obj
    try:
        if file is None and sys.stdin.isatty():
            code = _run_interactive(context)
        else:
            code = _run_script(context, file, keep_going)
    finally:
        context.close()
    click_context.exit(code)


def _run_line(context: Context, line: str) -> int:
    """Run one line and return its exit code. Errors are printed. `context` is that of the shell."""
    own = Context(context)
    words: list[str] = []

    def act() -> None:
        words.extend(_words(line))
        if words[:1] == ["shell"]:
            raise UsageError("a shell within a shell", "run its lines here")
        if "--detach" in words:
            raise click.exceptions.Exit(_run_apart(context, words))
        if words:
            invoke(words, own)

    try:
        code = guard(act, own, words)
    finally:
        own.close()
    if code in (EXIT_NO_DAEMON, EXIT_INTERRUPTED) or not _DAEMON_CHANGES.isdisjoint(words):
        context.close()  # the daemon is gone, or a request on the connection may be incomplete
    return code


def _run_apart(context: Context, words: list[str]) -> int:
    """Run a line in a separate process, which may fork and exit (the shell must not); return its exit code."""
    import subprocess

    said = {
        "--instance": context.instance, "--socket": context.socket, "--ns": context.namespace,
        "--output": context.format, "--timeout": context.timeout,
    }  # fmt: skip
    options = [word for name, value in said.items() if value is not None for word in (name, str(value))]
    options += ["--quiet"] * context.quiet + ["--verbose"] * context.verbose
    stdin = None if sys.stdin is sys.__stdin__ else subprocess.DEVNULL
    argv = [sys.executable, "-P", "-m", "slidectl", *options, *words]
    with subprocess.Popen(argv, stdin=stdin, env=with_package(os.environ)) as process:
        while True:
            with suppress(KeyboardInterrupt):  # the process gets the Ctrl-C too, and handles it
                return process.wait()


def _run_script(context: Context, file: str | None, keep_going: bool) -> int:
    """Run a script; return the exit code of the first line that failed, else 0."""
    first_failure = EXIT_DONE
    with _script(file) as (name, lines):
        for number, line in enumerate(lines, 1):
            if line.strip() in _LEAVE:
                break
            code = _run_line(context, line)
            if code != EXIT_DONE:
                context.say(f"{name}, line {number}: {line.strip()}")
                first_failure = first_failure or code
            if (first_failure and not keep_going) or code == EXIT_INTERRUPTED or output.is_reader_gone():
                break
    return first_failure


@contextmanager
def _script(file: str | None) -> Iterator[tuple[str, Iterator[str]]]:
    """Yield the name and lines of the script. When it comes from stdin, its commands read an empty stdin."""
    if file is not None and file != "-":
        # Bytes that are not UTF-8 are kept, as on stdin: names of files may have them.
        with opened_text(file, errors="surrogateescape", pipes=True) as lines:
            yield file, bounded(lines, file)
        return
    stdin, sys.stdin = sys.stdin, io.StringIO()
    try:
        yield "stdin", bounded(stdin, "stdin")
    finally:
        sys.stdin = stdin


# --- on a terminal --------------------------------------------------------------------------------------------------


def _run_interactive(context: Context) -> int:
    """Run lines until Ctrl-D or `exit`. Ctrl-C discards a line. A command that fails does not end the shell."""
    save = _with_readline(context)
    while True:
        try:
            line = input(PROMPT)
        except EOFError:
            print(file=sys.stderr)
            return EXIT_DONE
        except KeyboardInterrupt:
            print(file=sys.stderr)
            continue
        if line.strip() in _LEAVE:
            return EXIT_DONE
        _run_line(context, line)
        save()


def history_file() -> str:
    """The path of the history file: `$XDG_STATE_HOME/slidectl/history`, by default below `~/.local/state`."""
    base = os.environ.get("XDG_STATE_HOME") or os.path.expanduser("~/.local/state")
    return os.path.join(base, "slidectl", "history")


def _with_readline(context: Context) -> Callable[[], None]:
    """Set up editing, history and completion, if Python has readline. Returns a function that saves the history."""
    try:
        import readline
    except ImportError:
        return lambda: None
    path = history_file()
    found: list[str] = []

    def complete(text: str, state: int) -> str | None:
        if state == 0:
            found[:] = _completions(context, readline.get_line_buffer()[: readline.get_begidx()], text)
        return found[state] if state < len(found) else None

    def save() -> None:
        with suppress(OSError):  # the shell goes on without a saved history
            os.makedirs(os.path.dirname(path), mode=0o700, exist_ok=True)
            readline.write_history_file(path)

    readline.set_history_length(_MOST_HISTORY)
    with suppress(OSError):
        readline.read_history_file(path)
    readline.set_completer_delims(" \t\n")
    readline.set_completer(complete)
    readline.parse_and_bind("tab: complete")
    return save


def _completions(context: Context, before: str, text: str) -> list[str]:
    """The completions of the word `text` after the words `before`; a complete word ends with a blank."""
    from glob import escape, glob

    from click.shell_completion import ShellComplete

    try:
        words = shlex.split(before)
    except ValueError:  # an open quote
        return []
    asking = Context()
    asking.instance, asking.socket, asking.namespace = context.instance, context.socket, context.namespace
    try:
        items = ShellComplete(root, {"obj": asking}, "slidectl", "").get_completions(words, text)
    finally:
        asking.close()
    found = [f"{item.value} " for item in items if item.type == "plain"]
    if any(item.type == "file" for item in items):
        found += [f"{name}/" if os.path.isdir(name) else f"{name} " for name in sorted(glob(escape(text) + "*"))]
    return found
