"""A bias that drifts: first-order Gauss-Markov in time.

b(0) ~ N(0, sd^2),  b(t + dt) = exp(-dt / tau) b(t) + sd sqrt(1 - exp(-2 dt / tau)) N(0, 1):  sd at every time
"""

from __future__ import annotations

import math

import numpy as np

from ltv_mpc.signals import Array


class Drift:
    """Independent biases of one standard deviation and one time constant."""

    def __init__(self, sd: float, tau_s: float, size: int, draws: np.random.Generator) -> None:
        """The first values are drawn at once."""
        self._sd, self._tau, self._draws = sd, tau_s, draws
        self._steps: dict[float, tuple[float, float]] = {}
        self.value: Array = sd * draws.standard_normal(size)

    def advance(self, dt_s: float) -> Array:
        """The biases dt_s later, shape (size,)."""
        if dt_s not in self._steps:
            kept = math.exp(-dt_s / self._tau)
            self._steps[dt_s] = kept, self._sd * math.sqrt(-math.expm1(-2.0 * dt_s / self._tau))
        kept, fresh = self._steps[dt_s]
        self.value = kept * self.value + fresh * self._draws.standard_normal(len(self.value))
        return self.value
