"""The messages between a live team and its robots, as pydantic models; `schemas` gives JSON Schema for each.

The messages are easy to map to what fleets speak. An order is one action of one robot with a route, like the nodes of
a VDA 5050 order; its end is reported as FINISHED or FAILED, VDA 5050's action states. `navigate` is Nav2's
NavigateToPose: SUCCEEDED is `arrived`, ABORTED `navigation_failed`, and a new order for a robot under way cancels the
previous one. Every event has an ``id`` that the sender chose and the time at which it happened, in seconds on one clock
for all, such as ROS or Unix time.

Fields that a message is not known to have are ignored, and later versions only add optional ones, so that clients and
live teams of different age understand each other.
"""

from typing import Annotated, Any, Literal, Self, get_args

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, model_validator

PROTOCOL_VERSION = 2
MAX_NAME = 200
MAX_LISTED = 1000
MAX_TIME_S = 1e11
"""Room for Unix time in seconds; one in milliseconds is a mistake."""
MAX_METRES = 1e6

Name = Annotated[str, Field(min_length=1, max_length=MAX_NAME)]
Seconds = Annotated[float, Field(ge=0, le=MAX_TIME_S)]
Metres = Annotated[float, Field(ge=-MAX_METRES, le=MAX_METRES)]
Confidence = Annotated[float, Field(gt=0, le=1)]
Outcome = Literal["FINISHED", "FAILED"]


class Message(BaseModel):
    """Anything on the wire."""

    model_config = ConfigDict(frozen=True, extra="ignore", strict=True, allow_inf_nan=False)


class _Event(Message):
    id: Name
    time_s: Seconds


class _OfRobot(_Event):
    robot: Name


class _AtPlace(_OfRobot):
    x_m: Metres
    y_m: Metres


class _AtContainer(_OfRobot):
    container: Name


class Pose(_AtPlace):
    """The robot is at this place."""

    type: Literal["pose"]


class Arrived(_AtContainer):
    """The robot is at the container that it was ordered to."""

    type: Literal["arrived"]


class NavigationFailed(_AtContainer):
    """The robot gave up its way to the container."""

    type: Literal["navigation_failed"]
    reason: str = Field(default="", max_length=MAX_NAME)


class Detection(Message):
    """An object that was detected, with the probability that this was a detection and no noise."""

    object: Name
    confidence: Confidence


class SearchEnded(_AtContainer):
    """The robot has searched the container: all objects that it saw there; what is not among them was not detected."""

    type: Literal["search_ended"]
    status: Outcome = "FINISHED"
    objects: tuple[Name | Detection, ...] = Field(default=(), max_length=MAX_LISTED)


class ObjectSeen(_Event):
    """An object was seen in a container in passing, or (``present`` false) seen not to be there any more."""

    type: Literal["object_seen"]
    container: Name
    object: Name
    present: bool = True
    confidence: Confidence = 1.0
    robot: Name | None = None


class InteractionEnded(_AtContainer):
    """The robot has interacted with the object, or could not; ``gone``: because the object is not there."""

    type: Literal["interaction_ended"]
    object: Name
    status: Outcome = "FINISHED"
    gone: bool = False


class Heartbeat(_OfRobot):
    """The robot is well. From its first heartbeat on it promises to say something every few seconds."""

    type: Literal["heartbeat"]


class Clock(_Event):
    """Nothing happened until this time: what was to be done by then is done."""

    type: Literal["clock"]


class TryAgain(_Event):
    """An operator says that what failed may work now: for this robot or all, at this container or anywhere."""

    type: Literal["try_again"]
    robot: Name | None = None
    container: Name | None = None


class RobotLost(_OfRobot):
    """The robot takes part no more."""

    type: Literal["robot_lost"]


class RobotJoined(_AtPlace):
    """A new robot, or one that was lost, takes part from this place on."""

    type: Literal["robot_joined"]


class _Barrier(_Event):
    door: Name | None = None
    x_m: Metres | None = None
    y_m: Metres | None = None
    radius_m: float = Field(default=0.3, gt=0, le=10)

    @model_validator(mode="after")
    def _one_place(self) -> Self:
        if (self.door is None) == (self.x_m is None or self.y_m is None):
            raise ValueError("give a door, or x_m and y_m")
        return self


