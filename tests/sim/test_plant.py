"""Plant as a node: its reaction to plans, and its messages with their times."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest
from scipy.integrate import quad

from ltv_mpc.array_encoding import to_wire
from ltv_mpc.messages import Applied, Truth
from ltv_mpc.node import ReceivedMessage
from ltv_mpc.vehicle.parameters import Vehicle
from sim.plant import PERIOD_NS, STEP_NS, Plant
from sim.scenario import Scenario
from sim.water import make
from tests.ltv_mpc.plans import plan_of

ENCODE = msgspec.json.Encoder(enc_hook=to_wire).encode
MS, S = 1_000_000, 1_000_000_000
VEHICLE = Vehicle.load("paper")


def scenario(**changes) -> Scenario:
    """Return the paper's descent with other values: ``water={...}``, ``plant={...}``, ``run={...}``."""
    base = Scenario.load("descent")
    tables = {name: msgspec.structs.replace(getattr(base, name), **values) for name, values in changes.items()}
    return msgspec.structs.replace(base, **tables)


def plant_of(settings: Scenario) -> Plant:
    return Plant(settings, VEHICLE, make(settings.water, settings.run.seed))


def arrival(
    start_ns: int, thrust: list[list[float]], *, sequence: int = 0, received_ns: int | None = None
) -> ReceivedMessage:
    plan = plan_of(start_ns, thrust, cycle_t_ns=start_ns - 5)
    return ReceivedMessage(plan, 77, sequence, start_ns if received_ns is None else received_ns)


def run(
    plant: Plant, until_ns: int, arrivals: dict[int, list[ReceivedMessage]], *, start_ns: int = -S
) -> list[Truth | Applied]:
    """Return all published messages; ``arrivals`` are the inboxes by step."""
    said = []
    for t in range(start_ns, until_ns + 1, STEP_NS):
        said += plant.step(t, arrivals.get(t, []))
    return said


def of(kind, said):
    return [x for x in said if type(x) is kind]


def at(said, t_ns: int):
    return next(x for x in said if x.t_ns == t_ns)


RAMP = [[0, 0, 0], [30, -30, 30], [60, -60, 60], [60, -60, 60]]


def test_truth_comes_every_ten_milliseconds_and_the_report_every_hundred():
    said = run(plant_of(scenario()), S, {})
    assert [x.t_ns for x in of(Truth, said)] == list(range(-S, S + 1, 10 * MS))
    assert [x.t_ns for x in of(Applied, said)] == list(range(-S, S + 1, 100 * MS))


@pytest.mark.parametrize("depth", [0.0, 12.6])
def test_before_the_descent_the_vehicle_drifts_with_the_water_at_its_depth(depth):
    settings = scenario(plant={"heading_rad": 0.7, "north_m": 3.0, "depth_m": depth})
    said = run(plant_of(settings), 0, {-900 * MS: [arrival(-900 * MS, [[20, 20, 20]] * 9)]})
    north, east = make(settings.water, 0).at(depth, 0)
    last = of(Truth, said)[-1]
    assert last.position_m == pytest.approx((3.0 + north, east, depth))
    assert last.velocity_mps == pytest.approx((north, east, 0.0))
    assert last.attitude_rad[2] == 0.7
    for x in of(Applied, said):
        assert x.command_N == (0.0, 0.0, 0.0)
        assert x.thrust_N == (0.0, 0.0, 0.0)


def test_it_follows_a_plan_to_its_end_and_then_ramps_down_at_the_slew_limit():
    said = run(plant_of(scenario()), 2 * S, {0: [arrival(0, RAMP)]})
    commands = {x.t_ns: x.command_N for x in of(Applied, said)}
    assert commands[300 * MS] == pytest.approx((30, -30, 30))
    assert commands[900 * MS] == pytest.approx((60, -60, 60))
    assert commands[1000 * MS] == pytest.approx((50, -50, 50))
    assert commands[1400 * MS] == pytest.approx((10, -10, 10))
    assert commands[1500 * MS] == pytest.approx((0, 0, 0), abs=1e-9)
    slews = np.array([x.command_slew_N_per_s for x in of(Applied, said)])
    assert slews.max() == pytest.approx(100.0, abs=1e-9)
    assert (slews <= 100.0 + 1e-9).all()
    assert slews[-1].max() == 0.0


