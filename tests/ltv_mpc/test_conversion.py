"""Numbers that a Python program gives in other types: the plan is the same to the last bit, or says what is wrong."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from ltv_mpc import Controller, ControllerConfig, CurrentProfile, Estimate, Obstacle, Obstacles, Vehicle, references
from ltv_mpc.conversion import converted, exact
from ltv_mpc.errors import ConfigError
from ltv_mpc.messages import Authority, Plan, PlanOrigin
from ltv_mpc.safety.command_arbiter import ThrustOverride
from tests.ltv_mpc.reports import report
from tests.ltv_mpc.vehicles import changed

PAPER = Vehicle.load("paper")
CONFIG = ControllerConfig(horizon_s=3.0)
DIVE = references.Point(north_m=2.0, east_m=-1.0, depth_m=9.0)

OTHER_SCALARS: tuple[Callable[[float], Any], ...] = (int, float, np.float64, np.float32, np.int16, np.int64, np.array)
OTHER_ARRAYS: tuple[Callable[[Any], Any], ...] = (
    lambda rows: np.asarray(rows).astype(int),
    lambda rows: np.asarray(rows, dtype=np.float32),
    lambda rows: np.asarray(rows).tolist(),
    lambda rows: tuple(np.asarray(rows).astype(int).tolist()),
    lambda rows: np.repeat(np.asarray(rows, dtype=float), 2, axis=-1)[..., ::2],
    lambda rows: np.asfortranarray(rows),
    lambda rows: np.asarray(rows, dtype=">f8"),
)


def estimate_of(k: int, scalar: Callable[[float], Any] = float, array: Callable[[Any], Any] = np.asarray) -> Estimate:
    """Return an estimate of whole numbers, of any types."""
    profile = CurrentProfile(
        depth_m=array([0.0, 5.0, 20.0]), north_mps=array([0.0, 1.0, 0.0]), east_mps=array([1.0, 0.0, 0.0])
    )
    position = {"north_m": k, "east_m": 1.0, "depth_m": 4.0, "heading_rad": 2.0, "yaw_rate_radps": 0.0}
    velocity = {"velocity_north_mps": 1.0, "velocity_east_mps": 0.0, "velocity_down_mps": 0.0}
    return Estimate(
        t_ns=k * 300_000_000 if scalar in (float, np.int16) else scalar(k * 3e8),
        covariance=array(np.diag([1.0, 2.0, 1.0, 1.0, 1.0, 1.0])),
        current=profile,
        **{name: scalar(number) for name, number in (position | velocity).items()},
    )


def plans(scalar: Callable[[float], Any] = float, array: Callable[[Any], Any] = np.asarray) -> list[Plan]:
    """Return plans of which every input is of these types: vehicle, settings, reference, estimates, reports."""
    other = {f"thruster.{side}.max_N": scalar(60.0) for side in ("port", "vertical")}
    other |= {f"thruster.{side}.slew_N_per_s": scalar(90.0) for side in ("port", "vertical")}
    vehicle = changed(PAPER, other | {"net_buoyancy_N": scalar(30.0)})
    reference = replace(DIVE, north_m=scalar(2.0), depth_m=scalar(9.0))
    controller = Controller(vehicle, reference, replace(CONFIG, horizon_s=scalar(3.0)))
    made = []
    position = {"id": 3, "t_ns": 0, "north_m": 9, "east_m": 9, "radius_m": 1}
    numbers = position | {"velocity_north_mps": 0, "velocity_east_mps": 0}
    given = {name: scalar(number) for name, number in numbers.items()}
    obstacle = Obstacle(covariance_m2=array([1.0, 0.0, 1.0]), **given)
    controller.add_obstacles(Obstacles(t_ns=scalar(0), obstacles=[obstacle]))
    for k in range(2):
        given = replace(report(k * 300_000_000, [0.0] * 3), thrust_N=array([0.0, 4.0, 1.0]), command_N=array([0.0] * 3))
        made.append(controller.plan(estimate_of(k, scalar, array), applied=given))
    hand = ThrustOverride(Authority.MANUAL, array([1.0, 2.0, 3.0]), 10**12, "by hand")
    return [*made, controller.plan(estimate_of(2, scalar, array), override=hand)]


@pytest.fixture(scope="module")
def expected() -> list[Plan]:
    made = plans()
    assert [plan.origin for plan in made] == [PlanOrigin.SOLVED, PlanOrigin.SOLVED, PlanOrigin.MANUAL]
    return made


@pytest.mark.parametrize(("scalar", "array"), list(zip(OTHER_SCALARS, OTHER_ARRAYS, strict=True)))
def test_the_plan_is_the_same_for_numbers_of_every_type(
    expected: list[Plan], scalar: Callable[[float], Any], array: Callable[[Any], Any]
) -> None:
    for plan, other in zip(plans(scalar, array), expected, strict=True):
        assert (plan.origin, plan.why) == (other.origin, other.why)
        assert plan.thrust_N.tobytes() == other.thrust_N.tobytes()
        assert plan.states.tobytes() == other.states.tobytes()


def test_a_message_that_has_its_types_is_not_touched() -> None:
    estimate = estimate_of(1)
    assert exact(estimate) is estimate
    for whole in (PAPER, CONFIG, DIVE, references.load("square"), Vehicle.load("surface")):
        assert exact(whole) is whole
        assert converted(whole) == whole


@pytest.mark.parametrize(
    ("change", "names"),
    [
        ({"north_m": "far"}, "Estimate: north_m: Expected `float`, got `str`"),
        ({"north_m": object()}, "Estimate: north_m: "),
        ({"east_m": None}, "Estimate: east_m: Expected `float`, got `null`"),
        ({"t_ns": 0.5}, "Estimate: t_ns: Expected `int`, got `float`"),
        ({"depth_m": np.array([1.0, 2.0])}, "Estimate: depth_m: "),
        ({"covariance": [[1, 2], [3]]}, "Estimate: covariance: "),
        ({"covariance": "P"}, "Estimate: covariance: "),
        ({"heading_rad": 10**9}, "Estimate: heading_rad: Expected `float` <= 10000.0"),
        ({"current": 3}, "Estimate: current: "),
    ],
)
def test_what_is_no_number_gives_a_plan_that_names_the_field(change: dict[str, Any], names: str) -> None:
    controller = Controller(PAPER, DIVE, CONFIG)
    plan = controller.plan(replace(estimate_of(0), **change))
    assert plan.origin is PlanOrigin.ZERO
    assert plan.why.startswith(f"ConfigError: {names}")
    with pytest.raises(ConfigError, match=names.split("`")[0]):
        controller.predict(replace(estimate_of(0), **change), 0)


@pytest.mark.parametrize(
    ("bad", "why"),
    [(None, "Applied: thrust_N[1]: "), ("full", "Applied: thrust_N[1]: ")]
    + [(number, "more than 188 N") for number in (1e9, -190.0, math.nan, -math.inf)],
)
def test_a_report_with_what_is_no_number_is_not_used_and_the_health_says_so(bad: Any, why: str) -> None:
    used, without = (Controller(PAPER, DIVE, CONFIG) for _ in range(2))
    for k in range(3):
        wrong = replace(report(k * 300_000_000, [0.0] * 3), thrust_N=(0.0, bad, 0.0))
        plan = used.plan(estimate_of(k), applied=wrong)
        assert plan.thrust_N.tolist() == without.plan(estimate_of(k)).thrust_N.tolist()
        assert f"a report of the actuators cannot be used: {why}" in plan.health_why
    later = replace(report(900_000_000, [0.0] * 3), t_ns=10**18)
    assert "cannot be used" not in used.plan(estimate_of(3), applied=later).health_why


def test_an_estimate_with_what_is_no_number_is_replaced_by_the_last_good_one() -> None:
    controller = Controller(PAPER, DIVE, CONFIG)
    controller.plan(estimate_of(0))
    plan = controller.plan(replace(estimate_of(1), north_m=None), t_ns=300_000_000)
    assert plan.origin is PlanOrigin.SOLVED
    assert plan.estimate_t_ns == 0
    plan = controller.plan(replace(estimate_of(20), north_m=None), t_ns=6_000_000_000)
    assert "the newest was rejected: Estimate: north_m: Expected" in plan.health_why


def test_a_report_of_later_than_now_is_one_of_now() -> None:
    ahead, right = (Controller(PAPER, DIVE, CONFIG) for _ in range(2))
    for k in range(4):
        t_ns = k * 300_000_000
        plans_of = [
            controller.plan(estimate_of(k), applied=report(t_ns + late_ns, [20.0, 10.0, 0.0]))
            for controller, late_ns in ((ahead, 800_000_000), (right, 0))
        ]
        assert plans_of[0].thrust_N.tolist() == plans_of[1].thrust_N.tolist()


def test_where_no_plan_is_promised_a_wrong_number_raises() -> None:
    with pytest.raises(ConfigError, match="Vehicle: net_buoyancy_N: "):
        Controller(replace(PAPER, net_buoyancy_N="light"), DIVE)
    with pytest.raises(ConfigError, match="Point: north_m: "):
        Controller(PAPER, replace(DIVE, north_m=[1.0]))


@pytest.mark.parametrize("t_ns", [np.int64(300_000_000), 3e8, np.float64(3e8)])
def test_the_time_of_a_cycle_may_be_of_any_type(t_ns: Any) -> None:
    plan = Controller(PAPER, DIVE, CONFIG).plan(estimate_of(0), t_ns=t_ns)
    assert (plan.origin, plan.cycle_t_ns) == (PlanOrigin.SOLVED, 300_000_000)
    assert type(plan.cycle_t_ns) is int


@pytest.mark.parametrize(
    ("profile", "why"),
    [
        (([], [], []), "no valid estimate: current: depth_m (0,): must be (K) with K = 1"),
        (([0.0, 9.0], [0.1], [0.1, 0.1]), "no valid estimate: current: north_mps (1,): must be (K) with K = 2"),
        (([9.0, 0.0], [0.1, 0.0], [0.1, 0.0]), "no valid estimate: current: depth_m: must increase"),
        (([0.0, np.nan], [0.1, 0.0], [0.1, 0.0]), "no valid estimate: current: depth_m: must increase"),
        (([0.0, 9.0], [np.nan, 0.0], [0.1, 0.0]), "no valid estimate: a number is not finite"),
    ],
)
def test_a_current_that_is_no_profile_is_named(profile: tuple[list[float], ...], why: str) -> None:
    depth, north, east = (np.array(row) for row in profile)
    current = CurrentProfile(depth_m=depth, north_mps=north, east_mps=east)
    plan = Controller(PAPER, DIVE, CONFIG).plan(replace(Estimate.at_rest(depth_m=4.0), current=current))
    assert plan.origin is PlanOrigin.ZERO
    assert plan.why.startswith(why)
