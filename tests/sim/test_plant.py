"""Plant as a node: its reaction to plans and disturbances, and its messages with their times."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from ltv_mpc import frames
from ltv_mpc.array_encoding import to_wire
from ltv_mpc.messages import Applied, Disturbance, Truth
from ltv_mpc.node import ReceivedMessage
from ltv_mpc.vehicle.parameters import Vehicle
from sim.plant import PERIOD_NS, STEP_NS, Plant
from sim.scenario import Scenario
from sim.water import make
from tests.ltv_mpc.plans import plan_of
from tests.sim.worlds import MS, S, plant_of
from tests.stepping import feed

ENCODE = msgspec.json.Encoder(enc_hook=to_wire).encode
VEHICLE = Vehicle.load("paper")
WATER = make(Scenario.load("descent").water, 0)


def arrival(start_ns: int, thrust, *, sequence: int = 0, received_ns: int | None = None) -> ReceivedMessage:
    plan = plan_of(start_ns, thrust, cycle_t_ns=start_ns - 5)
    return ReceivedMessage(plan, 77, sequence, start_ns if received_ns is None else received_ns)


def run(plant: Plant, until_ns: int, arrivals: dict[int, list[ReceivedMessage]], period_ns: int = STEP_NS):
    """Return all truths, and all reports of the actuators; ``arrivals`` are the inboxes by step."""
    said = feed(plant, ((t, arrivals.get(t, [])) for t in range(-S, until_ns + 1, period_ns)))
    return [x for x in said if isinstance(x, Truth)], [x for x in said if isinstance(x, Applied)]


def dive(*settings: str, until_s: int, thrust) -> list[Truth]:
    """Return the truths of a vehicle that is sent a plan every four seconds: thrusts at its first knots, then held."""
    first = [[0, 0, 0], *thrust, *[thrust[-1]] * 18]
    plans = {0: [arrival(0, first)]}
    plans |= {t: [arrival(t, [thrust[-1]] * 20, sequence=t // S)] for t in range(4 * S, until_s * S, 4 * S)}
    return run(plant_of(*settings), until_s * S, plans)[0]


RAMP = [[0, 0, 0], [30, -30, 30], [60, -60, 60], [60, -60, 60]]


def test_truth_comes_every_ten_milliseconds_and_the_report_every_hundred():
    truths, reports = run(plant_of(), S, {})
    assert [x.t_ns for x in truths] == list(range(-S, S + 1, 10 * MS))
    assert [x.t_ns for x in reports] == list(range(-S, S + 1, 100 * MS))


@pytest.mark.parametrize("depth", [0.0, 12.6])
def test_before_the_descent_the_vehicle_drifts_with_the_water_at_its_depth(depth):
    plant = plant_of("plant.heading_rad=0.7", "plant.north_m=3", f"plant.depth_m={depth}")
    truths, reports = run(plant, 0, {-900 * MS: [arrival(-900 * MS, [[20, 20, 20]] * 9)]})
    north, east = WATER.at(depth, 0)
    assert truths[-1].position_m == pytest.approx((3.0 + north, east, depth))
    assert truths[-1].velocity_mps == pytest.approx((north, east, 0.0))
    assert truths[-1].attitude_rad[2] == 0.7
    assert not np.any([(x.command_N, x.thrust_N) for x in reports])


def test_it_follows_a_plan_to_its_end_and_then_ramps_down_at_the_slew_limit():
    _, reports = run(plant_of(), 2 * S, {0: [arrival(0, RAMP)]})
    commands = {x.t_ns // MS: x.command_N[0] for x in reports}
    assert [commands[ms] for ms in (300, 900, 1000, 1400, 1500)] == pytest.approx([30, 60, 50, 10, 0], abs=1e-9)
    assert all(x.command_N == pytest.approx(np.multiply(x.command_N[0], (1, -1, 1))) for x in reports)
    slews = np.array([x.command_slew_N_per_s for x in reports])
    assert slews.max() == pytest.approx(100.0, abs=1e-9)
    assert slews[-1].max() == 0.0


def test_five_steps_at_once_take_each_plan_with_the_step_in_which_it_has_arrived():
    """A message that came later stays behind the one before it, even if the clock read less."""
    received_ms = (215, 232, 228)
    plans = [arrival(ms * MS - 5, RAMP, sequence=i, received_ns=ms * MS) for i, ms in enumerate(received_ms)]
    one = run(plant_of(), S, {220 * MS: plans[:1], 240 * MS: plans[1:]})
    other = run(plant_of(), S, {250 * MS: plans}, PERIOD_NS)
    assert ENCODE(other) == ENCODE(one)
    assert len([x for x in other[1] if x.t_ns % (100 * MS)]) == 2


def test_a_plan_is_answered_in_the_step_it_arrives_in():
    plan = arrival(220 * MS, RAMP, sequence=5, received_ns=215 * MS)
    reports = {x.t_ns: x for x in run(plant_of(), 500 * MS, {230 * MS: [plan]})[1]}
    before, receipt = reports[200 * MS], reports[230 * MS]
    assert (before.plan_epoch, before.plan_sequence, before.plan_late) == (0, -1, False)
    assert (receipt.plan_epoch, receipt.plan_sequence, receipt.plan_late) == (77, 5, False)
    assert (receipt.plan_received_t_ns, receipt.plan_cycle_t_ns) == (215 * MS, 220 * MS - 5)
    assert (receipt.plans_late, receipt.plans_rejected) == (0, 0)


def test_a_late_plan_is_counted_and_does_not_make_the_command_jump():
    _, reports = run(plant_of(), S, {430 * MS: [arrival(0, RAMP, received_ns=425 * MS)]})
    (receipt,) = (x for x in reports if x.t_ns == 430 * MS)
    assert (receipt.plan_late, receipt.plans_late) == (True, 1)
    assert receipt.command_N[0] == pytest.approx(0.5)  # in force from its arrival on: 5 ms at 100 N/s
    assert all(max(x.command_slew_N_per_s) <= 100 + 1e-9 for x in reports)


def test_refused_plans_are_counted_and_change_nothing():
    inboxes = {
        0: [arrival(0, [[0, 0, 0], *[[20, 20, 20]] * 9], sequence=3)],
        500 * MS: [arrival(500 * MS, RAMP, sequence=3)],
        510 * MS: [arrival(500 * MS, [[20, 20, 20], [70, 20, 20]], sequence=4)],
        520 * MS: [arrival(500 * MS, [[20, 20, 20], [51, 20, 20]], sequence=5)],
    }
    last = run(plant_of(), S, inboxes)[1][-1]
    assert (last.plan_sequence, last.plans_rejected, last.plans_late) == (3, 3, 0)
    assert last.command_N == (20.0, 20.0, 20.0)


def test_velocity_over_ground_is_that_through_water_plus_the_current_at_depth():
    plant = plant_of("plant.heading_rad=2", "plant.depth_m=7.4")
    truths, _ = run(plant, 3 * S, {0: [arrival(0, [[0, 0, 0], *[[30, 20, 10]] * 9])]})
    for x in truths[::25]:
        assert x.current_mps == WATER.at(x.position_m[2], x.t_ns)
        over_ground = frames.rotation(0.0, 0.0, x.attitude_rad[2]) @ x.water_velocity_mps + np.array(
            [*x.current_mps, 0]
        )
        assert x.velocity_mps == pytest.approx(tuple(over_ground))


def test_a_stronger_plant_delivers_no_more_than_its_limits():
    ramp = [[30, 30, 30], [60, 60, 60], [62.5, 62.5, 62.5]]
    strong, usual = (dive(*of, until_s=4, thrust=ramp) for of in (["plant.mismatch.thrust=1.1"], []))
    delivered = np.array([x.thrust_N for x in strong])
    assert delivered.max(axis=0) == pytest.approx([thruster.max_N for thruster in VEHICLE.thrusters])
    # The motion too: the acceleration at the surface is that of the delivered thrust.
    assert strong[-1].water_velocity_mps[2] < 1.04 * usual[-1].water_velocity_mps[2]


def disturbed(
    *settings: str, until_ns: int, disturbance: Disturbance | None = None, at_ns: int = 0, thrust=None
) -> dict[int, Truth]:
    """Return the truths, by time, of a vehicle at 20 m in still water that ramps to a thrust in 9 s."""
    inboxes = {}
    if thrust is not None:
        inboxes[0] = [arrival(0, np.outer(np.minimum(np.arange(41) * 30.0 / max(thrust), 1.0), thrust))]
    if disturbance is not None:
        inboxes[at_ns] = [*inboxes.get(at_ns, []), ReceivedMessage(disturbance, 9, 0, at_ns)]
    truths, _ = run(plant_of("water.sd_mps=0", "plant.depth_m=20", *settings), until_ns, inboxes)
    return {x.t_ns: x for x in truths}


def test_a_short_push_changes_the_momentum_by_its_impulse():
    """f dt = M dv along each axis of the body, m dt = I dr; damping of a vehicle at rest is of second order."""
    push = Disturbance(end_t_ns=S // 10, force_N=(40.0, -30.0, 20.0), yaw_moment_Nm=15.0)
    heading, M = 0.7, VEHICLE.coefficients()
    moved, still = (  # without the push it rises by its buoyancy
        disturbed("plant.heading_rad=0.7", until_ns=S // 10, disturbance=one)[S // 10] for one in (push, None)
    )
    ahead = 40.0 * math.cos(heading) - 30.0 * math.sin(heading)
    to_starboard = -30.0 * math.cos(heading) - 40.0 * math.sin(heading)
    expected = (0.1 * ahead / M.mass_surge, 0.1 * to_starboard / M.mass_sway, 0.1 * 20.0 / M.mass_heave)
    gained = np.subtract(moved.water_velocity_mps, still.water_velocity_mps)
    assert gained.tolist() == pytest.approx(expected, rel=0.03)
    assert moved.yaw_rate_radps == pytest.approx(0.1 * 15.0 / M.inertia_yaw, rel=0.05)


def test_lost_thrust_moves_the_vehicle_as_one_whose_propellers_give_less():
    """The plant's own factor on thrust, which goes through its integrator, is the other way to the same motion."""
    lost = Disturbance(end_t_ns=60 * S, thrust_scale=(0.5, 0.6, 0.5))
    of = {"until_ns": 8 * S, "thrust": (40.0, 25.0, 30.0)}
    here = disturbed(disturbance=lost, **of)
    there = disturbed("plant.mismatch.thrust=0.5", "plant.mismatch.starboard_thrust=1.2", **of)
    for t in (2 * S, 5 * S, 8 * S):
        np.testing.assert_allclose(here[t].position_m, there[t].position_m, atol=2e-4)
        np.testing.assert_allclose(here[t].thrust_N, there[t].thrust_N, rtol=1e-2)
    assert np.linalg.norm(np.subtract(disturbed(**of)[8 * S].position_m, here[8 * S].position_m)) > 0.5


