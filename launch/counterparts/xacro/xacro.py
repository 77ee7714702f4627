#!/usr/bin/env python3
"""Prints the URDF that slidectl makes of a xacro file, as `rosrun xacro xacro` does: for whoever calls it by its path.

Becomes slidectl, run by the interpreter that slidectl is installed for. Imports nothing but the standard library: as
the first folder of the search path is that of this file, `xacro` would be this file.
"""

import os
import shutil
import sys

_HERE = os.path.dirname(os.path.realpath(__file__))
# Of a checkout: ROOT/launch/counterparts/xacro; of a wheel: SITE/slidectl/share/launch/counterparts/xacro.
_CHECKOUT = os.path.dirname(os.path.dirname(os.path.dirname(_HERE)))
_SITE = os.path.dirname(os.path.dirname(_CHECKOUT))


def _command():
    """The words that begin slidectl's command line, or None when there is no slidectl."""
    is_checkout = os.path.isfile(os.path.join(_CHECKOUT, "slidectl", "__init__.py"))
    named = os.environ.get("SLIDECTL_PYTHON")
    if named:
        if is_checkout:  # which may not be installed
            os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [_CHECKOUT, os.environ.get("PYTHONPATH")]))
        return [named, "-P", "-m", "slidectl"]
    prefix = _CHECKOUT + "/.venv" if is_checkout else os.path.dirname(os.path.dirname(os.path.dirname(_SITE)))
    script = os.path.join(prefix, "bin", "slidectl")
    found = script if os.access(script, os.X_OK) else shutil.which("slidectl")
    return [found] if found else None


command = _command()
if command is None:
    sys.exit("xacro: there is no slidectl on the PATH, whose program this is")
os.execv(command[0], [*command, "ros", "rosrun", "xacro", "xacro", *sys.argv[1:]])