def test_delivered_thrust_lags_behind_the_command():
    said = run(plant_of(scenario()), 4 * S, {0: [arrival(0, [[0, 0, 0], *[[20, 20, 0]] * 20])]})
    thrust = {x.t_ns: x.thrust_N[0] for x in of(Applied, said)}
    # At rest n_c = sqrt(F / a) and F rises to 20 N within T = 0.3 s; the lag, tau = 0.3 s too, is one of n, not of F.
    n_over_asked = quad(lambda s: math.exp(-(0.3 - s) / 0.3) / 0.3 * math.sqrt(s / 0.3), 0.0, 0.3)[0]
    assert thrust[300 * MS] == pytest.approx(20 * n_over_asked**2, rel=0.03)
    assert thrust[4 * S] == pytest.approx(20, abs=0.3)  # the inflow still grows


def test_five_steps_at_once_take_each_plan_with_the_step_in_which_it_has_arrived():
    """A message that came later stays behind the one before it, even if the clock read less."""
    received_ms = (215, 232, 228)
    plans = [arrival(ms * MS - 5, RAMP, sequence=i, received_ns=ms * MS) for i, ms in enumerate(received_ms)]
    one = run(plant_of(scenario()), S, {220 * MS: plans[:1], 240 * MS: plans[1:]})
    plant = plant_of(scenario())
    other = [x for t in range(-S, S + 1, PERIOD_NS) for x in plant.step(t, plans if t == 250 * MS else [])]
    assert [ENCODE(x) for x in other] == [ENCODE(x) for x in one]
    assert len([x for x in of(Applied, other) if x.t_ns % (100 * MS)]) == 2


def test_a_plan_is_answered_in_the_step_it_arrives_in():
    said = run(plant_of(scenario()), 500 * MS, {230 * MS: [arrival(220 * MS, RAMP, sequence=5, received_ns=215 * MS)]})
    before, receipt = at(of(Applied, said), 200 * MS), at(of(Applied, said), 230 * MS)
    assert (before.plan_epoch, before.plan_sequence, before.plan_late) == (0, -1, False)
    assert (receipt.plan_epoch, receipt.plan_sequence, receipt.plan_late) == (77, 5, False)
    assert receipt.plan_received_t_ns == 215 * MS
    assert receipt.plan_cycle_t_ns == 220 * MS - 5
    assert (receipt.plans_late, receipt.plans_rejected) == (0, 0)


def test_a_late_plan_is_counted_and_does_not_make_the_command_jump():
    late = arrival(0, RAMP, received_ns=425 * MS)
    said = run(plant_of(scenario()), S, {430 * MS: [late]})
    receipt = at(of(Applied, said), 430 * MS)
    assert receipt.plan_late
    assert receipt.plans_late == 1
    # In force from its arrival on: 5 ms at 100 N/s.
    assert receipt.command_N[0] == pytest.approx(0.5)
    assert all(max(x.command_slew_N_per_s) <= 100 + 1e-9 for x in of(Applied, said))


def test_refused_plans_are_counted_and_change_nothing():
    inboxes = {
        0: [arrival(0, [[0, 0, 0], *[[20, 20, 20]] * 9], sequence=3)],
        500 * MS: [arrival(500 * MS, RAMP, sequence=3)],
        510 * MS: [arrival(500 * MS, [[20, 20, 20], [70, 20, 20]], sequence=4)],
        520 * MS: [arrival(500 * MS, [[20, 20, 20], [51, 20, 20]], sequence=5)],
    }
    said = run(plant_of(scenario()), S, inboxes)
    last = of(Applied, said)[-1]
    assert (last.plan_sequence, last.plans_rejected, last.plans_late) == (3, 3, 0)
    assert last.command_N == (20.0, 20.0, 20.0)


def test_a_plan_that_starts_between_two_steps_is_followed_from_its_start():
    first = arrival(0, [[0, 0, 0], [30, 0, 0], [60, 0, 0]])
    second = arrival(300 * MS + 4 * MS, [[30.4, 0, 0], [0.4, 0, 0]], sequence=1, received_ns=302 * MS)
    said = run(plant_of(scenario()), 600 * MS, {0: [first], 310 * MS: [second]})
    assert at(of(Applied, said), 310 * MS).command_N[0] == pytest.approx(30.4 - 0.6)
    assert at(of(Applied, said), 400 * MS).command_N[0] == pytest.approx(30.4 - 9.6)


