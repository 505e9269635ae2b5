"""Late messages: the resulting belief is that of the same messages in order, bit for bit."""

import copy
import dataclasses
from collections import Counter

import msgspec
import numpy as np
import pytest

from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.estimator import Estimator
from ltv_mpc.localisation.filter.error_state_filter import ErrorStateFilter
from ltv_mpc.localisation.out_of_sequence import REACH_NS
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.sensors import BY_MESSAGE
from ltv_mpc.localisation.sensors.adcp import beam_directions
from ltv_mpc.localisation.sensors.bottom_track import BottomTracking
from ltv_mpc.localisation.sensors.lbl import Lbl
from ltv_mpc.localisation.sensors.usbl import Usbl
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
    UsblFix,
)

SECOND = 1_000_000_000
ODD = {"missing_share": 0.0, "outlier_share": 0.0}
REALISTIC = SensorConfig.load("realistic")
SUITE = msgspec.structs.replace(
    REALISTIC,
    bottom_track=BottomTracking(**ODD, period_ns=333_333_333, range_m=50.0, beam_noise_sd_mps=0.03, outlier_mps=0.5),
    lbl=Lbl(
        **ODD,
        period_ns=SECOND,
        transponders_m=((100.0, 0.0, 60.0), (0.0, 120.0, 60.0)),
        sound_speed_mps=1500.0,
        sound_speed_sd_mps=2.0,
        range_sd_m=0.5,
        outlier_m=0.0,
    ),
    usbl=Usbl(
        **ODD, period_ns=SECOND, latency_ns=0, ship_m=(0.0, 0.0), position_sd_m=1.0, bearing_sd_rad=0.01, outlier_m=0.0
    ),
)
CONFIG = msgspec.structs.replace(EstimatorConfig(), deepest_m=20.0)
ALIGNED_NS = -2 * SECOND
KINDS = (GnssFix, TdcpFix, AdcpPing, PressureDepth, CompassHeading, BottomTrack, LblRange, UsblFix)


@pytest.fixture(scope="module")
def messages(make_dive):
    """Three seconds at the surface and three below, all sensors, those of one instant in the order of ``KINDS``."""
    dive = make_dive(SUITE, 7, surface_s=3.0, duration_s=3.0)
    rng = np.random.default_rng(8)
    out = list(dive.messages)
    for tenth in range(-29, 30):
        t_ns = tenth * 100_000_000 + 7_654_321  # between two inertial samples
        k = dive.at(t_ns)
        p = dive.position[k]
        if tenth % 3 == 0:
            z = -beam_directions(SUITE.adcp.beam_angle_rad) @ dive.R[k].T @ dive.velocity[k]
            z += 0.03 * rng.standard_normal(4)
            out.append(BottomTrack(t_ns=t_ns, range_m=np.full(4, 9.0), beam_velocity_mps=z))
        if tenth % 5 == 0:
            for j, place in enumerate(SUITE.lbl.transponders_m):
                r = np.linalg.norm(p - place) + 0.5 * rng.standard_normal()
                out.append(LblRange(t_ns=t_ns, transponder=j, travel_time_s=2 * r / 1500.0))
        if tenth % 4 == 0:
            n, e = p[:2] + rng.standard_normal(2)
            out.append(UsblFix(t_ns=t_ns, north_m=float(n), east_m=float(e)))
    order = {kind: i for i, kind in enumerate((ImuSample, *KINDS))}
    return sorted(out, key=lambda m: (m.t_ns, order[type(m)]))


def arriving(messages, latency_of):
    """Return messages in order of arrival; of one instant the inertial sample first, then by validity time."""
    return sorted(messages, key=lambda m: (m.t_ns + latency_of(m), not isinstance(m, ImuSample), m.t_ns))


def in_order(arrived):
    """Return the same messages by time; those of one time in order of arrival."""
    return sorted(arrived, key=lambda m: m.t_ns)


def used(messages, inbox_of, observe=None):
    """Return an estimator that has used the messages one by one, and its output."""
    estimator, said = Estimator(SUITE, CONFIG), []
    for message in messages:
        heard = estimator.filter is not None and message.t_ns > ALIGNED_NS
        if heard and observe not in (None, *estimator.filter.observers):
            estimator.filter.observers.append(observe)
        said += [one for one in estimator.step(message.t_ns, inbox_of(message)) if isinstance(one, Estimate)]
    return estimator, said


