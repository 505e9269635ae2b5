"""What the filter's water cells hold of the true water: its best fit by lines between the nodes.

c(z) bends where it likes, the filter's profile at the nodes of its grid alone. Its truth is
    c* = argmin of the integral of |sum_k c_k hat_k(z) - c(z)|^2 over the grid,    hat_k: 1 at node k, 0 at all others
    M c* = f,  M_kl = integral of hat_k hat_l,  f_k = integral of hat_k c
which of water that bends at the nodes alone is its value there, and of a jump within a cell is not. Beams meet every
depth of a cell while the vehicle passes; so c* is what many pings tend to, and not c at the nodes. What is left,
c - c*, is finer than a cell, and no state.
Exact   between all bends and nodes every integrand is of the second degree: Simpson's rule.
Source  L2 projection on linear splines: e.g. de Boor 2001, A practical guide to splines, chapter III.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array, diags_array
from scipy.sparse.linalg import splu

from ltv_mpc.messages import Array


class GridProjection:
    """Of one grid in one column of water."""

    def __init__(self, node_m: Array, bend_m: Array) -> None:
        """Nodes (G,) and the depths between which the water is linear, both increasing."""
        ends = np.union1d(node_m, bend_m[(bend_m > node_m[0]) & (bend_m < node_m[-1])])
        h = np.diff(ends)
        self.depth_m = np.concatenate([ends[:-1], ends[:-1] + 0.5 * h, ends[1:]])  # where the water is looked at, (D,)
        self._share = np.concatenate([h, 4.0 * h, h]) / (6.0 * (ends[-1] - ends[0]))
        k = np.clip(np.searchsorted(node_m, self.depth_m, side="right") - 1, 0, len(node_m) - 2)
        t = (self.depth_m - node_m[k]) / (node_m[k + 1] - node_m[k])
        rows = np.arange(len(k))
        hats = np.concatenate([1.0 - t, t]), (np.concatenate([rows, rows]), np.concatenate([k, k + 1]))
        self._hats = csr_array(hats, shape=(len(k), len(node_m)))
        self._weighted = self._hats.T @ diags_array(self._share)
        self._solve = splu((self._weighted @ self._hats).tocsc()).solve

    def fit(self, water_mps: Array) -> Array:
        """c*, (G, 2), of the water at ``depth_m``, (D, 2)."""
        fitted: Array = self._solve(self._weighted @ water_mps)
        return fitted

    def subgrid_mps(self, water_mps: Array) -> float:
        """What c* does not hold of the water at ``depth_m``: rms over depth of the vector c - c*."""
        rest = water_mps - self._hats @ self.fit(water_mps)
        return float(np.sqrt(self._share @ np.sum(rest**2, axis=1)))
