"""`slidectl view` and `slidectl gui`: show the world in a browser."""

from __future__ import annotations

import os
from contextlib import suppress

import click

from slidectl.cli.commands import command
from slidectl.cli.context import DEFAULT_TIMEOUT_S, Context
from slidectl.errors import Refused, UsageError
from slidectl.paths import install_command


@command(step=None, examples=["slidectl view", "slidectl gui", "slidectl view --port 8090 --read-only --no-open"])
@click.option("--port", type=click.IntRange(0, 65535), default=8080, show_default=True, metavar="N",
              help="The port, or the next one that is free; 0 takes any.")  # fmt: skip
@click.option("--host", default="127.0.0.1", show_default=True, metavar="ADDRESS",
              help="Address of this machine; others than loopback need --token.")  # fmt: skip
@click.option("--token", envvar="SLIDECTL_TOKEN", metavar="WORD", help="Require this token of browsers.")
@click.option("--read-only", is_flag=True, help="Let browsers look, and change nothing.")
@click.option("--allow", type=click.Choice(["files", "code"]), multiple=True,
              help="Let browsers also name files to read and write, or code to run; may repeat.")  # fmt: skip
@click.option("--any-user", is_flag=True,
              help="Let in browsers of all users of this machine; else, without a token, yours alone.")  # fmt: skip
@click.option("--open/--no-open", "is_opened", default=True, help="Open a browser where there is a display.")
@click.pass_obj
def view(
    ctx: Context,
    port: int,
    host: str,
    token: str | None,
    read_only: bool,
    allow: tuple[str, ...],
    any_user: bool,
    is_opened: bool,
) -> None:
    """Show the world in a browser.

    Prints the address and serves the page until Ctrl-C. Robots, joints, controllers, gains, plots, topics, services and
    the log are there, for all browsers that have it open. Needs pip install '.[view]' in a clone. When the daemon ends
    the page waits for the next one.

    The page is for your own browsers on this machine. Another --host needs a --token of at least 8 letters, digits and
    -._~, which may be given as SLIDECTL_TOKEN too.

    JSON keys: url, port, instance, read_only.
    """
    from slidectl.client import Client
    from slidectl.open_page import announced
    from slidectl.supervision import Interrupted, Interrupts

    try:
        from slidectl.extensions.viewing.page.guarded_server import AccessGuard, GuardedServer, free_port
    except ModuleNotFoundError as error:
        needed = f"the page needs the library {error.name}"
        raise Refused(needed, f"install it: {install_command('view')}") from error
    from slidectl.extensions.viewing.page.page import Page
    from slidectl.extensions.viewing.page.rosbridge_endpoint import RosbridgeEndpoint
    from slidectl.web_access import check_effects, check_token, check_users_can_be_told, is_loopback, shown_host

    if token is not None:
        check_token(token)
    free = free_port(host, port)
    if token is None and not is_loopback(host):
        raise UsageError(f"--host {host} lets other machines in: --token WORD is needed")
    permitted = check_effects(read_only, allow)
    if token is None:
        check_users_can_be_told(any_user)
    paths = ctx.client.paths  # raises NoDaemon when none runs
    guard = AccessGuard(host, token or "", any_user)
    endpoint = RosbridgeEndpoint(paths, permitted)
    server = GuardedServer(host, free, guard, endpoint)
    taken = server.get_port()  # viser takes the next port when another process has taken this one
    if taken != port and port:
        ctx.warn(f"port {port} is taken: {taken} is used")

    limit = ctx.wait_limit(DEFAULT_TIMEOUT_S)

    def connected() -> Client:
        client = Client(ctx.instance, ctx.socket, timeout=limit)
        client.restrict(*permitted)
        return client

    page = Page(server, connected, read_only, endpoint.tell)
    endpoint.serve = page.serve
    address = f"http://{shown_host(host)}:{taken}/"
    url = address + (f"?token={token}" if token else "")
    ctx.done({"url": url, "port": taken, "instance": paths.name, "read_only": read_only}, url)
    try:
        if is_opened and any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY")):
            import webbrowser

            webbrowser.open(address + (f"?token={guard.word()}" if token else ""))
        with suppress(Interrupted), announced(paths, address), Interrupts() as interrupts, interrupts.raised():
            page.run(lambda: bool(interrupts.received))
    finally:
        page.close()


gui = view
