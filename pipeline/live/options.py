"""The options of the live process: those of any tool on a map, and the robots, files and address."""

import ipaddress
from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Literal, Self

from pydantic import BeforeValidator, Field, field_validator, model_validator

from mrtask.execution.team_spec import RobotSpec
from mrtask.homes.home import Point
from mrtask.planning.planners import make_planner
from pipeline.app.map_task import Coordinates, MapTask
from pipeline.base.sections import Perception, TeamRobot
from pipeline.base.values import LocalPath

MIN_TOKEN = 16


class LiveRobot(TeamRobot):
    """A robot of a live team: where it is, and what sets it apart."""

    start: Coordinates


def _placed(value: object) -> object:
    """Return a place alone, ``[x, y]``, as a robot that starts there."""
    return {"start": value} if isinstance(value, list | tuple) else value


class TeamOptions(MapTask):
    """The options of `pipeline.live`; ``conf/live.yaml`` explains each."""

    team: dict[str, Annotated[LiveRobot, BeforeValidator(_placed)]] = Field(min_length=1)
    decide_by: str
    perception: Perception
    state: LocalPath | None
    unsaved: Literal["stand_still", "go_on"]
    log: LocalPath | None
    lost_after_s: float | None = Field(gt=0)
    own_clock: bool
    websocket: str | None
    token: str | None

    @field_validator("websocket", mode="before")
    @classmethod
    def _with_host(cls, value: object) -> object:
        return f"127.0.0.1:{value}" if isinstance(value, int) else value

    @model_validator(mode="after")
    def _safe(self) -> Self:
        make_planner(self.decide_by, self.planner_options)
        if self.websocket is not None:
            host, port = self.address
            if not 0 <= port <= 65535:
                raise ValueError(f"websocket={self.websocket}: a port is 0 to 65535")
            if not _is_loopback(host) and len(self.token or "") < MIN_TOKEN:
                raise ValueError(
                    f"websocket={self.websocket} can be reached from other machines: give a token of at least "
                    f"{MIN_TOKEN} characters, or 127.0.0.1"
                )
        return self

    @property
    def spec(self) -> RobotSpec:
        """The robots' speed, times and perception."""
        return replace(super().spec, perception=self.perception.perception())

    @property
    def specs(self) -> dict[str, RobotSpec]:
        """The robots that differ from ``spec``, by name."""
        alike = self.spec
        made = {name: replace(robot.spec(alike, ""), start_m=None) for name, robot in self.team.items()}
        return {name: replace(spec, name=name) for name, spec in made.items() if spec != alike}

    @property
    def starts(self) -> dict[str, Point]:
        """Where each robot is, in the map's metres."""
        return {name: robot.start for name, robot in self.team.items()}

    @property
    def planner_options(self) -> Mapping[str, object]:
        """The options of the deciding planner."""
        return self.planner.get(self.decide_by.rsplit(".", 1)[-1], {})

    @property
    def address(self) -> tuple[str, int]:
        """The host and port of the WebSocket."""
        host, colon, port = (self.websocket or "").rpartition(":")
        if not colon or not port.isdigit():
            raise ValueError(f"websocket={self.websocket}: give a port or host:port")
        return host.strip("[]"), int(port)


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
