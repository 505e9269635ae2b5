"""Sensor screening: an implausible message is counted and changes nothing, and the messages after it are used."""

import msgspec
import numpy as np
import pytest

from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.estimator import Estimator
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.sensor_screening import MAX_CLOCK_LEAD_NS, MIN_CONSISTENT, SensorScreening
from ltv_mpc.messages import AdcpPing, CompassHeading, GnssFix, ImuSample, PressureDepth, TdcpFix
from ltv_mpc.node import ReceivedMessage
from tests.stepping import as_sent

SUITE = SensorConfig.load("paper")
CONFIG = msgspec.structs.replace(EstimatorConfig(), deepest_m=60.0, kept_m=0.0)
MS, S = 1_000_000, 1_000_000_000

SAID = (
    ImuSample(t_ns=S, interval_ns=10 * MS, angular_rate_radps=(0.1, 0.2, 0.3), specific_force_mps2=(0.0, 0.0, -9.8)),
    GnssFix(t_ns=S, north_m=1.0, east_m=2.0, velocity_north_mps=0.1, velocity_east_mps=0.0),
    TdcpFix(t_ns=S, from_t_ns=0, north_m=0.1, east_m=0.2),
    AdcpPing(t_ns=S, range_m=np.arange(2.0), beam_velocity_mps=np.array([[0.1, np.nan]] * 4)),
)


@pytest.mark.parametrize("message", SAID, ids=lambda message: type(message).__name__)
def test_a_sensor_that_repeats_its_reading_is_stuck_until_it_changes(message):
    screening = SensorScreening()
    assert screening.rejection(S, message, S) is None
    assert screening.rejection(S, message, S) is None  # the same message twice: of that the history knows
    assert [screening.rejection(t, message, t) for t in (2 * S, 3 * S)] == ["stuck"] * 2
    name = {ImuSample: "specific_force_mps2", AdcpPing: "beam_velocity_mps"}.get(type(message), "north_m")
    old = getattr(message, name)
    new = (0.0, 1e-9, -9.8) if isinstance(old, tuple) else old + 1e-9
    assert screening.rejection(4 * S, msgspec.structs.replace(message, **{name: new}), 4 * S) is None
    assert screening.rejection(5 * S, message, 5 * S) is None


@pytest.mark.parametrize("message", [PressureDepth(t_ns=S, depth_m=3.0), CompassHeading(t_ns=S, heading_rad=1.0)])
def test_a_single_number_and_a_ping_without_return_may_repeat(message):
    screening = SensorScreening()
    nothing = AdcpPing(t_ns=S, range_m=np.arange(2.0), beam_velocity_mps=np.full((4, 2), np.nan))
    assert [screening.rejection(t, one, t) for t in (S, 2 * S) for one in (message, nothing)] == [None] * 4


def sample(t_ns, force, rate=0.3):
    return ImuSample(
        t_ns=t_ns, interval_ns=10 * MS, angular_rate_radps=(0.1, 0.2, rate), specific_force_mps2=(force, 0.0, -9.8)
    )


@pytest.mark.parametrize(("force", "rate"), [(2.1, 0.3), (0.0, 0.51)])
def test_after_implausible_samples_five_plausible_ones_in_a_row_are_accepted(force, rate):
    screening, said = SensorScreening(), []
    for k in range(1, 14):
        odd = k == 5
        one = sample(k * 10 * MS, force + 1e-3 * k if odd else 1e-3 * k, rate if odd else 0.3)
        said.append(screening.rejection(one.t_ns, one, one.t_ns))
    # the odd one, the first after it, which is as far from it, and four more
    assert said == [None] * 4 + ["jump"] * (1 + MIN_CONSISTENT) + [None] * 3


def test_over_a_longer_time_a_vehicle_may_turn_further():
    screening = SensorScreening()
    samples = sample(10 * MS, 0.0), sample(110 * MS, 9.0, 1.2)
    assert [screening.rejection(one.t_ns, one, one.t_ns) for one in samples] == [None, None]


