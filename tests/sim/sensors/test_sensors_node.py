"""The sensors node: times and types of its messages, latencies, optional sensors, a random stream for each sensor."""

from __future__ import annotations

import math
from collections import Counter, defaultdict

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace

from ltv_mpc.array_encoding import to_wire
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.sensors import PUBLISHED
from ltv_mpc.messages import (
    AdcpPing,
    BottomTrack,
    CompassHeading,
    Estimate,
    GnssFix,
    ImuSample,
    LblRange,
    PressureDepth,
    TdcpFix,
    Truth,
)
from sim.scenario import Scenario, with_overrides
from sim.sensors.vehicle_state import motion_between
from sim.water import make
from tests.ltv_mpc.localisation.sensors.every_sensor import EVERY_SENSOR, with_settings
from tests.sim.worlds import MS, S, sensed, truth

encode = msgspec.json.Encoder(enc_hook=to_wire).encode
PLAIN, PAPER = SensorConfig.load("realistic"), SensorConfig.load("paper")
EVERY = with_settings(
    replace(PLAIN, bottom_track=EVERY_SENSOR.bottom_track, lbl=EVERY_SENSOR.lbl, usbl=EVERY_SENSOR.usbl),
    bottom_track={"period_ns": 333_333_333, "beam_noise_sd_mps": 0.0015, "outlier_mps": 0.0},
    lbl={
        "transponders_m": ((300.0, 0.0, 60.0), (0.0, -500.0, 60.0), (0.0, 100.0, 60.0)),
        "sound_speed_sd_mps": 2.0,
        "range_sd_m": 0.5,
    },
    usbl={"period_ns": 500 * MS, "latency_ns": 800 * MS, "ship_m": (60.0, -40.0), "bearing_sd_rad": 0.01},
)
LBL, USBL, BED = EVERY.lbl, EVERY.usbl, EVERY.bottom_track


def scenario(*settings: str) -> Scenario:
    return with_overrides(Scenario.load("descent"), ["run.seed=4", *settings])


def truths(from_ns=-S, until_ns=3 * S, step_ns=10 * MS, depth=20.0) -> list[Truth]:
    """Return the truth of a vehicle that moves slowly ahead at one depth, and rolls."""
    moving = {"velocity_mps": (0.3, 0.0, 0.0), "water_velocity_mps": (0.3, 0.0, 0.0)}
    return [
        truth(t, position_m=(0.3e-9 * t, 0.0, depth), attitude_rad=(0.02 * math.sin(2e-9 * t), 0.0, 0.1), **moving)
        for t in range(from_ns, until_ns + 1, step_ns)
    ]


def said(suite: SensorConfig, world: list[Truth], settings: Scenario | None = None) -> list[tuple[int, object]]:
    return sensed(suite, world, settings or scenario())


def of(kind, suite: SensorConfig, world: list[Truth], settings: Scenario | None = None) -> list:
    """Return the messages of one type."""
    return [m for _, m in said(suite, world, settings) if type(m) is kind]


def late(suite: SensorConfig, **latencies_ms: int) -> SensorConfig:
    return with_settings(suite, **{name: {"latency_ns": ms * MS} for name, ms in latencies_ms.items()})


LATENCIES = {"adcp": 137, "pressure": 20, "gnss": 255, "tdcp": 1000, "compass": 400, "bottom_track": 333, "usbl": 800}
KINDS = {name: PUBLISHED[name] for name in LATENCIES}


