"""Moving window of the depth grid in the state: it follows the vehicle, so cost does not grow with the dive.

Move    Downwards, the state of the uppermost grid point k is dropped and one below the lowest is appended; upwards, the
        opposite. The window moves only when the vehicle comes within reach of an end.
Drop    Rows and columns of k leave; the rest of P stays. This marginalisation is exact. The knowledge of k is kept as a
        link to g, all states except position p, velocity and the cloned satellite epoch, which change soon:
            A = P_kg P_gg^-1,  C = P_kk - A P_gk,  B = P_kp - A P_gp,  S = P_pp - P_pg P_gg^-1 P_gp,  g_then = g
Append  c_k = c + A (g - g_then),  P_k. = A P_g.,  P_kp += rho B,  P_kk = A P_gg A^T + C
        If k was never in the state, the link is the prior's and exact (``column.py``). Otherwise the link from the drop
        is used: the prior's link would count measurements of k twice that its neighbours already know. It is
        approximate in four ways:
          - r at the drop is taken as independent of the present velocity;
          - the covariance of r with the position error stays as it was if the position error has grown (nothing
            measures position), else it shrinks by rho, the smallest eigenvalue of S^-1 S_now if that is below 1;
          - the present attitude and drifting biases stand for those at the drop;
          - a random walk since then is noise of both neighbours, w (1 + A A^T) over the water part of A.
        Failure signatures (``adaptive/failure_signatures.py``) follow those of g: E_k = A E_g.
Source  Marginal and conditional of a Gaussian: e.g. Bishop 2006, section 2.3.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
import numpy.typing as npt
from scipy.linalg.lapack import dposv

from ltv_mpc.localisation.filter.state import ATTITUDE, CORE, POSITION, Belief, Layout
from ltv_mpc.messages import Array, DroppedGridPoint

Indices: TypeAlias = npt.NDArray[np.int64]

_HORIZONTAL = np.arange(POSITION.stop)[:2]
_REGULARISATION = 1e-9
"""Added to the unit diagonal of the correlation of g. It limits the accuracy of the remainder r to 3e-5 of its sd."""


def move_window(belief: Belief, above_m: float, below_m: float, cell_m: float) -> None:
    """Move the window until it covers the vehicle's surroundings, within the grid.

    The covariance must be propagated to the time of the belief.

    Parameters
    ----------
    belief : state estimate; its water states and its column change.
    above_m, below_m : depths above and below the vehicle that the window must cover (m).
    cell_m : step of the depth grid (m).
    """
    layout, column = belief.layout, belief.column
    cells = layout.north.stop - layout.north.start
    if cells == layout.nodes:
        return
    depth = float(belief.x[2])
    lowest = min(math.floor((depth + below_m) / cell_m) + 1, layout.nodes - 1)
    highest = max(math.floor((depth - above_m) / cell_m), 0)
    while column.first + cells - 1 < lowest:
        _shift(belief, down=True)
    while column.first > highest:
        _shift(belief, down=False)


def link_covariance(link: DroppedGridPoint, water: npt.NDArray[np.bool_], walked: float) -> Array:
    """Return C of a link after further random walk, (2, 2) m2/s2.

    Parameters
    ----------
    link : conditional distribution of a grid point.
    water : (q,) mask of the states of g that are currents.
    walked : present variance of the random walk (m2/s2).
    """
    A = link.regression[:, water]
    C: Array = link.covariance + (walked - link.walk_variance_m2ps2) * (np.eye(2) + A @ A.T)
    return C


def conditioning_states(layout: Layout, slot: int) -> Indices:
    """Return the indices of g, the states a link refers to.

    Parameters
    ----------
    layout : order of the states.
    slot : position of the dropped grid point in the window.
    """
    states = np.arange(layout.size)
    water = states >= layout.north.start
    own = (states == layout.north.start + slot) | (states == layout.east.start + slot)
    lasting = (states >= ATTITUDE.start) & ((states < CORE) | (states >= layout.epoch.stop))
    g: Indices = states[np.where(water, ~own, lasting)]
    return g


def _shift(belief: Belief, *, down: bool) -> None:
    """Move the window by one grid point."""
    layout, column, P = belief.layout, belief.column, belief.P
    cells = layout.north.stop - layout.north.start
    step, top, bottom = (
        (1, 0, cells - 1) if down else (-1, cells - 1, 0)
    )  # slots of the dropped and the appended grid point
    column.dropped[column.first + top] = _link(belief, top)

    order = np.arange(layout.size)
    for axis in (layout.north, layout.east):
        order[axis] = np.clip(np.arange(axis.start, axis.stop) + step, axis.start, axis.stop - 1)
    belief.x[:] = belief.x[order]
    P[:] = P[np.ix_(order, order)]
    E = belief.signatures.error
    E[:] = E[order]
    column.first += step

    node = column.first + bottom
    link = column.dropped.pop(node, None)
    rho_B = np.zeros((2, 2))
    if link is None:
        link = column.prior.link(node, node - step, column.walked)
        g = np.array([*_indices(layout, bottom - step), layout.mean.start, layout.mean.start + 1])
        C = link.covariance
    else:
        g = conditioning_states(layout, bottom)
        C = link_covariance(link, g >= layout.north.start, column.walked)
        remaining = _remaining_share(link.position_covariance, _regression(P, _HORIZONTAL, g)[1])
        rho_B = remaining * link.position_cross_covariance
    A, k = link.regression, _indices(layout, bottom)
    belief.x[k] = link.velocity_mps + A @ (belief.x[g] - link.conditioning_states)
    E[k] = A @ E[g]
    P[k, :] = A @ P[g, :]
    own = P[np.ix_(k, g)] @ A.T + C
    P[np.ix_(k, _HORIZONTAL)] += rho_B
    P[:, k] = P[k, :].T
    P[np.ix_(k, k)] = 0.5 * (own + own.T)


def _link(belief: Belief, slot: int) -> DroppedGridPoint:
    """Return the link of the grid point at ``slot`` of the window from the present covariance."""
    k, g = _indices(belief.layout, slot), conditioning_states(belief.layout, slot)
    A, C = _regression(belief.P, np.concatenate([k, _HORIZONTAL]), g)
    north, east = belief.x[k].tolist()
    return DroppedGridPoint(
        grid_point=belief.column.first + slot,
        velocity_mps=(north, east),
        conditioning_states=belief.x[g],
        regression=A[:2],
        covariance=C[:2, :2],
        position_cross_covariance=C[:2, 2:],
        position_covariance=C[2:, 2:],
        walk_variance_m2ps2=belief.column.walked,
    )


def _regression(P: Array, y: Indices, g: Indices) -> tuple[Array, Array]:
    """Return the regression A (y, g) of states ``y`` on states ``g``, and the covariance (y, y) of the remainder."""
    P_yg, P_gg = P[np.ix_(y, g)], P[np.ix_(g, g)]
    # correlations, because variances differ by up to 1e10; states of variance 0 have none
    sd = np.sqrt(np.diagonal(P_gg))
    scale = np.where(sd > 0, 1.0 / np.where(sd > 0, sd, 1.0), 0.0)
    correlation = P_gg * np.outer(scale, scale)
    correlation[np.diag_indices(len(g))] = 1.0 + _REGULARISATION
    _, solution, info = dposv(correlation, (P_yg * scale).T, lower=1)
    A = solution.T * scale if info == 0 else np.zeros_like(P_yg)  # P is not a covariance: forget the link
    C = P[np.ix_(y, y)] - A @ P_yg.T
    C = C - P_yg @ A.T + A @ P_gg @ A.T  # exact for this A, which the regularisation makes slightly suboptimal
    return A, 0.5 * (C + C.T)


def _remaining_share(S: Array, S_now: Array) -> float:
    """Return rho: the share that remains of the position error with which a grid point was dropped."""
    if np.linalg.det(S) <= 0:
        return 0.0
    return float(np.clip(np.linalg.eigvals(np.linalg.solve(S, S_now)).real.min(), 0.0, 1.0))


def _indices(layout: Layout, slot: int) -> Indices:
    """Return the indices of north and east of the grid point at ``slot``, (2,)."""
    return np.array([layout.north.start + slot, layout.east.start + slot])
