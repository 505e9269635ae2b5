"""Drifting biases: first-order Gauss-Markov processes in time.

b(0) ~ N(0, sd^2),  b(t + dt) = exp(-dt / tau) b(t) + sd sqrt(1 - exp(-2 dt / tau)) N(0, 1):  sd at every time
"""

from __future__ import annotations

import math

import numpy as np

from ltv_mpc.messages import Array


class GaussMarkovBias:
    """Independent biases, each with its standard deviation and time constant."""

    def __init__(self, sd: float | Array, tau_s: float | Array, size: int, draws: np.random.Generator) -> None:
        """Draw the first values. ``sd`` and ``tau_s`` hold one number for all biases, or one for each."""
        self._draws = draws
        self._sd, self._tau_s = (np.broadcast_to(x, (size,)).tolist() for x in (sd, tau_s))
        self._coefficients: dict[float, tuple[Array, Array]] = {}
        self.value: Array = np.array(self._sd) * draws.standard_normal(size)

    def coefficients(self, dt_s: float) -> tuple[Array, Array]:
        """Return the decay of the biases over dt_s, and the standard deviation of their new part, (size,) each."""
        if dt_s not in self._coefficients:
            decay = [math.exp(-dt_s / tau) for tau in self._tau_s]
            new_sd = [sd * math.sqrt(-math.expm1(-2.0 * dt_s / t)) for sd, t in zip(self._sd, self._tau_s, strict=True)]
            self._coefficients[dt_s] = np.array(decay), np.array(new_sd)
        return self._coefficients[dt_s]

    def advance(self, dt_s: float) -> Array:
        """Move the biases on by dt_s and return them, (size,)."""
        decay, new_sd = self.coefficients(dt_s)
        self.value = decay * self.value + new_sd * self._draws.standard_normal(len(self.value))
        return self.value
