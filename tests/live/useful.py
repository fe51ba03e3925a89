"""What a team could still do, worked out from the events that were accepted and from where its robots are taken to be.

Ways are found by filling the floor from where a robot stands, without the live team's maps; what was searched, seen and
failed is counted here. A robot that stands in a barrier is there all the same, so that barrier does not hold it.
"""

from collections import Counter

import numpy as np
from scipy import ndimage

GIVEN_UP = 3
"""A robot that failed this often at a container may be left alone with it."""


class Useful:
    def __init__(self, live):
        self.live = live
        self.certain = live.setup.spec.perception.sees_all
        self.searched = set()
        self.found = {}  # (container, object) -> (time, present), the latest sight
        self.failures = Counter()  # (robot, container, what) -> how often
        self.barriers = {}  # door or place -> [H, W] the cells in it

    def take(self, event):
        """Takes in an event that was accepted."""
        kind, container = event["type"], event.get("container")
        if kind == "object_seen":
            self._see(event, event["object"], event.get("present", True))
        elif kind == "search_ended" and event.get("status", "FINISHED") == "FINISHED":
            self.searched.add(container)
            self._forgive(container, "navigation_failed", "search_ended")
            for name in self.live.setup.task.propositions:
                seen = [one if isinstance(one, str) else one["object"] for one in event.get("objects", ())]
                self._see(event, name, name in seen)
        elif kind == "arrived":
            self._forgive(container, "navigation_failed")
        elif kind == "interaction_ended" and event.get("gone") and event["status"] == "FAILED":
            seen_s, _ = self.found.get((container, event["object"]), (-1.0, None))
            self.found[container, event["object"]] = (max(seen_s, event["time_s"]), False)
        elif kind in ("navigation_failed", "search_ended") or event.get("status") == "FAILED":
            self.failures[event["robot"], container, kind] += 1
        elif kind == "route_blocked":
            self._block(event)
        elif kind == "route_cleared":
            self.barriers.pop(self._key(event))
            self._forgive(None, "navigation_failed")
        elif kind == "try_again" and event.get("robot") is None:
            self._forgive(container, "navigation_failed", "search_ended", "interaction_ended")

    def options(self):
        """What each robot could do, in words."""
        live, team = self.live, self.live.team
        automaton, state = team.automaton, team.state
        after = automaton.steps_to_accept[automaton.transitions[state]]
        names = live.setup.task.propositions
        nearer = {names[obj] for obj in np.flatnonzero(after < automaton.steps_to_accept[state])}
        wanted = {names[obj] for obj in np.flatnonzero(automaton.advancing[state])}
        reach = {name: self._reach(name, robot) for name, robot in zip(live.names, team.robots, strict=True)}
        everywhere = set().union(*reach.values())
        at = {name: {c for c in everywhere if self._known(c) and self._holds(c, name)} for name in names}
        missing = {name for name in wanted if not at[name]}
        options = []
        for robot, containers in reach.items():
            options += [f"{robot} could search {c}" for c in containers if missing and not self._known(c)]
            options += [f"{robot} could go to {name} in {c}" for name in nearer for c in containers & at[name]]
        return options

    def _reach(self, name, robot):
        """The containers that a robot can get to and has not failed at too often."""
        if robot.lost:
            return set()
        live = self.live
        position = robot.position_at(live.team.time_s)
        starts, free = {position.back, position.ahead}, live.setup.home_map.free.copy()
        blocked = [cells for cells in self.barriers.values()]
        if all(any(cells[start] for cells in blocked) for start in starts):
            blocked = [cells for cells in blocked if not any(cells[start] for start in starts)]
        for cells in blocked:
            free &= ~cells
        regions, _ = ndimage.label(free, np.ones((3, 3)))
        mine = {regions[start] for start in starts} - {0}
        access = live.setup.home_map.access
        given_up = {c for (who, c, _), count in self.failures.items() if who == name and count >= GIVEN_UP}
        return {c for c, index in live.containers.items() if regions[tuple(access[index])] in mine} - given_up

    def _known(self, container):
        """Whether nobody needs to search it any more; where searches err, the belief's word is taken for that."""
        if self.certain:
            return container in self.searched
        return bool(self.live.team.belief.searched[self.live.containers[container]])

    def _holds(self, container, name):
        if self.certain:
            return bool(self.found.get((container, name), (0, False))[1])
        obj = self.live.setup.task.propositions.index(name)
        return self.live.team.belief.presence_prob[self.live.containers[container], obj] > 0

    def _see(self, event, name, present):
        key = event["container"], name
        if event["time_s"] >= self.found.get(key, (-1.0, None))[0]:
            self.found[key] = (event["time_s"], present)

    def _forgive(self, container, *kinds):
        for key in list(self.failures):
            if key[1] == (container or key[1]) and key[2] in kinds:
                del self.failures[key]

    @staticmethod
    def _key(event):
        return event.get("door") or (event["x_m"], event["y_m"])

    def _block(self, event):
        grid = self.live.setup.home_map
        doors = {door.id: (door.start, door.end) for door in self.live.setup.home.doors}
        place = (event.get("x_m"), event.get("y_m"))
        ends = doors[event["door"]] if event.get("door") else (place, place)
        radius_m = grid.resolution_m * 2 if event.get("door") else event.get("radius_m", 0.3)
        rows, cols = np.indices(grid.free.shape)
        cells = np.stack([grid.origin_m[0] + (cols + 0.5) * grid.resolution_m,
                          grid.origin_m[1] + (rows + 0.5) * grid.resolution_m], axis=-1)  # fmt: skip
        start, along = np.array(ends[0]), np.subtract(ends[1], ends[0])
        share = np.clip((cells - start) @ along / max(along @ along, 1e-12), 0.0, 1.0)
        inside = np.linalg.norm(cells - start - share[..., None] * along, axis=-1) <= radius_m
        self.barriers[self._key(event)] = self.barriers.get(self._key(event), False) | inside
