"""Run one task in one world with one planner: pyrobosim's robots do what the live process orders.

The live process is `pipeline.live` (`simulators.pyrobosim.served`), which gets the map, the containers' places and the
task, and is told what happens through `pipeline.live.client`. Its clock is the simulation's, which stands still while
it thinks. On arrival a robot detects (`Robot.detect_objects`, partly observed objects); to interact is to pick the
object up and put it back.
"""

import queue
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from pyrobosim.core import Robot, WorldYamlLoader
from pyrobosim.core import World as Simulated
from pyrobosim.utils.pose import Pose

from mrtask.errors import InputError
from mrtask.execution.trials import Trial
from mrtask.homes.home import Point
from pipeline.live.client import Client, Message
from simulators.pyrobosim.fleet import REFUGE_M, STEP_S, Fleet
from simulators.pyrobosim.robot import Body
from simulators.pyrobosim.served import ServedClient
from simulators.pyrobosim.world import RESOLUTION_M, World

MAX_TIME_S = 1800.0
"""In simulated time; a task that takes longer has failed."""
ANSWER_WITHIN_S = 120.0
POSE_M = 0.01
"""A robot that moved less than this since its last pose sends none."""


@dataclass(frozen=True)
class Leg:
    """A drive to a container that was not redirected."""

    robot: str
    container: str
    planned_s: float
    """The length of the route that was ordered over the robot's top speed, which is what the planner counts with."""
    real_s: float


@dataclass(frozen=True, eq=False)
class Outcome:
    """A trial's outcome."""

    status: str
    """``accepted``, ``failed``"""
    cost_s: float | None
    """When the last interaction ended."""
    error: str | None
    orders: int
    refused: tuple[str, ...]
    """Why the live process refused events."""
    legs: tuple[Leg, ...]
    contacts: int
    brushes: int
    least_gap_m: float | None
    held_s: float
    gave_way: int
    gave_up: int
    paths: dict[str, list[Point]] = field(default_factory=dict)
    """Each robot's positions, step by step."""


def load_world(world: World) -> Simulated:
    """Load the world into pyrobosim, without robots.

    Raises:
        InputError: pyrobosim left something out, which it only logs.
    """
    simulated = WorldYamlLoader().from_file(world.world_file)
    wanted = {container.id: set(container.objects) for container in world.home.containers}
    found = {name: _held(simulated, name) for name in simulated.get_location_names() if name in wanted}
    if found != wanted:
        wrong = sorted(name for name in wanted if found.get(name) != wanted[name])
        raise InputError(f"{world.world_file}: pyrobosim did not take {', '.join(wrong)} as they are")
    without = [name for name in wanted if not _spawn(simulated, name).nav_poses]
    if without:
        raise InputError(f"{world.world_file}: pyrobosim lets no robot stand at {', '.join(without)}")
    return simulated


def _spawn(simulated: Simulated, container: str) -> Any:
    return simulated.get_location_by_name(container).children[0]


def _held(simulated: Simulated, container: str) -> set[str]:
    return {str(one.category) for one in _spawn(simulated, container).children}


def starts_near(world: World, trial: Trial, body: Body) -> list[Point]:
    """Return the robots' starts: the free places nearest to the trial's start that are far enough from each other."""
    home_map = world.home_map
    cells = np.argwhere(home_map.free)
    first = np.array(trial.start_cell)
    cells = cells[np.argsort(np.hypot(*(cells - first).T), kind="stable")]
    apart = (2 * body.radius_m + REFUGE_M) / home_map.resolution_m
    chosen: list[Any] = []
    for cell in cells:
        if len(chosen) < trial.team.robots and all(np.hypot(*(cell - other)) >= apart for other in chosen):
            chosen.append(cell)
    if len(chosen) < trial.team.robots:
        raise InputError(f"{trial.team.robots} robots do not fit into {world.folder}")
    return [home_map.cell_center((int(row), int(col))) for row, col in chosen]


