"""Scenarios of the foreign craft in lock step: what each may cost."""

from __future__ import annotations

from itertools import groupby
from math import cos, hypot, sin
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.messages import Health, ModelCheck, Plan
from tests.foreign_plant.flight import (
    CORNERS,
    CURRENT_MPS,
    HULL,
    SIDE_M,
    SPEED_MPS,
    Flight,
    Source,
    distance_from_outline_m,
    farthest_m,
)
from tests.foreign_plant.mavlink_flight import BAD, MavlinkFlight
from tests.foreign_plant.plant import STEP_S, Sender

AWAY: dict[str, Any] = {"heading_rad": 1.0, "start_m": (3.0, -2.0)}
"""Start 3.6 m from the point."""


def off_north(flight: Flight, metres: float) -> Source:
    """Return another publisher of the estimate, which is as far to the north."""
    hull = flight.hull
    return "estimate", Sender(), lambda t_ns: {**hull.estimate(t_ns), "north_m": float(hull.x[0]) + metres}


def not_of_the_newest(flight: Flight) -> int:
    """Return the number of cycles whose estimate is not the newest of the true publisher."""
    return sum(plan.cycle_t_ns - plan.estimate_t_ns > 250_000_000 for plan in flight.plans[10:])


def seconds_of(flight: Flight, health: str) -> float:
    return 0.3 * sum(plan.health == health for plan in flight.plans[66:])


# --- hold and square -------------------------------------------------------------------------------------------------


def test_a_square_is_followed_from_a_hover_with_the_bow_into_the_current() -> None:
    """With the effort "high" and 5 s of horizon; with the defaults it is up to 0.27 m beside a straight part."""
    flight = Flight(config=ControllerConfig(horizon_s=5.1, effort="high"), armed=True)
    flight.fly(30.0)
    hovered = len(flight.plans)
    flight.follow_square()
    track = flight.fly(115.0)
    following = [plan for plan in flight.plans[hovered:] if plan.progress is not None]
    times_s = np.array([plan.t_ns[0] - following[0].t_ns[0] for plan in following]) * 1e-9
    progress = np.array([plan.progress for plan in following])
    begin_s, end_s = times_s[progress > 0.001][0], times_s[progress >= 0.999][0]
    t_s = STEP_S * np.arange(len(track))
    lap = track[(t_s >= begin_s) & (t_s <= end_s)]
    off_m, corner_m = distance_from_outline_m(lap), np.linalg.norm(lap[:, None] - CORNERS, axis=2)
    assert off_m.max() < 0.5
    assert off_m[corner_m.min(axis=1) > 3.0].max() < 0.15  # away from arcs and turns
    assert corner_m.min(axis=0).max() < 0.6  # each is passed
    assert end_s - begin_s < 1.25 * 4 * SIDE_M / SPEED_MPS


def test_over_a_bad_link_to_an_autopilot_it_holds_and_follows() -> None:
    """Along two legs of the square."""
    flight = MavlinkFlight(faults=BAD, config=ControllerConfig(effort="high"), **AWAY)
    flight.fly(5.0)
    flight.arm()
    flight.command(action="arm")
    flight.fly(25.0)
    assert farthest_m(flight.fly(15.0)) < 0.5
    flight.follow_square()
    assert distance_from_outline_m(flight.fly(45.0)).max() < 0.8
    assert flight.edge.refused == 0
    assert flight.edge.lost / flight.frames["to edge"] <= 1.1 * BAD.lost + 0.001


# --- estimates -------------------------------------------------------------------------------------------------------


def test_dropouts_of_5_s_are_carried_and_of_30_s_end_at_rest_each_change_told_once() -> None:
    flight = Flight(armed=True)
    flight.fly(20.0)
    sources, flight.sources = flight.sources, []
    short = flight.fly(5.0)
    flight.sources = sources
    assert farthest_m(np.concatenate([short, flight.fly(10.0)])) < 0.15
    began, flight.sources = len(flight.plans) - 1, []
    flight.fly(20.5)  # until it lets go
    assert hypot(*flight.hull.x[7:9]) < 0.1
    flight.fly(9.5)
    flight.sources = sources
    flight.fly(1.0)
    told = [health for (health, _), _ in groupby((plan.health, plan.health_why) for plan in flight.plans[began:])]
    assert told == ["nominal", "degraded", "hold", "failsafe", "nominal"]


def test_a_flood_of_2000_frames_a_second_under_another_epoch_moves_nothing() -> None:
    flight = Flight(armed=True)
    flight.fly(25.0)
    before = flight.validator.received
    flight.sources += [off_north(flight, 2.0)] * 200
    flight.fly(5.0)
    assert flight.validator.received - before <= 5 * 150
    del flight.sources[1:]
    flight.fly(15.0)
    assert farthest_m(flight.track[1000:]) < 0.3
    assert not_of_the_newest(flight) == 0


