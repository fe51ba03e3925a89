"""Random event streams against a live team, with what must hold whatever comes in.

By hand: ``python -m tests.live.fuzz 10000``, which takes an hour of CPU time; a second number is the first seed.
"""

import json
import random
from itertools import permutations

import numpy as np

from mrtask.execution.perception import Perception, Rates
from mrtask.live.session import LiveSession
from tests.live.useful import Useful

KINDS = (
    "pose", "arrived", "navigation_failed", "search_ended", "object_seen", "interaction_ended", "robot_lost",
    "robot_joined", "route_blocked", "route_cleared", "heartbeat", "clock", "try_again",
)  # fmt: skip


PLANNERS = ("greedy", "learned_myopic", "nonlearned_myopic", "pouct", "pouct_paper")
OPTIONS = {"pouct": {"samples": 25}, "pouct_paper": {"samples": 25}}
FORMULAS = ("F Egg & F Pillow", "(!Pillow U Egg) & F Pillow", "F (Egg & X F Pillow)", "F Egg | F Pillow")


class Stream:
    """One stream: likely events, contradictory ones, and lines that are no message at all."""

    def __init__(self, live, seed, doors=()):
        self.live, self.rng, self.doors = live, random.Random(seed), list(doors)
        self.session = LiveSession(live)
        self.certain = live.setup.spec.perception.sees_all
        """Whether what was seen last is believed."""
        self.useful = Useful(live)
        self.time_s, self.count, self.sent = 0.0, 0, []
        self.rejected = 0

    def run(self, length):
        self.check_orders([json.loads(line) for line in self.session.begin()])
        for _ in range(length):
            self.step()
        self.check_wakes()
        return self

    def step(self):
        rng = self.rng
        line = self.junk() if rng.random() < 0.1 else json.dumps(self.event())
        if self.sent and rng.random() < 0.1:
            line = rng.choice(self.sent)
        self.sent = [*self.sent[-20:], line]
        self.send(line)
        if rng.random() < 0.5:
            self.check_wakes()

    def send(self, line):
        answers, news = self.session.receive(line)
        answers, news = [json.loads(one) for one in answers], [json.loads(one) for one in news]
        if not line.startswith('{"type": "hello"') and '"events": []' not in line:
            assert answers and all(one["type"] == "answer" for one in answers), "an event without an answer"
        for answer in answers:
            if answer["type"] == "answer" and answer["status"] != "accepted":
                assert answer["reason"], "a refusal without a reason"
                self.rejected += answer["status"] == "rejected"
        more = self.note(line, answers)
        self.check_orders(news)
        self.check_ordered_again(line, answers, news)
        self.check_state()
        for task in news:
            if task["type"] == "task":
                self.check_task(task, more)

    def event(self):
        rng, live = self.rng, self.live
        self.count += 1
        self.time_s += rng.choice([0.0, 0.5, 2.0, rng.choice([0.5, 2.0, 10.0, 70.0])])
        kind = rng.choice(KINDS)
        late_s = rng.choice([0.0, 0.0, 0.0, 1.0, 5.0])
        event = {"type": kind, "id": f"i{self.count}", "time_s": max(self.time_s - late_s, 0.0)}
        index = rng.randrange(len(live.names))
        robot = live.team.robots[index]
        container = rng.choice(list(live.containers))
        if rng.random() < 0.7:  # what fits the robot's order
            place = robot.assignment.container if robot.moving else robot.place
            container = live.team.containers[place] if place >= 0 else container
        objects = [*live.setup.task.propositions, "Spoon"]
        place = self.place()
        event |= {
            "pose": {"robot": live.names[index], **place},
            "arrived": {"robot": live.names[index], "container": container},
            "navigation_failed": {"robot": live.names[index], "container": container, "reason": "stuck"},
            "search_ended": {
                "robot": live.names[index],
                "container": container,
                "status": rng.choice(["FINISHED", "FINISHED", "FAILED"]),
                "objects": [self.detection(name) for name in rng.sample(objects, rng.randrange(len(objects) + 1))],
            },
            "object_seen": {
                "container": container,
                "object": rng.choice(objects),
                "present": rng.random() < 0.5,
                "confidence": 1.0 if self.certain else rng.uniform(0.01, 1.0),
            },
            "interaction_ended": {
                "robot": live.names[index],
                "container": container,
                "object": live.setup.task.propositions[robot.act.obj] if robot.act.obj >= 0 else rng.choice(objects),
                "status": rng.choice(["FINISHED", "FAILED"]),
                "gone": rng.random() < 0.5,
            },
            "robot_lost": {"robot": live.names[index]},
            "robot_joined": {"robot": rng.choice([*live.names, "new"]), **place},
            "route_blocked": rng.choice(
                [{"door": rng.choice(self.doors or ["none"])}, {**place, "radius_m": rng.uniform(0.1, 1.0)}]
            ),
            "route_cleared": rng.choice([{"door": rng.choice(self.doors or ["none"])}, self.blocked() or place]),
            "heartbeat": {"robot": live.names[index]},
            "clock": {},
            "try_again": rng.choice([{}, {"robot": live.names[index]}, {"container": container}]),
        }[kind]
        if rng.random() < 0.1:  # contradictory or unknown
            event[rng.choice(list(event))] = rng.choice([None, "nobody", -1.0, 1e300, [], {}, True, "x" * 300])
        if rng.random() < 0.1:
            return {"type": "batch", "events": [event], "more": rng.random() < 0.5}
        return event

    def place(self):
        """Anywhere, or where something is going on: at a robot, at a container, in a barrier."""
        rng, grid = self.rng, self.live.team.home_map
        robot = rng.choice(self.live.team.robots)
        cells = [robot.position_at(self.live.team.time_s).back, rng.choice(self.live.setup.home_map.access.tolist())]
        spots = [grid.cell_center(tuple(cell)) for cell in cells if cell[0] >= 0]
        spots += [barrier.start for barrier in self.live.barriers.values()]
        x_m, y_m = rng.choice([(rng.uniform(-1, 9), rng.uniform(-1, 5)), *spots])
        return {"x_m": x_m, "y_m": y_m}

    def blocked(self):
        """Some place that is blocked."""
        places = [one.start for key, one in self.live.barriers.items() if key.startswith("place")]
        return dict(zip(("x_m", "y_m"), self.rng.choice(places), strict=True)) if places else None

    def detection(self, name):
        if self.rng.random() < 0.5:
            return name
        return {"object": name, "confidence": 1.0 if self.certain else self.rng.uniform(0.01, 1.0)}

    def junk(self):
        rng = self.rng
        return rng.choice(
            [
                "", "{", "null", "[]", "[" * 10_000, '{"a":' * 5000, '"' + "x" * 300_000, "\\", "{}",
                '{"type": "order"}',
                '{"type": "pose"}', '{"type": "hello"}', '{"type": "hello", "version": "x"}', "\ud800", "NaN", "1e999",
                '{"type": "pose", "id": "n", "time_s": NaN, "robot": "r1", "x_m": 0, "y_m": 0}',
                json.dumps({"type": "batch", "events": [{"type": "batch", "events": []}]}),
                "".join(chr(rng.randrange(32, 0x2FF)) for _ in range(rng.randrange(200))),
            ]
        )  # fmt: skip

    def note(self, line, answers):
        """Take in what was accepted; whether more is to come at this instant."""
        if not any(answer.get("status") == "accepted" for answer in answers):
            return False
        content = json.loads(line)
        events = content["events"] if content["type"] == "batch" else [content]
        for event, answer in zip(events, answers, strict=True):
            if answer["status"] == "accepted":
                self.useful.take(event)
        return content.get("more", False)

    def check_state(self):
        live, team = self.live, self.live.team
        belief = team.belief
        assert ((belief.posterior >= 0) & (belief.posterior <= 1)).all()
        for (container, name), (_, present) in self.useful.found.items() if self.certain else ():
            if name not in live.setup.task.propositions:
                continue
            obj = live.setup.task.propositions.index(name)
            assert belief.presence_prob[live.containers[container], obj] == float(present), "a find was forgotten"
        told = np.where(belief.searched[:, None], belief.detected & (belief.posterior >= 0.5), belief.posterior)
        if self.certain:
            assert np.array_equal(belief.presence_prob, told)
        else:  # where nobody has searched, planners are told the likelihood, not the prior with its doubts
            assert np.allclose(belief.presence_prob, told, atol=1e-3)
        assert team.state == team.automaton.run(letter.object for letter in team.letters)
        assert team.state != team.automaton.sink
        acts = [robot.act.obj for robot in team.robots if robot.act.kind == "interact"]
        assert not acts or any(self.all_count(order, team) for order in permutations(acts)), "two for one letter"
        assert len(live.names) == len(team.robots) == len(live.heard_s)

    @staticmethod
    def all_count(order, team):
        state = team.state
        for obj in order:
            if not team.automaton.advancing[state, obj]:
                return False
            state = team.automaton.transitions[state, obj]
        return True

    def check_task(self, task, more):
        """Nobody is stuck while something useful can be reached, or while more of this instant is to come."""
        if task["status"] == "stuck":
            assert not more, "stuck before all of this instant is known"
            assert not (options := self.useful.options()), f"stuck, although {options[0]}"
        elif task["status"] == "running" and not more and not self.acting():
            assert task["reason"], "nobody acts, and nobody knows why"
            assert task["wake_s"] > task["time_s"], "a team that nothing wakes"

    def check_wakes(self):
        """A team that waits to try something again does so when it said."""
        live = self.live
        self.send('{"type": "batch", "events": []}')
        if live.team.accepted or self.acting() or not live.left_alone():
            return
        self.time_s = live.left_alone()[0][0]
        self.send(json.dumps({"type": "clock", "id": f"w{self.time_s}", "time_s": self.time_s}))
        assert self.acting() or not live.present, "it does not try again"

    def acting(self):
        """The robots that have something to do."""
        return [robot for robot in self.live.team.robots if not (robot.free or robot.lost)]

    def check_ordered_again(self, line, answers, news):
        """Whoever ended what it was to do is told what to do next, even if that is the same."""
        if not answers or answers[0].get("status") != "accepted" or "kept" in answers[0]["reason"]:
            return
        event = json.loads(line)
        over = ("navigation_failed", "search_ended", "interaction_ended")
        if event["type"] in over and "before the robot was lost" not in answers[0]["reason"]:
            robot = self.live.team.robots[self.live.names.index(event["robot"])]
            told = {order["robot"] for order in news if order["type"] == "order"}
            assert event["robot"] in told or robot.lost, "a robot that nobody tells what to do"

    def check_orders(self, news):
        live, team = self.live, self.live.team
        for order in news:
            if order["type"] != "order":
                continue
            robot = team.robots[live.names.index(order["robot"])]
            assert not robot.lost, "an order for a robot that is lost"
            if order["action"] == "navigate":
                container = live.containers[order["container"]]
                reached = team.home_map.cell_center(tuple(live.setup.home_map.access[container]))
                assert np.allclose(order["route"][-1], reached), "a route that ends elsewhere"
                cells = robot.route.cells
                blocked = [area for area in self.useful.barriers.values() if not any(area[cell] for cell in cells[:2])]
                assert not any(area[cell] for area in blocked for cell in cells), "a route through what is blocked"
            if order["action"] == "interact":
                obj = live.setup.task.propositions.index(order["object"])
                assert team.belief.presence_prob[live.containers[order["container"]], obj] > 0, (
                    "an object that is not there"
                )


