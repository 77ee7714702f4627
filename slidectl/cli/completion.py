"""`slidectl completion SHELL`, and the completers of names, which ask the daemon and wait at most 100 ms.

Use: `shell_complete=completion.topics` of a click argument or option. Completers never raise; without a daemon they
return no names.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

import click

from slidectl.cli.commands import command
from slidectl.cli.context import Context
from slidectl.cli.main import COMPLETION_VARIABLE, root
from slidectl.cli.output import write
from slidectl.errors import SlidectlError

LIMIT_S = 0.1

Completer = Callable[[click.Context, click.Parameter, str], list[Any]]


@command(
    step=None,
    examples=[
        'eval "$(slidectl completion bash)"',
        "slidectl completion fish > ~/.config/fish/completions/slidectl.fish",
    ],
)
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]))
def completion(shell: str) -> None:
    """Print the completion script of a shell.

    Put the first example's line into ~/.bashrc (zsh: ~/.zshrc with `completion zsh`). It asks the daemon for topics,
    controllers, robots and parameters, within 100 ms.
    """
    from click.shell_completion import get_completion_class

    kind = get_completion_class(shell)
    assert kind is not None
    write(kind(root, {}, "slidectl", COMPLETION_VARIABLE).source())


def fitting(names: Iterable[str], incomplete: str) -> list[str]:
    """The names that begin with `incomplete`. A relative name is compared with the ends of the full names."""
    if incomplete and not incomplete.startswith("/"):
        parts = [name.strip("/").split("/") for name in names]
        names = {"/".join(part[index:]) for part in parts for index in range(len(part))}
    return sorted(name for name in names if name.startswith(incomplete))


def completer(ask: Callable[[Context], Iterable[str]]) -> Completer:
    """A click `shell_complete` callback from a function that asks the daemon for names."""
    return partial(_complete, lambda context, incomplete: fitting(ask(context), incomplete))


def _complete(
    find: Callable[[Context, str], list[str]], click_context: click.Context, _param: click.Parameter, incomplete: str
) -> list[str]:
    context = click_context.find_object(Context) or Context()
    context.timeout = LIMIT_S
    try:
        return find(context, incomplete)
    except (SlidectlError, OSError):
        return []


def _topics_and_fields(context: Context, incomplete: str) -> list[str]:
    """The topics, and behind a whole topic's name its fields; an array also with its first element."""
    from slidectl.msgs.schema import TIMES, from_typedefs

    known = context.names("topic")
    words = fitting(known, incomplete)
    parts = incomplete.split("/")
    for count in range(len(parts) - 1, 0, -1):
        topic = "/".join(parts[:count])
        if topic and topic in fitting(known, topic):
            schema = from_typedefs(context.resolve("topic", topic)["typedefs"])
            types = {**schema.types, **TIMES}
            *inner, begun = parts[count:]
            kind: str | None = schema.root
            for name in inner:
                bare = name.partition("[")[0]
                kind = next((field.type for field in types.get(kind or "", ()) if field.name == bare), None)
            for field in types.get(kind or "", ()):
                forms = [field.name] if field.array < 0 else [field.name, f"{field.name}[0]"]
                words += ["/".join([topic, *inner, form]) for form in forms if form.startswith(begun)]
            break
    return words


topics = completer(lambda context: context.names("topic"))
topics_and_fields = partial(_complete, _topics_and_fields)
services = completer(lambda context: context.names("service"))
parameters = completer(lambda context: context.names("parameter"))
robots = completer(lambda context: [robot["name"] for robot in context.client.robots()])
controllers = completer(lambda context: [name for manager in context.managers() for name in manager.known()])
managers = completer(lambda context: [manager.namespace for manager in context.managers()])


def files(_context: click.Context, _param: click.Parameter, incomplete: str) -> list[Any]:
    """Let the shell complete a file name."""
    from click.shell_completion import CompletionItem

    return [CompletionItem(incomplete, type="file")]


def file_option(*names: str, **more: Any) -> Callable[..., Any]:
    """An option that takes the name of a file, FILE in its help text. The arguments are those of `click.option`."""
    return click.option(*names, **{"metavar": "FILE", "shell_complete": files, **more})


def models(context: click.Context, param: click.Parameter, incomplete: str) -> list[Any]:
    """Shipped models, then files."""
    from slidectl.paths import share

    shipped = sorted(path.stem for path in share("models").glob("*.xacro"))
    return [name for name in shipped if name.startswith(incomplete)] or files(context, param, incomplete)
