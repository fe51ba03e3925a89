"""The reliability diagram: how often an object was where the model said, by the probability that the model gave."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from mrtask.analysis.page.charts import panels, ticks_as
from mrtask.analysis.page.style import BLUE, GREY, house_style

PANEL_IN = (4.2, 3.6)


@house_style()
def draw_reliability(bins: Sequence[Mapping[str, Any]]) -> Figure | None:
    """Draw the bins of `mrtask.analysis.studies.calibration.reliability_in_homes`; None without any."""
    if not bins:
        return None
    frame = pd.DataFrame(bins).astype({"low": float, "high": float})
    beliefs, (width_in, height_in) = list(frame["belief"].unique()), PANEL_IN
    figure, (line,) = panels(width_in * len(beliefs), height_in, columns=len(beliefs), sharey=True)
    for axes, belief in zip(line, beliefs, strict=True):
        shown = frame[frame["belief"] == belief]
        bars = np.clip([shown["frequency"] - shown["low"], shown["high"] - shown["frequency"]], 0, None)
        axes.axline((0, 0), slope=1, color=GREY, linewidth=0.8, zorder=0)
        axes.errorbar(shown["mean_prob"], shown["frequency"], yerr=np.nan_to_num(bars), fmt="o-", color=BLUE, capsize=2)
        axes.set(title=belief, xlabel="probability", xlim=(0, 1), ylim=(0, 1))
        ticks_as(axes.xaxis, "{:g}".format)
    ticks_as(line[0].yaxis, "{:g}".format)
    line[0].set_ylabel("was there")
    return figure
