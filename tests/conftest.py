"""What holds for every test: one BLAS thread, as in every process, and no deadlines on shared machines."""

from __future__ import annotations

from hypothesis import settings

import services  # noqa: F401  (sets the number of BLAS threads before numpy is imported)

# A first example pays for compilation, and these machines are shared.
settings.register_profile("ltv-mpc", deadline=None, derandomize=True)
settings.load_profile("ltv-mpc")
