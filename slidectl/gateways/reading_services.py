"""The services that change nothing: what a gateway that is read-only lets its clients call."""

from __future__ import annotations

_READING = frozenset(
    [
        *(f"/rosapi/{name}" for name in (
            "action_servers", "get_param", "get_param_names", "get_ros_version", "get_time", "has_param",
            "message_details", "node_details", "nodes", "publishers", "search_param", "service_host", "service_node",
            "service_providers", "service_request_details", "service_response_details", "service_type", "services",
            "services_for_type", "subscribers", "topic_type", "topics", "topics_and_raw_types", "topics_for_type",
        )),
        *(f"/slidectl/{name}" for name in (
            "fault/kinds", "fault/list", "graph", "joint_states", "list_robots", "resolve", "scene", "snapshots",
            "sources", "status", "trace", "update_times", "wait",
        )),
        *(f"/slidectl/get_{name}" for name in (
            "entities", "entities_states", "entity_bounds", "entity_info", "entity_state", "simulation_state",
            "simulator_features", "spawnables",
        )),
        *(f"/gazebo/get_{name}" for name in (
            "joint_properties", "link_properties", "link_state", "model_properties", "model_state",
            "physics_properties", "world_properties",
        )),
    ]
)  # fmt: skip
_ENDS = ("/controller_manager/list_controllers", "/controller_manager/list_controller_types")


def is_reading(service: str) -> bool:
    """Whether a service, by its full name, is one of them."""
    return service in _READING or service.endswith(_ENDS)
