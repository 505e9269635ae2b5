"""Effects of the plant that the controller's model does not have, each against a closed form."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from ltv_mpc.array_encoding import to_wire
from ltv_mpc.messages import Applied, Message, Truth
from ltv_mpc.node import Inbox, ReceivedMessage
from ltv_mpc.vehicle.parameters import Vehicle
from sim.plant import PERIOD_NS, STEP_NS, CommandPath
from sim.plant import Wind as WindForce
from sim.scenario import Actuators, Scenario, Wind, with_overrides
from sim.water import make
from tests.ltv_mpc.plans import plan_of
from tests.sim.worlds import S, plant_of
from tests.stepping import feed

VEHICLE = Vehicle.load("surface")
P = VEHICLE.coefficients()
ENCODE = msgspec.json.Encoder(enc_hook=to_wire).encode


def fly(
    *settings: str, thrust: tuple[float, float] = (0.0, 0.0), until_s: float = 4.0, period_ns: int = PERIOD_NS
) -> list[Message]:
    """Return the messages of a plant in still water that ramps to a thrust in 0.3 s from t = 0 on."""
    plant = plant_of("water.sd_mps=0", "plant.tilt_rms_rad=0", *settings, vehicle="surface")
    plan = plan_of(0, [(0.0, 0.0, 0.0), *[(*thrust, 0.0)] * 40], cycle_t_ns=-5)
    inbox: Inbox = [ReceivedMessage(plan, 7, 0, 0)]
    times = range(-S, round(until_s * S) + 1, period_ns)
    return feed(plant, ((t, inbox if t == 0 else []) for t in times))


def truths(*settings: str, **of) -> dict[float, Truth]:
    """Return the truths by time in seconds."""
    return {round(x.t_ns / S, 2): x for x in fly(*settings, **of) if isinstance(x, Truth)}


def test_all_effects_give_the_same_bits_step_by_step_and_five_at_once():
    all_of_it = (
        "plant.mismatch.port_thrust=0.8", "plant.mismatch.starboard_arm=1.3", "plant.mismatch.lag=1.5",
        "plant.actuators.dead_time_s=0.123", "plant.actuators.dead_zone_N=2", "plant.actuators.quantum_N=0.5",
        "plant.wind.force_N=3", "plant.wind.gust_N=2", "water.surface_waves.height_m=0.4", "water.feature.kind=tide",
        "water.change_mps_per_rts=0.01",
    )  # fmt: skip
    for effects in (all_of_it, [one for one in all_of_it if "wind" not in one]):  # wind has steps of its own
        one, two = (fly(*effects, thrust=(20.0, 15.0), period_ns=ns) for ns in (STEP_NS, PERIOD_NS))
        assert [ENCODE(x) for x in one] == [ENCODE(x) for x in two]
    assert ENCODE(fly(*all_of_it)[-2]) != ENCODE(fly(*all_of_it, "run.seed=8")[-2])


def test_a_dead_time_shifts_the_thrust_and_leaves_the_reported_command():
    """The command, linear between steps, is that of 0.123 s before; the lag is zero, so the thrust is the command."""
    lagless = "plant.mismatch.lag=1e-6"
    late = truths(lagless, "plant.actuators.dead_time_s=0.123", thrust=(20.0, 12.0))
    for t in (0.1, 0.2, 0.3, 0.41, 0.43, 2.0):
        share = min(max(t - 0.123, 0.0) / 0.3, 1.0)
        assert late[t].thrust_N[:2] == pytest.approx((20.0 * share, 12.0 * share), abs=0.1)  # the inflow grows
    reports = [x for x in fly("plant.actuators.dead_time_s=0.123", thrust=(20.0, 12.0)) if isinstance(x, Applied)]
    usual = [x for x in fly(thrust=(20.0, 12.0)) if isinstance(x, Applied)]
    assert [(x.command_N, x.command_slew_N_per_s) for x in reports] == [
        (x.command_N, x.command_slew_N_per_s) for x in usual
    ]


def test_small_commands_move_nothing_and_others_come_in_steps():
    commands = np.array([[0.4, -2.6, 7.9], [2.1, 3.2, -1.3], [-0.6, 1.9, 0.0]])
    path = CommandPath(Actuators(dead_zone_N=2.0, quantum_N=1.5))
    np.testing.assert_allclose(path.followed([0, 1, 2, 3], commands), [[0, -3, 7.5], [0, 3, 0], [0, 0, 0]])
    assert CommandPath(Actuators()).followed([0, 1, 2, 3], commands) is commands


def test_lag_thrust_and_arm_are_those_of_each_thruster():
    """dr/dt at rest is (F1 a1 - F2 a2) / I; what the revolutions, as sqrt(F), lack decays within the lag of 0.9 s."""
    lag_s = VEHICLE.thrusters[0].lag_s
    extra = f"plant.mismatch.extra_lag_s={0.9 - 0.5 * lag_s}"
    slow = truths("plant.mismatch.lag=0.5", extra, thrust=(20.0, -20.0))  # no inflow
    lacks = [1.0 - math.sqrt(slow[t].thrust_N[0] / 20.0) for t in (1.0, 2.0)]
    assert lacks[1] / lacks[0] == pytest.approx(math.exp(-1.0 / 0.9), rel=0.05)
    settings = ("port_thrust=0.7", "starboard_thrust=1.2", "port_arm=0.8", "starboard_arm=1.5", "lag=1e-6", "drag=0.01")
    turned = truths(*(f"plant.mismatch.{one}" for one in settings), thrust=(20.0, 10.0))
    assert turned[0.3].thrust_N[:2] == pytest.approx((14.0, 12.0), rel=0.01)
    moment = 14.0 * 0.8 * P.arm_port - 12.0 * 1.5 * P.arm_starboard
    assert turned[0.3].yaw_rate_radps == pytest.approx(0.15 * moment / P.inertia_yaw, rel=0.05)


def test_wind_pushes_at_the_surface_alone_and_its_gusts_have_their_rms():
    pushed = truths("plant.wind.force_N=10", "plant.wind.direction_rad=2.0", until_s=0.0)
    impulse = 0.5  # of 50 ms, afloat before t = 0
    expected = impulse * math.cos(2.0) / P.mass_surge, impulse * math.sin(2.0) / P.mass_sway
    assert pushed[-0.95].water_velocity_mps[:2] == pytest.approx(expected, rel=0.1)
    wind = WindForce(Wind(force_N=5.0, gust_N=2.0, direction_rad=-0.5), 3)
    force = np.array([wind.force_N(t, 0.2) for t in range(0, 4000 * S, S // 2)])
    along = force @ [math.cos(0.5), -math.sin(0.5)]
    assert (along.mean(), along.std()) == (pytest.approx(5.0, abs=0.1), pytest.approx(2.0, rel=0.05))
    np.testing.assert_allclose(force @ [math.sin(0.5), math.cos(0.5)], 0.0, atol=1e-12)
    assert wind.force_N(7 * S, 0.5) == (0.0, 0.0)


def test_surface_waves_carry_the_vehicle_on_the_orbit_of_their_height():
    """A vehicle at rest in the water moves from one side to the other by the height; the orbits shrink as exp(-k z)."""
    waves = (
        "water.surface_waves.height_m=0.6",
        "water.surface_waves.period_s=4",
        "water.surface_waves.direction_rad=1",
    )
    carried = np.array([x.position_m for x in truths(*waves, until_s=12.0).values()])
    along = carried[:, :2] @ [math.cos(1.0), math.sin(1.0)]
    assert np.ptp(along) == pytest.approx(0.6, rel=0.01)
    np.testing.assert_allclose(carried[:, :2] @ [-math.sin(1.0), math.cos(1.0)], 0.0, atol=1e-9)
    column = make(with_overrides(Scenario.load("descent"), ["water.sd_mps=0", *waves]).water, 0)
    k = (2 * math.pi / 4) ** 2 / 9.81
    for t in (0, S // 3, 5 * S):
        np.testing.assert_allclose(column.at(3.0, t), np.exp(-3.0 * k) * np.array(column.at(0.0, t)), rtol=1e-12)
        slope = np.subtract(column.at(3.0 + 1e-5, t), column.at(3.0 - 1e-5, t)) / 2e-5
        np.testing.assert_allclose(column.gradient(3.0, t), slope, rtol=1e-6)
    assert max(math.hypot(*column.at(0.0, t)) for t in range(0, 4 * S, S // 100)) == pytest.approx(
        math.pi * 0.6 / 4, rel=1e-4
    )
