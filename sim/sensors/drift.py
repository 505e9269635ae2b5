"""A bias that drifts: first-order Gauss-Markov in time.

b(0) ~ N(0, sd^2),  b(t + dt) = exp(-dt / tau) b(t) + sd sqrt(1 - exp(-2 dt / tau)) N(0, 1):  sd at every time
"""

from __future__ import annotations

import math

import numpy as np

from ltv_mpc.messages import Array


class Drift:
    """Independent biases, each with its standard deviation and time constant."""

    def __init__(self, sd: float | Array, tau_s: float | Array, size: int, draws: np.random.Generator) -> None:
        """One number for all, or one for each. The first values are drawn at once."""
        self._draws = draws
        self._sd, self._tau_s = (np.broadcast_to(x, (size,)).tolist() for x in (sd, tau_s))
        self._steps: dict[float, tuple[Array, Array]] = {}
        self.value: Array = np.array(self._sd) * draws.standard_normal(size)

    def shares(self, dt_s: float) -> tuple[Array, Array]:
        """What is kept of the biases over dt_s, and the standard deviation of what is new in them, (size,) each."""
        if dt_s not in self._steps:
            kept = [math.exp(-dt_s / tau) for tau in self._tau_s]
            fresh = [sd * math.sqrt(-math.expm1(-2.0 * dt_s / t)) for sd, t in zip(self._sd, self._tau_s, strict=True)]
            self._steps[dt_s] = np.array(kept), np.array(fresh)
        return self._steps[dt_s]

    def advance(self, dt_s: float) -> Array:
        """The biases dt_s later, shape (size,)."""
        kept, fresh = self.shares(dt_s)
        self.value = kept * self.value + fresh * self._draws.standard_normal(len(self.value))
        return self.value
