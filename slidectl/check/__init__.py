"""Checks files without a daemon: models, files of controllers, launch files.

Every tag, attribute, parameter and limit is reported as used, converted, ignored or wrong, with file and line. A check
starts nothing and changes nothing. Heavy modules are imported by the functions that need them.
"""

from __future__ import annotations

from slidectl.check.findings import Findings

__all__ = ["Findings"]
