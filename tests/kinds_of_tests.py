"""The kinds of tests, by files: which ones have the marks `slow`, `process` and `foreign`."""

from __future__ import annotations

import re
from fnmatch import fnmatch

FOREIGN = (
    "gateways/ros1/*", "gateways/ros2/*", "gateways/websocket/test_websocket_clients.py",
    "gateways/websocket/test_websocket_page.py", "gateways/test_foxglove.py", "viewing/test_page*",
    "cli/test_cli_ros_shells.py", "test_deployment.py", "test_examples.py", "test_shown_sessions.py", "test_site.py",
)  # fmt: skip
"""They start programs that are not part of slidectl: ROS 1 and 2, Node, Chromium, shells."""
PROCESS = (
    *FOREIGN, "cli/*", "client/*", "daemon/*", "fuzz/*", "gateways/*", "viewing/*",
    "description/test_description_xacro_hostile.py", "launch/test_launch_supervision.py", "test_confined.py",
    "test_docs.py", "test_extending_page.py", "test_operating_system.py", "test_portable_ways.py",
    "test_pytest_plugin.py", "test_python_page.py", "test_pythons.py", "test_scenarios_page.py", "test_test_runs.py",
)  # fmt: skip
"""They start processes: daemons, commands, gateways."""
SLOW = (
    # foreign programs, browsers, whole pages, attacks, and runs of the tests themselves
    "fuzz/*", "gateways/ros1/*", "gateways/ros2/*", "gateways/websocket/test_websocket_clients.py",
    "viewing/test_page*",
    "gateways/websocket/test_websocket_page.py", "test_deployment.py", "test_examples.py", "test_pytest_plugin.py",
    "test_shown_sessions.py", "test_site.py", "test_test_runs.py", "test_portable_ways.py",
    # commands that start much: launches, shells with the ROS commands, recordings, scenarios, and many daemons
    "cli/test_cli_base_clean.py", "cli/test_cli_base_controllers.py", "cli/test_cli_base_daemon*",
    "cli/test_cli_base_robots.py",
    "cli/test_cli_base_sim.py", "cli/test_cli_base_stopping.py", "cli/test_cli_baselines.py",
    "cli/test_cli_doctor.py", "cli/test_cli_faults.py", "cli/test_cli_full_disk.py", "cli/test_cli_graph_param.py",
    "cli/test_cli_graph_pub.py",
    "cli/test_cli_hostile_files.py", "cli/test_cli_keep_going.py", "cli/test_cli_launch_*",
    "cli/test_cli_own_controllers.py", "cli/test_cli_plot.py", "cli/test_cli_recordings.py", "cli/test_cli_render.py",
    "cli/test_cli_ros_*", "cli/test_cli_scenario*", "cli/test_cli_shell.py", "cli/test_cli_snapshots.py",
    "cli/test_cli_teleop.py", "cli/test_cli_top.py", "cli/test_cli_trajectories.py",
    # generated input, and input that unfolds without end
    "check/test_check_fuzz.py", "description/test_description_fuzz.py", "launch/test_launch_bounds.py",
    "launch/test_launch_fuzz.py",
    # compilers, recorded runs, thousands of connections
    "control/test_control_conformance.py", "daemon/test_daemon_hostile.py", "daemon/test_daemon_journal.py",
    "daemon/test_daemon_pictures.py", "gateways/test_foxglove.py", "gateways/test_gateway_processes.py",
    "gateways/test_unfinished.py",
    "simulation/test_simulation_all_or_nothing.py", "simulation/test_simulation_compiled_cache.py",
    "simulation/test_simulation_compiled_controllers.py", "simulation/test_simulation_own_controllers.py",
    "simulation/test_simulation_own_laws.py", "simulation/test_simulation_snapshots.py",
)  # fmt: skip
"""They take long. Each entry is a pattern of paths in this folder, as in the tables above."""

KINDS = {"foreign": FOREIGN, "process": PROCESS, "slow": SLOW}


def marks_of(file: str) -> set[str]:
    """The marks of all tests of a file; its path is relative to this folder."""
    return {mark for mark, patterns in KINDS.items() if any(fnmatch(file, pattern) for pattern in patterns)}


def marks_left_out(expression: str) -> set[str]:
    """The marks that an expression such as "not slow and not process" leaves out; empty for other expressions."""
    parts = expression.split(" and ")
    found = [re.fullmatch(r"not (\w+)", part.strip()) for part in parts]
    return {match[1] for match in found if match} if all(found) else set()
