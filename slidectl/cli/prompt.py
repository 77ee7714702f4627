"""The lines of a person at a terminal: a prompt, and with readline a history and the completion of live names.

Only reads. It knows the root command for its completions and runs nothing.
"""

from __future__ import annotations

import os
import shlex
import sys
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

from slidectl.cli.context import Context

PROMPT = "slidectl> "
_MOST_HISTORY = 1000


def lines(context: Context) -> Iterator[str]:
    """What is typed, line by line, until Ctrl-D. Ctrl-C gives up the line."""
    history = _with_readline(context)
    while True:
        try:
            line = input(PROMPT)
        except EOFError:
            print(file=sys.stderr)
            break
        except KeyboardInterrupt:
            print(file=sys.stderr)
            continue
        yield line
        _save(history)


def history_file() -> str:
    """Where the lines are remembered: `$XDG_STATE_HOME/slidectl/history`, by default below `~/.local/state`."""
    base = os.environ.get("XDG_STATE_HOME") or os.path.expanduser("~/.local/state")
    return os.path.join(base, "slidectl", "history")


def _with_readline(context: Context) -> str | None:
    """Editing, history and completion; the history's file, or None where Python has no readline."""
    try:
        import readline
    except ImportError:
        return None
    path = history_file()
    readline.set_history_length(_MOST_HISTORY)
    with suppress(OSError):
        readline.read_history_file(path)
    readline.set_completer_delims(" \t\n")
    readline.set_completer(Completer(context))
    readline.parse_and_bind("tab: complete")
    return path


def _save(path: str | None) -> None:
    if path is None:
        return
    import readline

    with suppress(OSError):  # a history that cannot be kept is no reason to stop
        os.makedirs(os.path.dirname(path), mode=0o700, exist_ok=True)
        readline.write_history_file(path)


class Completer:
    """readline's callback: the `state`th completion of `text`, asked of the command line's own completion."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._found: list[str] = []

    def __call__(self, text: str, state: int) -> str | None:
        import readline

        if state == 0:
            self._found = completions(self._context, readline.get_line_buffer()[: readline.get_begidx()], text)
        return self._found[state] if state < len(self._found) else None


def completions(context: Context, before: str, text: str) -> list[str]:
    """What the word `text` may become, after the words `before` it; with a blank where a word is complete."""
    from click.shell_completion import ShellComplete

    from slidectl.cli.main import root

    try:
        words = shlex.split(before)
    except ValueError:  # an open quote
        return []
    asking = Context()
    asking.instance, asking.socket, asking.namespace = context.instance, context.socket, context.namespace
    options: dict[str, Any] = {"obj": asking}
    try:
        items = ShellComplete(root, options, "slidectl", "").get_completions(words, text)
    finally:
        asking.close()
    return [f"{item.value} " for item in items if item.type == "plain"] + _files(text, items)


def _files(text: str, items: list[Any]) -> list[str]:
    if not any(item.type == "file" for item in items):
        return []
    from glob import escape, glob

    return [f"{name}/" if os.path.isdir(name) else f"{name} " for name in sorted(glob(escape(text) + "*"))]
