"""Which tests `make quick` leaves out."""

from __future__ import annotations

from fnmatch import fnmatch

SLOW = (
    # foreign programs, browsers, whole pages, attacks, and runs of the tests themselves
    "fuzz/*", "gateways/ros1/*", "gateways/websocket/test_websocket_clients.py", "viewing/test_page*",
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
    # compilers, recorded runs, thousands of connections
    "control/test_control_conformance.py", "daemon/test_daemon_hostile.py", "daemon/test_daemon_journal.py",
    "daemon/test_daemon_pictures.py", "gateways/test_foxglove.py", "gateways/test_gateway_processes.py",
    "gateways/test_unfinished.py",
    "simulation/test_simulation_all_or_nothing.py", "simulation/test_simulation_compiled_cache.py",
    "simulation/test_simulation_own_laws.py", "simulation/test_simulation_snapshots.py",
)  # fmt: skip
"""The files whose tests `make quick` leaves out, as patterns of paths in this folder."""


def is_slow(file: str) -> bool:
    """True for a file of SLOW; its path is relative to this folder."""
    return any(fnmatch(file, entry) for entry in SLOW)
