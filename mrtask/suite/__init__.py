"""A suite of trials that never changes, so that planners' scores can be quoted and compared.

``mrtask score my_lab.Cautious`` runs a planner on it. Importing this package sets numba's cache folder, as the pipeline
does, so that a suite's workers find the kernels compiled.
"""

from mrtask.sources import use_kernel_cache

use_kernel_cache()
