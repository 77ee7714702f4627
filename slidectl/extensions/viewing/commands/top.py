"""`slidectl top`: watch a world on a terminal, or print it once as text."""

from __future__ import annotations

import select
import sys
from collections.abc import Callable
from time import monotonic

import click

from slidectl.cli import completion, output
from slidectl.cli.commands import command, positive_seconds
from slidectl.cli.context import Context
from slidectl.errors import NoDaemon, TimedOut
from slidectl.extensions.viewing.commands.terminal_keys import terminal_keys
from slidectl.extensions.viewing.top_screen import TopScreen
from slidectl.extensions.viewing.world_monitor import WorldMonitor


@command(step=None, examples=["slidectl top", "slidectl top rrbot", "slidectl top --once", "slidectl top --json"])
@click.argument("text", required=False, default="", shell_complete=completion.robots)
@click.option("-d", "--delay", type=float, callback=positive_seconds, default=0.5, show_default=True, metavar="S",
              help="Look again after so long, s of wall time.")  # fmt: skip
@click.option("--once", is_flag=True, help="Print it once, as text.")
@click.pass_obj
def top(ctx: Context, text: str, delay: float, once: bool) -> None:
    """Watch controllers, joints, topics and the log.

    Only rows with TEXT are shown, where it is given. The keys are shown by '?': they also pause and step the world, and
    start and stop controllers. Rates are in simulated time. Without a terminal, and with --once, it is printed once,
    after it has looked for --delay.

    JSON keys: status (as of 'slidectl sim status'), controllers (manager, name, state, type, claims), joints (name,
    position, velocity, effort, set_point), topics (topic, type, rate in Hz), log (lines).
    """
    screen = TopScreen(text)
    if once or ctx.format != "text" or not (output.is_terminal(sys.stdout) and sys.stdin.isatty()):
        monitor = screen.monitor = WorldMonitor(ctx.client, delay / 2)
        monitor.refresh()
        ctx.pause(delay)
        monitor.refresh()
        ctx.emit(screen.as_data(), screen.plain())
        return
    _watch(ctx, screen, delay)


def _watch(ctx: Context, screen: TopScreen, delay: float) -> None:
    """Show the screen until the quit key. When the daemon ends, wait for the next one."""
    from rich.console import Console, Group
    from rich.live import Live

    monitor: WorldMonitor | None = _connected(ctx, delay)
    console = Console()
    with terminal_keys() as keys, Live(console=console, screen=True, auto_refresh=False) as live:
        due = 0.0
        while True:
            if (now := monotonic()) >= due:
                due = now + delay
                monitor = _refreshed(ctx, screen, monitor, delay)
            live.update(Group(*screen.lines(*console.size)), refresh=True)
            pressed: list[str] = []
            try:
                while not (pressed := _pressed(keys, monitor, due - monotonic())) and monotonic() < due:
                    pass
            except NoDaemon:  # the refresh reports it
                due = 0.0
            if not all(map(screen.press, pressed)):
                return


def _connected(ctx: Context, delay: float) -> WorldMonitor:
    """A monitor on a new connection, since an existing one (the shell's) may be to an ended daemon. Raises NoDaemon."""
    own = Context()
    own.instance, own.socket, own.quiet = ctx.instance, ctx.socket, True
    return WorldMonitor(own.client, delay)


def _refreshed(ctx: Context, screen: TopScreen, monitor: WorldMonitor | None, delay: float) -> WorldMonitor | None:
    """Refresh the monitor, or make a new one if there is none. Returns None while no daemon answers."""
    try:
        monitor = monitor or _connected(ctx, delay)
        monitor.refresh()
    except NoDaemon as error:
        screen.gone = f"{error.message}; top waits for a daemon"
        if monitor is not None:
            monitor.client.close()
        return None
    except TimedOut as error:
        screen.gone = error.message
        return monitor
    screen.monitor, screen.gone = monitor, ""
    return monitor


def _pressed(keys: Callable[[], list[str]], monitor: WorldMonitor | None, seconds: float) -> list[str]:
    """Wait for keys, at most `seconds`; returns none when data from the daemon comes first. That data is processed.

    Raises:
        NoDaemon.
    """
    sources = [sys.stdin, *([monitor.client] if monitor else [])]
    ready = select.select(sources, (), (), max(0.0, seconds))[0]
    if monitor is not None and monitor.client in ready:
        for _ in monitor.client.events(0.0):
            pass
    return keys() if sys.stdin in ready else []
