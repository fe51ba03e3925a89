"""The experiment's Hydra stages, and below them the rooms that they share; only ``backends`` knows Ray and MLflow.

Importing this package sets numba's cache folder to one named after the hash of the packages that hold kernels, since
numba does not notice when a function that a cached kernel calls was edited in another file.
"""

import os
import sys

from mrtask.files import default_cache_dir
from pipeline.base import interrupt
from pipeline.store.version import source_hash

KERNEL_SOURCES = ("mrtask/maps", "mrtask/planning", "mrtask/analysis/bounds")
os.environ.setdefault("NUMBA_CACHE_DIR", str(default_cache_dir() / "numba" / source_hash(*KERNEL_SOURCES)))

# So it is while Python looks for the module that `python -m pipeline.<stage>` names.
if sys.argv[0] == "-m":
    interrupt.ends_imports()
