"""Scenarios: files of steps that are held to what they say, many at a time. Reading, checking, running, results.

The steps are commands of the command line, which gives them by `step_commands.Commands`; nothing here knows click.
"""
