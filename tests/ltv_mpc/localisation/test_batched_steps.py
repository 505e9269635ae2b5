"""A batch of estimator steps gives the same bits as single steps, for any messages of the sensors."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
import numpy as np
import pytest

from ltv_mpc.localisation.estimator import Estimator
from ltv_mpc.localisation.filter.preintegration import sample_matrix
from ltv_mpc.localisation.sensor_screening import MAX_CLOCK_LEAD_NS, SensorScreening
from ltv_mpc.messages import AdcpPing, CompassHeading, ImuSample, LocalisationReport, Message, PressureDepth
from ltv_mpc.node import Due, ReceivedMessage
from services.bus import wire
from services.run.nodes import make_nodes
from services.run.run_config import Override, RunConfig, resolve
from services.tools import lockstep_run
from sim.scheduler import LockStep, Observation
from tests.stepping import step

S = 1_000_000_000


class MessageLog:
    """Recorder of the sensors' messages."""

    def __init__(self) -> None:
        self.said: list[ReceivedMessage] = []

    def published(self, node: str, message: ReceivedMessage) -> None:
        if node == "sensors":
            self.said.append(message)


def descent(sensors: str, duration_s: float) -> RunConfig:
    settings = (
        f"run.duration_s={duration_s}",
        "run.surface_time_s=12.0",
        "run.seed=8",
        f"sensors={sensors}",
        "controller.disturbance.model_sd=0.0",  # whether the shadow filter replaces depends on the motion
        "controller.horizon_s=5.1",
        "controller.effort=high",
    )
    return resolve("descent", [Override("test", settings)])


def heard(run_config: RunConfig) -> list[ReceivedMessage]:
    ears, scenario = MessageLog(), run_config.scenario
    nodes = make_nodes(run_config)
    LockStep(
        nodes,
        start_ns=scenario.start_ns,
        latest=lockstep_run.LATEST,
        observation=Observation(ears),
    ).advance(scenario.end_ns)
    return ears.said


@pytest.fixture(scope="module")
def run_config() -> RunConfig:
    return descent("realistic", 50.0)


@pytest.fixture(scope="module")
def said(run_config: RunConfig) -> list[ReceivedMessage]:
    return heard(run_config)


def estimator(run_config: RunConfig) -> Estimator:
    return Estimator(run_config.sensor_config, run_config.scenario.estimator, run_config.prior)


def before(said: Sequence[ReceivedMessage], end_s: float) -> list[ReceivedMessage]:
    """Return what is received until some seconds after a disturbance: what it changes is then in the output."""
    return [message for message in said if message.received_t_ns < end_s * S]


def payload(signal: Message) -> bytes:
    return wire.encode(signal, wire.Header(epoch=1, sequence=0, sent_monotonic_us=0))


def both(
    run_config: RunConfig, arrivals: Sequence[ReceivedMessage], chunk: int
) -> tuple[list[Message], dict[str, int]]:
    """Return the output of single steps, after comparing it with that of batches."""
    due: list[Due] = [(arrival.message.t_ns, [arrival]) for arrival in arrivals]  # type: ignore[attr-defined]
    one, other = estimator(run_config), estimator(run_config)
    slow = [step(one, *one_due) for one_due in due]
    fast: list[list[Message]] = []
    for first in range(0, len(due), chunk):
        fast += other.steps(due[first : first + chunk])
    assert [[payload(x) for x in signals] for signals in fast] == [[payload(x) for x in signals] for signals in slow]
    assert dict(other.account) == dict(one.account)
    assert one.filter is not None
    assert other.filter is not None
    for name in ("x", "P", "R"):
        np.testing.assert_array_equal(getattr(other.filter.belief, name), getattr(one.filter.belief, name))
    return [x for signals in slow for x in signals], dict(one.account)


def changed(message: ReceivedMessage, **fields: object) -> ReceivedMessage:
    return msgspec.structs.replace(message, message=msgspec.structs.replace(message.message, **fields))


