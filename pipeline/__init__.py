"""The experiment's Hydra stages; Ray is known to ``pipeline.pool`` and MLflow to ``pipeline.tracking`` only.

Importing it points numba's cache to the user's, by the sources' hash: numba itself does not notice when a function
that a cached kernel calls was edited in another file.
"""

import os
import sys

from pipeline import interrupt
from pipeline.cache import default_cache_dir
from pipeline.version import source_hash

os.environ.setdefault("NUMBA_CACHE_DIR", str(default_cache_dir() / "numba" / source_hash("mrtask")))

# So it is while Python looks for the module that `python -m pipeline.<stage>` names.
if sys.argv[0] == "-m":
    interrupt.ends_imports()
