"""Survey of the water by a dive, as a prior for later dives: the current at every depth that the ADCP has observed.

Grid points in the window are as in the belief. A dropped one follows from its link (``grid_window.py``),
    c_k = c + A (g - g_then),  cov(c_k, y) = A cov(g, y),  var(c_k) = A cov(g) A^T + C,
so that later knowledge of its neighbours counts for it too. They are evaluated outwards from the window.
Common  All currents are measured relative to the vehicle's velocity and share its error. Their covariance is split into
            var(c_k) = sd_common^2 + own_k^2,  sd_common^2 = mean of cov(c_i, c_j) over all i != j of one axis,
        for both axes together, limited to [0, smallest variance]. The variance of each depth stays exact; the variance
        of the mean over depth stays the same up to 1 / K of the own parts.
Cost    The joint covariance of all K grid points, (2 K + states)^2; once, at the end of a dive.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ltv_mpc.currents import WaterPrior
from ltv_mpc.localisation.filter.state import Belief
from ltv_mpc.localisation.water.grid_window import conditioning_states, link_covariance
from ltv_mpc.messages import Array


def prior_from(belief: Belief, depth_m: Array) -> WaterPrior | None:
    """Return the observed water as a prior for a later dive; None if nothing was observed.

    The profile reaches from the uppermost to the lowest observed grid point; unobserved ones between them have a larger
    standard deviation. The covariance must be propagated to the time of the belief.

    Parameters
    ----------
    belief : state estimate at the end of the dive.
    depth_m : (G,) depths of the grid (m).
    """
    seen = np.flatnonzero(belief.column.observed)
    if len(seen) == 0:
        return None
    nodes, c, P = _joint(belief)
    k = np.flatnonzero((nodes >= seen[0]) & (nodes <= seen[-1]))
    k = k[np.argsort(nodes[k])]
    measured = k[belief.column.observed[nodes[k]]]
    variance = np.array([np.diagonal(P[axis])[k] for axis in range(2)])
    shared = np.mean([_off_diagonal(P[axis][np.ix_(measured, measured)]) for axis in range(2)])
    common = min(max(float(shared), 0.0), float(variance.min()))
    return WaterPrior(
        depth_m=depth_m[nodes[k]].copy(),
        north_mps=c[k, 0].copy(),
        east_mps=c[k, 1].copy(),
        sd_mps=np.sqrt(variance.max(axis=0)),
        sd_common_mps=float(np.sqrt(common)),
    )


def _joint(belief: Belief) -> tuple[npt.NDArray[np.int64], Array, tuple[Array, Array]]:
    """Return the known grid points (K,), unordered, their c (K, 2), and the covariances of north and east (K, K)."""
    layout, column = belief.layout, belief.column
    cells = layout.north.stop - layout.north.start
    first = column.first
    # The link of each refers to the window and to the grid points between.
    above = [node for node in range(first - 1, -1, -1) if node in column.dropped]
    below = [node for node in range(first + cells, layout.nodes) if node in column.dropped]
    nodes = np.array([*range(first, first + cells), *above, *below])

    others = conditioning_states(layout, 0)
    others = others[others < layout.north.start]
    place = np.empty(layout.nodes, dtype=np.int64)  # index of north of each grid point; east is the next
    place[nodes] = len(others) + 2 * np.arange(len(nodes))
    size = len(others) + 2 * len(nodes)
    x, P = np.zeros(size), np.zeros((size, size))
    slots = np.arange(cells)
    states = np.concatenate([others, np.stack([layout.north.start + slots, layout.east.start + slots], axis=1).ravel()])
    known = slice(0, len(states))
    x[known], P[known, known] = belief.x[states], belief.P[np.ix_(states, states)]
    for node in (*above, *below):
        link = column.dropped[node]
        slot = 0 if node < first else cells - 1
        near = node - slot + slots[slots != slot]
        g = np.concatenate([np.arange(len(others)), place[near], place[near] + 1])  # in the order of ``given``
        C = link_covariance(link, g >= len(others), column.walked)
        k = slice(place[node], place[node] + 2)
        x[k] = link.c + link.A @ (x[g] - link.then)
        P[k, :] = link.A @ P[g, :]
        own = P[k, g] @ link.A.T + C
        P[:, k] = P[k, :].T
        P[k, k] = 0.5 * (own + own.T)
    north = place[nodes]
    axes = (P[np.ix_(north, north)], P[np.ix_(north + 1, north + 1)])
    return nodes, np.stack([x[north], x[north + 1]], axis=1), axes


def _off_diagonal(P: Array) -> float:
    """Return the mean of P_ij over i != j; 0 for a single grid point."""
    n = len(P)
    return float((P.sum() - np.trace(P)) / (n * (n - 1))) if n > 1 else 0.0
