"""A disturbance state for offset-free control: what the water does that its profile does not say.

The profile in use is the estimate's plus a bias b (2,), north and east, the same at all depths; without a profile it is
all there is. b walks at random, and shows in how the velocity over ground v (2,) changes from one estimate to the next,
through the drag on what moves against the water:

    b(t + dt) = b(t) + w,   w ~ N(0, q^2 dt I)
    v(t + dt) = h(b) + e,   e ~ N(0, r^2 I)

with h the exact flow from the last estimate through the commands that were sent: an extended Kalman filter of two
states. Where the vehicle drifts with the water, drag is zero to first order, dh/db vanishes, and b waits; its variance
is held at that of the prior. One state more than an integrator of the position error needs, but nothing to unwind: it
feeds forward through the model, and a saturated thruster does not fill it.
"""

from __future__ import annotations

import msgspec
import numpy as np

from ltv_mpc.control.advance import as_estimate
from ltv_mpc.control.commands import SentCommands
from ltv_mpc.control.config import Disturbance
from ltv_mpc.control.prediction import Prediction
from ltv_mpc.signals import Array, CurrentProfile, Estimate

STEP_MPS = 0.005
"""Difference that dh/db is taken over."""

LONGEST_NS = 2_000_000_000
"""Over a longer silence the model says too little of the velocity."""


class CurrentBias:
    """b and its covariance, from estimate to estimate."""

    def __init__(self, settings: Disturbance) -> None:
        self._settings = settings
        self._prior = settings.sd_mps**2
        self.bias_mps: Array = np.zeros(2)
        self.covariance: Array = self._prior * np.eye(2)
        self._last: Estimate | None = None

    def corrected(self, estimate: Estimate, prediction: Prediction, commands: SentCommands) -> Estimate:
        """``estimate``, newer than the last one, with b in its current."""
        last, self._last = self._last, estimate
        if last is not None and 0 < estimate.t_ns - last.t_ns <= LONGEST_NS:
            self._learn(last, estimate, prediction, commands)
        return _biased(estimate, self.bias_mps)

    def _learn(self, last: Estimate, estimate: Estimate, prediction: Prediction, commands: SentCommands) -> None:
        settings, b = self._settings, self.bias_mps

        def h(bias: Array) -> Array:
            before = _biased(last, bias)
            after = as_estimate(prediction.roll(before, estimate.t_ns, commands), before)
            return np.array([after.velocity_north_mps, after.velocity_east_mps])

        foreseen = h(b)
        H = np.column_stack([(h(b + step) - foreseen) / STEP_MPS for step in STEP_MPS * np.eye(2)])
        seconds = (estimate.t_ns - last.t_ns) * 1e-9
        P = self.covariance + settings.walk_mps_per_rts**2 * seconds * np.eye(2)
        # Directions that are not seen gain no more doubt than there was at the beginning.
        P *= min(1.0, self._prior / float(np.linalg.eigvalsh(P)[-1]))
        S = H @ P @ H.T + settings.noise_mps**2 * np.eye(2)
        gain = np.linalg.solve(S, H @ P).T
        found = np.array([estimate.velocity_north_mps, estimate.velocity_east_mps])
        bias = b + gain @ (found - foreseen)
        if not np.isfinite(bias).all():
            return
        # Joseph's form: stays symmetric and positive
        left = np.eye(2) - gain @ H
        self.covariance = left @ P @ left.T + settings.noise_mps**2 * gain @ gain.T
        self.bias_mps = np.clip(bias, -settings.most_mps, settings.most_mps)


def _biased(estimate: Estimate, bias: Array) -> Estimate:
    """With ``bias`` (2,) on top of its profile; where it has none, alone."""
    known = estimate.current
    if known is None:
        known = CurrentProfile(depth_m=np.zeros(1), north_mps=np.zeros(1), east_mps=np.zeros(1))
    current = msgspec.structs.replace(known, north_mps=known.north_mps + bias[0], east_mps=known.east_mps + bias[1])
    return msgspec.structs.replace(estimate, current=current)