def test_random_readings_of_an_inertial_unit_are_no_motion(make_dive):
    """Up to 0.2 rad/s and 2 m/s2 for 4 s, a tenth of its range: the truth stays within 3.5 sigma."""
    dive, rng = make_dive(SUITE, 4, duration_s=12.0), np.random.default_rng(2)
    estimator = Estimator(SUITE, CONFIG)
    for message in dive.messages:
        said = message
        if isinstance(message, ImuSample) and 4 * S < message.t_ns <= 8 * S:
            noise = rng.uniform(-1.0, 1.0, (2, 3)) * [[0.2], [2.0]]
            values = {"angular_rate_radps": tuple(noise[0]), "specific_force_mps2": tuple(noise[1])}
            said = msgspec.structs.replace(message, **values)
        estimator.step(message.t_ns, [ReceivedMessage(as_sent(said), 1, 0, message.t_ns)])
    assert estimator.account["imu.jump"] > 390
    P, x, k = estimator.filter.core_covariance(), estimator.filter.belief.x, dive.at(12 * S)
    assert abs(x[3:5] - dive.velocity[k, :2]).max() < 3.5 * P[3, 3] ** 0.5
    assert P[3, 3] ** 0.5 < 0.05


@pytest.mark.parametrize(
    ("stamp_ns", "why"),
    [
        (3600 * S, "future"),
        (10 * S + MAX_CLOCK_LEAD_NS + 1, "future"),
        (10 * S + MAX_CLOCK_LEAD_NS, None),
        (0, None),  # a bus may be slow, and the history knows what is too late
    ],
)
def test_stamps_later_than_their_arrival_are_rejected(stamp_ns, why):
    assert SensorScreening().rejection(stamp_ns, CompassHeading(t_ns=stamp_ns, heading_rad=1.0), 10 * S) == why


def test_delayed_messages_are_used_unless_newer_ones_have_arrived():
    """A delay of 0.8 s that ends: the newest first, and what was under way between newer ones."""
    screening = SensorScreening()
    for k in range(100):
        one = sample(k * 10 * MS, 1e-3 * k)
        assert screening.rejection(one.t_ns, one, one.t_ns + 800 * MS) is None
    for k in range(100, 180):
        fresh, old = (sample(j * 10 * MS, 1e-3 * j) for j in (k + 80, k))
        assert screening.rejection(fresh.t_ns, fresh, fresh.t_ns) is None
        assert screening.rejection(old.t_ns, old, fresh.t_ns) == "stale"


@pytest.mark.parametrize("jump_s", [3600.0, -4.0, -1.2], ids=["ahead", "back", "a little back"])
def test_a_clock_that_jumps_and_comes_back_leaves_a_gap_and_nothing_else(make_dive, jump_s):
    """For 5 s: stamps that are back by 4 s catch up with the filter's time, but the measurements are 4 s younger."""
    dive = make_dive(SUITE, 4, duration_s=12.0)
    estimator = Estimator(SUITE, CONFIG)
    for message in dive.messages:
        said = message
        if 4 * S < message.t_ns <= 9 * S:
            said = msgspec.structs.replace(message, t_ns=message.t_ns + round(jump_s * S))
            before_ns = estimator.filter.belief.t_ns
        estimator.step(message.t_ns, [ReceivedMessage(as_sent(said), 1, 0, message.t_ns)])
        assert said is message or estimator.filter.belief.t_ns == before_ns
    assert estimator.filter.belief.t_ns == 12 * S
    assert estimator.account["imu.gap"] == 1
    account = estimator.account
    assert account["imu.future"] + account["imu.stale"] + account["imu.late"] == 500
    P, x, k = estimator.filter.core_covariance(), estimator.filter.belief.x, dive.at(12 * S)
    assert abs(x[3:5] - dive.velocity[k, :2]).max() < 3.5 * P[3, 3] ** 0.5
    assert P[3, 3] ** 0.5 < 0.05
