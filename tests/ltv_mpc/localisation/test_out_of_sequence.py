"""Late messages: the resulting belief is that of the same messages in order, bit for bit."""

import copy
import dataclasses
from collections import Counter

import numpy as np
import pytest
from msgspec.structs import replace

from ltv_mpc.localisation.filter.error_state_filter import ErrorStateFilter
from ltv_mpc.localisation.out_of_sequence import REACH_NS
from ltv_mpc.localisation.sensors import BY_MESSAGE
from ltv_mpc.messages import (
    AdcpPing,
    BottomTrack,
    CompassHeading,
    GnssFix,
    ImuSample,
    LblRange,
    PressureDepth,
    TdcpFix,
    UsblFix,
)
from tests.ltv_mpc.localisation.dives import CONFIG as SHIPPED
from tests.ltv_mpc.localisation.dives import REALISTIC, Run, S, dive
from tests.ltv_mpc.localisation.sensors.every_sensor import EVERY_SENSOR, with_settings

SENSORS = with_settings(
    replace(EVERY_SENSOR, pressure=REALISTIC.pressure),
    bottom_track={"period_ns": 297_654_321, "beam_noise_sd_mps": 0.03},  # between two inertial samples
    lbl={
        "period_ns": 400_000_000,
        "transponders_m": ((100.0, 0.0, 60.0), (0.0, 120.0, 60.0)),
        "sound_speed_sd_mps": 2.0,
        "range_sd_m": 0.5,
    },
    usbl={"period_ns": 297_654_321, "bearing_sd_rad": 0.01},
)
CONFIG = replace(SHIPPED, deepest_m=20.0)
ALIGNED_NS = -2 * S
KINDS = (GnssFix, TdcpFix, AdcpPing, PressureDepth, CompassHeading, BottomTrack, LblRange, UsblFix)


@pytest.fixture(scope="module")
def messages():
    """Three seconds at the surface and three below, all sensors, those of one instant in the order of ``KINDS``."""
    of = dive(SENSORS, 7, surface_s=3.0, duration_s=3.0, bottom_m=15.0)
    order = {kind: i for i, kind in enumerate((ImuSample, *KINDS))}
    return sorted(of.messages, key=lambda m: (m.t_ns, order[type(m)]))


def arriving(messages, latency_of):
    """Return messages in order of arrival; of one instant the inertial sample first, then by validity time."""
    return sorted(messages, key=lambda m: (m.t_ns + latency_of(m), not isinstance(m, ImuSample), m.t_ns))


def used(messages):
    return Run(messages, SENSORS, CONFIG)


def plain(value):
    """Return a value that can be compared to the last bit."""
    if isinstance(value, np.ndarray):
        return value.shape, value.tobytes()
    if dataclasses.is_dataclass(value):
        return {f.name: plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, dict):
        return {name: plain(entry) for name, entry in value.items()}
    if isinstance(value, tuple | list):
        return [plain(entry) for entry in value]
    return plain(vars(value)) if hasattr(value, "__dict__") else value


def belief_of(run):
    return plain(run.estimator.filter.snapshot())


