"""The team's clock, which its robots' stamps set: it begins at 0 and goes on with them, whatever clock they count on.

One stamp far ahead of all before, or days behind, is not believed: its event counts as one of the present instant,
until somebody else's stamp confirms it. So a wrong stamp changes nothing for long.
"""

from dataclasses import dataclass, field

MAX_AHEAD_S = 600.0
"""A stamp this far ahead of all before, and of what robots are expected to do next, has to be confirmed."""
MAX_BEHIND_S = 86_400.0
"""So has one this far behind."""


@dataclass
class TeamClock:
    """Turns stamps into the team's time."""

    zero_s: float = 0.0
    """The stamp at which the team's time is 0."""
    _doubted: tuple[str, float] | None = field(default=None, init=False)
    """Who sent the last stamp, if it was not believed, and the team's time that it meant."""

    def begin(self, stamp_s: float, now_s: float) -> None:
        """Take in the first stamp: one that is far off, such as a Unix time, says what clock the senders count on."""
        if stamp_s > now_s + MAX_AHEAD_S:
            self.zero_s = stamp_s - now_s

    def time_s(self, stamp_s: float, now_s: float, due_s: float, sender: str, *, alone: bool) -> tuple[float, str]:
        """Return the team's time of a stamp, and a note to the sender if it is not the stamp's own.

        Args:
            now_s: the team's time.
            due_s: the latest end of what robots are doing.
            sender: who sent it.
            alone: whether there is nobody else to confirm it.
        """
        time_s = stamp_s - self.zero_s
        doubted, self._doubted = self._doubted, None
        ahead, behind = time_s > max(now_s, due_s) + MAX_AHEAD_S, time_s < now_s - MAX_BEHIND_S
        if not (ahead or behind):
            return max(time_s, 0.0), ""
        near = doubted is not None and abs(doubted[1] - time_s) <= MAX_AHEAD_S
        if doubted is None or not near or not (alone or doubted[0] != sender):
            self._doubted = (sender, time_s)
            off = f"{abs(time_s - now_s):.0f} s {'ahead of all before' if ahead else 'behind'}"
            return now_s, f"its time_s is {off} and counts as now; is its clock right?"
        if behind:
            self.zero_s = stamp_s - now_s
        return max(time_s, now_s), ""
