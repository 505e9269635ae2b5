"""Measurement update of the filter: innovation gate, robust de-weighting, and the invariant correction of the heading.

With rows z = H e + n, n ~ N(0, R), R diagonal, S = H P H^T + R; a row passes the gate if z_i^2 / S_ii <= gate.
Of the rows in use, S = L L^T (Cholesky) and the whitened rows are W = L^-1 H P, y = L^-1 z:
    e = W^T y,   P := P - W^T W
De-weighted rows are those with gate < z_i^2 / S_ii <= deweight_limit, for sensors that measure seldom. Most of their S
is the error of the state, and so is most of a residual that is too large. Their noise is inflated until they just pass,
S_ii := z_i^2 / gate. This bounds their influence: a de-weighted row, correct or not, moves no state further than a row
at the gate does (Huber 1981, Robust statistics; Yang, He & Xu 2001, J. Geodesy 75, adaptively robust filtering).

Heading     ADCP and IMU do not observe it. If velocity v, current c and attitude turn together about the vertical,
            every beam reads the same. If errors are plain differences, the unobservable direction
                N(x) = [phi_d = 1, dv = z x v, dc_k = z x c_k],  z x [n, e] = [-e, n],
            depends on the estimate. After each correction of v or c, earlier beams then seem to contradict later ones
            by phi_d times the correction, and the filter gains false information about heading. (Without this step
            2.0 deg of compass bias became 1.8 deg within 60 s.) With the invariant error xi,
            v_true = v + xi + phi_d z x v, likewise for c, N is constant. The filter stores plain differences. When the
            estimate moves by e, its covariance is transformed through xi:
                P := M P M^T,  M = I + a e_phi_d^T,  a = z x e on the rows of v, of every c_k and of their mean m
Symmetry    P stays bitwise symmetric: W^T W and a b^T + b a^T have equal mirror elements.
Shapes      P (n, n) symmetric; E (n, K) mean errors of K fault hypotheses, with score (K,) and information (K, K)
            (``adaptive/failure_signatures.py``); W (m', n), Y (m', K), y (m',) for m' rows used.
Source      Barrau & Bonnabel 2017, IEEE T-AC 62(4) (invariant errors); Huang, Mourikis & Roumeliotis 2010, IJRR 29(5)
            (a filter stays consistent if its unobservable direction does not depend on the estimate).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.linalg.blas import dsyrk, dtrsm
from scipy.linalg.lapack import dpotrf

from ltv_mpc.jit import jit
from ltv_mpc.localisation.filter.state import ATTITUDE, VELOCITY, Belief, Layout
from ltv_mpc.localisation.sensors.sensor import Rows
from ltv_mpc.messages import Array

HEADING = ATTITUDE.stop - 1
"""Index of the heading error phi_d."""


class Correction(NamedTuple):
    """Result of a measurement update, row by row."""

    accepted: npt.NDArray[np.bool_]  # (m,) rows that passed the gate
    S: Array  # (m, m), of all rows
    definite: bool  # S was positive definite; if not, nothing has changed, and P must not be trusted
    error: Array  # (n,), estimated error, to be added to the estimate; zero if no row passed
    deweighted: int  # number of rows that were used with inflated noise; they do not count as accepted


def heading_coupling(error: Array, layout: Layout) -> Array:
    """Return the coupling vector a of the head of this file, (n,), with a[HEADING] = 0.

    Parameters
    ----------
    error : (n,) error e by which the estimate has just moved.
    layout : order of the states.
    """
    a = np.zeros(len(error))
    v, m = VELOCITY.start, layout.mean.start
    for north, east in ((v, v + 1), (m, m + 1), (layout.north, layout.east)):
        a[north], a[east] = -error[east], error[north]
    return a


def reduce_covariance(P: Array, W: Array, a: Array) -> None:
    """Update P := M (P - W^T W) M^T in place, with M = I + a e_phi_d^T.

    With b = P_.phi_d + a P_phi_d,phi_d / 2:  M P M^T = P + a b^T + b a^T.

    Parameters
    ----------
    P : (n, n) covariance; changes.
    W : (m', n) whitened rows.
    a : (n,) coupling vector of ``heading_coupling``.
    """
    column = P[HEADING] - W[:, HEADING] @ W
    dsyrk(-1.0, W.T, beta=1.0, c=P.T, lower=1, overwrite_c=1)  # BLAS is column-major: this is the upper triangle of P
    _couple(P, a, column + 0.5 * column[HEADING] * a)


@jit
def _couple(P: Array, a: Array, b: Array) -> None:
    """Update the upper triangle of P by a b^T + b a^T, and copy it to the lower one."""
    for i in range(len(a)):
        for j in range(i, len(a)):
            P[i, j] += a[i] * b[j] + b[i] * a[j]
            P[j, i] = P[i, j]


def correct(belief: Belief, rows: Rows, gate: float, deweight_limit: float = 0.0) -> Correction:
    """Update a belief in place by the rows in use: estimate, covariance and fault hypotheses.

    A row is in use if it is within the gate, or if it is de-weighted.

    Parameters
    ----------
    belief : state estimate; changes.
    rows : m scalar measurements at the time of the belief.
    gate : quantile of the chi-square distribution with one degree of freedom.
    deweight_limit : rows with gate < z_i^2 / S_ii <= deweight_limit are de-weighted.

    Returns
    -------
    Result by row.
    """
    P, E, z = belief.P, belief.signatures.error, rows.residual
    n, m = len(P), len(z)
    HP = rows.times(P)
    S = rows.times(np.ascontiguousarray(HP.T))
    S = 0.5 * (S + S.T)
    S.flat[:: m + 1] += rows.variance
    variance, square = S.diagonal(), z * z
    nis = square / variance
    accepted, used = nis <= gate, nis <= max(gate, deweight_limit)
    if not used.any():
        return Correction(accepted, S, True, np.zeros(n), 0)
    inflated = S[used][:, used]
    inflated.flat[:: len(inflated) + 1] = np.maximum(variance, square / gate)[used]  # larger only beyond the gate
    L, info = dpotrf(inflated, lower=1)
    if info != 0:
        return Correction(np.zeros_like(accepted), S, False, np.zeros(n), 0)
    # W = L^-1 H P, y = L^-1 z and Y = L^-1 H E, apart: how BLAS rounds one column depends on the number of columns, and
    # W must be the same bits with any number of hypotheses. It is column-major: the transpose is solved from the right.
    right = HP[used], z[used, None], rows.times(E)[used]
    W, y, Y = (dtrsm(1.0, L, x.T, side=1, lower=1, trans_a=1, overwrite_b=1).T for x in right)
    error = y[:, 0] @ W
    belief.apply_error(error)
    a = heading_coupling(error, belief.layout)
    reduce_covariance(P, W, a)
    belief.signatures.update(W, Y, y[:, 0])
    E += a[:, None] * E[HEADING]  # E := M E
    return Correction(accepted, S, True, error, int(np.count_nonzero(used)) - int(np.count_nonzero(accepted)))
