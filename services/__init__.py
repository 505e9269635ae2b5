"""The only place with a network, a wall clock, a thread or a process."""

import os
import sys

# A second BLAS thread changes the last bits of products of 155 rows and more, and a replay compares every bit.
# This must stand before numpy is first imported in the process, hence here.
_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")

ONE_BLAS_THREAD = "numpy" not in sys.modules or all(os.environ.get(name) == "1" for name in _THREADS[:2])
"""Whether this has come in time: somebody else's process, as a cluster's worker, may have numpy already."""

for _name in _THREADS:
    os.environ[_name] = "1"
