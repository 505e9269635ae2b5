"""Sensor screening: an implausible message is counted and changes nothing, and the messages after it are used."""

import numpy as np
import pytest
from msgspec.structs import replace

from ltv_mpc.localisation.estimator import Estimator
from ltv_mpc.localisation.sensor_screening import MAX_CLOCK_LEAD_NS, MIN_CONSISTENT, SensorScreening
from ltv_mpc.messages import AdcpPing, CompassHeading, GnssFix, ImuSample, PressureDepth, TdcpFix
from ltv_mpc.node import ReceivedMessage
from tests.ltv_mpc.localisation.dives import CONFIG, PAPER, S, dive
from tests.stepping import as_sent

MS = 1_000_000
DIVE = dive(PAPER, 4, duration_s=12.0)


def sample(t_ns, force=0.0, rate=0.3):
    return ImuSample(
        t_ns=t_ns, interval_ns=10 * MS, angular_rate_radps=(0.1, 0.2, rate), specific_force_mps2=(force, 0.0, -9.8)
    )


def rejections(messages, screening=None):
    """Return why each message is rejected on arrival without latency."""
    screening = screening or SensorScreening()
    return [screening.rejection(message.t_ns, message, message.t_ns) for message in messages]


@pytest.mark.parametrize(
    "message",
    [
        sample(S),
        GnssFix(t_ns=S, north_m=1.0, east_m=2.0, velocity_north_mps=0.1, velocity_east_mps=0.0),
        TdcpFix(t_ns=S, from_t_ns=0, north_m=0.1, east_m=0.2),
        AdcpPing(t_ns=S, range_m=np.arange(2.0), beam_velocity_mps=np.array([[0.1, np.nan]] * 4)),
    ],
    ids=lambda message: type(message).__name__,
)
def test_a_sensor_that_repeats_its_reading_is_stuck_until_it_changes(message):
    name = {ImuSample: "specific_force_mps2", AdcpPing: "beam_velocity_mps"}.get(type(message), "north_m")
    old = getattr(message, name)
    new = replace(message, **{name: (0.0, 1e-9, -9.8) if isinstance(old, tuple) else old + 1e-9})
    repeated = [replace(one, t_ns=t * S) for t, one in enumerate((message, message, message, new, message), 1)]
    # the same message twice: of that the history knows
    assert rejections([message, *repeated]) == [None, None, "stuck", "stuck", None, None]


def test_a_single_number_and_a_ping_without_return_may_repeat():
    nothing = AdcpPing(t_ns=S, range_m=np.arange(2.0), beam_velocity_mps=np.full((4, 2), np.nan))
    for message in (PressureDepth(t_ns=S, depth_m=3.0), CompassHeading(t_ns=S, heading_rad=1.0), nothing):
        assert rejections([message, replace(message, t_ns=2 * S)]) == [None, None]


@pytest.mark.parametrize(("force", "rate"), [(2.1, 0.3), (0.0, 0.51)])
def test_after_implausible_samples_five_plausible_ones_in_a_row_are_accepted(force, rate):
    samples = [sample(k * 10 * MS, 1e-3 * k) for k in range(1, 14)]
    samples[4] = sample(50 * MS, force + 5e-3, rate)
    # the odd one, the first after it, which is as far from it, and four more
    assert rejections(samples) == [None] * 4 + ["jump"] * (1 + MIN_CONSISTENT) + [None] * 3


def test_over_a_longer_time_a_vehicle_may_turn_further():
    assert rejections([sample(10 * MS), sample(110 * MS, 9.0, 1.2)]) == [None, None]


@pytest.mark.parametrize(
    ("stamp_ns", "why"),
    [
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


def dived(change):
    """Return the estimator after the dive with changed messages, which arrive when they were made."""
    estimator = Estimator(PAPER, replace(CONFIG, deepest_m=60.0))
    for message in DIVE.messages:
        estimator.step(message.t_ns, [ReceivedMessage(as_sent(change(message)), 1, 0, message.t_ns)])
    P, x, k = estimator.filter.core_covariance(), estimator.filter.belief.x, DIVE.at(12 * S)
    assert abs(x[3:5] - DIVE.velocity[k, :2]).max() < 3.5 * P[3, 3] ** 0.5
    assert P[3, 3] ** 0.5 < 0.05
    return estimator


def test_random_readings_of_an_inertial_unit_are_no_motion():
    """Up to 0.2 rad/s and 2 m/s2 for 4 s, a tenth of its range: the truth stays within 3.5 sigma."""
    rng = np.random.default_rng(2)

    def change(message):
        if not isinstance(message, ImuSample) or not 4 * S < message.t_ns <= 8 * S:
            return message
        rate, force = map(tuple, rng.uniform(-1.0, 1.0, (2, 3)) * [[0.2], [2.0]])
        return replace(message, angular_rate_radps=rate, specific_force_mps2=force)

    assert dived(change).account["imu.jump"] > 390


@pytest.mark.parametrize("jump_s", [3600.0, -4.0, -1.2], ids=["ahead", "back", "a little back"])
def test_a_clock_that_jumps_and_comes_back_leaves_a_gap_and_nothing_else(jump_s):
    """For 5 s: stamps that are back by 4 s catch up with the filter's time, but the measurements are 4 s younger."""
    estimator = dived(lambda m: replace(m, t_ns=m.t_ns + round(jump_s * S)) if 4 * S < m.t_ns <= 9 * S else m)
    assert estimator.filter.belief.t_ns == 12 * S
    account = estimator.account
    assert account["imu.gap"] == 1
    assert account["imu.future"] + account["imu.stale"] + account["imu.late"] == 500
