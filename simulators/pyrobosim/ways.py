"""A robot's way, and how to steer along it: forward speed and turn rate for the next instant."""

from collections.abc import Sequence
from math import atan2, copysign, hypot, pi, sqrt

import numpy as np
from numpy.typing import NDArray

from mrtask.homes.home import Point
from simulators.pyrobosim.robot import Body

LOOKAHEAD_M, CAREFUL_LOOKAHEAD_M = 0.15, 0.04
"""A robot heads for the point of its way this far ahead, so it cuts corners by a few centimetres at most; the second is
for the moment after it was stopped at furniture."""
WINDOW_M, WINDOW_STEP_M = 0.6, 0.01
"""Where on its way a robot is, is looked for this far ahead of where it was, in these steps."""
SLOW_RAD = 0.7
"""A robot whose heading is this far off its way turns on the spot."""
BRAKING_SHARE = 0.8
"""Of the acceleration; the rest is for the time between two instants."""
STEP_M = 0.05
"""Between the points of a way that others are kept away from."""


class Way:
    """A line of points that is driven once, and how far the robot is on it."""

    def __init__(self, points: Sequence[Point]) -> None:
        line = np.array(points, dtype=np.float64).reshape(-1, 2)
        moved = np.concatenate([[True], np.hypot(*np.diff(line, axis=0).T) > 0]) if len(line) > 1 else [True]
        self._line = line[moved]
        lengths_m = np.hypot(*np.diff(self._line, axis=0).T) if len(self._line) > 1 else np.zeros(0)
        self._reached_m = np.concatenate([[0.0], np.cumsum(lengths_m)])
        self.progress_m = 0.0

    @property
    def length_m(self) -> float:
        """From its first point to its last."""
        return float(self._reached_m[-1])

    @property
    def end(self) -> Point:
        """Its last point."""
        return (float(self._line[-1, 0]), float(self._line[-1, 1]))

    def at(self, metres: NDArray[np.float64] | float) -> NDArray[np.float64]:
        """Return [..., 2] the points at these distances in metres; the last point beyond the end."""
        return np.stack([np.interp(metres, self._reached_m, self._line[:, axis]) for axis in (0, 1)], axis=-1)

    def advance(self, place: Point) -> None:
        """Note the robot's position: on its way, it is at the nearest point ahead of where it was."""
        metres = np.arange(
            self.progress_m, min(self.progress_m + WINDOW_M, self.length_m) + WINDOW_STEP_M, WINDOW_STEP_M
        )
        away = np.hypot(*(self.at(metres) - place).T)
        self.progress_m = min(float(metres[int(np.argmin(away))]), self.length_m)

    def ahead(self, horizon_m: float = np.inf) -> NDArray[np.float64]:
        """Return [K, 2] points of the remaining way, from where the robot is to the horizon."""
        end_m = min(self.progress_m + horizon_m, self.length_m)
        count = max(int(np.ceil((end_m - self.progress_m) / STEP_M)), 1)
        return self.at(np.linspace(self.progress_m, end_m, count + 1))


def wrapped(angle: float) -> float:
    """Return the angle between -pi and pi."""
    return (angle + pi) % (2 * pi) - pi


def turn_rate(error: float, body: Body, dt_s: float) -> float:
    """Return the rate at which to turn by ``error`` so that the robot can still stop turning in time."""
    rate = sqrt(2 * BRAKING_SHARE * body.turn_acceleration_rad_per_s2 * abs(error))
    return copysign(min(rate, body.turn_rad_per_s, abs(error) / dt_s), error)


def speed_to_stop_in(metres: float, body: Body, dt_s: float) -> float:
    """Return the greatest speed from which the robot can stop within this distance."""
    metres = max(metres, 0.0)
    return min(sqrt(2 * BRAKING_SHARE * body.acceleration_m_per_s2 * metres), metres / dt_s, body.speed_m_per_s)


def steer(
    place: Point, yaw: float, way: Way, limit_m_per_s: float, body: Body, dt_s: float, *, careful: bool = False
) -> tuple[float, float]:
    """Return forward speed and turn rate along the way; ``limit_m_per_s`` is the speed that other robots allow."""
    x, y = place
    to_end_m = hypot(way.end[0] - x, way.end[1] - y)
    goal_x, goal_y = way.at(way.progress_m + (CAREFUL_LOOKAHEAD_M if careful else LOOKAHEAD_M))
    error = wrapped(atan2(goal_y - y, goal_x - x) - yaw)
    left_m = max(way.length_m - way.progress_m, to_end_m)
    speed = min(limit_m_per_s, speed_to_stop_in(left_m, body, dt_s)) * max(0.0, 1 - abs(error) / SLOW_RAD)
    return speed, turn_rate(error, body, dt_s)
