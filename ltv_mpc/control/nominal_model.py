"""Nominal vehicle: it moves exactly as the controller's model says. For a first loop, and for tests."""

from __future__ import annotations

import msgspec
import numpy as np

from ltv_mpc.control.prediction import Prediction, Start, currents_at_depths
from ltv_mpc.conversion import exact
from ltv_mpc.messages import Estimate, Plan
from ltv_mpc.vehicle.parameters import Vehicle


def advance(vehicle: Vehicle, estimate: Estimate, plan: Plan, *, duration_s: float) -> Estimate:
    """Return the estimate some time later under a plan, by the exact flow of the nominal model.

    Before the plan's start its first thrusts act; after its end they ramp to zero at the slew limit. An ``Estimate``
    does not hold the delivered thrust: at the beginning every thruster is taken to deliver its command.

    Parameters
    ----------
    vehicle : nominal model.
    estimate : state at the beginning.
    plan : commands that act.
    duration_s : time to advance (s).
    """
    vehicle, estimate = exact(vehicle), exact(estimate)
    prediction = Prediction(vehicle)
    prediction.sent.add(plan, before_N=plan.initial_thrust_N)
    end = prediction.state_at(estimate, estimate.t_ns + round(duration_s * 1e9))
    return as_estimate(end, estimate)


def as_estimate(end: Start, before: Estimate) -> Estimate:
    """Return a predicted state as an estimate: [n', e'] = R(psi) [u, v] + c.

    Parameters
    ----------
    end : predicted state.
    before : estimate from which it was predicted; current, covariance and the missing depth are taken over.
    """
    n, e, u, v, psi, r = (float(x) for x in end.X[:6])
    has_depth = before.depth_m is not None
    altitude = before.altitude_m
    if altitude is not None and before.depth_m is not None:
        altitude = max(altitude + before.depth_m - end.depth_m, 0.0)  # over a level bottom
    c = currents_at_depths(before.current, np.array([end.depth_m]))[0]
    cos, sin = np.cos(psi), np.sin(psi)
    return msgspec.structs.replace(
        before,
        t_ns=end.t_ns,
        north_m=n,
        east_m=e,
        depth_m=end.depth_m if has_depth else None,
        heading_rad=float(np.arctan2(sin, cos)),
        yaw_rate_radps=r,
        velocity_north_mps=float(cos * u - sin * v + c[0]),
        velocity_east_mps=float(sin * u + cos * v + c[1]),
        velocity_down_mps=end.sinking_mps if has_depth else None,
        altitude_m=altitude,
    )
