"""Drifting biases: first-order Gauss-Markov processes in time.

b(0) ~ N(0, sd^2),  b(t + dt) = exp(-dt / tau) b(t) + sd sqrt(1 - exp(-2 dt / tau)) N(0, 1):  sd at every time
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.messages import Array


class GaussMarkovBias:
    """Independent biases, each with its standard deviation and time constant."""

    def __init__(self, sd: float | Array, tau_s: float | Array, size: int, draws: np.random.Generator) -> None:
        """Draw the first values. ``sd`` and ``tau_s`` hold one number for all biases, or one for each."""
        self._draws, self._sd, self._tau_s = draws, np.broadcast_to(sd, size), np.broadcast_to(tau_s, size)
        self._coefficients: dict[float, tuple[Array, Array]] = {}  # by dt_s: decay, and sd of the new part
        self.value: Array = self._sd * draws.standard_normal(size)

    def advance(self, dt_s: float) -> Array:
        """Move the biases on by dt_s and return them, (size,)."""
        if dt_s not in self._coefficients:
            new_sd = self._sd * np.sqrt(-np.expm1(-2.0 * dt_s / self._tau_s))
            self._coefficients[dt_s] = np.exp(-dt_s / self._tau_s), new_sd
        decay, new_sd = self._coefficients[dt_s]
        self.value = decay * self.value + new_sd * self._draws.standard_normal(len(self.value))
        return self.value
