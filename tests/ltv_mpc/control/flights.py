"""Flights of a controller with the nominal model of its vehicle."""

from __future__ import annotations

import msgspec
import numpy as np

from ltv_mpc import Controller, CurrentProfile, Estimate, Plan, advance


def water(north_mps: float = 0.0, east_mps: float = 0.0) -> CurrentProfile:
    """Return a current that is the same at all depths."""
    return CurrentProfile(depth_m=np.zeros(1), north_mps=np.array([north_mps]), east_mps=np.array([east_mps]))


def at_rest(north_mps: float = 0.0, east_mps: float = 0.0, **place: float) -> Estimate:
    """Return a vehicle at rest over ground, in a current that it knows."""
    return msgspec.structs.replace(Estimate.at_rest(**place), current=water(north_mps, east_mps))


def fly(controller: Controller, estimate: Estimate, cycles: int) -> tuple[list[Estimate], list[Plan]]:
    """Follow the plans for so many cycles of 0.3 s; return the estimates after them, and the plans."""
    way, plans = [], []
    for _ in range(cycles):
        plans.append(controller.plan(estimate))
        assert plans[-1].origin == "solved" or not controller.config.lateral, plans[-1].why
        estimate = advance(controller.vehicle, estimate, plans[-1], duration_s=0.3)
        way.append(estimate)
    return way, plans
