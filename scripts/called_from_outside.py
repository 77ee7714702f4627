"""Names that the package does not use itself, for vulture: what calls them, group by group.

Lines are never run. A name that nothing calls belongs out of the package, not in here. Commands, controllers and
gateways need no line: `[tool.vulture]` of pyproject.toml knows them by their decorators and names.
"""

# ruff: noqa

# click calls these of a command.
get_help_option_names
format_options
command_class

# The table in simulation/feature.py names these by text.
Actions
Drives
Faults
GazeboServices
JointTraces
LockStepService
OwnServices
Rosapi
Sensors
Snapshots
StandardServices
StatePublishers
Waits

# A controller's enter_state calls its hooks by name.
aborting

# features/saved_state.py looks it up in each class.
saved_or_none

# rclpy's nodes call it of their executor.
add_node

# io.BufferedReader calls it of a raw file.
readall

# cli.ros.command looks the ROS commands up by name.
roslaunch, roscore, rosbag, rosmsg, rossrv, rosnode, rosrun, rosservice, rostopic

# Registered by their decorators, or as subclasses that are looked up by type.
Unspawner, GroupScript, StaticTransform, Viewer, Window, JointStatePublisher
Throttle, Mux, TwistMux

# For authors of controllers, of hardware and of scripts.
ONGOING, set_joint_effort, unspawn

# Transmissions, limits and PIDs of ros_control: compared with the original by vectors, used when transmissions are applied.
SimpleTransmission, DifferentialTransmission, FourBarLinkageTransmission
joint_absolute_position, joint_torque_sensor, actuator_effort, actuator_position
has_jerk_limits, max_jerk, angle_wraparound
reset_to

# daemon.session calls an operation of the wire by its name; logging calls its handler.
_advertise, _unadvertise, _subscribe, _unsubscribe, _call_service, _advertise_service, _unadvertise_service
_service_response, _set_level, _set_node, _restrict, _cancel_call, handleError

# asyncio calls a protocol.
data_received

# xacro and ast call these of its adapter and of the evaluator.
eval_all, check_attrs, handle_macro_call, process_include, print_location, safe_eval, load_yaml
_tuple, _dict, _listcomp, _setcomp, _dictcomp, _joinedstr, _formattedvalue, _generatorexp, _lambda, _binop, _unaryop
_boolop, _compare, _ifexp, _attribute, _subscript

# numba puts these in the place of what they are registered for.
_fmod, _physics_step, _update_controller, _set_element

# viser calls it when a browser asks for it.
request_share_url

# pytest calls these of the plugin, and users its fixtures.
pytest_addoption, pytest_configure, pytest_runtest_makereport, pytest_collect_file, pytest_runtestloop
pytest_collection_modifyitems, pytest_runtest_logreport, pytest_sessionfinish, pytest_internalerror
collect, setup, runtest, repr_failure, reportinfo
slidectl_client, slidectl_daemon

# Python asks modules for it, and loaders of modules for these.
__getattr__
get_source, get_code

# Of rows of indices.
ACCELERATION, VELOCITY_SOFT

# The evaluation of expressions finds the method for a kind of node by its name.
_constant
