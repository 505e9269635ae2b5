"""The only place with a network, a wall clock, a thread or a process."""

import os

# A second BLAS thread changes the last bits of products of 155 rows and more, and a replay compares every bit.
# This must stand before numpy is first imported in the process, hence here.
for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[_name] = "1"