def scattered(seed):
    """Return random latencies of up to a second for every message but the inertial unit's."""
    latency_ns = np.random.default_rng(seed).integers(0, S, 10_000).tolist()
    return lambda m: 0 if isinstance(m, ImuSample) or m.t_ns <= ALIGNED_NS else latency_ns[(m.t_ns // 1000) % 9973]


FROM_THE_START = {GnssFix: 400_000_000, TdcpFix: 450_000_000, CompassHeading: 300_000_000, PressureDepth: 20_000_000}
LATENCIES = {
    "scattered": scattered(0),
    "from the start": lambda m: FROM_THE_START.get(type(m), 0),
}


@pytest.mark.parametrize("latency_of", LATENCIES.values(), ids=LATENCIES)
def test_late_sensors_give_the_same_belief_and_estimates_as_in_time(messages, latency_of):
    """Scattered by up to a second all kinds overtake each other, and carrier phases come before their epoch's fix."""
    arrived = arriving(messages, latency_of)
    late, ordered = used(arrived), used(sorted(arrived, key=lambda m: m.t_ns))
    assert belief_of(late) == belief_of(ordered)
    account = late.estimator.account
    for kind in {type(m) for m in messages if latency_of(m) > 0}:
        assert account[f"{BY_MESSAGE[kind].name}.late_applied"] > 0
    assert list(late.estimates) == list(ordered.estimates) == sorted(set(late.estimates))
    assert late.estimator.filter.belief.t_ns == 3 * S


def test_a_message_is_counted_and_observed_once(messages):
    """It may be applied several times."""
    seen, arrived = [], arriving(messages, scattered(0))
    estimator = used(m for m in arrived if m.t_ns <= ALIGNED_NS).estimator
    before = estimator.account
    estimator.filter.observers.append(seen.append)
    Run((m for m in arrived if m.t_ns > ALIGNED_NS), estimator=estimator)
    counts = Counter((v.sensor, v.t_ns, *v.indices.tolist()) for v in seen)
    assert set(counts.values()) == {1}
    more = Counter(estimator.account)
    more.subtract(before)
    for sensor in ("adcp", "pressure", "compass", "lbl", "usbl", "bottom_track"):
        rows = sum(len(v.residual) for v in seen if v.sensor == sensor)
        assert rows == more[f"{sensor}.used"] + more[f"{sensor}.gate"] > 0
    pings = sum(m.beam_velocity_mps.size for m in messages if isinstance(m, AdcpPing) and m.t_ns > ALIGNED_NS)
    assert pings == sum(more[f"adcp.{what}"] for what in ("used", "gate", "no_return", "outside_grid"))


def test_a_late_message_shows_in_the_next_estimate(messages):
    """A bottom track that comes 0.7 s late: the estimate before it is that of a filter that never receives it."""
    ping = next(m for m in messages if isinstance(m, BottomTrack) and m.t_ns > S)
    arrived = arriving(messages, lambda m: 700_000_000 if m is ping else 0)
    never = used(m for m in messages if m is not ping).estimates
    late, ordered = (used(order).estimates for order in (arrived, sorted(arrived, key=lambda m: m.t_ns)))
    for t_ns, estimate in late.items():
        same = never if t_ns < ping.t_ns + 700_000_000 else ordered
        assert estimate.velocity_north_mps == same[t_ns].velocity_north_mps
    last_ns = max(never)
    assert never[last_ns].velocity_north_mps != ordered[last_ns].velocity_north_mps


def test_a_message_beyond_the_buffers_reach_is_counted_and_dropped(messages):
    fix = next(m for m in messages if isinstance(m, UsblFix) and m.t_ns > 0)
    for latency_ns, what in ((REACH_NS - 20_000_000, "late_applied"), (REACH_NS + 20_000_000, "late")):
        late = used(arriving(messages, lambda m, by=latency_ns: by if m is fix else 0))
        assert late.estimator.account[f"usbl.{what}"] == 1
    assert belief_of(late) == belief_of(used(m for m in messages if m is not fix))


def test_a_message_that_arrives_twice_is_used_once(messages):
    """At once, half a second later, or during the alignment; two replies to one interrogation are two messages."""
    once = used(messages)
    begun = next(i for i, m in enumerate(messages) if m.t_ns > -2_600_000_000)
    made = [m for m in messages[:begun] if m.t_ns == messages[0].t_ns]
    twice = sorted([*messages, *messages], key=lambda m: m.t_ns)
    old = [m for m in messages if m.t_ns > 3 * S - 500_000_000]
    again = [*messages, *old]
    for repeated in (twice, again, [*messages[:begun], *made, *messages[begun:]]):
        run = used(repeated)
        assert belief_of(run) == belief_of(once)
        account = run.estimator.account
        assert len(repeated) < len(messages) + 100 or account["lbl.duplicate"] >= 2
        if repeated is again:
            assert account["imu.late"] == 50
            assert account["pressure.duplicate"] == sum(isinstance(m, PressureDepth) for m in old)
    assert once.estimator.account["lbl.used"] == sum(isinstance(m, LblRange) for m in messages)


def test_a_restored_filter_is_what_it_was_in_every_attribute(messages):
    """Whatever is added to the filter must be in its snapshot."""
    filter_ = used(m for m in messages if m.t_ns <= S).estimator.filter

    def state():
        return {name: plain(value) for name, value in vars(filter_).items() if name not in ("account", "observers")}

    before, then = copy.deepcopy(state()), filter_.snapshot()
    for _ in range(2):
        for m in messages:
            if m.t_ns > S and isinstance(m, ImuSample):
                filter_.advance(m.t_ns, m)
            elif m.t_ns > S:
                filter_.belief.t_ns = m.t_ns
                filter_.correct(m)
        assert state() != before
        filter_.restore(then)
        assert state() == before


@pytest.mark.parametrize(("sensors", "a_second"), [(REALISTIC, 1), (SENSORS, 4)], ids=["no latency", "latency"])
def test_snapshots_are_rarer_if_no_sensor_has_a_latency(messages, monkeypatch, sensors, a_second):
    taken, snapshot = [], ErrorStateFilter.snapshot
    monkeypatch.setattr(ErrorStateFilter, "snapshot", lambda self: taken.append(self.belief.t_ns) or snapshot(self))
    Run(messages, sensors, CONFIG)
    assert 0.9 * a_second < len(taken) / 6 <= a_second
