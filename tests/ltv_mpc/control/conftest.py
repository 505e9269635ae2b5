"""Closed loop with the nominal model, and the QPs of its cycles."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import msgspec
import numpy as np
import pytest

from ltv_mpc import Controller, ControllerConfig, CurrentProfile, Estimate, Plan, Vehicle, references
from ltv_mpc.control.config import ResolvedConfig, Weights
from ltv_mpc.control.lateral import LateralPlanner
from ltv_mpc.control.linearisation import Linearisation
from ltv_mpc.control.nominal_model import as_estimate
from ltv_mpc.control.prediction import Prediction, Start
from ltv_mpc.messages import Applied, Array
from tests.ltv_mpc.control.problems import Form
from tests.ltv_mpc.reports import report

PAPER = Vehicle.load("paper")


def rough_current(seed: int) -> CurrentProfile:
    """Return a rough current of 4 cm/s: cosines of random phase."""
    rng = np.random.default_rng(seed)
    z = np.arange(71.0)
    north, east = (
        sum(0.028 * np.cos(z / length + rng.uniform(0, 2 * np.pi)) for length in (4.0, 9.0)) for _ in range(2)
    )
    return CurrentProfile(depth_m=z, north_mps=np.array(north), east_mps=np.array(east))


def descend(
    seed: int, cycles: int, config: ControllerConfig | None = None, start: dict[str, float] | None = None
) -> tuple[list[Estimate], list[Plan]]:
    """Simulate a descent of the nominal model, one cycle every 0.3 s, from rest or from ``start``."""
    controller = Controller(PAPER, references.Point(north_m=0.0, east_m=0.0, depth_m=60.0), config)
    estimate = Estimate.at_rest(depth_m=0.0, **(start or {}))
    estimate = msgspec.structs.replace(estimate, current=rough_current(seed))
    estimates, plans = [estimate], []
    vehicle = Prediction(PAPER)
    for _ in range(cycles):
        plan = controller.plan(estimate)
        vehicle.sent.add(plan)
        end = vehicle.state_at(estimate, estimate.t_ns + 300_000_000)
        vehicle.add_report(applied(end))
        controller.add_report(applied(end))
        estimate = as_estimate(end, estimate)
        plans.append(plan)
        estimates.append(estimate)
    return estimates, plans


def applied(end: Start) -> Applied:
    """Return the actuators' report of what they deliver."""
    return report(end.t_ns, [*end.X[6:], end.vertical_N], end.command)


@pytest.fixture(scope="session")
def profile() -> Callable[[int], CurrentProfile]:
    """Return a function that makes a current from a seed."""
    return rough_current


@pytest.fixture(scope="session")
def closed_loop() -> Callable[..., tuple[list[Estimate], list[Plan]]]:
    """Return a function that simulates a descent from a seed and a number of cycles."""
    return descend


class Cycle(NamedTuple):
    """Inputs of one cycle's QP."""

    form: Form
    lin: Linearisation
    target: Array
    stages: float  # since the last problem; NaN: unrelated to it


@pytest.fixture(scope="session")
def cycles() -> list[Cycle]:
    """Return over 200 problems of closed loops: descents, one from 2 m off with a wrong heading."""
    seen: list[Cycle] = []
    config = ResolvedConfig(horizon_s=5.1, weights=Weights())  # as the solvers that get these problems
    run_solver = LateralPlanner._run_solver

    def remembered(self, problem, shift, *, last):  # type: ignore[no-untyped-def]
        copied = Linearisation(*map(np.copy, self._cycle.lin))  # the controller's own is used again
        seen.append(Cycle(Form(config.knots), copied, np.array(self.target), shift))
        return run_solver(self, problem, shift, last=last)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(LateralPlanner, "_run_solver", remembered)
        for seed, start in ((1, {}), (2, {}), (3, {"north_m": 2.0, "heading_rad": 3.0})):
            descend(seed, 70, ControllerConfig(horizon_s=5.1), start)
    return seen
