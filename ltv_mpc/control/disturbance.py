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

By itself it works where the estimates carry no profile, since nobody else then knows the water; it rests where they do.
"""

from __future__ import annotations

import msgspec
import numpy as np

from ltv_mpc.control.config import Disturbance
from ltv_mpc.control.prediction import Prediction, current_at_depth, predict_state
from ltv_mpc.control.sent_commands import SentCommands
from ltv_mpc.jit import jit
from ltv_mpc.messages import Array, CurrentProfile, Estimate, Times

STEP_MPS = 0.005
"""Difference that dh/db is taken over."""

STILL = CurrentProfile(depth_m=np.zeros(1), north_mps=np.zeros(1), east_mps=np.zeros(1))
"""What the bias comes on top of where nothing is known."""

UNKNOWN_SD_MPS = 0.1
"""Standard deviation, before anything was seen, of a current that nobody tells."""

LONGEST_NS = 2_000_000_000
"""Over a longer silence the model says too little of the velocity."""


class CurrentBias:
    """b and its covariance, from estimate to estimate."""

    def __init__(self, settings: Disturbance) -> None:
        """``settings.sd_mps`` is above 0, or left out."""
        self._settings = settings
        self._always = settings.sd_mps is not None
        self._prior = (UNKNOWN_SD_MPS if settings.sd_mps is None else settings.sd_mps) ** 2
        self.bias_mps: Array = np.zeros(2)
        self.covariance: Array = self._prior * np.eye(2)
        self._last: Estimate | None = None

    def correct(self, estimate: Estimate, prediction: Prediction, commands: SentCommands) -> Estimate:
        """``estimate``, newer than the last one, with b in its current; as it is where its profile is believed."""
        if estimate.current is not None and not self._always:
            self._last = None
            return estimate
        last, self._last = self._last, estimate
        if last is not None and 0 < estimate.t_ns - last.t_ns <= LONGEST_NS:
            self._learn(last, estimate, prediction, commands)
        return _biased(estimate, self.bias_mps)

    def _learn(self, last: Estimate, estimate: Estimate, prediction: Prediction, commands: SentCommands) -> None:
        settings, profile = self._settings, last.current or STILL
        found = np.array([estimate.velocity_north_mps, estimate.velocity_east_mps])
        vehicle, flat, report_ns, report = prediction.before(last)
        bias, covariance = update_bias(
            self.bias_mps,
            self.covariance,
            found,
            vehicle,
            flat,
            last.t_ns,
            estimate.t_ns,
            *commands.knots,
            report_ns,
            report,
            profile.depth_m,
            profile.north_mps,
            profile.east_mps,
            settings.walk_mps_per_rts,
            settings.noise_mps,
            self._prior,
        )
        if np.isfinite(bias).all():
            self.covariance = covariance
            self.bias_mps = np.clip(bias, -settings.max_mps, settings.max_mps)


@jit
def update_bias(
    b: Array,
    P: Array,
    found: Array,
    vehicle: Array,
    before: Array,
    since: int,
    until: int,
    t: Times,
    thrust: Array,
    report_ns: int,
    report: Array,
    depth: Array,
    north: Array,
    east: Array,
    walk: float,
    noise: float,
    prior: float,
) -> tuple[Array, Array]:
    """b (2,) and P (2, 2) after the velocity over ground ``found`` (2,) at ``until``.

    ``walk`` is q, ``noise`` r, ``prior`` the variance that no direction's may exceed; the rest is for
    ``predict_state``.
    """
    foreseen, H = np.empty(2), np.empty((2, 2))
    for j in range(-1, 2):
        dn, de = b[0], b[1]
        if j == 0:
            dn += STEP_MPS
        elif j == 1:
            de += STEP_MPS
        out = predict_state(vehicle, before, since, until, t, thrust, report_ns, report, depth, north + dn, east + de)
        c = current_at_depth(depth, north + dn, east + de, out[11])
        cos, sin = np.cos(out[4]), np.sin(out[4])
        # v = R(psi) [u, v] + c
        v0, v1 = cos * out[2] - sin * out[3] + c[0], sin * out[2] + cos * out[3] + c[1]
        if j < 0:
            foreseen[0], foreseen[1] = v0, v1
        else:
            H[0, j], H[1, j] = (v0 - foreseen[0]) / STEP_MPS, (v1 - foreseen[1]) / STEP_MPS
    grown = walk * walk * float(until - since) * 1e-9
    p00, p01, p11 = P[0, 0] + grown, P[0, 1], P[1, 1] + grown
    # Directions that are not seen gain no more doubt than there was at the beginning.
    largest = 0.5 * (p00 + p11) + np.sqrt(0.25 * (p00 - p11) ** 2 + p01 * p01)
    held = min(1.0, prior / largest)
    p00, p01, p11 = held * p00, held * p01, held * p11
    out_b, out_P = b.copy(), np.array([[p00, p01], [p01, p11]])
    # One component after the other: their noise is independent, so the order does not matter.
    for i in range(2):
        h0, h1 = H[i, 0], H[i, 1]
        a0, a1 = out_P[0, 0] * h0 + out_P[0, 1] * h1, out_P[1, 0] * h0 + out_P[1, 1] * h1  # P h
        S = h0 * a0 + h1 * a1 + noise * noise
        k0, k1 = a0 / S, a1 / S
        missed = found[i] - foreseen[i] - h0 * (out_b[0] - b[0]) - h1 * (out_b[1] - b[1])
        out_b[0] += k0 * missed
        out_b[1] += k1 * missed
        # Joseph's form, P = (1 - k h) P (1 - k h)' + k r^2 k': stays symmetric and positive
        j00, j01, j10, j11 = 1.0 - k0 * h0, -k0 * h1, -k1 * h0, 1.0 - k1 * h1
        q00, q01 = j00 * out_P[0, 0] + j01 * out_P[1, 0], j00 * out_P[0, 1] + j01 * out_P[1, 1]
        q10, q11 = j10 * out_P[0, 0] + j11 * out_P[1, 0], j10 * out_P[0, 1] + j11 * out_P[1, 1]
        r2 = noise * noise
        out_P[0, 0] = q00 * j00 + q01 * j01 + r2 * k0 * k0
        out_P[0, 1] = q00 * j10 + q01 * j11 + r2 * k0 * k1
        out_P[1, 0] = out_P[0, 1]
        out_P[1, 1] = q10 * j10 + q11 * j11 + r2 * k1 * k1
    return out_b, out_P


def _biased(estimate: Estimate, bias: Array) -> Estimate:
    """With ``bias`` (2,) on top of its profile; where it has none, alone."""
    known = estimate.current or STILL
    current = msgspec.structs.replace(known, north_mps=known.north_mps + bias[0], east_mps=known.east_mps + bias[1])
    return msgspec.structs.replace(estimate, current=current)
