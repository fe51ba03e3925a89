"""A team of real robots: events in, orders out.

`LiveTeam` handles what its robots report (`mrtask.live.events`), lets the planner decide when a robot became free or
something unexpected happened, and gives the orders that changed (`mrtask.live.orders`).
"""

import hashlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mrtask.errors import InputError
from mrtask.execution.trials import key_seed
from mrtask.homes.home import Point
from mrtask.live import messages as m
from mrtask.live.events import HANDLERS
from mrtask.live.orders import order_key, order_of, task_state
from mrtask.live.state import EventKey, LiveSetup, LiveState, Refused
from mrtask.planning.planners import make_planner
from mrtask.planning.problem import WAIT, Assignment

DIGEST_LENGTH = 16
ABOUT_ROBOTS = ("robot_joined", "robot_lost", "try_again")
"""Events that name a robot, but may come from somebody else."""


class LiveTeam(LiveState):
    """A `LiveState` that handles events and decides.

    Args:
        robots: name -> where it is, in metres.

    Raises:
        InputError: where `LiveState` raises it, or a planner that needs to know the contents.
    """

    def __init__(self, setup: LiveSetup, robots: Mapping[str, Point]) -> None:
        super().__init__(setup, robots)
        self.planner = make_planner(setup.planner, dict(setup.planner_options))
        if self.planner.knows_contents:
            raise InputError(f"planner {setup.planner!r} knows all contents, which nobody does here; give another")

    def begin(self) -> list[m.Outgoing]:
        """Compile what the planner needs, and make the first decision, or the next one after a restart."""
        if self.team.active:
            self.planner.warm_up(self.team.problem())
        return self._go_on(decide=True)

    def handle(self, events: Sequence[Any], *, more: bool = False, client: str = "") -> list[m.Outgoing]:
        """Handle the events of one instant.

        Args:
            events: models of `mrtask.live.messages.Event`.
            more: whether another batch of this instant follows, so that no robot is sent anywhere yet.
            client: the name of the client that sent them; ids are its own. Events of clients without a name are the
                same if their id and their content are.

        Returns:
            One `Answer` for each event, then the orders that changed, and the task's state if anything changed.
        """
        answers = [self._answer(event, client) for event in events]
        if answers and all(answer.status != "accepted" for answer in answers):
            return [*answers]
        return [*answers, *self._go_on(decide=not more)]

    def present_orders(self) -> list[m.Outgoing]:
        """Return the orders in force, as if they were given now."""
        return [order_of(self, number) for number in self.present]

    def _answer(self, event: Any, client: str) -> m.Answer:
        key = event_key(event, client)
        if key in self.ids or ("", event.id) in self.ids:
            return m.Answer(event=event.id, status="duplicate", reason="this event was taken in before")
        before_s, zero_s = self.team.time_s, self.clock.zero_s
        if not self.ids:
            self.clock.begin(event.time_s, before_s)
        sender = getattr(event, "robot", None) or client
        due_s = max((robot.act.until_s for robot in self.team.robots if robot.act.until_s < np.inf), default=before_s)
        time_s, doubt = self.clock.time_s(event.time_s, before_s, due_s, sender, alone=len(self.present) == 1)
        back, note = "", None
        try:
            self.team.time_s = max(before_s, time_s)
            if event.type != "interaction_ended":  # it may still end what it was doing
                back = self._welcome_back(event)
            note = HANDLERS[event.type](self, event.model_copy(update={"time_s": time_s}))
            back = back or self._welcome_back(event)
        except Refused as refused:
            if not back:
                self.team.time_s = before_s
                self.clock.zero_s = self.clock.zero_s if self.ids else zero_s
                return m.Answer(event=event.id, status="rejected", reason=str(refused))
            note = str(refused)
        self._heard(event)
        self.take_in(key)
        return m.Answer(event=event.id, status="accepted", reason="; ".join(filter(None, (back, note, doubt))))

    def _heard(self, event: Any) -> None:
        """Note who spoke; before the first word of all, nobody was late."""
        if not self.ids:
            self.spoke_s = [self.team.time_s] * len(self.names)
        if event.type not in ABOUT_ROBOTS and getattr(event, "robot", None) in self.names:
            self.spoke_s[self.number(event.robot)] = self.team.time_s

    def _welcome_back(self, event: Any) -> str:
        """Take a robot that had fallen silent into the team again, where it should be by what it last said."""
        name = getattr(event, "robot", None)
        number = self.names.index(name) if name in self.names else -1
        if number not in self.silent or event.type in ABOUT_ROBOTS:
            return ""
        robot = self.team.robots[number]
        self.team.join(robot.position, robot)
        robot.home_map = self.map_at(robot.position)
        self.silent.discard(number)
        self.surprise = True
        return f"{name} is back in the team"

    def _miss_the_silent(self) -> None:
        """Take the robots out of the team that are overdue; others may take over what they were to do."""
        for number in self.present:
            if self.overdue_s(number) <= self.team.time_s:
                self.team.lose(self.team.robots[number])
                self.silent.add(number)
                self.surprise = True

    def _go_on(self, *, decide: bool) -> list[m.Outgoing]:
        team = self.team
        self.more = not decide
        if self.ended:
            team.interactions_ended([team.robots[number] for number in sorted(self.ended)])
            self.ended = []
        self._use_own_maps()
        if decide:
            self._miss_the_silent()
        team.withdraw_interactions()
        team.start_interactions()
        if decide:
            team.release()
            freed = any(team.robots[number].free for number in self.busy)
            if (freed or self.surprise or self._may_go_on()) and not team.accepted:
                self._decide()
            self.busy = {number for number, robot in enumerate(team.robots) if not (robot.free or robot.lost)}
            self.surprise = False
        told, self.told = self.told, {}
        orders: list[m.Outgoing] = []
        for number, (name, robot) in enumerate(zip(self.names, team.robots, strict=True)):
            self.told[name] = order_key(self, robot)
            if self.told[name] != told.get(name):
                self.orders += 1
                if not robot.lost:
                    orders.append(order_of(self, number))
        return [*orders, task_state(self)]

    def _use_own_maps(self) -> None:
        """Let barriers hold the robots that have driven out of them, and none that stand in them."""
        for robot in (self.team.robots[number] for number in self.present if self.barriers):
            own_map = self.map_at(robot.position_at(self.team.time_s))
            if own_map is not robot.home_map:
                self.team.take_own_map(robot, own_map)

    def _may_go_on(self) -> bool:
        """Return whether robots without work may find some now, although nothing happened that calls for a decision.

        That is where one may try again what it failed at, and where everybody waits although there is something to do.
        """
        now_s, robots = self.team.time_s, [self.team.robots[number] for number in self.present]
        idle = [robot for robot in robots if robot.free]
        again = any(self.decided_s < one.until_s <= now_s for robot in idle for one in robot.setbacks.by.values())
        if again or len(idle) < len(robots):
            return again
        useful = self.team.useful()
        return any(bool(np.isfinite(robot.options_s(now_s)[useful]).any()) for robot in idle)

    def _decide(self) -> None:
        team = self.team
        self.decided_s = team.time_s
        problem = team.problem() if team.active else None
        if problem is None or not problem.deciders("all"):
            return
        seed = key_seed(self.setup.seed, self.setup.planner, self.decisions)
        plan = self.planner.plan(problem, seed)
        self.decisions += 1
        assignments = {
            index: assignment
            if assignment.container == WAIT or np.isfinite(problem.robots[index].travel_s[assignment.container])
            else Assignment(WAIT, assignment.interaction)
            for index, assignment in plan.assignments.items()
        }
        team.assign(assignments)
        team.start_interactions()
        team.release()


def event_key(event: Any, client: str) -> EventKey:
    """Return what tells an event from all others."""
    if client:
        return (f"client {client}", event.id)
    return (hashlib.sha256(event.model_dump_json(exclude_defaults=True).encode()).hexdigest()[:DIGEST_LENGTH], event.id)