def run_trial(
    world: World, simulated: Simulated, trial: Trial, planner: str, options: Sequence[str], body: Body
) -> Outcome:
    """Run a trial; ``options`` are further options of `pipeline.live`."""
    simulated.remove_all_robots()
    starts = starts_near(world, trial, body)
    robots = [_robot(f"robot-{number}", place, body) for number, place in enumerate(starts)]
    for robot, (x, y) in zip(robots, starts, strict=True):
        simulated.add_robot(robot, pose=Pose(x=x, y=y))
    containers = [container.id for container in world.home.containers]
    nav_poses = {name: _spawn(simulated, name).nav_poses[0] for name in containers}
    fleet = Fleet(simulated, world.home_map, containers, nav_poses, robots, body)
    team = ", ".join(f"{robot.name}: [{x!r}, {y!r}]" for robot, (x, y) in zip(robots, starts, strict=True))
    spec = trial.team.spec
    arguments = [
        *(f"map={world.map_file}", f"containers={world.containers_file}"),
        *(f"task={trial.formula}", f"team={{{team}}}", f"decide_by={planner}", f"seed={trial.seed}"),
        *(f"speed_m_per_s={spec.speed_m_per_s!r}", f"robot_radius_m={body.planned_radius_m!r}"),
        *(f"search_time_s={spec.search_time_s!r}", f"interact_time_s={spec.interact_time_s!r}"),
        *(f"resolution_m={RESOLUTION_M!r}", "own_clock=false", "lost_after_s=null", *options),
    ]
    client = ServedClient(arguments, clock=lambda: fleet.time_s)
    try:
        return Bridge(client, fleet, simulated, trial).run()
    finally:
        client.end()


def _robot(name: str, place: Point, body: Body) -> Robot:
    return Robot(
        name=name,
        pose=Pose(x=place[0], y=place[1]),
        radius=body.radius_m,
        max_linear_velocity=body.speed_m_per_s,
        max_angular_velocity=body.turn_rad_per_s,
        max_linear_acceleration=body.acceleration_m_per_s2,
        max_angular_acceleration=body.turn_acceleration_rad_per_s2,
        partial_obs_objects=True,
    )