def is_imu(message: ReceivedMessage, from_s: float, to_s: float) -> bool:
    return isinstance(message.message, ImuSample) and from_s * S < message.message.t_ns <= to_s * S


@pytest.mark.parametrize("chunk", [7, 60])
def test_batches_equal_single_steps_in_a_quiet_descent(
    run_config: RunConfig, said: list[ReceivedMessage], chunk: int
) -> None:
    out, account = both(run_config, before(said, 20.0), chunk)
    assert len(out) > 300
    assert not {key for key in account if key.startswith("imu.")}


def test_batches_equal_single_steps_with_satellite_fixes_without_latency() -> None:
    """The position of each fix is cloned when time continues."""
    run_config = descent("paper", 10.0)
    _, account = both(run_config, heard(run_config), 40)
    assert account["tdcp.used"] > 2
    assert "tdcp.other_epoch" not in account


@pytest.mark.parametrize("lost", [(6.03, 6.04), (8.03, 8.08), (12.03, 13.24), (17.03, 19.04)])
def test_batches_equal_single_steps_if_samples_are_lost(
    run_config: RunConfig, said: list[ReceivedMessage], lost: tuple[float, float]
) -> None:
    """One, some, a second and two of them, from within an interval between two estimates, and every second one."""
    arrivals = [
        m for i, m in enumerate(before(said, 30.0)) if not is_imu(m, *lost) and not (is_imu(m, 24.0, 25.0) and i % 2)
    ]
    _, account = both(run_config, arrivals, 40)
    assert account["imu.gap"] > 3


def test_batches_equal_single_steps_if_other_messages_are_lost(
    run_config: RunConfig, said: list[ReceivedMessage]
) -> None:
    """An estimate then waits for them until time continues."""
    arrivals = [
        m for m in before(said, 20.0) if not (isinstance(m.message, PressureDepth) and m.message.t_ns % (3 * S) < 2 * S)
    ]
    out, _ = both(run_config, arrivals, 40)
    assert len(out) > 300


def test_batches_equal_single_steps_if_samples_are_rejected(run_config: RunConfig, said: list[ReceivedMessage]) -> None:
    arrivals: list[ReceivedMessage] = []
    for message in before(said, 20.0):
        if is_imu(message, 6.0, 6.03):
            message = changed(message, specific_force_mps2=(50.0, 0.0, 0.0))
        elif is_imu(message, 9.0, 9.2):
            message = changed(message, angular_rate_radps=(0.1, 0.0, 0.0), specific_force_mps2=(0.1, 0.0, -9.8))
        elif is_imu(message, 15.0, 15.05):
            message = changed(message, t_ns=message.message.t_ns + 2 * MAX_CLOCK_LEAD_NS)  # type: ignore[attr-defined]
        arrivals.append(message)
    _, account = both(run_config, arrivals, 40)
    assert min(account[f"imu.{why}"] for why in ("jump", "stuck", "future")) > 2


def test_batches_equal_single_steps_if_messages_are_late_or_early(
    run_config: RunConfig, said: list[ReceivedMessage]
) -> None:
    arrivals: list[ReceivedMessage] = []
    held: list[ReceivedMessage] = []
    for i, message in enumerate(before(said, 20.0)):
        if isinstance(message.message, AdcpPing) and message.message.t_ns % (2 * S) < S:
            held.append(message)
        elif isinstance(message.message, PressureDepth | CompassHeading):
            arrivals.append(changed(message, t_ns=message.message.t_ns + 55_000_000))  # between two estimates
        else:
            arrivals.append(message)
        if i % 60 == 0:
            arrivals += [msgspec.structs.replace(late, received_t_ns=message.received_t_ns) for late in held]
            held.clear()
    _, account = both(run_config, arrivals, 40)
    assert account["adcp.late_applied"] > 5


