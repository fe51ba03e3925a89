"""The experiment's Hydra stages, and below them the rooms that they share; only ``backends`` knows Ray and MLflow."""

import sys

from pipeline.base import interrupt

# So it is while Python looks for the module that `python -m pipeline.<stage>` names.
if sys.argv[0] == "-m":
    interrupt.ends_imports()
