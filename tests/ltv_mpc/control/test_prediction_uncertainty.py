"""Growth of a prediction's uncertainty: against draws of the estimate, the current and the thrust."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from ltv_mpc import CurrentProfile, Estimate, Vehicle
from ltv_mpc.control.config import Disturbance
from ltv_mpc.control.disturbance import DisturbanceObserver
from ltv_mpc.control.prediction import Prediction, growth_m
from ltv_mpc.control.sent_commands import SentCommands
from tests.ltv_mpc.plans import plan_of

PAPER = Vehicle.load("paper")
S = 1_000_000_000
STILL = CurrentProfile(depth_m=np.zeros(1), north_mps=np.zeros(1), east_mps=np.zeros(1))
MOVING = msgspec.structs.replace(
    Estimate.at_rest(north_m=3.0, east_m=-2.0, heading_rad=0.6),
    velocity_north_mps=0.25,
    velocity_east_mps=0.15,
    yaw_rate_radps=0.05,
    current=STILL,
)
SD = np.array([0.4, 0.2, 0.02, 0.03, 0.05, 0.01])
"""Of north, east, velocity north and east, heading, yaw rate."""
CORRELATED = np.diag(SD) @ (np.eye(6) + 0.4 * (np.eye(6, k=2) + np.eye(6, k=-2))) @ np.diag(SD)


def learning(walk_mps_per_rts: float = 0.01, sd_mps: float | None = None) -> DisturbanceObserver:
    """Return the bias after one estimate without a current."""
    bias = DisturbanceObserver(Disturbance(sd_mps=sd_mps, walk_mps_per_rts=walk_mps_per_rts), PAPER)
    bias.correct(Estimate.at_rest(), Prediction(PAPER), SentCommands(PAPER))
    return bias


NEVER = learning(sd_mps=0.0)


def sent(port: float = 1.0, starboard: float = 1.0) -> SentCommands:
    """Return commands of 8 s, each thruster's scaled."""
    commands = SentCommands(PAPER)
    commands.add(plan_of(0, np.tile([30.0 * port, 22.0 * starboard, 0.0], (28, 1))))
    return commands


def drawn(t_ns: int, covariance: np.ndarray | None, current_sd: float) -> float:
    """Return the standard deviation of the predicted position over 1000 draws (m)."""
    rng = np.random.default_rng(1)
    factor = np.zeros((6, 6)) if covariance is None else np.linalg.cholesky(covariance)
    places = np.empty((1000, 2))
    for k in range(1000):
        n, e, vn, ve, psi, r = factor @ rng.standard_normal(6)
        cn, ce = current_sd * rng.standard_normal(2)
        estimate = msgspec.structs.replace(
            MOVING,
            north_m=3.0 + n,
            east_m=-2.0 + e,
            velocity_north_mps=0.25 + vn,
            velocity_east_mps=0.15 + ve,
            heading_rad=0.6 + psi,
            yaw_rate_radps=0.05 + r,
            current=CurrentProfile(depth_m=np.zeros(1), north_mps=np.array([cn]), east_mps=np.array([ce])),
        )
        commands = sent(*(1.0 + 0.1 * rng.standard_normal(2)))
        places[k] = Prediction(PAPER).state_at(estimate, t_ns, commands).X[:2]
    return float(np.sqrt(places.var(axis=0).sum()))


@pytest.mark.parametrize("seconds", [2, 6])
@pytest.mark.parametrize(
    ("covariance", "bias"),
    [(None, NEVER), (CORRELATED, NEVER), (None, learning()), (CORRELATED, learning())],
)
def test_the_growth_is_that_of_draws(covariance, bias, seconds):
    estimate = msgspec.structs.replace(MOVING, covariance=covariance)
    growth = growth_m(Prediction(PAPER), estimate, seconds * S, sent(), bias.covariance_of_mean(seconds))
    at_first = 0.0 if covariance is None else float(np.hypot(*SD[:2]))
    current_sd = 0.0 if bias is NEVER else float(np.sqrt(bias.covariance_of_mean(seconds)[0, 0]))
    assert growth == pytest.approx(drawn(seconds * S, covariance, current_sd) - at_first, rel=0.15)


def test_a_random_walk_of_the_current_adds_up():
    """By hand: the position of a drifting vehicle has the variance q^2 t^3 / 3 from a walk of q."""
    bias = learning(0.02)
    added = bias.covariance_of_mean(9.0) - bias.covariance
    np.testing.assert_allclose(added * 9.0**2, 0.02**2 * 9.0**3 / 3.0 * np.eye(2))


def test_the_standard_deviation_of_a_told_current_counts_at_the_depth_of_the_vehicle():
    zero = np.zeros(2)
    profile = CurrentProfile(depth_m=np.array([0.0, 10.0]), north_mps=zero, east_mps=zero, sd_mps=np.array([0.0, 0.2]))
    estimate = msgspec.structs.replace(MOVING, depth_m=5.0, current=profile)
    growth = growth_m(Prediction(PAPER), estimate, 6 * S, sent(), NEVER.covariance_of_mean(6.0))
    assert growth == pytest.approx(drawn(6 * S, None, 0.1), rel=0.15)
    assert growth > 1.5 * growth_m(Prediction(PAPER), MOVING, 6 * S, sent(), NEVER.covariance_of_mean(6.0))
