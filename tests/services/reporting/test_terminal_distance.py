"""Errors on the screen count from the start of the descent, with the truth at the time of the estimate."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from ltv_mpc.messages import Estimate, Plan, PlanOrigin, Solve, SolveStatus, Truth
from services.reporting.plots.collector import Collector
from services.reporting.terminal import observe
from services.supervisor.screen import LiveView

S = 1_000_000_000


def moment(t_ns: int, *, truth_m: tuple[float, float], estimate_m: tuple[float, float], age_ns: int = 0) -> LiveView:
    truth = Truth(
        t_ns=t_ns,
        position_m=(*truth_m, 1.0),
        velocity_mps=(0.5, -0.25, 0.2),
        attitude_rad=(0.0, 0.0, 0.0),
        water_velocity_mps=(0.0, 0.0, 0.0),
        yaw_rate_radps=0.0,
        current_mps=(0.0, 0.0),
        thrust_N=(0.0, 0.0, 0.0),
    )
    estimate = Estimate.at_rest(north_m=estimate_m[0], east_m=estimate_m[1])
    plan = Plan(
        cycle_t_ns=t_ns,
        t_ns=np.array([t_ns, t_ns + S]),
        thrust_N=np.zeros((2, 3)),
        states=np.zeros((2, 6)),
        origin=PlanOrigin.SOLVED,
        solve=Solve(status=SolveStatus.SOLVED),
        reference_m=(10.0, 20.0),
    )
    return LiveView(
        t_ns=t_ns,
        start_ns=-S,
        end_ns=100 * S,
        speed=1.0,
        requested_speed=1.0,
        wall_s=0.0,
        phase="diving",
        truth=truth,
        estimate=msgspec.structs.replace(estimate, t_ns=t_ns - age_ns),
        plan=plan,
    )


def test_the_error_of_the_first_fix_is_no_drift() -> None:
    """The reference starts at the first estimate, 5 m off; then the vehicle moves 5 m and the estimate 0.5 m less."""
    errors = Collector()
    observe(errors, moment(0, truth_m=(7.0, 16.0), estimate_m=(10.0, 20.0)))
    assert errors.true_error_m == 0.0
    observe(errors, moment(S, truth_m=(10.0, 20.0), estimate_m=(13.0, 23.5)))
    assert errors.true_error_m == 5.0


def test_an_old_first_estimate_is_compared_with_the_truth_of_its_own_time() -> None:
    """The vehicle moves at 0.5 and -0.25 m/s: the estimate of 0.2 s ago agrees with the truth of that time."""
    errors = Collector()
    observe(errors, moment(S, truth_m=(10.5, 19.75), estimate_m=(10.4, 19.8), age_ns=S // 5))
    assert errors.true_error_m == pytest.approx(math.hypot(0.5, 0.25), abs=1e-12)


def test_an_estimate_from_before_the_start_does_not_say_where_the_reference_is() -> None:
    """At ten times real time the first view after the start may hold an estimate from before a fix, metres off."""
    errors = Collector()
    observe(errors, moment(S // 2, truth_m=(0.0, 0.0), estimate_m=(2.0, 2.0), age_ns=S // 2 + 1))
    assert errors.true_error_m is None
    observe(errors, moment(S, truth_m=(7.0, 16.0), estimate_m=(10.0, 20.0)))
    assert errors.true_error_m == 0.0