@pytest.mark.parametrize("what", ["accelerometer", "profiler"])
def test_batches_equal_single_steps_across_a_reinitialisation(
    run_config: RunConfig, said: list[ReceivedMessage], what: str
) -> None:
    """A bias a hundred times as large, or a wrong scale, for as long as it takes, and then no longer."""

    def wrong(message: ReceivedMessage) -> ReceivedMessage:
        signal = message.message
        if what == "accelerometer" and isinstance(signal, ImuSample):
            x, y, z = signal.specific_force_mps2
            return changed(message, specific_force_mps2=(x + 0.98, y - 0.98, z))
        if what == "profiler" and isinstance(signal, AdcpPing):
            return changed(message, beam_velocity_mps=1.5 * signal.beam_velocity_mps)
        return message

    arrivals = [wrong(m) if 10 * S < m.received_t_ns < 34 * S else m for m in said]
    out, _ = both(run_config, arrivals, 40)
    reports = [signal for signal in out if isinstance(signal, LocalisationReport)]
    assert reports[-1].restarts >= 1
    returned = any("shadow filter has replaced" in report.why for report in reports)
    assert returned == (what == "profiler")


def test_the_quick_check_accepts_only_samples_that_screening_accepts() -> None:
    rng = np.random.default_rng(4)
    let = refused = 0
    for _ in range(300):
        screening, other = SensorScreening(), SensorScreening()
        samples: list[ImuSample] = []
        t_ns = 0
        force = np.array([0.0, 0.0, -9.8])
        for _ in range(12):
            t_ns += int(
                rng.choice(
                    [10_000_000, 10_000_000, 10_000_000, 2_000_000, 0, -300_000_000],
                    p=[0.4, 0.3, 0.2, 0.08, 0.01, 0.01],
                )
            )
            if rng.random() > 0.02:
                force = force + rng.normal(0.0, rng.choice([0.1, 0.1, 0.1, 0.5]), 3)
            samples.append(
                ImuSample(
                    t_ns=t_ns,
                    interval_ns=10_000_000,
                    angular_rate_radps=(0.0, 0.0, 0.1),
                    specific_force_mps2=tuple(force),
                )
            )
        came_ns = [
            s.t_ns + int(rng.choice([0, 5_000_000, -MAX_CLOCK_LEAD_NS - 1], p=[0.5, 0.49, 0.01])) for s in samples
        ]
        for sample, received_ns in zip(samples[:3], came_ns[:3], strict=True):
            assert screening.rejection(sample.t_ns, sample, received_ns) == other.rejection(
                sample.t_ns, sample, received_ns
            )
        verdicts = [screening.rejection(s.t_ns, s, r) for s, r in zip(samples[3:], came_ns[3:], strict=True)]
        if other.accepts_all(samples[3:], came_ns[3:], sample_matrix(samples[3:])):
            let += 1
            assert verdicts == [None] * 9
            other.record_last(samples[-1], came_ns[-1], sample_matrix(samples[-1:]))
            later = msgspec.structs.replace(samples[-1], t_ns=samples[-1].t_ns + 10_000_000)
            assert not other.accepts_all([later], [came_ns[-1] + 10_000_000], sample_matrix([later]))  # stuck
            turned = msgspec.structs.replace(later, angular_rate_radps=(0.0, 0.0, 0.11))
            assert other.accepts_all([turned], [came_ns[-1] + 10_000_000], sample_matrix([turned]))
            assert screening.rejection(later.t_ns, later, came_ns[-1] + 10_000_000) == "stuck"
            assert other.rejection(later.t_ns, later, came_ns[-1] + 10_000_000) == "stuck"
            # A sample that came by itself is what the next are held against, not the last of many before it.
            assert other.rejection(turned.t_ns, turned, came_ns[-1] + 10_000_000) is None
            again = msgspec.structs.replace(turned, t_ns=turned.t_ns + 10_000_000)
            assert not other.accepts_all([again], [came_ns[-1] + 20_000_000], sample_matrix([again]))
        else:
            refused += any(verdict is not None for verdict in verdicts)
    assert let > 50
    assert refused > 50
