"""`slidectl shell`: command lines from a terminal, a file or a pipe, all on one connection and in one process.

It reads lines, hands each to the root command, and decides when to stop. What the commands do is theirs.
"""

from __future__ import annotations

import io
import shlex
import sys
from collections.abc import Callable, Iterable

import click

from slidectl.cli import live, output
from slidectl.cli.commands import command
from slidectl.cli.context import DEFAULT_TIMEOUT_S, Context
from slidectl.cli.documents import bounded
from slidectl.cli.failure import guard
from slidectl.client import Client
from slidectl.errors import EXIT_DONE, EXIT_INTERRUPTED, EXIT_NO_DAEMON, BadFile, UsageError

_LEAVE = ("exit", "quit")
_DAEMON_CHANGES = frozenset(("daemon", "launch"))


class LineContext(Context):
    """The context of one line: the options of the shell to begin with, and its connection where that fits."""

    def __init__(self, shell: Shell) -> None:
        super().__init__()
        self._shell = shell
        self._shared: Client | None = None
        options = shell.context
        self.instance, self.socket, self.namespace = options.instance, options.socket, options.namespace
        self.format, self.quiet, self.verbose = options.format, options.quiet, options.verbose
        self.timeout = options.timeout

    @property
    def client(self) -> Client:
        """The shell's connection, or one of its own when the line picks another daemon. Raises NoDaemon."""
        if self._shared is not None:
            return self._shared
        shell = self._shell
        if self._client is None and (self.instance, self.socket) == (shell.context.instance, shell.context.socket):
            client = shell.client
            client.timeout = self.wait_limit(DEFAULT_TIMEOUT_S)
            self._shared = client
            return client
        return super().client


class Shell:
    """Runs lines. `context` has the options of the shell itself; `client` is made when the first line needs it."""

    def __init__(self, context: Context) -> None:
        self.context = context
        self._client: Client | None = None

    @property
    def client(self) -> Client:
        """The connection that all lines share. Raises NoDaemon."""
        if self._client is None:
            context = self.context
            self._client = Client(context.instance, context.socket, timeout=context.wait_limit(DEFAULT_TIMEOUT_S))
            context._client = self._client
            self._client.on_other_version = context.say_other_version
        return self._client

    def run(self, line: str) -> int:
        """One line; its exit code. Errors are printed."""
        context = LineContext(self)
        words: list[str] = []

        def act() -> None:
            words.extend(_words(line))
            if words:
                self._invoke(words, context)

        try:
            code = guard(act, context, words)
        finally:
            output.leave_reader_alone()
            context.close()
        if code in (EXIT_NO_DAEMON, EXIT_INTERRUPTED) or not _DAEMON_CHANGES.isdisjoint(words):
            self.close()  # it is gone, or may be in the middle of something
        return code

    def _invoke(self, words: list[str], context: LineContext) -> None:
        if words[0] == "shell":
            raise UsageError("a shell within a shell", "run its lines here")
        from slidectl.cli.main import root

        with root.make_context("slidectl", words, obj=context) as click_context:
            root.invoke(click_context)

    def close(self) -> None:
        """Let go of the connection; the next line makes a new one."""
        if self._client is not None:
            self._client.close()
            self._client = None


def _words(line: str) -> list[str]:
    """The words of a line, as a shell parts them; `slidectl` in front may be written. Raises UsageError."""
    try:
        words = shlex.split(line, comments=True)
    except ValueError as error:
        raise UsageError(f"cannot read the line: {error}") from None
    return words[1:] if words[:1] == ["slidectl"] else words


@command(
    examples=[
        "slidectl shell",
        "slidectl shell < script",
        "printf 'pub command 1.0\\nsim step 1000\\n' | slidectl --json shell",
    ]
)
@click.argument("file", required=False, shell_complete=live.files)
@click.option("--keep-going", is_flag=True, help="Go on after a failure; the exit code is that of the first.")
@click.pass_context
def shell(click_context: click.Context, file: str | None, keep_going: bool) -> None:
    """Run many commands in one process.

    One command a line, without 'slidectl' in front, from FILE or from stdin; '#' begins a comment. It stops at the
    first command that fails, with its exit code. All lines share one connection, so each takes about a
    millisecond. Options before 'shell' hold for every line.

    On a terminal there is a prompt with history and completion; 'exit' or Ctrl-D ends it.
    """
    context: Context = click_context.obj
    runner = Shell(context)
    try:
        if file is None and sys.stdin.isatty():
            from slidectl.cli.prompt import lines

            code = _converse(runner, lines(context))
        else:
            code = _run_script(runner, file, keep_going)
    finally:
        runner.close()
    click_context.exit(code)


def _converse(runner: Shell, lines: Iterable[str]) -> int:
    """Failures are for the person to see; only leaving ends it."""
    for line in lines:
        if line.strip() in _LEAVE:
            break
        runner.run(line)
    return EXIT_DONE


def _run_script(runner: Shell, file: str | None, keep_going: bool) -> int:
    """The exit code of the first line that failed, else 0."""
    name, lines, give_back = _script(file)
    first_failure = EXIT_DONE
    try:
        for number, line in enumerate(lines, 1):
            if line.strip() in _LEAVE:
                break
            code = runner.run(line)
            if code != EXIT_DONE:
                runner.context.say(f"{name}, line {number}: {line.strip()}")
                first_failure = first_failure or code
            if (first_failure and not keep_going) or code == EXIT_INTERRUPTED or output.reader_has_gone():
                break
    finally:
        give_back()
    return first_failure


def _script(file: str | None) -> tuple[str, Iterable[str], Callable[[], None]]:
    """Name and lines of the script. One that comes by stdin is not for its commands to read: they find it empty."""
    if file is not None and file != "-":
        try:
            opened = open(file, encoding="utf-8")  # noqa: SIM115 - closed by who reads it
        except OSError as error:
            raise BadFile(error.strerror or str(error), file) from None
        return file, bounded(opened, file), opened.close
    stdin = sys.stdin
    sys.stdin = io.StringIO()

    def give_back() -> None:
        sys.stdin = stdin

    return "stdin", bounded(stdin, "stdin"), give_back
