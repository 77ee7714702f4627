"""`slidectl completion SHELL`: the script that teaches a shell to complete slidectl. Live names come from live.py."""

from __future__ import annotations

import click

from slidectl.cli.commands import command
from slidectl.cli.output import write


@command(
    examples=[
        'eval "$(slidectl completion bash)"',
        "slidectl completion fish > ~/.config/fish/completions/slidectl.fish",
    ]
)
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]))
def completion(shell: str) -> None:
    """Print the completion script of a shell.

    Put the first example's line into ~/.bashrc (zsh: ~/.zshrc with `completion zsh`). Topics, controllers, robots and
    parameters are asked from the daemon, within 100 ms.
    """
    from click.shell_completion import get_completion_class

    from slidectl.cli.main import COMPLETION_VARIABLE, root

    kind = get_completion_class(shell)
    assert kind is not None
    write(kind(root, {}, "slidectl", COMPLETION_VARIABLE).source())
