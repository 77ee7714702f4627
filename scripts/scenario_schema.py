"""Writes slidectl/scenarios/scenario.schema.json from the commands: `python scripts/scenario_schema.py`."""

from slidectl.cli.step_runner import StepRunner
from slidectl.scenarios.scenario_schema import FILE, as_text

FILE.write_text(as_text(StepRunner()), "utf-8")