@pytest.mark.parametrize("step_ns", [10 * MS, 40 * MS])
def test_a_sensor_with_latency_publishes_the_same_values_that_much_later(step_ns):
    suite = late(replace(PLAIN, bottom_track=BED, usbl=USBL), usbl=0)
    world = truths(step_ns=step_ns)
    at_once, delayed = said(suite, world), said(late(suite, **LATENCIES), world)
    assert all(at - step_ns < m.t_ns <= at for at, m in at_once if m.t_ns > -S and not isinstance(m, ImuSample))
    latency = defaultdict(int, {KINDS[name]: ms * MS for name, ms in LATENCIES.items()})
    expected = defaultdict(list)
    for m in (m for _, m in at_once if not isinstance(m, ImuSample)):
        arrives = m.t_ns + latency[type(m)]
        at = max(-(-arrives // step_ns) * step_ns, -S + step_ns)  # the first truth only opens the first interval
        if at <= world[-1].t_ns:
            expected[type(m)].append((at, encode(m)))
    for kind in expected:
        assert [(at, encode(m)) for at, m in delayed if type(m) is kind] == expected[kind]
    assert set(expected) == set(KINDS.values())
    together = defaultdict(list)
    for at, m in ((at, m) for at, m in delayed if not isinstance(m, ImuSample)):
        together[at].append(m.t_ns)
    assert all(times == sorted(times) for times in together.values())  # whatever the order of their arrivals


def test_messages_of_one_arrival_time_are_published_in_order_of_validity():
    suite = late(replace(PLAIN, usbl=USBL), compass=1000, pressure=500)
    at_zero = [m for at, m in said(suite, truths()) if at == 0]
    # the compass of -1 s, pressure of -0.5 s, then what is measured now, in the order of the list
    assert [(type(m), m.t_ns) for m in at_zero] == [
        (CompassHeading, -S),
        (PressureDepth, -500 * MS),
        *((ImuSample, k * 10 * MS) for k in range(-4, 1)),
        (GnssFix, 0),
        (TdcpFix, 0),
        (AdcpPing, 0),
    ]


def test_a_range_is_published_when_the_reply_arrives():
    """A detour of up to 60 m takes up to 80 ms: replies by way of the surface arrive so much later."""
    wild = replace(LBL, range_sd_m=1e-9, outlier_share=0.5, outlier_m=60.0)
    suite = replace(PLAIN, lbl=wild)
    world = truths()
    ranges = [(at, m) for at, m in said(suite, world) if isinstance(m, LblRange)]
    assert [m.transponder for _, m in ranges] == [2, 0, 1] * 4  # near ones first
    calls = []
    for at, m in ranges:
        heard = m.t_ns + 0.5e9 * m.travel_time_s
        assert at - 10 * MS < heard <= at
        calls.append(m.t_ns - 0.5e9 * m.travel_time_s)
    np.testing.assert_allclose(calls, np.repeat(np.arange(-1, 3) * S, 3), atol=2)
    times = {m.transponder: m.travel_time_s for _, m in ranges}
    for j, direct in enumerate((0.404, 0.669, 0.144)):
        assert direct - 0.005 < times[j] < direct + 0.085


@pytest.mark.parametrize("name", [*KINDS, "imu", "lbl"])
def test_a_change_of_one_sensor_or_one_more_does_not_change_the_others(name):
    added = getattr(PLAIN, name) is None
    table = getattr(EVERY, name) if added else replace(getattr(PAPER, name), period_ns=500 * MS)
    suite, kind = replace(PLAIN, **{name: table}), ImuSample if name == "imu" else PUBLISHED[name]
    bed, other_seed = "water.bottom_m=39", "run.seed=5"
    before, after, again = (
        [(at, type(m), encode(m)) for at, m in said(x, truths(), scenario(bed, *seed))]
        for x, seed in ((PLAIN, ()), (suite, ()), (suite, (other_seed,)))
    )
    assert [row for row in before if row[1] is not kind] == [row for row in after if row[1] is not kind]
    own = [[row for row in rows if row[1] is kind] for rows in (before, after, again)]
    assert own[0] != own[1] != own[2]


def test_a_vehicle_at_rest_above_a_bed_finds_it_and_loses_the_cells_beyond():
    """Transducer at 20.3 m, bed at 32 m: cells of the realistic profiler at 0.9 to 10.9 m are nearer than 11.7 m."""
    level = {"mounting_known_to_rad": 0.0, "missing_share": 0.0, "outlier_share": 0.0}
    suite = with_settings(replace(PLAIN, bottom_track=BED), adcp=level)
    rest = [replace(x, velocity_mps=(0.0, 0.0, 0.0), attitude_rad=(0.0, 0.0, 0.1)) for x in truths()]
    pings, tracks = (of(kind, suite, rest, scenario("water.bottom_m=32")) for kind in (AdcpPing, BottomTrack))
    assert [m.t_ns for m in pings] == [m.t_ns for m in tracks]
    for ping, track in zip(pings, tracks, strict=True):
        np.testing.assert_array_equal(np.isnan(ping.beam_velocity_mps), np.tile(np.arange(14) >= 11, (4, 1)))
        np.testing.assert_allclose(track.range_m, 11.7 / math.cos(math.radians(20)))
        assert np.abs(track.beam_velocity_mps).max() < 5 * 0.0015
    assert all(np.isnan(m.beam_velocity_mps).all() for m in of(BottomTrack, suite, rest))


def test_sample_times_are_whole_multiples_of_each_period():
    messages = said(PAPER, truths(until_ns=10 * S))
    assert {at % (50 * MS) for at, x in messages if isinstance(x, ImuSample)} == {0}
    for kind, period in {ImuSample: 10 * MS, AdcpPing: 333_333_333, PressureDepth: 100 * MS, CompassHeading: S}.items():
        times = [x.t_ns for _, x in messages if type(x) is kind]
        assert times == [k * period for k in range(times[0] // period, 10 * S // period + 1)]
        assert times[0] - period <= -S
    assert Counter(type(x) for _, x in messages)[AdcpPing] == 34  # -3 to 30


def test_between_two_truths_the_attitude_turns_about_one_axis_and_the_rest_is_linear():
    def at(t_s):
        attitude = 0.03 * math.sin(1.5 * t_s), 0.04 * math.cos(1.4 * t_s), 0.3 + 0.1 * t_s
        velocity = 0.02 * math.cos(t_s), 0.2, 0.01 * math.sin(t_s)
        position = 0.02 * math.sin(t_s), 0.2 * t_s, 5.0 - 0.01 * math.cos(t_s)
        return truth(round(t_s * S), position_m=position, velocity_mps=velocity, attitude_rad=attitude)

    a, b, c = at(0.50), at(0.51), at(0.52)
    instant = motion_between(a, c).at(b.t_ns)
    np.testing.assert_allclose(instant.position_m, b.position_m, atol=1e-6)
    np.testing.assert_allclose(instant.velocity_mps, b.velocity_mps, atol=1e-5)
    np.testing.assert_allclose(instant.rotation, motion_between(a, b).at(b.t_ns).rotation, atol=5e-6)
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
    settings, world = scenario("run.perfect_state=true"), truths(until_ns=2 * S)
    estimates = of(Estimate, PAPER, world, settings)
    assert [x.t_ns for x in estimates] == list(range(-S, 2 * S + 1, 100 * MS))
    by_time = {x.t_ns: x for x in world}
    profile = make(settings.water, settings.run.seed).profile(0)
    for x in estimates:
        true = by_time[x.t_ns]
        assert (x.north_m, x.east_m, x.depth_m) == pytest.approx(true.position_m, abs=1e-12)
        velocity = (x.velocity_north_mps, x.velocity_east_mps, x.velocity_down_mps)
        assert velocity == pytest.approx(true.velocity_mps, abs=1e-12)
        assert (x.heading_rad, x.yaw_rate_radps) == pytest.approx((true.attitude_rad[2], true.yaw_rate_radps))
        assert x.current.depth_m.tolist() == list(range(71))
        np.testing.assert_array_equal(x.current.north_mps, profile.north_mps)
        np.testing.assert_array_equal(x.current.east_mps, profile.east_mps)
        assert (x.current.sd_mps == 0).all()


def test_a_truth_that_arrives_twice_is_measured_once():
    once, twice = truths(until_ns=0), [x for x in truths(until_ns=0) for _ in range(2)]
    assert encode([m for _, m in said(PAPER, once)]) == encode([m for _, m in said(PAPER, twice)])
