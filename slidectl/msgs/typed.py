"""Messages as typed dicts, for type checkers only: import it under TYPE_CHECKING.

Written by `python scripts/typed_messages.py` from the definitions in `data`. A float that is not a number reaches a
client as None.
"""

# mypy: disable-error-code="overload-overlap"

from __future__ import annotations

from typing import Any, Literal, Protocol, TypedDict, overload

Request = dict[str, Any] | None


class DeleteModelResponseMsg(TypedDict):
    success: bool
    status_message: str


class GetParamResponseMsg(TypedDict):
    value: str


class GetParamNamesResponseMsg(TypedDict):
    names: list[str]


class ServicesResponseMsg(TypedDict):
    services: list[str]


class TopicsResponseMsg(TypedDict):
    topics: list[str]
    types: list[str]


class JointStatesResponseMsg(TypedDict):
    joints: list[str]
    position: list[float]
    velocity: list[float]
    effort: list[float]


class JointInfoMsg(TypedDict):
    name: str
    type: str
    hardware_interface: str
    position: float
    velocity: float
    effort: float
    lower: float
    upper: float
    max_velocity: float
    max_effort: float


class NoticeMsg(TypedDict):
    verdict: str
    subject: str
    text: str
    file: str
    line: int


class RobotInfoMsg(TypedDict):
    name: str
    namespace: str
    kind: str
    fixed: bool
    links: list[str]
    joints: list[JointInfoMsg]
    controllers: list[str]
    pose: list[float]
    report: list[NoticeMsg]
    estop: bool
    frozen: bool
    process_session: int


class ListRobotsResponseMsg(TypedDict):
    robots: list[RobotInfoMsg]


class SpawnResponseMsg(TypedDict):
    robots: list[RobotInfoMsg]
    warnings: list[str]


class PointMsg(TypedDict):
    x: float
    y: float
    z: float


class Vector3Msg(TypedDict):
    x: float
    y: float
    z: float


class SceneResponseMsg(TypedDict):
    time: float
    ground: bool
    robots: list[str]
    serials: list[int]
    may_use_files: list[bool]
    descriptions: list[str]
    links: list[str]
    poses: list[dict[str, Any]]
    contact_points: list[PointMsg]
    contact_forces: list[Vector3Msg]


class SetParamsResponseMsg(TypedDict):
    created: list[str]
    guarded: list[str]


class SnapshotInfoMsg(TypedDict):
    name: str
    time: float
    cycles: int
    robots: list[str]


class ListSnapshotsResponseMsg(TypedDict):
    snapshots: list[SnapshotInfoMsg]


class StatusResponseMsg(TypedDict):
    version: str
    pid: int
    instance: str
    time: float
    cycles: int
    paused: bool
    trouble: str
    holders: list[str]
    lockstep: list[str]
    speed: float
    speed_reached: float
    timestep: float
    chosen: list[str]
    engine: str
    pictures: str
    cameras: list[str]
    cameras_asked: list[float]
    cameras_reached: list[float]
    cameras_advice: list[str]
    cycle_mean: float
    cycle_p99: float
    cycle_worst: float
    lateness_p50: float
    lateness_p99: float
    overruns: int
    robots: list[str]
    estop: list[str]
    frozen: list[str]
    faults: list[str]
    controllers: int
    controllers_running: int
    connections: int
    memory: int
    uptime: float
    log: str
    journal: str
    journal_trouble: str


class StepResponseMsg(TypedDict):
    success: bool
    message: str
    time: float
    cycles: int


class UpdateTimesMsg(TypedDict):
    name: str
    compiled: bool
    updates: int
    over_budget: int
    mean: float
    longest: float
    budget: float


class ListUpdateTimesResponseMsg(TypedDict):
    controllers: list[UpdateTimesMsg]


class HardwareInterfaceResourcesMsg(TypedDict):
    hardware_interface: str
    resources: list[str]


class ControllerStateMsg(TypedDict):
    name: str
    state: str
    type: str
    claimed_resources: list[HardwareInterfaceResourcesMsg]


class ListControllersResponseMsg(TypedDict):
    controller: list[ControllerStateMsg]


class ListControllerTypesResponseMsg(TypedDict):
    types: list[str]
    base_classes: list[str]


class ResolveResponseMsg(TypedDict):
    name: str
    field: str
    type: str
    typedefs: list[dict[str, Any]]
    response_typedefs: list[dict[str, Any]]
    nodes: list[str]
    effects: list[str]


class Call(Protocol):
    """`Client.call`: a known service returns its own response."""

    @overload
    def __call__(
        self, service: Literal["/gazebo/delete_model"], request: Request = None, *, timeout: float | None = None
    ) -> DeleteModelResponseMsg: ...

    @overload
    def __call__(
        self, service: Literal["/rosapi/get_param"], request: Request = None, *, timeout: float | None = None
    ) -> GetParamResponseMsg: ...

    @overload
    def __call__(
        self, service: Literal["/rosapi/get_param_names"], request: Request = None, *, timeout: float | None = None
    ) -> GetParamNamesResponseMsg: ...

    @overload
    def __call__(
        self, service: Literal["/rosapi/services"], request: Request = None, *, timeout: float | None = None
    ) -> ServicesResponseMsg: ...

    @overload
    def __call__(
        self, service: Literal["/rosapi/topics"], request: Request = None, *, timeout: float | None = None
    ) -> TopicsResponseMsg: ...

    @overload
    def __call__(
        self, service: Literal["/slidectl/joint_states"], request: Request = None, *, timeout: float | None = None
    ) -> JointStatesResponseMsg: ...

    @overload
    def __call__(
        self, service: Literal["/slidectl/list_robots"], request: Request = None, *, timeout: float | None = None
    ) -> ListRobotsResponseMsg: ...

    @overload
    def __call__(
        self, service: Literal["/slidectl/spawn"], request: Request = None, *, timeout: float | None = None
    ) -> SpawnResponseMsg: ...

    @overload
    def __call__(
        self, service: Literal["/slidectl/scene"], request: Request = None, *, timeout: float | None = None
    ) -> SceneResponseMsg: ...

    @overload
    def __call__(
        self, service: Literal["/slidectl/set_params"], request: Request = None, *, timeout: float | None = None
    ) -> SetParamsResponseMsg: ...

    @overload
    def __call__(
        self, service: Literal["/slidectl/snapshots"], request: Request = None, *, timeout: float | None = None
    ) -> ListSnapshotsResponseMsg: ...

    @overload
    def __call__(
        self, service: Literal["/slidectl/status"], request: Request = None, *, timeout: float | None = None
    ) -> StatusResponseMsg: ...

    @overload
    def __call__(
        self, service: Literal["/slidectl/step"], request: Request = None, *, timeout: float | None = None
    ) -> StepResponseMsg: ...

    @overload
    def __call__(
        self, service: Literal["/slidectl/update_times"], request: Request = None, *, timeout: float | None = None
    ) -> ListUpdateTimesResponseMsg: ...

    @overload
    def __call__(self, service: str, request: Request = None, *, timeout: float | None = None) -> dict[str, Any]: ...