def test_a_disturbance_ends_when_it_says_and_leaves_no_bit_changed_before_it_comes():
    push = Disturbance(end_t_ns=3 * S, force_N=(50.0, 0.0, 0.0))
    here, there = disturbed(until_ns=6 * S, disturbance=push, at_ns=2 * S), disturbed(until_ns=6 * S)
    assert all(ENCODE(here[t]) == ENCODE(there[t]) for t in there if t <= 2 * S)
    speed = {t: here[t].water_velocity_mps[0] for t in here}
    assert speed[3 * S] > speed[2 * S + STEP_NS] > 0.0
    assert speed[3 * S + STEP_NS] < speed[3 * S]


def test_a_new_disturbance_takes_the_old_ones_place():
    plant = plant_of("water.sd_mps=0", "plant.depth_m=20")
    push, nothing = Disturbance(end_t_ns=60 * S, force_N=(50.0, 0.0, 0.0)), Disturbance(end_t_ns=60 * S)
    inboxes = {0: [ReceivedMessage(push, 9, 0, 0)], S: [ReceivedMessage(nothing, 9, 1, S)]}
    *_, before, after = run(plant, S + STEP_NS, inboxes)[0]
    assert before.water_velocity_mps[0] > 0.05
    assert after.water_velocity_mps[0] <= before.water_velocity_mps[0]
