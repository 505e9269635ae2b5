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
        sd = math.sqrt(max(_squares(d[None], V[None])[0], MAX_SD**2))
        self.s = keep[:, None] * self.s + MAX_SD / sd * d
        self.W = keep[:, None, None] ** 2 * self.W + V

    def chi_square(self) -> Array:
        """Return s^T W^-1 s for each time constant, (T,); 0 before the first message."""
        if self._t_ns is None:
            return np.zeros(len(self.s))
        return _squares(self.s, self.W)


def _squares(s: Array, W: Array) -> Array:
    """Return s^T W^-1 s, (T,), for s (T, G) and W (T, G, G)."""
    squares: Array = (s * np.linalg.solve(W, s[..., None])[..., 0]).sum(axis=-1)
    return squares
