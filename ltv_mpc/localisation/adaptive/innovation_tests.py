"""Is the mean of innovations zero? Asked of sums over many messages: a little that lasts shows long before squares do.

A consistent filter's innovations r ~ N(0, S) are white: those of different messages are independent. Contrasts
d = D^T r of one message, as the mean over its rows, have the variance V = D^T S D, and sums that forget,
    s := lambda s + d,  W := lambda^2 W + V,  lambda = exp(-dt / tau),
make s^T W^-1 s chi-square of as many degrees of freedom as d has entries, whatever tau is.
A hundred rows that are all wrong by a tenth of their noise leave their squares as they are and are ten deviations in d.
One message moves s by at most ``MAX_SD`` deviations: one bad ping alone does not pass ``limit``, two do.
Source  Mehra 1970, IEEE T-AC 15(2) (whiteness); Bar-Shalom, Li & Kirubarajan 2001, section 5.4.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.special import chdtri

from ltv_mpc.jit import jit
from ltv_mpc.messages import Array

MAX_SD = 5.0

FALSE_ALARM = 3e-6
"""For each look at one sum. 200 s are some 600 independent looks: one dive in 500 has a false alarm."""


def threshold(degrees: int, false_alarm: float = FALSE_ALARM) -> float:
    """Chi-square that s^T W^-1 s exceeds by chance in ``false_alarm`` of all looks."""
    return float(chdtri(degrees, false_alarm))


class InnovationMeanTest:
    """s (T, G) and W (T, G, G) of one kind of contrasts (G,), one or two, for several time constants (T,) at once."""

    def __init__(self, tau_s: tuple[float, ...], size: int) -> None:
        self.s = np.zeros((len(tau_s), size))
        self.W = np.zeros((len(tau_s), size, size))
        self._tau_ns = 1e9 * np.array(tau_s)
        self._t_ns: int | None = None

    def add(self, t_ns: int, d: Array, V: Array) -> None:
        """One message's d (G,) with covariance V (G, G)."""
        keep = np.zeros(len(self.s)) if self._t_ns is None else np.exp((self._t_ns - t_ns) / self._tau_ns)
        self._t_ns = t_ns
        self.s, self.W = _added(self.s, self.W, keep, np.ascontiguousarray(d), np.ascontiguousarray(V))

    def chi_square(self) -> Array:
        """(T,); 0 before the first message."""
        if self._t_ns is None:
            return np.zeros(len(self.s))
        return _squares(self.s, self.W)

    def copy(self) -> InnovationMeanTest:
        """Independent of this one: s and W are replaced, never written into."""
        other = InnovationMeanTest.__new__(InnovationMeanTest)
        other.__dict__.update(self.__dict__)
        return other


@jit
def _added(s: Array, W: Array, keep: Array, d: Array, V: Array) -> tuple[Array, Array]:
    """s and W with one message more; ``keep`` (T,) is lambda."""
    own = _square(d, V)
    part = MAX_SD / math.sqrt(own) if own > MAX_SD * MAX_SD else 1.0
    new_s, new_W = np.empty_like(s), np.empty_like(W)
    for t in range(len(keep)):
        for i in range(len(d)):
            new_s[t, i] = keep[t] * s[t, i] + part * d[i]
            for j in range(len(d)):
                new_W[t, i, j] = keep[t] * keep[t] * W[t, i, j] + V[i, j]
    return new_s, new_W


@jit
def _squares(s: Array, W: Array) -> Array:
    """s^T W^-1 s of each time constant."""
    out = np.empty(len(s))
    for t in range(len(s)):
        out[t] = _square(s[t], W[t])
    return out


@jit
def _square(s: Array, W: Array) -> float:
    """s^T W^-1 s of one entry or two, in closed form: a compiled ``solve`` raises where a number is none."""
    if len(s) == 1:
        return float(s[0] * s[0] / W[0, 0])
    across = W[1, 1] * s[0] * s[0] - (W[0, 1] + W[1, 0]) * s[0] * s[1] + W[0, 0] * s[1] * s[1]
    return float(across / (W[0, 0] * W[1, 1] - W[0, 1] * W[1, 0]))