def test_plans_whose_arrival_times_are_out_of_order_do_no_harm():
    first = arrival(0, RAMP, received_ns=209 * MS)
    second = arrival(300 * MS, [[30, -30, 30]] * 9, sequence=1, received_ns=204 * MS)
    said = run(plant_of(scenario()), S, {210 * MS: [first, second]})
    assert of(Applied, said)[-1].plan_sequence == 1


def test_velocity_over_ground_is_that_through_water_plus_the_current_at_depth():
    settings = scenario(plant={"heading_rad": 2.0, "depth_m": 7.4})
    said = run(plant_of(settings), 3 * S, {0: [arrival(0, [[0, 0, 0], *[[30, 20, 10]] * 9])]})
    water = make(settings.water, 0)
    for x in of(Truth, said)[::25]:
        assert x.current_mps == water.at(x.position_m[2], x.t_ns)
        u, v, w = x.water_velocity_mps
        psi = x.attitude_rad[2]
        north = math.cos(psi) * u - math.sin(psi) * v + x.current_mps[0]
        east = math.sin(psi) * u + math.cos(psi) * v + x.current_mps[1]
        assert x.velocity_mps == pytest.approx((north, east, w))


@pytest.mark.parametrize("change", [0.0, 1e-3])
def test_position_is_the_integral_of_velocity(change):
    settings = scenario(water={"change_mps_per_rts": change})
    plans = {0: [arrival(0, [[0, 0, 0], [30, 20, 30], *[[60, 50, 60]] * 18])]}
    plans |= {t_ns: [arrival(t_ns, [[60, 50, 60]] * 20, sequence=t_ns // S)] for t_ns in range(4 * S, 20 * S, 4 * S)}
    said = of(Truth, run(plant_of(settings), 20 * S, plans))
    position = np.array([x.position_m for x in said])
    velocity = np.array([x.velocity_mps for x in said])
    way = 0.005 * (velocity[1:] + velocity[:-1]).sum(axis=0)
    np.testing.assert_allclose(position[-1] - position[0], way, atol=1e-5)


def test_a_weaker_plant_is_weaker_in_truth_and_not_in_what_its_actuators_say():
    push = {0: [arrival(0, [[0, 0, 0], *[[20, 20, 0]] * 20])]}
    weak = msgspec.structs.replace(scenario().plant.mismatch, thrust=0.7)
    said = run(plant_of(scenario(plant={"mismatch": weak})), 4 * S, push)
    assert of(Truth, said)[-1].thrust_N[0] == pytest.approx(0.7 * 20, rel=0.02)
    assert of(Applied, said)[-1].thrust_N[0] == pytest.approx(20, rel=0.02)


def test_a_stronger_plant_delivers_no_more_than_its_limits():
    strong = msgspec.structs.replace(scenario().plant.mismatch, thrust=1.1)
    push = {0: [arrival(0, [[0, 0, 0], [30, 30, 30], [60, 60, 60], *[[62.5, 62.5, 62.5]] * 20])]}
    said = run(plant_of(scenario(plant={"mismatch": strong})), 4 * S, push)
    limits = [thruster.max_N for thruster in VEHICLE.thrusters]
    delivered = np.array([x.thrust_N for x in of(Truth, said)])
    assert delivered.max(axis=0) == pytest.approx(limits)
    # The motion too: the acceleration at the surface is that of the delivered thrust.
    usual = run(plant_of(scenario()), 4 * S, push)
    ratio = of(Truth, said)[-1].water_velocity_mps[2] / of(Truth, usual)[-1].water_velocity_mps[2]
    assert ratio < 1.04


def test_the_descent_takes_two_hundred_seconds_for_forty_metres():
    plans = {0: [arrival(0, [[0, 0, 0], [0, 0, 30], [0, 0, 60], *[[0, 0, 62.5]] * 17])]}
    plans |= {t_ns: [arrival(t_ns, [[0, 0, 62.5]] * 20, sequence=t_ns // S)] for t_ns in range(4 * S, 200 * S, 4 * S)}
    said = of(Truth, run(plant_of(scenario()), 200 * S, plans))
    assert said[-1].position_m[2] == pytest.approx(40.0, abs=0.5)  # the start costs two seconds of it
