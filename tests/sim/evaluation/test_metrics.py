"""Metrics of hand-made messages whose values follow by hand calculation."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest

from ltv_mpc.messages import (
    Applied,
    Clock,
    ClockState,
    CycleTiming,
    Estimate,
    Health,
    Plan,
    PlanOrigin,
    Solve,
    SolveStatus,
    Truth,
)
from ltv_mpc.vehicle.parameters import Vehicle
from sim.evaluation.metrics import RunMetrics
from tests.ltv_mpc.plans import plan_of
from tests.ltv_mpc.reports import report
from tests.ltv_mpc.vehicles import changed
from tests.sim import worlds
from tests.sim.worlds import MS, STILL, S


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return Vehicle.load("paper")


@pytest.fixture
def metrics(vehicle: Vehicle) -> RunMetrics:
    return RunMetrics(vehicle)


def truth(t_ns: int, north_m: float = 0.0, east_m: float = 0.0, **fields: Any) -> Truth:
    return worlds.truth(t_ns, **({"position_m": (north_m, east_m, 7.0)} | fields))


def estimate(t_ns: int, north_m: float = 0.0, east_m: float = 0.0) -> Estimate:
    return msgspec.structs.replace(Estimate.at_rest(north_m=north_m, east_m=east_m), t_ns=t_ns)


def plan(
    cycle_t_ns: int, *, start_ns: int | None = None, status: SolveStatus = SolveStatus.SOLVED, **fields: Any
) -> Plan:
    start_ns = cycle_t_ns if start_ns is None else start_ns
    return plan_of(start_ns, np.zeros((3, 3)), cycle_t_ns=cycle_t_ns, solve=Solve(status=status), **fields)


def applied(
    t_ns: int,
    port_N: float = 0.0,
    starboard_N: float = 0.0,
    *,
    slew: tuple[float, float, float] = STILL,
    taken: tuple[int, int, int] = (0, -1, 0),
    late: int = 0,
    refused: int = 0,
) -> Applied:
    by = dict(zip(("plan_epoch", "plan_sequence", "plan_received_t_ns"), taken, strict=True))
    command_N = (port_N, starboard_N, 50.0)
    return report(t_ns, STILL, command_N, command_slew_N_per_s=slew, plans_late=late, plans_rejected=refused, **by)


def timing(t_ns: int, compute_ns: int, wall_ns: int = 0) -> CycleTiming:
    return CycleTiming(t_ns=t_ns, compute_ns=compute_ns, compute_wall_ns=wall_ns, estimate_age_ns=0, stage_us={})


def feed(metrics: RunMetrics, *signals: object, epoch: int = 1, sequence: int = 0) -> None:
    for signal in signals:
        metrics.observe(signal, epoch=epoch, sequence=sequence)  # type: ignore[arg-type]


@pytest.mark.parametrize("in_places", [False, True])
def test_errors_are_drift_since_the_descent_began_but_of_places_and_the_absolute_one(
    vehicle: Vehicle, in_places: bool
) -> None:
    """The fix at the surface is (10, -4) off. Then the truth drifts by (0, 4), the estimate by (3, 4)."""
    metrics = RunMetrics(vehicle, in_places=in_places)
    feed(metrics, truth(0, 100.0, 200.0), estimate(0, 110.0, 196.0), plan(0, reference_m=(110.0, 196.0)))
    feed(metrics, truth(S, position_m=(100.0, 204.0, 27.0)), estimate(S, 113.0, 200.0))  # depth is in no error
    tracking, true, true_drift, localisation, absolute = metrics.track.errors().values()
    assert tracking.final == pytest.approx(5.0)  # the estimate is (3, 4) off the line
    assert true_drift.final == pytest.approx(4.0)  # the truth has left its own start by (0, 4)
    assert true.final == pytest.approx(np.hypot(-10.0, 8.0) if in_places else 4.0)
    assert localisation.final == pytest.approx(3.0)  # the estimate has drifted from the truth by (3, 0)
    assert absolute.final == pytest.approx(np.hypot(13.0, -4.0))


def test_mean_maximum_and_final_are_over_the_estimates_after_zero(metrics: RunMetrics) -> None:
    feed(metrics, plan(0, reference_m=(0.0, 0.0)))
    for t_s, north_m in ((-1, 50.0), (0, 0.0), (1, 1.0), (2, 6.0), (3, 2.0)):
        feed(metrics, truth(t_s * S), estimate(t_s * S, north_m, 0.0))
    tracking = metrics.track.errors()["tracking_error_m"]
    assert (tracking.mean, tracking.max, tracking.final) == pytest.approx((3.0, 6.0, 2.0))


def test_the_truth_at_an_estimates_time_is_interpolated(metrics: RunMetrics) -> None:
    feed(metrics, truth(0), truth(2 * S, 8.0, 0.0), estimate(0), estimate(S))
    assert metrics.track.errors()["localisation_error_m"].final == pytest.approx(4.0)


def test_the_reference_is_that_of_the_newest_plan_and_before_the_first_that_one(metrics: RunMetrics) -> None:
    feed(metrics, plan(-S, reference_m=None), plan(2 * S, reference_m=(1.0, 0.0)), plan(4 * S, reference_m=(5.0, 0.0)))
    for t_s in range(6):
        feed(metrics, truth(t_s * S), estimate(t_s * S))
    tracking = metrics.track.errors()["tracking_error_m"]
    assert tracking.mean == pytest.approx((1 + 1 + 1 + 5 + 5) / 5)


def test_the_target_of_a_path_moves_evenly_from_plan_to_plan_at_their_first_knots(metrics: RunMetrics) -> None:
    for t_s, north in ((0, 0.0), (2, 4.0), (4, 8.0)):
        path = plan(t_s * S, start_ns=t_s * S + S, reference_m=(north, 0.0))
        feed(metrics, msgspec.structs.replace(path, progress=north / 10.0))
    feed(metrics, truth(0), estimate(0))
    for t_s, north in ((2, 2.0), (3, 4.0), (4, 6.5)):
        feed(metrics, truth(t_s * S, north, 0.0), estimate(t_s * S, north, 0.0))
    tracking = metrics.track.errors()["tracking_error_m"]
    assert tracking.max == pytest.approx(0.5)
    assert tracking.mean == pytest.approx(0.5 / 3)


def test_without_any_reference_the_line_passes_through_the_estimate_at_zero(metrics: RunMetrics) -> None:
    for t_s in range(3):
        feed(metrics, truth(t_s * S), estimate(t_s * S, 7.0 + t_s, 0.0))
    assert metrics.track.errors()["tracking_error_m"].final == pytest.approx(2.0)


def test_a_run_that_never_left_the_surface_has_no_figures(metrics: RunMetrics) -> None:
    feed(metrics, truth(-S), estimate(-S), applied(-S, 3.0))
    assert {error.mean for error in metrics.track.errors().values()} == {None}
    assert metrics.commands.thrust().mean_abs_N is None
    assert metrics.delays.end_to_end().median is None
    assert metrics.track.until_ns == -S


def test_the_energy_is_that_of_revolutions_and_torque_from_zero_on(metrics: RunMetrics) -> None:
    """Full thrust of port and of the vertical thruster for 4 s, at 0.5 m/s ahead: 101.06 W and 85.86 W."""
    for t_s in range(-1, 5):
        report = msgspec.structs.replace(applied(t_s * S, 62.5, 0.0), thrust_N=(62.5, 0.0, 62.5))
        feed(metrics, truth(t_s * S, water_velocity_mps=(0.5, 0.1, 0.0)), report)
    thrust = metrics.commands.thrust()
    assert thrust.lateral_energy_J == pytest.approx(4 * 101.06, abs=0.1)
    assert thrust.propulsive_energy_J == pytest.approx(4 * (101.06 + 85.86), abs=0.1)
    assert thrust.relative_power == pytest.approx(0.5)


def test_thrust_figures_are_over_time_of_the_lateral_commands_from_zero_on(metrics: RunMetrics) -> None:
    feed(
        metrics,
        applied(-1 * S, 62.5, 62.5, slew=(999.0, 999.0, 0.0)),
        applied(0 * S, 0.0, 0.0, slew=(999.0, 999.0, 0.0)),
        applied(1 * S, 10.0, -20.0, slew=(40.0, 30.0, 999.0)),
        applied(2 * S, 62.5, -20.0, slew=(52.5, 0.0, 999.0)),
        applied(4 * S, 62.5 - 0.9e-6, 20.0, slew=(0.0, 82.5, 999.0)),
        applied(5 * S, 0.0, 0.0, slew=(62.5, 20.0, 999.0)),
    )
    thrust = metrics.commands.thrust()
    assert thrust.saturated_fraction == pytest.approx(2 / 5)
    assert thrust.max_abs_N == 62.5
    port_Ns = 5.0 + 36.25 + 125.0 + 31.25
    starboard_Ns = 10.0 + 20.0 + 20.0 + 10.0  # from -20 to 20 N in 2 s: 10 N in the mean
    assert thrust.mean_abs_N == pytest.approx((port_Ns + starboard_Ns) / (2 * 5))
    assert thrust.travel_N == pytest.approx((10 + 52.5 + 62.5) + (20 + 40 + 20))
    assert thrust.max_slew_N_per_s == 82.5


def test_the_delivered_slew_is_that_of_the_lateral_thrust_from_zero_on(metrics: RunMetrics) -> None:
    at_ms = {
        -10: (0.0, 0.0, 0.0),
        0: (9.0, 0.0, 0.0),
        10: (10.0, 0.5, 0.0),
        20: (10.5, -1.2, 62.5),
        30: (10.5, -1.2, 0.0),
    }
    for ms, thrust_N in at_ms.items():
        feed(metrics, truth(ms * MS, thrust_N=thrust_N))
    feed(metrics, applied(0), applied(S))
    assert metrics.commands.thrust().max_delivered_slew_N_per_s == pytest.approx(170.0)


def test_a_command_inside_the_box_or_between_its_bounds_is_not_saturated(metrics: RunMetrics) -> None:
    inside_N = 62.5 - 2e-6
    for t_s, port_starboard_N in enumerate(((inside_N, 62.5), (inside_N, -62.5), (-inside_N,) * 2, (-inside_N,) * 2)):
        feed(metrics, applied(t_s * S, *port_starboard_N))
    assert metrics.commands.thrust().saturated_fraction == 0.0


def test_each_thruster_is_held_against_its_own_box(vehicle: Vehicle) -> None:
    metrics = RunMetrics(changed(vehicle, {"thruster.starboard.max_N": 20.0, "thruster.starboard.min_N": -10.0}))
    feed(metrics, applied(0, 20.0, 0.0), applied(S, 20.0, 20.0), applied(2 * S, 0.0, 20.0))
    feed(metrics, applied(3 * S, -10.0, -10.0), applied(4 * S, -10.0, -10.0))
    assert metrics.commands.thrust().saturated_fraction == 0.5


def test_a_vertical_thruster_at_its_limit_counts_by_itself(metrics: RunMetrics) -> None:
    for t_s, vertical_N in enumerate((62.5, 62.5, 62.5, 10.0, -62.5, -62.5)):
        feed(metrics, msgspec.structs.replace(applied(t_s * S), command_N=(0.0, 0.0, vertical_N)))
    thrust = metrics.commands.thrust()
    assert thrust.vertical_saturated_fraction == pytest.approx(3 / 5)
    assert thrust.saturated_fraction == 0.0


def test_a_surface_craft_has_no_vertical_thruster_to_be_at_a_limit() -> None:
    metrics = RunMetrics(Vehicle.load("surface"))
    feed(metrics, applied(0), applied(S))
    assert metrics.commands.thrust().vertical_saturated_fraction is None


def test_end_to_end_delay_ends_at_the_plans_start_or_its_later_arrival(metrics: RunMetrics) -> None:
    feed(metrics, plan(1000 * MS, start_ns=1400 * MS, estimate_t_ns=900 * MS), epoch=7, sequence=0)
    feed(metrics, plan(2000 * MS, start_ns=2400 * MS, estimate_t_ns=1900 * MS), epoch=7, sequence=1)
    feed(metrics, applied(1390 * MS, taken=(7, 0, 1350 * MS)))  # in time: takes effect at its start
    feed(metrics, applied(1490 * MS, taken=(7, 0, 1350 * MS)))  # the same plan again is no other plan
    feed(metrics, applied(2690 * MS, taken=(7, 1, 2600 * MS)))  # late: takes effect when it arrives
    feed(metrics, applied(2700 * MS, taken=(8, 0, 0)))  # of another epoch: unknown
    delay = metrics.delays.end_to_end()
    assert (delay.median, delay.max) == pytest.approx(((0.5 + 0.7) / 2, 0.7))


def test_wall_delays_are_vehicle_delays_divided_by_the_clock_speed_then(vehicle: Vehicle) -> None:
    metrics = RunMetrics(vehicle, speed=10.0)
    feed(metrics, plan(0, start_ns=S, estimate_t_ns=0), sequence=0)
    feed(metrics, applied(S, taken=(1, 0, 0)))
    assert metrics.delays.end_to_end(wall=True).max == pytest.approx(0.1)
    slower = clock(at_us=0, vehicle_ns=0, state=ClockState.RUNNING)
    feed(metrics, slower, plan(2 * S, start_ns=3 * S, estimate_t_ns=S), sequence=1)
    feed(metrics, applied(3 * S, taken=(1, 1, 0)))
    assert metrics.delays.end_to_end(wall=True).max == pytest.approx(2.0 / 2.5)
    assert metrics.delays.end_to_end().max == pytest.approx(2.0)


def test_the_speed_reached_is_that_from_the_start_to_the_last_change_of_the_clock(vehicle: Vehicle) -> None:
    metrics = RunMetrics(vehicle, speed=10.0)
    assert metrics.clock.reached() is None
    waiting = clock(at_us=0, vehicle_ns=-S, state=ClockState.WAITING)
    feed(metrics, waiting)
    assert metrics.clock.reached() is None
    feed(metrics, clock(at_us=3_000_000, vehicle_ns=-S, state=ClockState.RUNNING))
    feed(metrics, clock(at_us=4_000_000, vehicle_ns=4 * S, state=ClockState.RUNNING))
    feed(metrics, clock(at_us=5_000_000, vehicle_ns=5 * S, state=ClockState.PAUSED))
    assert metrics.clock.reached() == pytest.approx(3.0)


def clock(*, at_us: int, vehicle_ns: int, state: ClockState) -> Clock:
    """At two and a half times real time, of ten."""
    return Clock(
        clock_epoch=1,
        clock_sequence=1,
        host_boot_id="",
        at_monotonic_us=at_us,
        vehicle_ns=vehicle_ns,
        speed_num=5,
        speed_den=2,
        requested_speed=10.0,
        state=state,
    )


def test_compute_delay_has_median_p99_and_max_in_vehicle_and_wall_seconds(metrics: RunMetrics) -> None:
    for ms in range(1, 101):
        feed(metrics, timing(0, compute_ns=10 * ms * MS, wall_ns=ms * MS))
    vehicle, wall = metrics.delays.compute(), metrics.delays.compute(wall=True)
    assert (vehicle.median, vehicle.max) == pytest.approx((0.505, 1.0))
    assert vehicle.p99 == pytest.approx(0.9901)  # linear between the 99th and the 100th of 100
    assert (wall.median, wall.max) == pytest.approx((0.0505, 0.1))


def test_cycles_are_counted_by_solver_status_and_by_origin_of_the_plan(metrics: RunMetrics) -> None:
    feed(metrics, plan(-S, status=SolveStatus.NOT_RUN, origin=PlanOrigin.ZERO), sequence=0)
    feed(metrics, plan(0), sequence=1)
    feed(metrics, plan(S), sequence=2)
    feed(metrics, plan(2 * S, status=SolveStatus.ITERATION_LIMIT, origin=PlanOrigin.SHIFTED), sequence=3)
    assert metrics.cycles == 4
    assert metrics.qp_status == {"not_run": 1, "solved": 2, "iteration_limit": 1}
    assert metrics.plan_origin == {"zero": 1, "solved": 2, "shifted": 1}


def test_plans_are_counted_by_health_and_the_first_that_has_arrived_says_when(metrics: RunMetrics) -> None:
    assert metrics.track.arrived_s is None
    late = {"arrived": True, "health": Health.DEGRADED, "health_why": "hold: leak"}
    for sequence, (t_ns, fields) in enumerate(((0, {}), (S, late), (2 * S, late), (3 * S, {}), (4 * S, late))):
        feed(metrics, plan(t_ns, **fields), sequence=sequence)
    assert metrics.health == {"nominal": 2, "degraded: hold: leak": 3}
    assert metrics.track.arrived_s == 1.0


def test_misses_and_refusals_are_the_plants_last_word(metrics: RunMetrics) -> None:
    feed(metrics, applied(0, late=1), applied(S, late=3, refused=2))
    assert (metrics.deadline_misses, metrics.plans_refused) == (3, 2)
