from fractions import Fraction
from math import comb, sqrt
from statistics import NormalDist

import numpy as np
import pytest

from mrtask.analysis.report.wins import pair_table, share, share_sooner, sign_test
from mrtask.analysis.results.episodes import checked_episodes
from mrtask.analysis.results.statistics import UNDEFINED, Comparison, compare, summarise
from tests.analysis.synthetic import rows


def pair(wins: int, ties: int, losses: int) -> Comparison:
    return Comparison(UNDEFINED, np.nan, wins, ties, losses, np.nan, np.nan, 0, 0)


@pytest.mark.parametrize(("wins", "losses"), [(0, 1), (3, 3), (7, 2), (0, 9), (60, 40), (199, 101)])
def test_against_the_formulas_in_exact_fractions(wins, losses):
    n = wins + losses
    tail = sum(comb(n, k) for k in range(n + 1) if comb(n, k) <= comb(n, wins))
    assert sign_test(pair(wins, 5, losses)) == pytest.approx(float(Fraction(tail, 2**n)))
    z, p = NormalDist().inv_cdf(0.975), wins / n
    middle, half = p + z * z / (2 * n), z * sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    found = share_sooner(pair(wins, 5, losses))
    assert (found.value, found.n) == (pytest.approx(100 * p), n)
    expected = [100 * (middle - half) / (1 + z * z / n), 100 * (middle + half) / (1 + z * z / n)]
    assert [found.low, found.high] == pytest.approx(expected, abs=1e-9)


def test_only_ties_say_nothing():
    assert not share_sooner(pair(0, 4, 0)).defined and np.isnan(sign_test(pair(0, 4, 0)))
    assert share(0, 0) == UNDEFINED


@pytest.mark.parametrize(("ties", "decided"), [(60, True), (0, False)])
def test_where_ties_decide_both_p_values_are_shown(ties, decided):
    """Eight wins, all of them: p is 2 / 2^8 without ties. Sixty ties dilute it beyond 0.05."""
    saved = np.concatenate([np.arange(1.0, 9), np.zeros(ties)])
    assert compare(10 - saved, np.full(len(saved), 10.0)).ties_decide == decided
    frame = rows("small", 1, {"pouct": 10 - saved, "greedy": np.full(len(saved), 10.0)})
    row = next(row for row in pair_table(summarise(checked_episodes(frame)), "pouct").rows if not row.heading)
    wilcoxon = row.entries[-1]
    assert (float(wilcoxon.value) > 0.05) == decided
    assert wilcoxon.details == (("0.008 without ties",) if decided else ())
