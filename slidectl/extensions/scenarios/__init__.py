"""Scenarios: files of steps that a robot must pass. Reading, checking, running many at a time, results.

The steps are commands of the command line, which passes them in as `step_commands.Commands`; this package knows no
click. It exports `StepKind`, the base class of further kinds of steps.
"""

from slidectl.extensions.scenarios.step_commands import StepKind

__all__ = ["StepKind"]
