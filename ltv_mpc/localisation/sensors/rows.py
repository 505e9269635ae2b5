"""Scalar measurements, linearised about a belief: the one form in which every sensor reaches the filter.

Row     residual_i = z_i - h_i(belief) = sum_j partial_ij error[state_ij] + n_i,  n_i ~ N(0, variance_i), independent
        Each row touches few of the states: it names them. A padded entry has partial 0 (and any state).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ltv_mpc.messages import Array


class Rows(NamedTuple):
    """m scalar measurements of one instant, each of at most w states."""

    state: npt.NDArray[np.int64]  # (m, w)
    partial: Array  # (m, w)
    residual: Array  # (m,)
    variance: Array  # (m,)

    def dense(self, size: int) -> Array:
        """H, (m, n)."""
        H = np.zeros((len(self.residual), size))
        for i, (state, partial) in enumerate(zip(self.state, self.partial, strict=True)):
            np.add.at(H[i], state, partial)
        return H
