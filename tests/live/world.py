"""A world for live teams in tests: robots that do as ordered, with the truth, in simulated time."""

from dataclasses import dataclass, field

import numpy as np

from mrtask.live import messages as m
from mrtask.live.live_team import LiveTeam
from mrtask.live.state import LiveSetup
from mrtask.tasks.words import ReadTask


def setup_of(trial, home, home_map, likelihood, planner, options=None):
    """A trial as a live team's setup."""
    task = ReadTask(trial.formula, trial.objects)
    return LiveSetup(
        home, home_map, trial.formula, task, likelihood, trial.team.members[0], planner, options or {}, seed=trial.seed
    )


def names_of(count):
    return [f"robot-{index}" for index in range(count)]


def live_team(setup, trial):
    point = setup.home_map.cell_center(trial.start_cell)
    return LiveTeam(setup, dict.fromkeys(names_of(trial.team.robots), point))


def orders_of(replies):
    return [reply for reply in replies if reply.type == "order"]


def answers_of(replies):
    return [reply for reply in replies if reply.type == "answer"]


@dataclass
class World:
    """Each robot does its last order; ``step`` gives the events of the next instant."""

    contents: dict  # container -> objects
    speed_m_per_s: float = 1.0
    search_time_s: float = 0.0
    interact_time_s: float = 0.0
    time_s: float = 0.0
    detect: object = None  # (container, number of the search) -> objects; None: all that is there
    count: int = 0
    searches: dict = field(default_factory=dict)  # container -> how often it was searched
    due: dict = field(default_factory=dict)  # robot -> (time, order)

    def obey(self, replies):
        for order in orders_of(replies):
            took_s = {
                "navigate": order.length_m / self.speed_m_per_s,
                "search": self.search_time_s,
                "interact": self.interact_time_s,
                "wait": np.inf,
            }[order.action]
            self.due[order.robot] = (self.time_s + took_s, order)

    def step(self):
        """The events of the next instant; none when nobody does anything."""
        self.time_s = min([at for at, _ in self.due.values()], default=np.inf)
        if not np.isfinite(self.time_s):
            return []
        acted = [robot for robot, (at, _) in self.due.items() if at <= self.time_s + 1e-9]
        events = []
        for robot in sorted(acted):
            _, order = self.due.pop(robot)
            events.append(self.event(order))
        return events

    def settle(self, live):
        """Everything of the next instant, until somebody has to take his time; False when nobody does anything."""
        events = self.step()
        if not events:
            return False
        now_s = self.time_s
        while events:
            self.obey(live.handle(events, more=True))
            following = min([at for at, _ in self.due.values()], default=np.inf)
            events = self.step() if following <= now_s + 1e-9 else []
        self.time_s = now_s
        self.obey(live.handle([]))
        return True

    def event(self, order):
        self.count += 1
        common = {
            "id": f"e{self.count}",
            "time_s": float(self.time_s),
            "robot": order.robot,
            "container": order.container,
        }
        if order.action == "navigate":
            return m.Arrived(type="arrived", **common)
        if order.action == "search":
            search = self.searches[order.container] = self.searches.get(order.container, -1) + 1
            seen = self.detect(order.container, search) if self.detect else tuple(self.contents[order.container])
            return m.SearchEnded(type="search_ended", objects=seen, **common)
        there = order.object in self.contents[order.container]
        return m.InteractionEnded(
            type="interaction_ended",
            object=order.object,
            status="FINISHED" if there else "FAILED",
            gone=not there,
            **common,
        )
