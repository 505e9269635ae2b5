"""Failure signatures: mean errors of the filter under K hypotheses that its model does not contain.

A hypothesis has an unknown size nu (for example a drift of the current at all depths). Under it the mean error of the
belief is E nu, with one column of E per hypothesis. E propagates like an error:
    IMU propagation                  E := Phi E  on the core states (``filter/strapdown.py``)
    update with W = L^-1 H P         Y = L^-1 H E,   E := E - W^T Y
Innovations r in use contain nu, since y = L^-1 r ~ N(Y nu, I):
    score  d := d + Y^T y,           information  J := J + Y^T Y
Then d ~ N(J nu, J), and nu = J^-1 d is the maximum likelihood estimate of a linear filter without a gate.
One message adds at most ``MAX_SD`` standard deviations to a score, so that one bad ping is no evidence.
Source  Willsky & Jones 1976, A generalized likelihood ratio approach to the detection and estimation of jumps in linear
        systems, IEEE T-AC 21(1).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ltv_mpc.messages import Array

MAX_SD = 5.0
"""Largest change of a score by one message, in standard deviations."""


@dataclass(slots=True)
class FailureSignatures:
    """Signatures, scores and information of K hypotheses; K = 0 switches the test off."""

    error: Array  # E (n, K), mean error per unit of nu
    score: Array  # d (K,)
    information: Array  # J (K, K)

    @classmethod
    def of(cls, states: int, count: int) -> FailureSignatures:
        """Return signatures of zero: no hypothesis has started.

        Parameters
        ----------
        states : number of states n.
        count : number of hypotheses K.
        """
        return cls(np.zeros((states, count)), np.zeros(count), np.zeros((count, count)))

    def copy(self) -> FailureSignatures:
        """Return an independent copy."""
        return FailureSignatures(self.error.copy(), self.score.copy(), self.information.copy())

    def clear(self, columns: slice = slice(None)) -> None:
        """Set signature, score and information of the hypotheses in ``columns`` to zero.

        Parameters
        ----------
        columns : slice of the hypotheses.
        """
        self.error[:, columns] = 0.0
        self.score[columns] = 0.0
        self.information[columns, :] = 0.0
        self.information[:, columns] = 0.0

    def update(self, W: Array, Y: Array, y: Array) -> None:
        """Update by whitened rows (``filter/update.py``).

        Parameters
        ----------
        W : (m, n) L^-1 H P.
        Y : (m, K) L^-1 H E.
        y : (m,) L^-1 r.
        """
        self.error -= W.T @ Y
        J = Y.T @ Y
        bound = MAX_SD * np.sqrt(J.diagonal())
        self.score += np.minimum(np.maximum(y @ Y, -bound), bound)
        self.information += J
