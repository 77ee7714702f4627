"""Scenarios: files of steps that a robot must pass, many at a time. Reading, checking, running, results.

The steps are commands of the command line, which gives them by `step_commands.Commands`; nothing here knows click.
"""
