"""Water column: prior of the current at all grid points, and the distribution of those that are not in the state.

Grid    G grid points ("nodes" in the code) at depths 0, h, 2h, ...; a window of them, from ``first`` on, is in the
        state (``grid_window.py`` moves it).
Prior   c_k = mu_k + m + s_k (m/s);  m is common to all depths, sd ``common_sd_mps``;  s is first-order
        Gauss-Markov over depth, cov(s_i, s_j) = sd_i sd_j rho^|i-j|. North and east have equal priors and
        are independent.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from ltv_mpc.messages import Array, DroppedGridPoint


@dataclass(frozen=True, slots=True, kw_only=True)
class NodePrior:
    """Prior distribution of the current at all grid points."""

    mean_mps: Array  # mu, (G, 2)
    sd_mps: Array  # standard deviation of s, (G,)
    common_sd_mps: float  # standard deviation of m
    correlation: float  # rho, between neighbours

    @classmethod
    def certain(cls, nodes: int) -> NodePrior:
        """Return a prior of still water with zero variance at ``nodes`` grid points.

        Parameters
        ----------
        nodes : number of grid points G.
        """
        return cls(mean_mps=np.zeros((nodes, 2)), sd_mps=np.zeros(nodes), common_sd_mps=0.0, correlation=1.0)

    def covariance(self, nodes: slice) -> Array:
        """Return the covariance of c along one axis over a slice of the grid, (K, K) m2/s2. It includes m.

        Parameters
        ----------
        nodes : slice of K grid points.
        """
        sd = self.sd_mps[nodes]
        k = np.arange(len(sd))
        covariance: Array = np.outer(sd, sd) * self.correlation ** np.abs(k[:, None] - k[None, :])
        return covariance + self.common_sd_mps**2

    def link(self, node: int, neighbour: int, walked: float) -> DroppedGridPoint:
        """Return the link of a grid point k that was never in the state to its neighbour i and to m, g = [c_i, m].

        With w the variance of the random walk in time, var_k = sd_k^2 + w and a = rho sd_k sd_i / var_i:
            A = [a, 1 - a],  C = var_k - a^2 var_i
        Without a random walk this is exact: given c_i and m, k is independent of all other states. With one it is the
        conditional distribution of the pair alone.

        Parameters
        ----------
        node : index k in the grid.
        neighbour : index i in the grid, k - 1 or k + 1.
        walked : variance w (m2/s2).

        Returns
        -------
        Link with g (4,): north and east of c_i, then of m.
        """
        sd, sd_i = self.sd_mps[node], self.sd_mps[neighbour]
        variance = sd_i**2 + walked
        a = self.correlation * sd * sd_i / variance if variance > 0 else 0.0
        A = np.concatenate([a * np.eye(2), (1.0 - a) * np.eye(2)], axis=1)
        C = (sd**2 + walked - a * a * variance) * np.eye(2)
        north, east = self.mean_mps[node].tolist()
        return DroppedGridPoint(
            grid_point=node,
            velocity_mps=(north, east),
            conditioning_states=np.append(self.mean_mps[neighbour], [0.0, 0.0]),
            regression=A,
            covariance=C,
            position_cross_covariance=np.zeros((2, 2)),
            position_covariance=np.zeros((2, 2)),
            walk_variance_m2ps2=walked,
        )


@dataclass(slots=True, kw_only=True)
class WaterColumn:
    """Water column of one belief. Arrays cover the whole grid."""

    prior: NodePrior
    first: int  # grid index of the first point in the state
    observed: npt.NDArray[np.bool_]  # (G,), the ADCP has measured between this grid point and a neighbour
    dropped: dict[int, DroppedGridPoint]  # grid points that left the state, above and below the window
    walked: float  # variance of each grid point from the random walk in time, since the prior (m2/s2)

    @classmethod
    def certain(cls, nodes: int) -> WaterColumn:
        """Return still water with zero variance at ``nodes`` grid points, the window at the surface.

        Parameters
        ----------
        nodes : number of grid points G.
        """
        seen = np.zeros(nodes, dtype=bool)
        return cls(prior=NodePrior.certain(nodes), first=0, observed=seen, dropped={}, walked=0.0)

    def mark_observed(self, shallower: npt.NDArray[np.int64]) -> None:
        """Mark these grid points (m,) and the next below each as observed.

        Parameters
        ----------
        shallower : (m,) indices of grid points.
        """
        self.observed[shallower] = self.observed[shallower + 1] = True

    def copy(self) -> WaterColumn:
        """Return an independent copy."""
        return replace(self, observed=self.observed.copy(), dropped=self.dropped.copy())
