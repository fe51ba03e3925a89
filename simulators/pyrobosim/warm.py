"""Imported by the server from which live processes are forked: it prepares what all of them need."""

import pandas as pd

from mrtask.likelihood.catalogue_model import catalogue_model
from mrtask.likelihood.rows import TRIPLE
from mrtask.planning.warm_up import compile_kernels, kernels_missing
from pipeline.live import process as process

catalogue_model().predict(pd.DataFrame([("mug", "table", "kitchen")], columns=TRIPLE))
if not kernels_missing():  # else each process compiles what it needs
    compile_kernels({"pouct": ("pouct", {})})