class RouteBlocked(_Barrier):
    """Nobody gets through this door, or past this place (a disc of ``radius_m``; the larger of two counts)."""

    type: Literal["route_blocked"]


class RouteCleared(_Barrier):
    """What was blocked with the same door or place is free again."""

    type: Literal["route_cleared"]


_Events = (
    Pose
    | Arrived
    | NavigationFailed
    | SearchEnded
    | ObjectSeen
    | InteractionEnded
    | RobotLost
    | RobotJoined
    | RouteBlocked
    | RouteCleared
    | Heartbeat
    | Clock
    | TryAgain
)
Event = Annotated[_Events, Field(discriminator="type")]


class Batch(Message):
    """Events of one instant, all taken in before anybody is sent anywhere; with ``more`` another batch follows."""

    type: Literal["batch"]
    events: tuple[Event, ...] = Field(max_length=MAX_LISTED)
    more: bool = False


class Hello(Message):
    """Asks for `Welcome`, the present orders and the task's state; the first message on a WebSocket."""

    type: Literal["hello"]
    version: int = PROTOCOL_VERSION
    token: str | None = Field(default=None, max_length=MAX_NAME)
    client: Name | None = None
    """The client's name, the same after a break: then ids need to be unique among its own events only."""


_Incoming = _Events | Batch | Hello


class Blocked(Message):
    """A door that is shut, or a place that is blocked."""

    door: str | None = None
    x_m: float | None = None
    y_m: float | None = None
    radius_m: float


class Welcome(Message):
    """What the live team is about."""

    type: Literal["welcome"] = "welcome"
    version: int = PROTOCOL_VERSION
    task: str
    formula: str
    objects: tuple[str, ...]
    containers: tuple[str, ...]
    robots: tuple[str, ...]
    last_event: str | None
    """The id of the last event that was taken in: where to go on after a break."""
    doors: tuple[str, ...] = ()
    """The doors that can be reported as blocked."""
    blocked: tuple[Blocked, ...] = ()


class Answer(Message):
    """What became of an event: ``duplicate`` and ``rejected`` ones changed nothing; ``reason`` says why."""

    type: Literal["answer"] = "answer"
    event: str | None
    status: Literal["accepted", "duplicate", "rejected"]
    reason: str = ""


class Order(Message):
    """What a robot is to do from now on; it takes the place of the robot's order before."""

    type: Literal["order"] = "order"
    order: int
    robot: str
    action: Literal["navigate", "search", "interact", "wait"]
    container: str | None = None
    object: str | None = None
    route: tuple[tuple[float, float], ...] = ()
    """Turning points in metres, from where the robot is taken to be to where it is to stop."""
    length_m: float = 0.0
    heading_rad: float | None = None
    """Where to look at the end of the route, so as to face the container; 0 is along the map's x axis."""


class Letter(Message):
    """An interaction that counted."""

    time_s: float
    robot: str
    object: str
    container: str


class TaskState(Message):
    """How far the task is; ``stuck`` says why nobody can go on, until some event helps.

    With ``running``, the ``reason`` says what a team waits for in which nobody has anything to do yet.
    """

    type: Literal["task"] = "task"
    status: Literal["running", "done", "stuck"]
    time_s: float
    word: tuple[Letter, ...]
    reason: str = ""
    silent: tuple[str, ...] = ()
    """The robots that count as lost because they said nothing for too long; they are back as soon as they speak."""
    wake_s: float | None = None
    """The time at which the team decides again by itself if it hears nothing; any event of that time makes it so."""


Outgoing = Welcome | Answer | Order | TaskState
INCOMING: TypeAdapter[Any] = TypeAdapter(Annotated[_Incoming, Field(discriminator="type")])


def schemas() -> dict[str, dict[str, Any]]:
    """The JSON Schema of every message, by its ``type``."""
    result = {}
    for model in (*get_args(_Incoming), *get_args(Outgoing)):
        schema = model.model_json_schema(mode="validation")
        kind = schema["properties"]["type"]
        result[kind.get("const") or kind["default"]] = schema
    return result
