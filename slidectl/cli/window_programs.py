"""The windows of ROS and Gazebo that a shell has as commands of their own: names alone, for a quick import."""

ALONE = {
    "rviz": ("rviz", "rviz"),
    "rqt": ("rqt_gui", "rqt_gui"),
    "rqt_gui": ("rqt_gui", "rqt_gui"),
    **{
        name: (name, name)
        for name in ("rqt_plot", "rqt_graph", "rqt_console", "rqt_bag", "rqt_reconfigure", "rqt_controller_manager")
    },
    "gzclient": ("gazebo_ros", "gzclient"),
}
"""Command -> package and program."""
