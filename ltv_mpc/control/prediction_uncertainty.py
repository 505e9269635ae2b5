"""Growth of the uncertainty of a prediction that no newer estimate corrects.

    P(t) = A P0 A' + B Pb B' + sum over both lateral thrusters of d d',    growth = sd(t) - sd(0),
    sd = sqrt(P_nn + P_ee)

P0   covariance (6, 6) of the estimate; zero if it has none
A    derivative (2, 6) of the predicted position by the estimate
Pb   covariance (2, 2) of the mean current since the estimate: of the estimated bias with its random walk, and of the
     estimate's profile if it has standard deviations
B    derivative (2, 2) of the predicted position by the current
d    change (2,) of the predicted position if a thruster delivers 10 % more

The derivatives are differences of predictions, so this takes eleven predictions. The controller needs them only while
its estimates are late (``mode.py``).
"""

from __future__ import annotations

import math

import numpy as np

from ltv_mpc.control.disturbance import DisturbanceObserver
from ltv_mpc.control.prediction import Prediction, current_at_depth, predict_state, profile_of
from ltv_mpc.control.sent_commands import SentCommands
from ltv_mpc.messages import Array, CurrentProfile, Estimate

STEP = 1e-3
"""Step of the differences in m, m/s, rad and rad/s."""

THRUST_SD = 0.1
"""Standard deviation of the delivered thrust, as a share of it."""

COLUMN_OF = (0, 1, 4, 5, 2, 3)
"""Place of north, east, velocity north and east, heading, yaw rate in the estimate of ``prediction.Measured``."""


def growth_m(
    prediction: Prediction, estimate: Estimate, t_ns: int, commands: SentCommands, observer: DisturbanceObserver
) -> float:
    """Return the growth of the standard deviation of the predicted horizontal position (m).

    Parameters
    ----------
    prediction : knows the vehicle and the actuators' reports.
    estimate : where the prediction begins, with the bias in its current.
    t_ns : time of the predicted position, vehicle time (ns).
    commands : commands in force from the estimate's time on.
    observer : estimated bias of the current; it has no covariance where it does not apply.
    """
    since_ns, state, report_ns, thrust_N = prediction.measured(estimate, commands)
    times, commanded_N = prediction.delivered(commands)
    profile = profile_of(estimate)

    def _position(state: Array = state, current: tuple[float, float] = (0.0, 0.0), gain: Array | float = 1.0) -> Array:
        return predict_state(
            prediction.coefficients,
            (since_ns, state, report_ns, thrust_N * gain),
            max(t_ns, since_ns),
            (times, commanded_N * gain),
            (profile.depth_m, profile.north_mps + current[0], profile.east_mps + current[1]),
        )[:2]

    at = _position()
    variance = 0.0
    for thruster in (0, 1):
        gain = np.ones(3)
        gain[thruster] += THRUST_SD
        d = _position(gain=gain) - at
        variance += float(d @ d)
    Pb = _current_variance(profile, estimate.depth_m) * np.eye(2)
    Pb += observer.covariance_of_mean((t_ns - since_ns) * 1e-9)
    if Pb.any():
        B = np.array([_position(current=(STEP, 0.0)) - at, _position(current=(0.0, STEP)) - at]).T / STEP
        variance += float(np.trace(B @ Pb @ B.T))
    P0 = estimate.covariance
    if P0 is None:
        return math.sqrt(variance)
    A = np.array([_position(state + STEP * np.eye(len(state))[column]) - at for column in COLUMN_OF]).T / STEP
    variance += float(np.trace(A @ P0 @ A.T))
    return math.sqrt(variance) - math.sqrt(float(P0[0, 0] + P0[1, 1]))


def _current_variance(profile: CurrentProfile, depth_m: float | None) -> float:
    """Return the variance of either component of a profile at a depth (m^2/s^2); 0 if it is not known."""
    if profile.sd_mps is None:
        return 0.0
    sd_mps, _ = current_at_depth(profile.depth_m, profile.sd_mps, profile.sd_mps, depth_m or 0.0)
    return sd_mps * sd_mps
