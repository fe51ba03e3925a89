"""The simulated robots; all robots of a team are alike."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Body:
    """A disc that turns and drives forward, about a TurtleBot 4."""

    radius_m: float = 0.15
    speed_m_per_s: float = 0.5
    acceleration_m_per_s2: float = 0.5
    turn_rad_per_s: float = 1.5
    turn_acceleration_rad_per_s2: float = 3.0

    @property
    def planned_radius_m(self) -> float:
        """The radius that the live team plans with.

        pyrobosim keeps the robot's centre out of furniture that is grown by the radius with square corners, sqrt(2)
        radii from the corner; the rest is for driving a few centimetres beside the line.
        """
        return round(self.radius_m * 2**0.5 + 0.04, 2)