def plain(value):
    """Return a value that can be compared to the last bit."""
    if isinstance(value, np.ndarray):
        return value.shape, value.tobytes()
    if dataclasses.is_dataclass(value):
        return {f.name: plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, dict):
        return {name: plain(entry) for name, entry in value.items()}
    if isinstance(value, tuple):
        return [plain(entry) for entry in value]
    if hasattr(value, "__dict__"):
        return plain(vars(value))
    return value


def state(filter_):
    """Return all attributes of a filter except account and observers."""
    return {name: plain(value) for name, value in vars(filter_).items() if name not in ("account", "observers")}


def assert_same(late, ordered):
    assert plain(late.filter.snapshot()) == plain(ordered.filter.snapshot())


def only(kind, latency_ns):
    return lambda m: latency_ns if isinstance(m, kind) and m.t_ns > ALIGNED_NS else 0


def scattered(seed):
    """Return random latencies of up to a second for every message but the inertial unit's."""
    latency_ns = np.random.default_rng(seed).integers(0, SECOND, 10_000).tolist()
    return lambda m: 0 if isinstance(m, ImuSample) or m.t_ns <= ALIGNED_NS else latency_ns[(m.t_ns // 1000) % 9973]


@pytest.mark.parametrize("kind", KINDS)
def test_a_late_sensor_gives_the_same_belief_as_in_time(messages, inbox_of, kind):
    arrived = arriving(messages, only(kind, 730_000_000))
    late, ordered = used(arrived, inbox_of)[0], used(in_order(arrived), inbox_of)[0]
    assert_same(late, ordered)
    came_late = sum(isinstance(m, kind) and ALIGNED_NS < m.t_ns <= 3 * SECOND - 730_000_000 for m in messages)
    assert late.account[f"{BY_MESSAGE[kind].name}.late_applied"] >= came_late > 0


@pytest.mark.parametrize("seed", range(2))
def test_sensors_late_at_random_give_the_same_belief_as_in_order(messages, inbox_of, seed):
    """Up to a second each, so that they overtake each other, and carrier phases come before their epoch's fix."""
    arrived = arriving(messages, scattered(seed))
    late, ordered = used(arrived, inbox_of)[0], used(in_order(arrived), inbox_of)[0]
    assert_same(late, ordered)
    assert sum(late.account[f"{BY_MESSAGE[kind].name}.late_applied"] for kind in KINDS) > 100
    # It is not that lateness does not matter: without the late ones the belief is another.
    dropped = used([m for m in messages if m.t_ns <= ALIGNED_NS or isinstance(m, ImuSample)], inbox_of)[0]
    assert plain(dropped.filter.snapshot()) != plain(ordered.filter.snapshot())


def test_sensors_that_are_late_from_the_start_align_the_filter_as_in_order(messages, inbox_of):
    latency_ns = {GnssFix: 400_000_000, TdcpFix: 450_000_000, CompassHeading: 300_000_000, PressureDepth: 20_000_000}
    arrived = arriving(messages, lambda m: latency_ns.get(type(m), 0))
    late, ordered = used(arrived, inbox_of)[0], used(in_order(arrived), inbox_of)[0]
    assert_same(late, ordered)
    assert late.filter.belief.t_ns == 3 * SECOND


def test_a_message_is_counted_and_observed_once(messages, inbox_of):
    """It may be applied several times."""
    verdicts = []
    arrived = arriving(messages, scattered(0))
    late = used(arrived, inbox_of, verdicts.append)[0]
    before = used([m for m in arrived if m.t_ns <= ALIGNED_NS], inbox_of)[0].account
    judged = Counter((v.sensor, v.t_ns, *v.indices.tolist()) for v in verdicts)
    assert set(judged.values()) == {1}
    account = late.account
    for sensor in ("adcp", "pressure", "compass", "lbl", "usbl", "bottom_track"):
        rows = sum(len(v.residual) for v in verdicts if v.sensor == sensor)
        names = (f"{sensor}.used", f"{sensor}.gate")
        assert rows == sum(account[name] - before[name] for name in names) > 0
    pings = sum(m.beam_velocity_mps.size for m in messages if isinstance(m, AdcpPing) and m.t_ns > ALIGNED_NS)
    names = [f"adcp.{what}" for what in ("used", "gate", "no_return", "outside_grid")]
    assert pings == sum(account[name] - before[name] for name in names)


def test_estimates_are_published_once_and_as_when_all_is_in_time(messages, inbox_of):
    arrived = arriving(messages, scattered(1))
    times = [[e.t_ns for e in used(order, inbox_of)[1]] for order in (arrived, in_order(arrived))]
    assert times[0] == times[1] == sorted(set(times[0]))


def test_a_late_message_shows_in_the_next_estimate(messages, inbox_of):
    """A bottom track that comes 0.7 s late: the estimate before it is that of a filter that never receives it."""
    ping = next(m for m in messages if isinstance(m, BottomTrack) and m.t_ns > SECOND)
    others = [m for m in messages if m is not ping]
    arrived = arriving(messages, lambda m: 700_000_000 if m is ping else 0)
    (_, late), (_, never), (_, ordered) = (used(order, inbox_of) for order in (arrived, others, in_order(arrived)))
    for a, b, c in zip(late, never, ordered, strict=True):
        velocity = a.velocity_north_mps
        assert velocity == (b if a.t_ns < ping.t_ns + 700_000_000 else c).velocity_north_mps
    assert never[-1].velocity_north_mps != ordered[-1].velocity_north_mps


def test_a_message_beyond_the_buffers_reach_is_counted_and_dropped(messages, inbox_of):
    fix = next(m for m in messages if isinstance(m, UsblFix) and m.t_ns > 0)
    others = [m for m in messages if m is not fix]
    for latency_ns, what in ((REACH_NS - 20_000_000, "late_applied"), (REACH_NS + 20_000_000, "late")):
        late, _ = used(arriving(messages, lambda m, by=latency_ns: by if m is fix else 0), inbox_of)
        assert late.account[f"usbl.{what}"] == 1
    assert_same(late, used(others, inbox_of)[0])


def test_a_message_that_arrives_twice_is_used_once(messages, inbox_of):
    """Once more at once, and half a second later; two replies to one interrogation are different messages."""
    twice = sorted([*messages, *messages], key=lambda m: m.t_ns)
    again = [*messages, *(m for m in messages if m.t_ns > 3 * SECOND - 500_000_000)]
    once = used(messages, inbox_of)[0]
    for repeated in (twice, again):
        estimator = used(repeated, inbox_of)[0]
        assert_same(estimator, once)
        assert estimator.account["lbl.duplicate"] >= 2
        assert estimator.account["usbl.duplicate"] >= 1
    # those that made the belief, when it has begun to move
    begun = next(i for i, m in enumerate(messages) if m.t_ns > -2_600_000_000)
    made = [m for m in messages[:begun] if m.t_ns == messages[0].t_ns]
    assert_same(used([*messages[:begun], *made, *messages[begun:]], inbox_of)[0], once)
    assert once.account["lbl.used"] == sum(isinstance(m, LblRange) for m in messages)


def test_a_restored_filter_is_what_it_was_in_every_attribute(messages, inbox_of):
    """Whatever is added to the filter must be in its snapshot."""
    filter_ = used([m for m in messages if m.t_ns <= SECOND], inbox_of)[0].filter
    before, then = copy.deepcopy(state(filter_)), filter_.snapshot()
    for _ in range(2):
        for m in messages:
            if m.t_ns > SECOND:
                if isinstance(m, ImuSample):
                    filter_.advance(m.t_ns, m)
                else:
                    filter_.belief.t_ns = m.t_ns
                    filter_.correct(m)
        assert state(filter_) != before
        filter_.restore(then)
        assert state(filter_) == before


@pytest.mark.parametrize(("suite", "a_second"), [(REALISTIC, 1), (SUITE, 4)])
def test_snapshots_are_rarer_if_no_sensor_has_a_latency(messages, inbox_of, monkeypatch, suite, a_second):
    taken = []
    snapshot = ErrorStateFilter.snapshot
    monkeypatch.setattr(ErrorStateFilter, "snapshot", lambda self: taken.append(self.belief.t_ns) or snapshot(self))
    estimator = Estimator(suite, CONFIG)
    for message in messages:
        estimator.step(message.t_ns, inbox_of(message))
    assert 0.9 * a_second < len(taken) / 6 <= a_second
