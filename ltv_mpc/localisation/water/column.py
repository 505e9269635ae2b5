"""The column of water beside its states: which nodes are states, which have been seen, how the others hang on them.

Grid    G nodes at depths 0, h, 2h, ...; ``first`` and those that follow are states (``grid_window.py`` moves them).
Prior   c_k = mu_k + m + s_k;  m common to all depths, sd ``common_sd``;  s first-order Gauss-Markov over depth,
        cov(s_i, s_j) = sd_i sd_j rho^|i-j|. mu, m, s are NED (north, east), both axes alike and independent.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ltv_mpc.messages import Array


class Link(NamedTuple):
    """What is known of a node that is no state: c_k = c + A (g - g_then) + r, cov(r) = C.

    g are the states that A refers to; of all others r is correlated with the position p alone.
    """

    c: Array  # (2,), m/s
    then: Array  # (q,)
    A: Array  # (2, q)
    C: Array  # (2, 2), m2/s2
    B: Array  # (2, 2), cov(r, p), north and east
    S: Array  # (2, 2), cov(p | g) of that time
    walked: float  # ``WaterColumn.walked`` of that time


@dataclass(frozen=True, slots=True, kw_only=True)
class NodePrior:
    """What is assumed of every node of the grid before anything is measured."""

    mean_mps: Array  # mu, (G, 2)
    sd_mps: Array  # of s, (G,)
    common_sd_mps: float  # of m
    correlation: float  # rho, between neighbours

    @classmethod
    def certain(cls, nodes: int) -> NodePrior:
        """Still water, and no doubt of it."""
        return cls(mean_mps=np.zeros((nodes, 2)), sd_mps=np.zeros(nodes), common_sd_mps=0.0, correlation=1.0)

    def covariance(self, nodes: slice) -> Array:
        """Of c along one axis over ``nodes`` of the grid, (K, K); with m it is ``common_sd_mps`` squared throughout."""
        sd = self.sd_mps[nodes]
        k = np.arange(len(sd))
        covariance: Array = np.outer(sd, sd) * self.correlation ** np.abs(k[:, None] - k[None, :])
        return covariance + self.common_sd_mps**2

    def link(self, node: int, neighbour: int, walked: float) -> Link:
        """Of a node k that has never been a state to its neighbour i and to m: g = [c_i, m], (4,).

        With w what walking in time has added to every node, var_k = sd_k^2 + w and a = rho sd_k sd_i / var_i:
            A = [a, 1 - a],  C = var_k - a^2 var_i
        Without a walk this is exact: given c_i and m nothing else of the state tells of k. With one it is what the pair
        alone would have.
        """
        sd, sd_i = self.sd_mps[node], self.sd_mps[neighbour]
        variance = sd_i**2 + walked
        a = self.correlation * sd * sd_i / variance if variance > 0 else 0.0
        A = np.concatenate([a * np.eye(2), (1.0 - a) * np.eye(2)], axis=1)
        C = (sd**2 + walked - a * a * variance) * np.eye(2)
        then = np.append(self.mean_mps[neighbour], [0.0, 0.0])
        return Link(self.mean_mps[node], then, A, C, B=np.zeros((2, 2)), S=np.zeros((2, 2)), walked=walked)


@dataclass(slots=True, kw_only=True)
class WaterColumn:
    """Of one belief; arrays over the whole grid."""

    prior: NodePrior
    first: int  # node of the first state
    observed: npt.NDArray[np.bool_]  # (G,), the profiler has measured between this node and a neighbour
    dropped: dict[int, Link]  # nodes that were states, to either side of the window
    walked: float  # variance that each node has gained since the prior by walking in time (m2/s2)

    @classmethod
    def certain(cls, nodes: int) -> WaterColumn:
        """Still water, no doubt of it, the window at the surface."""
        seen = np.zeros(nodes, dtype=bool)
        return cls(prior=NodePrior.certain(nodes), first=0, observed=seen, dropped={}, walked=0.0)

    def mark_observed(self, upper: npt.NDArray[np.int64]) -> None:
        """Something has been measured between each of these nodes and the next below."""
        self.observed[upper] = self.observed[upper + 1] = True

    def copy(self) -> WaterColumn:
        """Independent of this one."""
        return replace(self, observed=self.observed.copy(), dropped=self.dropped.copy())
