"""The sensors node: exact sample times, surface phases, and an independent random stream for each sensor."""

from __future__ import annotations

import math
from collections import Counter

import msgspec
import numpy as np
import pytest

from ltv_mpc.array_encoding import to_wire
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.messages import (
    AdcpPing,
    CompassHeading,
    Estimate,
    GnssFix,
    ImuSample,
    PressureDepth,
    TdcpFix,
    Truth,
)
from ltv_mpc.vehicle.parameters import Vehicle
from sim.plant import Plant
from sim.scenario import Scenario
from sim.sensors.vehicle_state import motion_between
from sim.water import make
from tests.sim.worlds import MS, S, sensed

encode = msgspec.json.Encoder(enc_hook=to_wire).encode


def scenario(*, surface_s: float = 1.0, seed: int = 0, perfect: bool = False) -> Scenario:
    base = Scenario.load("descent")
    run = msgspec.structs.replace(base.run, surface_time_s=surface_s, seed=seed, perfect_state=perfect)
    return msgspec.structs.replace(base, run=run)


def truths(settings: Scenario, until_ns: int, step_ns: int = 10 * MS) -> list[Truth]:
    plant = Plant(settings, Vehicle.load("paper"), make(settings.water, settings.run.seed))
    said = []
    for t in range(settings.start_ns, until_ns + 1, step_ns):
        said += [x for x in plant.step(t, []) if isinstance(x, Truth) and x.t_ns == t]
    return said


def measured(settings: Scenario, suite: SensorConfig, world: list[Truth]):
    said = [message for _, message in sensed(suite, world, settings)]
    return sorted(said, key=lambda x: x.t_ns)


def of(kind, said):
    return [x for x in said if type(x) is kind]


@pytest.mark.parametrize("surface_s", [1.0, 30.0])
def test_a_surface_phase_of_n_seconds_has_exactly_n_fixes_of_carrier_phase(surface_s):
    settings = scenario(surface_s=surface_s)
    said = measured(settings, SensorConfig.load("paper"), truths(settings, 3 * S))
    fixes = of(TdcpFix, said)
    assert len(fixes) == int(surface_s)
    assert fixes[-1].t_ns == 0
    assert [f.t_ns - f.from_t_ns for f in fixes] == [S] * len(fixes)
    assert [f.t_ns for f in of(GnssFix, said)] == list(range(settings.start_ns, 1, S))


def test_sample_times_are_whole_multiples_of_each_period():
    settings, suite = scenario(), SensorConfig.load("paper")
    world = truths(settings, 10 * S)
    said = measured(settings, suite, world)
    assert {at % (50 * MS) for at, x in sensed(suite, world, settings) if isinstance(x, ImuSample)} == {0}
    periods = {ImuSample: 10 * MS, AdcpPing: 333_333_333, PressureDepth: 100 * MS, CompassHeading: S}
    for kind, period in periods.items():
        times = [x.t_ns for x in of(kind, said)]
        assert times == [k * period for k in range(times[0] // period, 10 * S // period + 1)]
        assert times[0] - period <= -S
    assert Counter(type(x) for x in said)[AdcpPing] == 34  # -3 to 30
    assert [x.t_ns for x in said] == sorted(x.t_ns for x in said)


def test_a_slower_truth_gives_the_same_sample_times():
    settings, suite = scenario(), SensorConfig.load("paper")
    fast = measured(settings, suite, truths(settings, 2 * S))
    slow = measured(settings, suite, truths(settings, 2 * S, 20 * MS))
    assert [(type(x), x.t_ns) for x in fast] == [(type(x), x.t_ns) for x in slow]
    depths = [[x.depth_m for x in of(PressureDepth, said)] for said in (fast, slow)]
    np.testing.assert_allclose(*depths, atol=1e-6)


def test_between_two_truths_the_attitude_turns_about_one_axis_and_the_rest_is_linear():
    world = truths(scenario(), -900 * MS)
    a, b, c = world[2], world[3], world[4]
    instant = motion_between(a, c).at(b.t_ns)
    np.testing.assert_allclose(instant.position_m, b.position_m, atol=1e-6)
    np.testing.assert_allclose(instant.velocity_mps, b.velocity_mps, atol=1e-5)
    exact = motion_between(a, b).at(b.t_ns)
    np.testing.assert_allclose(instant.rotation, exact.rotation, atol=5e-6)
    # The body's rate by Euler's equations from rates of roll, pitch, heading
    roll, pitch, _ = b.attitude_rad
    rates = (np.array(c.attitude_rad) - np.array(a.attitude_rad)) / 0.02
    body = [
        rates[0] - rates[2] * math.sin(pitch),
        rates[1] * math.cos(roll) + rates[2] * math.sin(roll) * math.cos(pitch),
        -rates[1] * math.sin(roll) + rates[2] * math.cos(roll) * math.cos(pitch),
    ]
    np.testing.assert_allclose(instant.angular_rate_radps(), body, atol=1e-6)


def test_a_perfect_state_is_the_truth_with_the_true_profile_in_the_estimators_cells():
    settings = scenario(perfect=True)
    world = truths(settings, 2 * S)
    said = measured(settings, SensorConfig.load("paper"), world)
    estimates = of(Estimate, said)
    assert [x.t_ns for x in estimates] == list(range(-S, 2 * S + 1, 100 * MS))
    by_time = {x.t_ns: x for x in world}
    water = make(settings.water, 0)
    for x in estimates:
        truth = by_time[x.t_ns]
        assert (x.north_m, x.east_m, x.depth_m) == pytest.approx(truth.position_m, abs=1e-12)
        velocity = (x.velocity_north_mps, x.velocity_east_mps, x.velocity_down_mps)
        assert velocity == pytest.approx(truth.velocity_mps, abs=1e-12)
        assert (x.heading_rad, x.yaw_rate_radps) == pytest.approx((truth.attitude_rad[2], truth.yaw_rate_radps))
        assert x.current.depth_m.tolist() == list(range(71))
        np.testing.assert_array_equal(x.current.north_mps, water.profile(0).north_mps)
        np.testing.assert_array_equal(x.current.east_mps, water.profile(0).east_mps)
        assert (x.current.sd_mps == 0).all()
    assert len(of(ImuSample, said)) == 300


def test_a_truth_that_arrives_twice_is_measured_once():
    settings, world = scenario(), truths(scenario(), 0)
    once = encode(measured(settings, SensorConfig.load("paper"), world))
    twice = encode(measured(settings, SensorConfig.load("paper"), [x for x in world for _ in range(2)]))
    assert once == twice
