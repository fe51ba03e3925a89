"""The experiment's Hydra stages, and below them the rooms that they share; only ``backends`` knows Ray and MLflow.

Importing this package sets numba's cache folder to one named after the hash of the packages that hold kernels, since
numba does not notice when a function that a cached kernel calls was edited in another file.
"""

import sys

from mrtask.sources import use_kernel_cache
from pipeline.base import interrupt

use_kernel_cache()

# So it is while Python looks for the module that `python -m pipeline.<stage>` names.
if sys.argv[0] == "-m":
    interrupt.ends_imports()
