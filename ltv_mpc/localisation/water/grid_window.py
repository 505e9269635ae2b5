"""The window of depths whose water is in the state: it goes with the vehicle, so that cost does not grow with the dive.

Down    The state of the uppermost node k is dropped, that of a node below the lowest is appended; up likewise. Between
        the two nothing moves until the vehicle comes within reach of an end.
Drop    Rows and columns go, the rest of P stays as it is: the marginal, exact. What is known of k is kept as its link
        to g, all states but position p, velocity and the satellite epoch's clone, which will soon be others:
            A = P_kg P_gg^-1,  C = P_kk - A P_gk,  B = P_kp - A P_gp,  S = P_pp - P_pg P_gg^-1 P_gp,  g_then = g
Append  c_k = c + A (g - g_then),  P_k. = A P_g.,  P_kp += rho B,  P_kk = A P_gg A^T + C
        Never a state before: the link is the prior's, and exact (``column.py``). Otherwise what was measured of k is
        remembered, and so is what of it the others know already: the prior's link would let the one measurement of
        a neighbour serve twice. Approximate in four ways: r of then is taken as independent of the velocity of now;
        its covariance with the error in position, which only grows while nothing measures position, stays as it was,
        else shrinks by rho, the smallest eigenvalue of S^-1 S_now, if that is below 1; attitude and drifting biases of
        now stand for those of then; a walk since is noise of both neighbours, w (1 + A A^T) over the water's part of A.
        What hypotheses would do to it (``failure_signatures.py``) is what they do to g: E_k = A E_g.
Source  Marginal and conditional of a Gaussian: e.g. Bishop 2006, section 2.3.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
import numpy.typing as npt
from scipy.linalg.lapack import dposv

from ltv_mpc.localisation.filter.state import ATTITUDE, CORE, POSITION, Belief, Layout
from ltv_mpc.localisation.water.column import Link
from ltv_mpc.messages import Array

Places: TypeAlias = npt.NDArray[np.int64]

_HORIZONTAL = np.arange(POSITION.stop)[:2]
_SMALLEST = 1e-9
"""Added to the correlations of g, whose diagonal is 1: what g leaves open is not reckoned closer than to 3e-5 of sd."""


def move_window(belief: Belief, above_m: float, below_m: float, cell_m: float) -> None:
    """Move the window until it holds ``above_m`` over the vehicle to ``below_m`` under it, as far as the grid does.

    The covariance must stand at the belief's time.
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


def link_covariance(link: Link, water: npt.NDArray[np.bool_], walked: float) -> Array:
    """Its C, (2, 2), after the water has walked on to ``walked``; ``water`` (q,) says which of g walk."""
    A = link.A[:, water]
    C: Array = link.C + (walked - link.walked) * (np.eye(2) + A @ A.T)
    return C


def conditioning_states(layout: Layout, slot: int) -> Places:
    """Places of g for the node at ``slot`` of the window."""
    places = np.arange(layout.size)
    water = places >= layout.north.start
    own = (places == layout.north.start + slot) | (places == layout.east.start + slot)
    lasting = (places >= ATTITUDE.start) & ((places < CORE) | (places >= layout.epoch.stop))
    g: Places = places[np.where(water, ~own, lasting)]
    return g


def _shift(belief: Belief, *, down: bool) -> None:
    """By one node."""
    layout, column, P = belief.layout, belief.column, belief.P
    cells = layout.north.stop - layout.north.start
    step, top, bottom = (1, 0, cells - 1) if down else (-1, cells - 1, 0)  # slots where one goes and one comes
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
        g = np.array([*_places(layout, bottom - step), layout.mean.start, layout.mean.start + 1])
        C = link.C
    else:
        g = conditioning_states(layout, bottom)
        C = link_covariance(link, g >= layout.north.start, column.walked)
        rho_B = _kept(link.S, _regression(P, _HORIZONTAL, g)[1]) * link.B
    k = _places(layout, bottom)
    belief.x[k] = link.c + link.A @ (belief.x[g] - link.then)
    E[k] = link.A @ E[g]
    P[k, :] = link.A @ P[g, :]
    own = P[np.ix_(k, g)] @ link.A.T + C
    P[np.ix_(k, _HORIZONTAL)] += rho_B
    P[:, k] = P[k, :].T
    P[np.ix_(k, k)] = 0.5 * (own + own.T)


def _link(belief: Belief, slot: int) -> Link:
    """Of the node at ``slot`` of the window, as it is known now."""
    k, g = _places(belief.layout, slot), conditioning_states(belief.layout, slot)
    A, C = _regression(belief.P, np.concatenate([k, _HORIZONTAL]), g)
    return Link(
        c=belief.x[k],
        then=belief.x[g],
        A=A[:2],
        C=C[:2, :2],
        B=C[:2, 2:],
        S=C[2:, 2:],
        walked=belief.column.walked,
    )


def _regression(P: Array, y: Places, g: Places) -> tuple[Array, Array]:
    """A, (y, g), of the states ``y`` on the states ``g``, and the covariance (y, y) of what A leaves of them."""
    P_yg, P_gg = P[np.ix_(y, g)], P[np.ix_(g, g)]
    # by correlations, for variances lie up to 1e10 apart; what is certain has none
    sd = np.sqrt(np.diagonal(P_gg))
    scale = np.where(sd > 0, 1.0 / np.where(sd > 0, sd, 1.0), 0.0)
    correlation = P_gg * np.outer(scale, scale)
    correlation[np.diag_indices(len(g))] = 1.0 + _SMALLEST
    _, solution, info = dposv(correlation, (P_yg * scale).T, lower=1)
    A = solution.T * scale if info == 0 else np.zeros_like(P_yg)  # a P that is no covariance: nothing is remembered
    C = P[np.ix_(y, y)] - A @ P_yg.T
    C = C - P_yg @ A.T + A @ P_gg @ A.T  # for this A, which is not quite the best one
    return A, 0.5 * (C + C.T)


def _kept(S: Array, S_now: Array) -> float:
    """rho: what is left of the error in position that a node was dropped with."""
    if np.linalg.det(S) <= 0:
        return 0.0
    return float(np.clip(np.linalg.eigvals(np.linalg.solve(S, S_now)).real.min(), 0.0, 1.0))


def _places(layout: Layout, slot: int) -> Places:
    """Of its north and east in the state."""
    return np.array([layout.north.start + slot, layout.east.start + slot])
