"""Imported by the server that live processes are forked from: what all of them need is made before they begin."""

import pandas as pd

from mrtask.likelihood.catalogue_model import catalogue_model
from mrtask.likelihood.rows import TRIPLE
from mrtask.planning.warm_up import compile_kernels, kernels_missing
from pipeline.live import process as process

catalogue_model().predict(pd.DataFrame([("mug", "table", "kitchen")], columns=TRIPLE))
if not kernels_missing():  # else who needs them compiles them
    compile_kernels({"pouct": ("pouct", {})})
