"""Bow first on paths: a craft that is weaker astern turns round, and does not go astern afterwards."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from ltv_mpc.control.config import ControllerConfig, MotionLimits
from ltv_mpc.control.controller import Controller
from ltv_mpc.control.resolution import settled
from ltv_mpc.control.solvers import SOLVERS
from ltv_mpc.messages import Estimate, PlanOrigin
from ltv_mpc.references import Line, Place, Point
from ltv_mpc.vehicle.parameters import Vehicle
from tests.foreign_plant.flight import Flight, distance_from_outline_m


def surge_and_distance(limits: MotionLimits) -> tuple[np.ndarray, float]:
    """Follow the square from a start with the stern along its first side.

    Return the surge speed in each plan from the first ahead on (m/s), and the mean distance from the outline (m).
    """
    flight = Flight(heading_rad=-math.pi / 2, config=ControllerConfig(limits=limits), armed=True)
    flight.fly(0.5)
    flight.follow_square()
    track = flight.fly(115.0)
    surge = np.array([plan.states[0, 2] for plan in flight.plans if plan.progress is not None])
    return surge[np.argmax(surge > 0.1) :], float(distance_from_outline_m(track).mean())


def test_a_craft_that_is_weaker_astern_turns_its_bow_to_the_path() -> None:
    either, astern_m = surge_and_distance(MotionLimits(bow="either"))
    default, ahead_m = surge_and_distance(MotionLimits())
    assert (either < -0.1).mean() > 0.5  # what the limit is for
    assert (default < -0.05).mean() == 0.0
    assert ahead_m < astern_m


@pytest.mark.parametrize(
    ("name", "bow"), [("paper", "either"), ("low-yaw", "either"), ("weak-reverse", "first"), ("surface", "first")]
)
def test_the_bow_goes_first_by_default_if_the_vehicle_is_weaker_astern(name: str, bow: str) -> None:
    vehicle = Vehicle.load(name)
    assert settled(ControllerConfig(), vehicle).limits.bow == bow
    assert settled(ControllerConfig(limits=MotionLimits(bow="either")), vehicle).limits.bow == "either"


def test_only_a_path_forbids_to_go_astern() -> None:
    limits = MotionLimits(bow="first", min_surge_mps=-0.5)
    assert limits.on(path=False) is limits
    assert limits.on(path=True) == msgspec.structs.replace(limits, min_surge_mps=0.0)
    assert MotionLimits(bow="either").on(path=True).min_surge_mps is None


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_path_and_a_point_are_planned_by_turns(solver: str) -> None:
    """The limit of surge comes and goes with the reference, and the solver with it."""
    weak = Vehicle.load("weak-reverse")
    line = Line(start=Place(north_m=0.0, east_m=0.0), end=Place(north_m=9.0, east_m=0.0), speed_mps=0.2)
    controller, estimate = Controller(weak, line, ControllerConfig(solver=solver)), Estimate.at_rest()
    for k, reference in enumerate((line, Point(north_m=2.0, east_m=0.0), line)):
        controller.follow(reference)
        plan = controller.plan(msgspec.structs.replace(estimate, t_ns=k * 300_000_000))
        assert plan.origin is PlanOrigin.SOLVED, plan.why
