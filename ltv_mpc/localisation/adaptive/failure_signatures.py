"""What errors the filter would have, were a hypothesis true: carried with the belief, for each of K of them.

Of something that the filter does not know of, of size nu (a slope of all water's velocity, a gyro's bias that begins),
the mean of the belief's error is E nu, and E, a column a hypothesis, goes with the belief as errors do:
    moved by the inertial unit       E := Phi E  on the core (``preintegration.propagate``)
    corrected, W = L^-1 H P          Y = L^-1 H E,   E := E - W^T Y
and each correction by innovations r that the gate lets through tells of nu, y = L^-1 r ~ N(Y nu, I):
    score  d := d + Y^T y,           information  J := J + Y^T Y
so that d ~ N(J nu, J) and nu = J^-1 d is the best that there is (linear, no gate).
One message adds at most ``MAX_SD`` deviations to a score: one bad ping is no evidence.
Source  Willsky & Jones 1976, A generalized likelihood ratio approach to the detection and estimation of jumps in linear
        systems, IEEE T-AC 21(1).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.linalg.blas import dgemm

from ltv_mpc.jit import jit
from ltv_mpc.messages import Array

MAX_SD = 5.0


@dataclass(slots=True)
class FailureSignatures:
    """Of K hypotheses, K = 0 where nothing is asked."""

    error: Array  # E (n, K)
    score: Array  # d (K,)
    information: Array  # J (K, K)

    @classmethod
    def of(cls, states: int, count: int) -> FailureSignatures:
        """None has begun."""
        return cls(np.zeros((states, count)), np.zeros(count), np.zeros((count, count)))

    def copy(self) -> FailureSignatures:
        """Independent of this one."""
        return FailureSignatures(self.error.copy(), self.score.copy(), self.information.copy())

    def clear(self, columns: slice = slice(None)) -> None:
        """Nothing has been heard of these."""
        self.error[:, columns] = 0.0
        self.score[columns] = 0.0
        self.information[columns, :] = 0.0
        self.information[:, columns] = 0.0

    def update(self, W: Array, Y: Array, y: Array) -> None:
        """By rows made white: W (m, n), Y (m, K), y (m,), all C-contiguous."""
        # of row-major arrays LAPACK sees the transposes: E^T := E^T - Y^T W, in place
        dgemm(-1.0, Y.T, W.T, beta=1.0, c=self.error.T, trans_b=1, overwrite_c=1)
        J = Y.T @ Y
        most = MAX_SD * np.sqrt(J.diagonal())
        self.score += np.minimum(np.maximum(y @ Y, -most), most)
        self.information += J


@jit
def update_signatures(error: Array, score: Array, information: Array, W: Array, Y: Array, y: Array) -> None:
    """``FailureSignatures.update`` by few rows."""
    m, n = W.shape
    K = error.shape[1]
    for i in range(n):
        for k in range(m):
            w = W[k, i]
            for j in range(K):
                error[i, j] -= w * Y[k, j]
    for j in range(K):
        told, own = 0.0, 0.0
        for k in range(m):
            told += Y[k, j] * y[k]
            own += Y[k, j] * Y[k, j]
            for b in range(K):
                information[j, b] += Y[k, j] * Y[k, b]
        most = MAX_SD * math.sqrt(own)
        score[j] += min(max(told, -most), most)
