"""Test of the mean of innovations over many messages: it detects small lasting errors long before a test of squares.

The innovations r ~ N(0, S) of a consistent filter are white: those of different messages are independent. Contrasts
d = D^T r of one message (for example the mean over its rows) have the covariance V = D^T S D. With exponential
forgetting,

    s := lambda s + d,  W := lambda^2 W + V,  lambda = exp(-dt / tau),

s^T W^-1 s is chi-square distributed for any tau, with as many degrees of freedom as d has entries.
Example: an error of a tenth of the noise in each of a hundred rows hardly changes their squares. In d, the mean over
these rows, it is one standard deviation, and it grows with each message.

One message moves s by at most ``MAX_SD`` standard deviations: one bad ping does not exceed ``threshold(2)``, two do.

Source  Mehra 1970, IEEE T-AC 15(2) (whiteness); Bar-Shalom, Li & Kirubarajan 2001, section 5.4.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.special import chdtri

from ltv_mpc.jit import jit
from ltv_mpc.messages import Array

MAX_SD = 5.0
"""Largest change of a sum by one message, in standard deviations."""

FALSE_ALARM = 3e-6
"""Probability of a false alarm per test of one sum. 200 s are about 600 independent tests: one dive in 500."""


def threshold(degrees: int, false_alarm: float = FALSE_ALARM) -> float:
    """Return the value that a consistent s^T W^-1 s exceeds with probability ``false_alarm``.

    Parameters
    ----------
    degrees : degrees of freedom, the number of contrasts.
    false_alarm : probability.
    """
    return float(chdtri(degrees, false_alarm))


class InnovationMeanTest:
    """Sums s (T, G) and covariances W (T, G, G) of G contrasts, one or two, for T time constants at once.

    Parameters
    ----------
    tau_s : T time constants (s).
    size : number of contrasts G.
    """

    def __init__(self, tau_s: tuple[float, ...], size: int) -> None:
        self.s = np.zeros((len(tau_s), size))
        self.W = np.zeros((len(tau_s), size, size))
        self._tau_ns = 1e9 * np.array(tau_s)
        self._t_ns: int | None = None

    def add(self, t_ns: int, d: Array, V: Array) -> None:
        """Add the contrasts of one message.

        Parameters
        ----------
        t_ns : time of the message, not before the last.
        d : (G,) contrasts.
        V : (G, G) their covariance.
        """
        keep = np.zeros(len(self.s)) if self._t_ns is None else np.exp((self._t_ns - t_ns) / self._tau_ns)
        self._t_ns = t_ns
        self.s, self.W = _added(self.s, self.W, keep, np.ascontiguousarray(d), np.ascontiguousarray(V))

    def chi_square(self) -> Array:
        """Return s^T W^-1 s for each time constant, (T,); 0 before the first message."""
        if self._t_ns is None:
            return np.zeros(len(self.s))
        return _squares(self.s, self.W)

    def copy(self) -> InnovationMeanTest:
        """Return an independent copy. ``add`` replaces s and W and never writes into them, so they may be shared."""
        other = InnovationMeanTest.__new__(InnovationMeanTest)
        other.__dict__.update(self.__dict__)
        return other


@jit
def _added(s: Array, W: Array, keep: Array, d: Array, V: Array) -> tuple[Array, Array]:
    """Return s and W with one more message; ``keep`` (T,) is lambda."""
    squared = _square(d, V)
    part = MAX_SD / math.sqrt(squared) if squared > MAX_SD * MAX_SD else 1.0
    new_s, new_W = np.empty_like(s), np.empty_like(W)
    for t in range(len(keep)):
        for i in range(len(d)):
            new_s[t, i] = keep[t] * s[t, i] + part * d[i]
            for j in range(len(d)):
                new_W[t, i, j] = keep[t] * keep[t] * W[t, i, j] + V[i, j]
    return new_s, new_W


@jit
def _squares(s: Array, W: Array) -> Array:
    """Return s^T W^-1 s of each time constant, (T,)."""
    out = np.empty(len(s))
    for t in range(len(s)):
        out[t] = _square(s[t], W[t])
    return out


@jit
def _square(s: Array, W: Array) -> float:
    """Return s^T W^-1 s of one or two entries in closed form; a compiled ``solve`` raises on NaN."""
    if len(s) == 1:
        return float(s[0] * s[0] / W[0, 0])
    across = W[1, 1] * s[0] * s[0] - (W[0, 1] + W[1, 0]) * s[0] * s[1] + W[0, 0] * s[1] * s[1]
    return float(across / (W[0, 0] * W[1, 1] - W[0, 1] * W[1, 0]))