def main(count, first=0):
    """Runs that many streams from a seed on, on the two-room house, and says what came of them."""
    import pipeline  # noqa: F401 - kernels from the cache
    from mrtask.homes.procthor import parse_house
    from mrtask.maps.home_map import build_map
    from tests.conftest import ASSETS, make_two_room_house
    from tests.live.test_team import two_robots

    home = parse_house(make_two_room_house(), ASSETS, "two-rooms", 0)
    home_map = build_map(home)
    events = rejected = failed = 0
    for seed in range(first, first + count):
        perception = Perception(Rates(0.7, 0.1)) if seed % 4 == 3 else None
        formula = FORMULAS[seed // 5 % len(FORMULAS)]
        live = two_robots(home, home_map, PLANNERS[seed % 5], formula, perception=perception, options=OPTIONS)
        stream = Stream(live, seed, [door.id for door in home.doors])
        try:
            stream.run(30)
        except AssertionError as error:
            failed += 1
            print(f"seed {seed}, {PLANNERS[seed % 5]}, {formula}, event {stream.count}: {error}", flush=True)
        events, rejected = events + stream.count, rejected + stream.rejected
    print(f"{count} streams from {first}, {events} events, {rejected} refusals, {failed} failed", flush=True)
    return failed


if __name__ == "__main__":
    import sys

    sys.exit(main(*map(int, sys.argv[1:])) > 0)
