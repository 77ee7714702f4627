"""Names for the completion of a shell: asked from the daemon, within 100 ms, silently nothing when that fails.

`shell_complete=live.topics` on a click argument or option. Nothing here raises.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

import click

from slidectl.cli.context import Context
from slidectl.errors import SlidectlError

LIMIT_S = 0.1

Completer = Callable[[click.Context, click.Parameter, str], list[str]]


def fitting(names: Iterable[str], incomplete: str) -> list[str]:
    """The names that begin with what was typed; a relative one is compared with the ends of the full names."""
    if not incomplete or incomplete.startswith("/"):
        return sorted(name for name in names if name.startswith(incomplete))
    ends = (end for name in names for end in _ends(name))
    return sorted({end for end in ends if end.startswith(incomplete)})


def _ends(name: str) -> Iterator[str]:
    parts = name.strip("/").split("/")
    return ("/".join(parts[index:]) for index in range(len(parts)))


def completer(ask: Callable[[Context], Iterable[str]]) -> Completer:
    """A click `shell_complete` callback from a function that asks the daemon for names."""

    def complete(click_context: click.Context, _param: click.Parameter, incomplete: str) -> list[str]:
        context = click_context.find_object(Context) or Context()
        try:
            with _time_limit(LIMIT_S):
                return fitting(list(ask(context)), incomplete)
        except (SlidectlError, OSError):
            return []

    return complete


@contextmanager
def _time_limit(seconds: float) -> Iterator[None]:
    """TimeoutError in the body when it takes longer. Main thread only, as signals are."""
    import signal

    def stop(*_: Any) -> None:
        raise TimeoutError

    previous = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, previous)


def _controllers(context: Context) -> list[str]:
    from slidectl.cli.managers import managers

    return [name for manager in managers(context) for name in manager.known()]


def _managers(context: Context) -> list[str]:
    from slidectl.cli.managers import managers

    return [manager.namespace for manager in managers(context)]


topics = completer(lambda context: context.names("topic"))
services = completer(lambda context: context.names("service"))
parameters = completer(lambda context: context.names("parameter"))
robots = completer(lambda context: context.names("robot"))
controllers = completer(_controllers)
managers = completer(_managers)


def files(_context: click.Context, _param: click.Parameter, incomplete: str) -> list[Any]:
    """Leave it to the shell to complete a file."""
    from click.shell_completion import CompletionItem

    return [CompletionItem(incomplete, type="file")]


def models(context: click.Context, param: click.Parameter, incomplete: str) -> list[Any]:
    """Shipped models, then files."""
    from click.shell_completion import CompletionItem

    from slidectl.paths import share

    shipped = sorted(path.stem for path in share("models").glob("*.xacro"))
    found = [CompletionItem(name) for name in shipped if name.startswith(incomplete)]
    return found or files(context, param, incomplete)
