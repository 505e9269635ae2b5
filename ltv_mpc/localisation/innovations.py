"""Is the mean of innovations zero? Asked of sums over many messages: a little that lasts shows long before squares do.

A consistent filter's innovations r ~ N(0, S) are white: those of different messages are independent. Contrasts
d = D^T r of one message, as the mean over its rows, have the variance V = D^T S D, and sums that forget,
    s := lambda s + d,  W := lambda^2 W + V,  lambda = exp(-dt / tau),
make s^T W^-1 s chi-square of as many degrees of freedom as d has entries, whatever tau is.
A hundred rows that are all wrong by a tenth of their noise leave their squares as they are and are ten deviations in d.
One message moves s by at most ``MOST`` deviations: one bad ping alone does not pass ``limit``, two do.
Source  Mehra 1970, IEEE T-AC 15(2) (whiteness); Bar-Shalom, Li & Kirubarajan 2001, section 5.4.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.special import chdtri

from ltv_mpc.signals import Array

MOST = 5.0

FALSE_ALARM = 3e-6
"""For each look at one sum. 200 s are some 600 independent looks: one dive in 500 has a false alarm."""


def limit(degrees: int) -> float:
    """Chi-square that s^T W^-1 s exceeds by chance in ``FALSE_ALARM`` of all looks."""
    return float(chdtri(degrees, FALSE_ALARM))


class Mean:
    """s (T, G) and W (T, G, G) of one kind of contrasts (G,), for several time constants (T,) at once."""

    def __init__(self, tau_s: tuple[float, ...], size: int) -> None:
        self.s = np.zeros((len(tau_s), size))
        self.W = np.zeros((len(tau_s), size, size))
        self._tau_ns = 1e9 * np.array(tau_s)
        self._t_ns: int | None = None

    def add(self, t_ns: int, d: Array, V: Array) -> None:
        """One message's d (G,) with covariance V (G, G)."""
        own = float(d @ np.linalg.solve(V, d))
        if own > MOST * MOST:
            d = d * (MOST / math.sqrt(own))
        keep = np.zeros(len(self.s)) if self._t_ns is None else np.exp((self._t_ns - t_ns) / self._tau_ns)
        self._t_ns = t_ns
        self.s = keep[:, None] * self.s + d
        self.W = (keep * keep)[:, None, None] * self.W + V

    def chi_square(self) -> Array:
        """(T,); 0 before the first message."""
        if self._t_ns is None:
            return np.zeros(len(self.s))
        result: Array = np.einsum("tg,tg->t", self.s, np.linalg.solve(self.W, self.s[..., None])[..., 0])
        return result

    def copy(self) -> Mean:
        """Independent of this one: s and W are replaced, never written into."""
        other = Mean.__new__(Mean)
        other.__dict__.update(self.__dict__)
        return other
