"""Projection of the true current onto the depth grid of the filter: its best fit by lines between grid points.

The true current c(z) has any shape; the filter's profile is linear between grid points. The filter's true state is
    c* = argmin of the integral of |sum_k c_k hat_k(z) - c(z)|^2 over the grid,    hat_k: 1 at grid point k, 0 at others
    M c* = f,  M_kl = integral of hat_k hat_l,  f_k = integral of hat_k c
c* equals c at the grid points only if c is linear between them. Beams measure all depths of a cell while the vehicle
passes, so the mean of many pings tends to c*, not to c at the grid points. The rest c - c* is finer than a cell and not
a state.
Exact   Between the bends of c and the grid points every integrand is quadratic: Simpson's rule is exact.
Source  L2 projection on linear splines: e.g. de Boor 2001, A practical guide to splines, chapter III.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array, diags_array
from scipy.sparse.linalg import splu

from ltv_mpc.messages import Array


class GridProjection:
    """Projection of the current in one water column onto one depth grid.

    Parameters
    ----------
    node_m : (G,) depths of the grid points, increasing (m).
    bend_m : depths between which the current is linear, increasing (m).
    """

    def __init__(self, node_m: Array, bend_m: Array) -> None:
        ends = np.union1d(node_m, bend_m[(bend_m > node_m[0]) & (bend_m < node_m[-1])])
        h = np.diff(ends)
        self.depth_m = np.concatenate([ends[:-1], ends[:-1] + 0.5 * h, ends[1:]])  # sampling depths, (D,)
        share = np.concatenate([h, 4.0 * h, h]) / (6.0 * (ends[-1] - ends[0]))
        k = np.clip(np.searchsorted(node_m, self.depth_m, side="right") - 1, 0, len(node_m) - 2)
        t = (self.depth_m - node_m[k]) / (node_m[k + 1] - node_m[k])
        rows = np.arange(len(k))
        hats = np.concatenate([1.0 - t, t]), (np.concatenate([rows, rows]), np.concatenate([k, k + 1]))
        hats_at = csr_array(hats, shape=(len(k), len(node_m)))
        self._weighted = hats_at.T @ diags_array(share)
        self._solve = splu((self._weighted @ hats_at).tocsc()).solve

    def fit(self, water_mps: Array) -> Array:
        """Return c*, (G, 2), for the current at ``depth_m``, (D, 2) (m/s)."""
        fitted: Array = self._solve(self._weighted @ water_mps)
        return fitted