def test_a_second_source_30_m_away_is_reported_and_not_followed() -> None:
    """For ten seconds."""
    flight = Flight(armed=True)
    flight.fly(25.0)
    begin = len(flight.plans)
    flight.sources.append(off_north(flight, 30.0))
    flight.fly(10.0)
    end = len(flight.plans)
    del flight.sources[1:]
    flight.fly(15.0)
    assert farthest_m(flight.track[1000:]) < 0.3
    assert not_of_the_newest(flight) == 0
    assert sum("second source on estimate" not in plan.health_why for plan in flight.plans[begin:end]) <= 4


@pytest.mark.parametrize(("reports", "behind_s"), [(False, -5.0), (True, 60.0)])
def test_a_restarted_source_is_followed_also_with_a_clock_of_its_own(reports: bool, behind_s: float) -> None:
    flight = Flight(reports=reports, armed=True)
    flight.fly(25.0)
    begin, hull = len(flight.plans) - 1, flight.hull
    flight.sources = [("estimate", Sender(), lambda t_ns: hull.estimate(t_ns + round(behind_s * 1e9)))]
    flight.fly(7.0)
    assert max(plan.cycle_t_ns - plan.estimate_t_ns for plan in flight.plans[begin:]) < 1_500_000_000
    assert farthest_m(flight.track[1000:]) < 0.3


def antenna_flight(
    folder: Path, antenna_m: tuple[float, float], *, declared: bool, tells_current: bool = False
) -> tuple[Flight, list[tuple[float, float]]]:
    """Return a flight whose estimates are those of an antenna, and the list to which it adds its thrusts."""
    file = folder / "craft.toml"
    table = "\n[reference_point]\nforward_m = {}\nstarboard_m = {}\n".format(*antenna_m)
    file.write_text(HULL.read_text() + (table if declared else ""))
    flight, thrusts_N, (x, y) = Flight(vehicle=file, armed=True, **AWAY), [], antenna_m
    north_mps, east_mps = CURRENT_MPS
    current = {"current": {"depth_m": [0.0], "north_mps": [north_mps], "east_mps": [east_mps]}}

    def estimate(t_ns: int) -> dict[str, Any]:
        thrusts_N.append(flight.hull.thrust_N)
        fields = flight.hull.estimate(t_ns)
        heading, r = fields["heading_rad"], fields["yaw_rate_radps"]
        north, east = x * cos(heading) - y * sin(heading), x * sin(heading) + y * cos(heading)
        fields["north_m"] += north
        fields["east_m"] += east
        fields["velocity_north_mps"] -= r * east
        fields["velocity_east_mps"] += r * north
        return fields | (current if tells_current else {})

    flight.sources = [("estimate", flight.sender, estimate)]
    return flight, thrusts_N


def held(flight: Flight, thrusts_N: list[tuple[float, float]]) -> tuple[float, float]:
    """Return the largest distance (m) and the mean abs thrust (N), from 40 s to 55 s."""
    flight.fly(40.0)
    thrusts_N.clear()
    return farthest_m(flight.fly(15.0)), float(np.abs(thrusts_N).mean())


def test_a_declared_antenna_costs_nothing_and_another_is_named(tmp_path: Path) -> None:
    _, centre_N = held(*antenna_flight(tmp_path, (0.0, 0.0), declared=False))
    off_m, mean_N = held(*antenna_flight(tmp_path, (0.5, 0.5), declared=True))
    assert off_m < 0.05
    assert mean_N < 1.1 * centre_N
    undeclared, _ = antenna_flight(tmp_path, (0.5, 0.5), declared=False, tells_current=True)
    undeclared.fly(61.0)
    checks = [check for check in undeclared.outputs if isinstance(check, ModelCheck) and check.alarm]
    first = next(check for check in checks if "[reference_point]" in check.why)
    assert first.t_ns - undeclared.plans[0].cycle_t_ns < 60_000_000_000


# --- actuators -------------------------------------------------------------------------------------------------------


def time_s(plans: list[Plan], *, nominal: bool) -> float:
    """Return the time from the first plan to the one from which on all are nominal, or none is."""
    last = max((plan.cycle_t_ns for plan in plans if (plan.health is Health.NOMINAL) is not nominal), default=None)
    return 0.0 if last is None else (last - plans[0].cycle_t_ns) * 1e-9 + 0.3