class Bridge:
    """Turns orders into what pyrobosim's robots do, and what they did into events."""

    def __init__(self, client: Client, fleet: Fleet, simulated: Simulated, trial: Trial) -> None:
        self.client, self.fleet, self.simulated, self.trial = client, fleet, simulated, trial
        self.orders: dict[str, Message] = {}
        """Robot -> its order."""
        self.ordered_s: dict[str, float] = {}
        self.due_s: dict[str, float] = {}
        """Robot -> when its search or interaction ends."""
        self.told = {name: member.place for name, member in fleet.members.items()}
        """Robot -> where the live process last heard that it is."""
        self.legs: list[Leg] = []
        self.paths: dict[str, list[Point]] = {name: [member.place] for name, member in fleet.members.items()}
        self.count = 0

    def run(self) -> Outcome:
        """Run until the task is done, or no robot does anything any more."""
        self._hear_until_task()
        error = None
        while self.client.task["status"] != "done":
            self._end_what_is_due()
            if self.client.task["status"] == "done":
                break
            if self.client.task["status"] == "stuck" and self._all_stand():
                error = self.client.task["reason"]
                break
            if self.fleet.time_s > MAX_TIME_S:
                error = f"not done after {MAX_TIME_S:g} s"
                break
            if (wake_s := self.client.task["wake_s"]) is not None and wake_s <= self.fleet.time_s:
                self._tell("clock")
            moved = self.fleet.step()
            for name, member in self.fleet.members.items():
                self.paths[name].append(member.place)
            for name in moved.arrived:
                self._arrived(name)
            for name in moved.gave_up:
                self._tell("navigation_failed", robot=name, container=self.orders[name]["container"], reason="blocked")
        tally = self.fleet.tally
        return Outcome(
            status="accepted" if error is None else "failed",
            cost_s=self.fleet.time_s if error is None else None,
            error=error,
            orders=self.count,
            refused=tuple(answer["reason"] for answer in self.client.rejected),
            legs=tuple(self.legs),
            contacts=tally.contacts,
            brushes=tally.brushes,
            least_gap_m=tally.least_gap_m if len(self.fleet.members) > 1 else None,
            held_s=tally.held_s,
            gave_way=tally.gave_way,
            gave_up=tally.gave_up,
            paths=self.paths,
        )

    def _all_stand(self) -> bool:
        return not self.due_s and all(member.way is None and not member.aside for member in self.fleet.members.values())

    def _hear_until_task(self) -> None:
        """Read messages up to the task's state, which ends every reply to an accepted event."""
        while True:
            try:
                message = self.client.messages.get(timeout=ANSWER_WITHIN_S)
            except queue.Empty:
                raise RuntimeError(f"the live process said nothing for {ANSWER_WITHIN_S:g} s") from None
            if message is None:
                raise RuntimeError("the live process ended; its errors stand above")
            if message["type"] == "order":
                self._obey(message)
            elif message["type"] == "task" or (message["type"] == "answer" and message["status"] != "accepted"):
                return

    def _tell(self, kind: str, **facts: Any) -> None:
        """Send an event, preceded by the poses of all robots that moved since the last one."""
        for name, member in self.fleet.members.items():
            x, y = member.place
            arrived = kind == "arrived" and name == facts["robot"]
            if not arrived and np.hypot(x - self.told[name][0], y - self.told[name][1]) > POSE_M:
                self.client.send("pose", robot=name, x_m=x, y_m=y)
                self._hear_until_task()
            self.told[name] = (x, y)
        self.client.send(kind, **facts)
        self._hear_until_task()

    def _obey(self, order: Message) -> None:
        name, action = order["robot"], order["action"]
        member = self.fleet.members[name]
        self.orders[name] = order
        self.ordered_s[name] = self.fleet.time_s
        self.count += 1
        self.due_s.pop(name, None)
        member.busy = False
        if action == "wait":
            self.fleet.halt(name)
        elif action == "navigate":
            self.fleet.drive(name, order["container"], [(x, y) for x, y in order["route"]])
        elif self.fleet.stands_at(name, order["container"]):
            self._begin(name)
        else:  # it made way for another robot meanwhile
            self.fleet.drive(name, order["container"], [])

    def _begin(self, name: str) -> None:
        spec = self.trial.team.spec
        took_s = spec.search_time_s if self.orders[name]["action"] == "search" else spec.interact_time_s
        self.due_s[name] = self.fleet.time_s + took_s
        self.fleet.members[name].busy = True

    def _arrived(self, name: str) -> None:
        order = self.orders[name]
        if order["action"] != "navigate":
            self._begin(name)
            return
        planned_s = order["length_m"] / self.trial.team.spec.speed_m_per_s
        self.legs.append(Leg(name, order["container"], planned_s, self.fleet.time_s - self.ordered_s[name]))
        self._tell("arrived", robot=name, container=order["container"])

    def _end_what_is_due(self) -> None:
        """End the searches and interactions that are due, and those that follow from them and take no time."""
        while due := [name for name, at_s in self.due_s.items() if at_s <= self.fleet.time_s + STEP_S / 2]:
            name = due[0]
            del self.due_s[name]
            self.fleet.members[name].busy = False
            order = self.orders[name]
            robot, container = self.fleet.members[name].robot, order["container"]
            if order["action"] == "search":
                found = robot.detect_objects()
                seen = sorted({str(one.category) for one in robot.last_detected_objects})
                status = "FINISHED" if found.is_success() else "FAILED"
                self._tell("search_ended", robot=name, container=container, status=status, objects=seen)
            else:
                done = self._interact(robot, order["object"])
                status = "FINISHED" if done else "FAILED"
                facts = {"robot": name, "container": container, "object": order["object"]}
                self._tell("interaction_ended", status=status, gone=not done, **facts)

    def _interact(self, robot: Robot, kind: str) -> bool:
        """Pick the object up and put it back where it was."""
        known = [one for one in robot.get_known_objects() if one.category == kind and one.parent is robot.location]
        if not known:  # another robot searched here
            robot.detect_objects()
            known = [one for one in robot.last_detected_objects if one.category == kind]
        if not known:
            return False
        pose = known[0].pose
        place = Pose(x=pose.x, y=pose.y, yaw=pose.get_yaw())
        return bool(robot.pick_object(known[0]).is_success() and robot.place_object(place).is_success())
