"""Hosts that a daemon puts around its own, by the start option that asks for them.

They belong to extensions. Each is a function in a module that is imported when the option is given.
"""

from __future__ import annotations

from importlib import import_module

from slidectl.daemon.options import DaemonOptions
from slidectl.simulation.host import Host

WRAPPERS = {
    "replay": ("slidectl.extensions.journal.journal_replay", "host_of"),
    "journal": ("slidectl.extensions.journal.journal", "host_of"),
}
"""The option, and the module and its function, which takes the daemon's host and options and returns a host around it.

A host that has a `simulation` already has made the world. Of two that are asked for, the first is used.
"""


def wrapped(host: Host, options: DaemonOptions) -> Host:
    """The host in the wrapper that the options ask for; itself without one. Raises as the wrapper's function."""
    for option, (module, function) in WRAPPERS.items():
        if getattr(options, option):
            made: Host = getattr(import_module(module), function)(host, options)
            return made
    return host