def test_actuators_that_refuse_every_plan_degrade_the_health_with_the_reason() -> None:
    flight = Flight(armed=True)
    flight.fly(20.0)
    assert {plan.health for plan in flight.plans[10:]} == {Health.NOMINAL}
    flight.accepts, flight.plans = lambda _plan: False, []
    flight.fly(10.0)
    refused, flight.plans = flight.plans, []
    flight.accepts = lambda _plan: True
    flight.fly(20.0)
    assert time_s(refused, nominal=False) <= 1.5
    assert {plan.health_why for plan in refused if plan.health is Health.DEGRADED} == {"the actuators reject plans"}
    assert time_s(flight.plans, nominal=True) <= 1.5
    assert farthest_m(flight.track[-500:]) < 0.3


def test_a_weak_thruster_in_the_hold_is_named_and_forgotten_when_it_has_recovered() -> None:
    """Starboard delivers a quarter of what it reports for half a minute; half of that small thrust is not found."""
    flight = Flight(armed=True)
    flight.fly(30.0)
    flight.hull.plant.outside[4:] = 1.0, 0.25
    assert farthest_m(flight.fly(30.0)) < 0.1
    flight.hull.plant.outside[4:] = 1.0, 1.0
    assert farthest_m(flight.fly(40.0)) < 0.05
    begin_ns = flight.plans[0].cycle_t_ns
    weak = [plan for plan in flight.plans if "starboard thruster weak" in plan.health_why]
    weak_s = [(plan.cycle_t_ns - begin_ns) * 1e-9 for plan in weak]
    assert 30.0 <= min(weak_s) < 45.0
    assert max(weak_s) < 90.0


def test_a_healthy_craft_in_a_known_current_gives_no_evidence_of_a_loss() -> None:
    """The vehicle file is a data sheet, so only the yaw moment tells of a loss."""
    flight = Flight(armed=True)
    north_mps, east_mps = CURRENT_MPS
    current = {"depth_m": [0.0], "north_mps": [north_mps], "east_mps": [east_mps]}
    estimate = flight.hull.estimate
    flight.sources = [("estimate", flight.sender, lambda t_ns: {**estimate(t_ns), "current": current})]
    flight.fly(30.0)
    flight.follow_square()
    flight.fly(12.0)
    begin = len(flight.outputs)
    flight.fly(60.0)
    checks = [message for message in flight.outputs[begin:] if isinstance(message, ModelCheck)]
    assert max(check.evidence for check in checks) < 6.0


# --- steps of the craft's clock --------------------------------------------------------------------------------------


@pytest.mark.parametrize("step_s", [-0.05, 5.0])
def test_two_way_a_step_above_the_clock_error_is_certain_and_degrades_for_a_second(step_s: float) -> None:
    flight = Flight(delay_us=20_000, armed=True)  # a longer exchange would not tell a step of 0.05 s
    flight.fly(20.0)
    error_ns = flight.clock_offset.error_ns
    assert error_ns is not None
    assert error_ns < abs(step_s) * 1e9
    flight.set_clock(step_s)
    flight.fly(10.0)
    (clock_step,) = flight.clock_steps
    assert clock_step.certain
    assert clock_step.step_ns == pytest.approx(step_s * 1e9, abs=min(error_ns + 1_000_000, 50_000_000))
    assert seconds_of(flight, "failsafe") == seconds_of(flight, "hold") == 0.0
    assert seconds_of(flight, "degraded") <= 1.0
    assert farthest_m(flight.track[1000:]) < 0.3


def test_one_way_a_small_step_backwards_is_followed_and_moves_nothing() -> None:
    """Stamps that are later by a constant could be a slower link; the reported error is null. The offset follows."""
    flight = Flight(reports=False, armed=True)
    flight.fly(20.0)
    flight.set_clock(-0.2)
    flight.fly(35.0)
    assert flight.clock_offset.error_ns is None
    assert flight.clock_offset.offset_ns == pytest.approx(flight.craft_ns - flight.host_us * 1000, abs=1_000_000)
    assert farthest_m(flight.track[1000:]) < 0.05
    periods_s = np.diff([plan.cycle_t_ns for plan in flight.plans]) * 1e-9
    assert periods_s.min() >= 0.0  # vehicle time never steps back


@pytest.mark.parametrize("step_s", [-86_400.0, -5.0, 5.0])
def test_one_way_a_step_backwards_is_doubtful_for_ten_seconds(step_s: float) -> None:
    flight = Flight(reports=False, delay_us=20_000, armed=True)
    flight.fly(20.0)
    flight.set_clock(step_s)
    flight.fly(15.0)
    doubtful = -10.0 < step_s < 0.0
    assert [clock_step.certain for clock_step in flight.clock_steps] == [not doubtful]
    assert seconds_of(flight, "failsafe") == seconds_of(flight, "hold") == 0.0
    assert seconds_of(flight, "degraded") == pytest.approx(10.5 if doubtful else 0.3, abs=0.8)
    assert farthest_m(flight.track[1000:]) < 1.0
