"""The context of every command: the daemon, the namespace, the output format and the timeout.

Commands take it with `@click.pass_obj def robots(ctx: Context, ...)`. It connects on first use of `client`
and must not import the client, YAML or rich before they are needed.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from slidectl.cli import output
from slidectl.errors import UsageError

if TYPE_CHECKING:
    from slidectl.client import Client
    from slidectl.client.manager import Manager
    from slidectl.msgs.schema import Schema, Typedefs
    from slidectl.msgs.typed import Call, ResolveResponseMsg
    from slidectl.paths import InstancePaths

DEFAULT_TIMEOUT_S = 10.0

# kind -> (service, key of the answer that holds the names)
_LISTS = {
    "topic": ("/rosapi/topics", "topics"),
    "service": ("/rosapi/services", "services"),
    "parameter": ("/rosapi/get_param_names", "names"),
    "node": ("/rosapi/nodes", "nodes"),
}


class Target(NamedTuple):
    """A topic with its type, the field path behind its name, rosapi's typedefs, and the nodes in the requested role."""

    topic: str
    type: str
    field: str
    typedefs: Typedefs
    users: list[str]

    @property
    def schema(self) -> Schema:
        from slidectl.msgs.schema import from_typedefs

        return from_typedefs(self.typedefs)


class Context:
    """The options of one invocation, and the connection to the daemon that they select."""

    def __init__(self, shell: Context | None = None) -> None:
        """`shell` is the context of the `slidectl shell` that runs this line; its options and connection are used."""
        self.instance: str | None = None
        self.socket: str | None = None
        self.namespace = "/"
        self.format = "text"
        self.quiet = False
        self.verbose = 0
        self.timeout: float | None = None
        """Wall seconds of `--timeout`; None when it was not given."""
        self.up: Callable[[], None] | None = None
        """In a scenario: a command that goes on in the background calls this when it is up."""
        for option in list(vars(self)) if shell else ():
            setattr(self, option, getattr(shell, option))
        self._shell = shell
        self._client: Client | None = None
        self._emitted: list[str] | None = None

    # --- the daemon ---------------------------------------------------------------------------------------------

    @property
    def paths(self) -> InstancePaths:
        """Socket, lock and log of the chosen instance. Raises UsageError for a bad name."""
        from slidectl import paths

        if self.instance and self.socket:
            raise UsageError("--instance and --socket exclude each other")
        return paths.instance(self.instance, self.socket)

    @property
    def client(self) -> Client:
        """The connection to the daemon, made on first use. Raises NoDaemon when no daemon answers."""
        if self._client is not None:
            return self._client
        shell = self._shell
        if shell is not None and (self.instance, self.socket) == (shell.instance, shell.socket):
            self._client = shell.client
            self._client.timeout = self.wait_limit(DEFAULT_TIMEOUT_S)
            return self._client
        from slidectl.client import Client

        self._client = Client(socket=self.paths.socket_text, timeout=self.wait_limit(DEFAULT_TIMEOUT_S))
        self._client.on_other_version = self._say_other_version
        return self._client

    def _say_other_version(self, theirs: str) -> None:
        """Warn that the daemon was started by another version of this program; the two may be incompatible."""
        from slidectl import __version__
        from slidectl.paths import command

        version = f"version {theirs}" if theirs else "another version"
        restart = command(self.client.paths, "daemon restart")
        self.warn(f"the daemon is of {version}, this command of {__version__}; to have one: {restart}")

    @property
    def uri(self) -> str:
        """The URI of every node and service: the daemon's socket."""
        return f"unix://{self.client.paths.socket_text}"

    def close(self) -> None:
        """Close the connection if there is one, unless it is the shell's. For a process that runs many commands."""
        if self._client is not None and (self._shell is None or self._client is not self._shell._client):
            self._client.close()
        self._client = None

    def wait_limit(self, default_s: float) -> float:
        """How long this command may wait: `--timeout` if given, else `default_s` (wall seconds)."""
        return default_s if self.timeout is None else self.timeout

    def pause(self, seconds: float) -> None:
        """Wait on the client's clock. Raises NoDaemon as soon as the daemon closes the connection."""
        client = self.client
        deadline = client.monotonic() + seconds
        while (left := deadline - client.monotonic()) > 0:
            next(client.events(left), None)

    @property
    def call(self) -> Call:
        """`Client.call` of the daemon's client."""
        return self.client.call

    def manager(self, namespace: str) -> Manager:
        """The controller manager of a namespace; its warnings go to stderr."""
        from slidectl.client.manager import Manager

        return Manager(self.client, namespace, self.warn, timeout_s=self.timeout or 0.0)

    def managers(self) -> list[Manager]:
        """All controller managers, by namespace."""
        return [self.manager(one.namespace) for one in self.client.managers()]

    # --- names --------------------------------------------------------------------------------------------------

    def names(self, kind: str) -> list[str]:
        """All names of a kind, sorted: `topic`, `service`, `parameter` or `node`."""
        service, key = _LISTS[kind]
        return sorted(self.call(service)[key])

    def resolve(self, kind: str, name: str) -> ResolveResponseMsg:
        """The response of /slidectl/resolve for a name from the user. Raises as Client.resolve does."""
        return self.client.resolve(kind, name, namespace=self.namespace)

    def find_topic(self, text: str, role: str | None, *, with_field: bool = True) -> Target:
        """The topic that `text` means among those with `role` (None: any), and the field behind its name.

        Raises:
            UnknownName: no such topic. Unused: no node has that role. AmbiguousName: several topics match.
        """
        found = self.client.resolve("topic", text, namespace=self.namespace, role=role or "", with_field=with_field)
        return Target(found["name"], found["type"], found["field"], found["typedefs"], found["nodes"])

    # --- printing -----------------------------------------------------------------------------------------------

    def emit(self, record: Mapping[str, Any], text: str | None = None) -> None:
        """Print one result of one or several. As text it is `text` (nothing when empty), or `key: value` lines if None.

        Several are lines of json, documents of yaml, or rows of csv below one header.
        """
        if self.format == "json":
            output.write(output.as_json(record))
        elif self.format == "yaml":
            output.write(("" if self._emitted is None else "---\n") + output.as_yaml(record))
        elif self.format == "csv":
            header = [] if self._emitted == list(record) else [list(record)]
            output.write(output.as_csv([*header, list(record.values())]))
        elif text != "":
            output.write(output.as_lines(record) if text is None else text)
        self._emitted = list(record)

    def emit_rows(self, rows: Sequence[Mapping[str, Any]], columns: Sequence[str], empty: str = "") -> None:
        """Print many results: a table as text, an object a line as json, a list as yaml, a header and rows as csv.

        `columns` are the keys that text and csv show; json and yaml hold all keys of the rows. `empty` is a line
        for stderr when there are no rows.
        """
        if self.format == "yaml":
            output.write(output.as_yaml(list(rows)))
        elif self.format == "csv":
            output.write(output.as_csv([list(columns), *([row.get(key) for key in columns] for row in rows)]))
        elif not rows:
            self.say(empty)
        elif self.format == "json":
            output.write("\n".join(map(output.as_json, rows)))
        else:
            output.write(output.table(rows, columns))

    def emit_names(self, names: Sequence[str], key: str, empty: str = "") -> None:
        """Print a list of names: one a line as text, objects `{key: name}` as json, yaml and csv."""
        if self.format != "text":
            self.emit_rows([{key: name} for name in names], [key], empty)
        elif names:
            output.write("\n".join(names))
        else:
            self.say(empty)

    def done(self, record: Mapping[str, Any], text: str) -> None:
        """Print the result of an action. As text it is one line that `-q` silences; other formats print the record."""
        if self.format != "text" or not self.quiet:
            self.emit(record, text)

    def say(self, text: str) -> None:
        """Print a remark on stderr; `-q` silences it."""
        if text and not self.quiet:
            print(text, file=sys.stderr, flush=True)

    def warn(self, text: str) -> None:
        """Print a warning on stderr; `-q` silences it."""
        self.say(f"{paint('warning:', 'yellow')} {text}")

    def detail(self, text: str) -> None:
        """Print a remark on stderr, only with `-v`."""
        if self.verbose:
            self.say(text)


def paint(text: str, colour: str) -> str:
    """The text, coloured when stderr is a terminal that takes colours."""
    if not output.wants_colour(sys.stderr):
        return text
    import click

    return click.style(text, fg=colour, bold=True)
