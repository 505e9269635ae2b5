"""One Kalman update of a belief by the rows of one message, with an innovation gate.

S = H P H^T + R,  each row passes if residual_i^2 / S_ii <= gate;  of those that pass, with S = L L^T, W = L^-1 H P:
    error = W^T L^-1 residual,   P := P - W^T W
then P is carried over to the estimate that has moved (``turning.py``). W^T W is formed once and mirrored, so P stays
symmetric to the last bit. H is sparse: H P costs m w n, not m n^2.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.linalg.blas import dsyrk, dtrsm, dtrsv
from scipy.linalg.lapack import dpotrf

from ltv_mpc.compiled import kernel
from ltv_mpc.localisation.measurements.rows import Rows
from ltv_mpc.localisation.state import Belief
from ltv_mpc.localisation.turning import turn_with_heading
from ltv_mpc.signals import Array


class Correction(NamedTuple):
    """What came of each row. ``nis`` is residual^2 / S_ii, before the gate: chi-square of one degree of freedom."""

    accepted: npt.NDArray[np.bool_]
    nis: Array
    definite: bool  # S was positive definite; if not, the belief has not been touched and must not be trusted


@kernel
def _project(P: Array, state: npt.NDArray[np.int64], partial: Array, variance: Array) -> tuple[Array, Array]:
    """H P, (m, n), and S = H P H^T + R, (m, m)."""
    m, w = state.shape
    n = P.shape[0]
    HP = np.zeros((m, n))
    S = np.empty((m, m))
    for i in range(m):
        for a in range(w):
            c = partial[i, a]
            if c != 0.0:
                row = P[state[i, a]]
                for k in range(n):
                    HP[i, k] += c * row[k]
    for i in range(m):
        for j in range(i + 1):
            s = 0.0
            for a in range(w):
                s += partial[j, a] * HP[i, state[j, a]]
            S[i, j] = s
            S[j, i] = s
        S[i, i] += variance[i]
    return HP, S


@kernel
def _mirror(P: Array) -> None:
    """The upper triangle becomes the lower one."""
    for i in range(P.shape[0]):
        for j in range(i):
            P[i, j] = P[j, i]


def correct(belief: Belief, rows: Rows, gate: float) -> Correction:
    """Update ``belief`` in place by the rows within ``gate`` (a quantile of chi-square, 1 degree of freedom)."""
    HP, S = _project(belief.P, rows.state, rows.partial, rows.variance)
    nis = rows.residual**2 / np.diagonal(S)
    accepted = nis <= gate
    residual = rows.residual
    if not accepted.any():
        return Correction(accepted, nis, definite=True)
    if not accepted.all():
        HP = HP[accepted]
        S = S[np.ix_(accepted, accepted)]
        residual = residual[accepted]
    # P is symmetric and row-major, LAPACK column-major: .T views are the same numbers without a copy.
    L, info = dpotrf(S.T, lower=1, clean=0, overwrite_a=1)
    if info != 0:
        return Correction(np.zeros_like(accepted), nis, definite=False)
    WT = dtrsm(1.0, L, HP.T, side=1, lower=1, trans_a=1, overwrite_b=1)  # (n, m): W^T = (H P)^T L^-T
    y = dtrsv(L, residual, lower=1)
    error = WT @ y
    belief.add(error)
    dsyrk(-1.0, WT, beta=1.0, c=belief.P.T, lower=1, overwrite_c=1)
    _mirror(belief.P)
    turn_with_heading(belief.P, error, belief.layout)
    return Correction(accepted, nis, definite=True)
