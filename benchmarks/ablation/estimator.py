"""Mechanisms of the estimator, each with the event that it exists for and the way it is switched off."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from typing import Any

import msgspec
import numpy as np

from benchmarks.ablation import descent
from benchmarks.ablation.descent import BEGINS_S, Descent, S, TimedNode
from benchmarks.ablation.mechanism import Event, Mechanism, replaced
from ltv_mpc.localisation import imu_dropout, out_of_sequence, supervision
from ltv_mpc.localisation.adaptive.process_noise import AdaptiveProcessNoise, NoiseLevel
from ltv_mpc.localisation.filter import correction, error_state_filter
from ltv_mpc.localisation.reinitialisation import Reinitialisation
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.sensor_screening import SensorScreening
from ltv_mpc.messages import (
    AdcpPing,
    CompassHeading,
    Estimate,
    EstimatorState,
    GnssFix,
    ImuSample,
    MessageFault,
    PressureDepth,
    TdcpFix,
)
from sim.faults.interval import Interval
from sim.faults.message_faults import MessageFaultInterval
from sim.faults.sensor_faults import Failure, SensorFault

SENSORS = (ImuSample, AdcpPing, CompassHeading, PressureDepth, GnssFix, TdcpFix)

Off = Callable[[], AbstractContextManager[Any]]


def interval(seconds: float, begins_s: float = BEGINS_S) -> Interval:
    """Return the time from ``begins_s`` on."""
    return Interval(round(begins_s * S), round((begins_s + seconds) * S))


def broken(kind: type, failure: Failure, seconds: float, size: float = 1.0) -> Descent:
    """Return a descent in which an instrument fails for so long."""
    return Descent(broken=(SensorFault(kind, failure, interval(seconds), size, seed=1),))


def harmed(kinds: tuple[type, ...], harm: MessageFault, seconds: float, size: float) -> Descent:
    """Return a descent in which messages are harmed on their way for so long."""
    return Descent(harmed=(MessageFaultInterval(kinds, harm, interval(seconds), size, seed=1),))


def front(step_mps: float, width_s: float, sensors: str = "realistic") -> Descent:
    """Return a descent through a front that begins at ``BEGINS_S``."""
    return Descent(
        settings=(
            'water.feature.kind="front"',
            f"water.feature.step_mps={step_mps}",
            f"water.feature.width_s={width_s}",
            f"water.feature.at_s={BEGINS_S + 0.5 * width_s}",
        ),
        sensors=sensors,
    )


def gyro(deg_per_h: float) -> Descent:
    """Return a descent in which a gyro's bias jumps."""
    return Descent(gyro_radps=math.radians(deg_per_h) / 3600.0)


FORETOLD = Event("foretold", "water as foretold, nothing fails", Descent())
FAST_FRONT = Event("fast front", "front 20 cm/s in 5 s", front(0.2, 5.0))
MEDIUM_FRONT = Event("medium front", "front 10 cm/s in 10 s", front(0.1, 10.0))
SLOW_FRONT = Event("slow front", "front 10 cm/s in 15 s, paper sensors", front(0.1, 15.0, "paper"))
SLOWER_FRONT = Event("slower front", "front 20 cm/s in 30 s, paper sensors", front(0.2, 30.0, "paper"))
WAVES = Event(
    "waves",
    "internal waves 5 cm/s, 300 s, paper sensors",
    Descent(
        sensors="paper",
        settings=(
            'water.feature.kind="waves"',
            "water.feature.amplitude_mps=0.05",
            "water.feature.period_s=300",
        ),
        duration_s=110.0,
    ),
)
STEP = Event(
    "step",
    "step of the water, 30 cm/s over 1 m at 25 m",
    Descent(
        settings=('water.feature.kind="step"', "water.feature.step_mps=0.3", "water.feature.at_m=25"), duration_s=110.0
    ),
)
GYRO = Event("gyro 30", "gyro bias jumps by 30 deg/h", gyro(30.0))
GYRO_FAST = Event("gyro 100", "gyro bias jumps by 100 deg/h", gyro(100.0))
PROFILER_WRONG = Event("profiler wrong", "profiler 0.2 m/s off for 10 s", broken(AdcpPing, Failure.WRONG, 10.0))
PROFILER_GARBAGE = Event(
    "profiler garbage", "profiler says anything (+-1.5 m/s) for 10 s", broken(AdcpPing, Failure.GARBAGE, 10.0, 0.5)
)
PRESSURE_WRONG = Event("pressure wrong", "pressure gauge 3 m off for 8 s", broken(PressureDepth, Failure.WRONG, 8.0))
IMU_WRONG = Event(
    "imu wrong", "inertial unit 0.1 m/s2, 0.02 rad/s off for 10 s", broken(ImuSample, Failure.WRONG, 10.0)
)
IMU_WORSE = Event(
    "imu worse", "inertial unit 0.3 m/s2, 0.06 rad/s off for 12 s", broken(ImuSample, Failure.WRONG, 12.0, 3.0)
)
IMU_LASTING = Event(
    "imu lasting", "inertial unit 0.1 m/s2, 0.02 rad/s off from then on", broken(ImuSample, Failure.WRONG, 200.0)
)
IMU_OFF = Event("imu off", "inertial unit says nothing for 8 s", broken(ImuSample, Failure.OFF, 8.0))
IMU_OFF_SHORT = Event("imu off, 2 s", "inertial unit says nothing for 2 s", broken(ImuSample, Failure.OFF, 2.0))
SILENCE = Event(
    "silence",
    "no sensor says anything for 9 s",
    Descent(broken=tuple(SensorFault(kind, Failure.OFF, interval(9.0), 1.0, seed=1) for kind in SENSORS)),
)
IMU_LOSS = Event(
    "imu loss", "half of the inertial samples lost for 20 s", harmed((ImuSample,), MessageFault.LOSS, 20.0, 0.5)
)
IMU_HEAVY_LOSS = Event(
    "imu heavy loss", "85 % of the inertial samples lost for 20 s", harmed((ImuSample,), MessageFault.LOSS, 20.0, 0.85)
)
IMU_GARBAGE = Event("imu garbage", "inertial unit says anything for 5 s", broken(ImuSample, Failure.GARBAGE, 5.0, 0.5))
IMU_STUCK = Event("imu stuck", "inertial unit repeats itself for 8 s", broken(ImuSample, Failure.STUCK, 8.0))
PROFILER_STUCK = Event("profiler stuck", "profiler repeats itself for 20 s", broken(AdcpPing, Failure.STUCK, 20.0))
FIX_STUCK = Event(
    "fix stuck",
    "satellite receiver repeats itself for the last 20 s afloat",
    Descent(
        broken=tuple(
            SensorFault(kind, Failure.STUCK, interval(20.5, -20.0), 1.0, seed=1) for kind in (GnssFix, TdcpFix)
        ),
        surface_s=30.0,
    ),
)
CLOCK_AHEAD = Event(
    "clock ahead", "sensors' clock 60 s ahead for 8 s", harmed(SENSORS, MessageFault.CLOCK_JUMP, 8.0, 60.0)
)
CLOCK_BACK = Event("clock back", "sensors' clock 1 s back for 8 s", harmed(SENSORS, MessageFault.CLOCK_JUMP, 8.0, -1.0))
PINGS_LATE = Event("pings late", "pings come 0.5 s late for 40 s", broken(AdcpPing, Failure.DELAYED, 40.0, 0.5))
PINGS_TWICE = Event("pings twice", "the profiler's driver publishes every ping twice", Descent(twice=(AdcpPing,)))
ALL_TWICE = Event("all twice", "every driver publishes every message twice", Descent(twice=SENSORS))
RESTARTED = Event("restart", "the estimator's process is replaced under water", Descent(restarted=True))
WRONG_FIX = Event(
    "wrong fix",
    "velocity of the one satellite fix before it 0.1 m/s (5 sigma) off",
    Descent(gnss_velocity_mps=0.1, surface_s=1.0),
)
ONE_FIX = Event("one fix", "one satellite fix before the descent, nothing wrong", Descent(surface_s=1.0))
LONG = Event("long", "one satellite fix, a descent of 160 s", Descent(surface_s=1.0, duration_s=160.0))
LONG_BLIND = Event(
    "long, no compass",
    "one satellite fix, a descent of 160 s, the compass off",
    Descent(
        surface_s=1.0,
        duration_s=160.0,
        broken=(SensorFault(CompassHeading, Failure.OFF, interval(400.0, 1.0), 1.0, seed=1),),
    ),
)
DEEP_GRID = Event(
    "deep grid", "water kept over a grid of 500 m", Descent(settings=("estimator.deepest_m=500",), duration_s=60.0)
)


class NoShadow:
    """A shadow filter that is forgotten at once."""

    expired = True

    def __init__(self, *_: object) -> None:
        pass

    def advance(self, *_: object) -> None:
        """Stand still."""

    def correct(self, *_: object) -> None:
        """Correct nothing."""


def no_shadow() -> AbstractContextManager[None]:
    """Switch the shadow filter off."""
    return replaced((supervision, "ShadowFilter", NoShadow))


def no_reinitialisation() -> AbstractContextManager[None]:
    """Switch reinitialisation off: the filter goes on whatever becomes of it."""
    watch = Reinitialisation.watch

    def watched(self: Reinitialisation, *args: Any, **kwargs: Any) -> bool:
        watch(self, *args, **kwargs)
        return False

    return replaced(
        (Reinitialisation, "watch", watched), (Reinitialisation, "has_good_position", property(lambda _: False))
    )


def no_slow_fronts() -> AbstractContextManager[None]:
    """Carry no hypotheses of slow fronts."""
    return replaced((error_state_filter, "COLUMNS", 0))


def no_follow() -> AbstractContextManager[None]:
    """Never prolong a walk because the water drifts on, and never tell a tilt from a front by it."""
    return replaced((AdaptiveProcessNoise, "_follow", lambda *_: None))


def no_making_up() -> AbstractContextManager[None]:
    """Treat a front that began before what the filter can go back to as one that began within it."""
    began = AdaptiveProcessNoise.detect_onset

    def lately(self: AdaptiveProcessNoise, *args: Any) -> Any:
        found = began(self, *args)
        return None if found is None else found._replace(is_old=False)

    return replaced((AdaptiveProcessNoise, "detect_onset", lately))


def no_adaptation() -> AbstractContextManager[None]:
    """Grant the water nothing."""
    return replaced(
        (AdaptiveProcessNoise, "required_level", lambda *_: NoiseLevel.NONE),
        (AdaptiveProcessNoise, "detect_onset", lambda *_: None),
        (error_state_filter, "COLUMNS", 0),
    )


def seen_as(change: Callable[[NoiseLevel], NoiseLevel]) -> AbstractContextManager[None]:
    """Grant something else than what is seen."""
    seen = AdaptiveProcessNoise.required_level

    def other(self: AdaptiveProcessNoise, *args: Any) -> NoiseLevel:
        return change(seen(self, *args))

    return replaced((AdaptiveProcessNoise, "required_level", other))


def no_unit() -> AbstractContextManager[None]:
    """Never doubt the inertial unit."""
    return seen_as(lambda change: min(change, NoiseLevel.FAST))


def no_slow_walk() -> AbstractContextManager[None]:
    """Grant nothing after a shear."""
    return seen_as(lambda change: NoiseLevel.NONE if change is NoiseLevel.SLOW else change)


def no_screening(*reasons: str) -> Off:
    """Let in what would be refused for one of these reasons."""

    def off() -> AbstractContextManager[None]:
        refusal = SensorScreening.rejection

        def lenient(self: SensorScreening, *args: Any) -> str | None:
            why = refusal(self, *args)
            return None if why in reasons else why

        return replaced((SensorScreening, "rejection", lenient), (SensorScreening, "accepts_all", lambda *_: False))

    return off


def given(**tables: dict[str, float]) -> Off:
    """Give the estimator a sensors file with other values than the true ones."""

    def other(suite: SensorConfig) -> SensorConfig:
        changed = {name: msgspec.structs.replace(getattr(suite, name), **values) for name, values in tables.items()}
        return msgspec.structs.replace(suite, **changed)

    return lambda: replaced((descent, "as_given", other))


def restored(*, checkpoint: bool, estimate: bool) -> Off:
    """Hand less than everything to the new process."""

    def states(self: TimedNode) -> list[EstimatorState]:
        state = self.newest.get(EstimatorState) if checkpoint else None
        newest = self.newest.get(Estimate) if estimate else None
        return [] if state is None else [msgspec.structs.replace(state, estimate=newest)]

    return lambda: replaced((TimedNode, "states", states))


def together(*offs: Off) -> Off:
    """Switch several mechanisms off at once."""

    @contextmanager
    def off() -> Iterator[None]:
        with ExitStack() as stack:
            for each in offs:
                stack.enter_context(each())
            yield

    return off


def uncoupled(*args: Any) -> Any:
    """Correct by few rows as ``correction._correct_few`` does, without the coupling of velocity and heading."""
    (x, R, P), (E, score, information), rows, gate, limit, _ = args
    result, white = correction._whiten_few(P, E, rows, gate, limit)
    if white.W.shape[0]:
        correction.apply_error(x, R, result.error)
        zero = np.zeros(len(P))
        correction._subtract(P, white.W, zero, zero)
        if E.shape[1]:
            correction.update_signatures(E, score, information, white.W, white.Y, white.y)
    return result.accepted, result.nis, result.S, result.definite, result.error, result.deweighted


def of(
    name: str,
    off: Off,
    events: tuple[Event, ...],
    measures: tuple[str, ...],
    *,
    timed: bool = False,
) -> tuple[Mechanism, ...]:
    """Return one row for each event of a mechanism."""
    return tuple(Mechanism(name, event, off, measures, timed) for event in events)


ERRORS = ("true rms m", "true 95 % m", "drift end m", "velocity rms m/s", "silent")
CONSISTENT = (*ERRORS, "outside", "position nees", "velocity nees")
HEADING = ("heading rms deg", "heading nees, end", "heading outside 2 sigma", "heading sd, end deg")
SEEN = (*ERRORS, "missed", "delay s", "alarms before")
MECHANISMS: tuple[Mechanism, ...] = (
    *of(
        "shadow filter",
        no_shadow,
        (PROFILER_WRONG, PROFILER_GARBAGE, PRESSURE_WRONG, IMU_WRONG),
        (*ERRORS, "reinitialised"),
    ),
    *of(
        "reinitialisation",
        no_reinitialisation,
        (IMU_WORSE, IMU_WRONG, PROFILER_WRONG, IMU_LASTING),
        (*ERRORS, "crashed", "reinitialised"),
    ),
    *of(
        "shadow filter and reinitialisation",
        together(no_shadow, no_reinitialisation),
        (PROFILER_WRONG, IMU_WRONG, PRESSURE_WRONG),
        ERRORS,
    ),
    *of(
        "water carried over a reinitialisation",
        lambda: replaced((Reinitialisation, "restore_water", lambda *_: False)),
        (IMU_WORSE, IMU_WRONG),
        ERRORS,
    ),
    *of("slow-front detector", no_slow_fronts, (SLOW_FRONT, SLOWER_FRONT, MEDIUM_FRONT, GYRO, FORETOLD), SEEN),
    *of(
        "slow-front detector: time",
        no_slow_fronts,
        (Event("foretold, timed", FORETOLD.description, Descent()),),
        ("estimator ms per s",),
        timed=True,
    ),
    *of("walk prolonged while water drifts", no_follow, (SLOW_FRONT, SLOWER_FRONT, GYRO, GYRO_FAST), SEEN),
    *of("front made up for afterwards", no_making_up, (SLOW_FRONT, SLOWER_FRONT), SEEN),
    *of("slow fronts, all of it", together(no_slow_fronts, no_follow), (SLOW_FRONT, SLOWER_FRONT, GYRO), SEEN),
    *of(
        "going back 10 s before a walk is granted",
        lambda: replaced((out_of_sequence, "BACK_NS", out_of_sequence.REACH_NS)),
        (FAST_FRONT, MEDIUM_FRONT, GYRO, GYRO_FAST, WAVES),
        SEEN,
    ),
    *of("slow walk after a shear", no_slow_walk, (WAVES, STEP), (*SEEN, "cells silent")),
    *of("doubt of the inertial unit", no_unit, (GYRO, GYRO_FAST), SEEN),
    *of(
        "adaptation to water, all of it",
        no_adaptation,
        (FAST_FRONT, MEDIUM_FRONT, SLOW_FRONT, SLOWER_FRONT, WAVES, STEP, GYRO, GYRO_FAST, FORETOLD),
        (*SEEN, "cells silent"),
    ),
    *of(
        "means that call for what no water does",
        lambda: replaced((AdaptiveProcessNoise, "is_inconsistent", lambda *_: False)),
        (IMU_WRONG, PROFILER_WRONG, IMU_WORSE),
        SEEN,
    ),
    *of(
        "de-weighted satellite rows",
        lambda: replaced((error_state_filter, "_DEWEIGHT_LIMIT", 0.0)),
        (WRONG_FIX, ONE_FIX),
        ERRORS,
    ),
    *of(
        "IMU dropout: coasting",
        lambda: replaced((imu_dropout, "MAX_BRIDGED_NS", 2**62)),
        (IMU_OFF, IMU_OFF_SHORT, IMU_STUCK),
        ERRORS,
    ),
    *of(
        "IMU dropout: levelling after it",
        lambda: replaced((imu_dropout, "MIN_LEVELLED_NS", 2**62)),
        (IMU_OFF, SILENCE),
        (*ERRORS, "reinitialised"),
    ),
    *of(
        "IMU dropout: noise over bridged samples",
        lambda: replaced((imu_dropout, "inflate", lambda *_: None)),
        (IMU_LOSS, IMU_HEAVY_LOSS),
        CONSISTENT,
    ),
    *of("warm restart", restored(checkpoint=False, estimate=True), (RESTARTED,), (*ERRORS, "no estimate")),
    *of(
        "warm restart: last estimate beside the checkpoint",
        restored(checkpoint=True, estimate=False),
        (RESTARTED,),
        ERRORS,
    ),
    *of(
        "out-of-sequence buffer",
        lambda: replaced((out_of_sequence.MeasurementBuffer, "is_within_reach", lambda *_: False)),
        (PINGS_LATE,),
        ERRORS,
    ),
    *of(
        "refusal of repeated messages",
        lambda: replaced((out_of_sequence.MeasurementBuffer, "contains", lambda *_: False)),
        (PINGS_TWICE, ALL_TWICE),
        CONSISTENT,
    ),
    *of(
        "measurement compression",
        lambda: replaced((correction, "_COMPRESSION_RATIO", 0.0)),
        (Event("foretold, timed", FORETOLD.description, Descent()),),
        ("estimator ms per s", "drift end m"),
        timed=True,
    ),
    *of(
        "invariant correction",
        lambda: replaced(
            (correction, "heading_coupling", lambda error, _: np.zeros(len(error))),
            (correction, "_correct_few", uncoupled),
        ),
        (FORETOLD, ONE_FIX, LONG, LONG_BLIND),
        (*CONSISTENT, *HEADING),
    ),
    *of("screening: stuck", no_screening("stuck"), (PROFILER_STUCK, FIX_STUCK, IMU_STUCK), ERRORS),
    *of("screening: jump", no_screening("jump"), (IMU_GARBAGE,), (*ERRORS, "crashed", "reinitialised")),
    *of("screening: future", no_screening("future"), (CLOCK_AHEAD,), (*ERRORS, "no estimate")),
    *of("screening: stale", no_screening("stale"), (CLOCK_BACK,), (*ERRORS, "no estimate")),
    *of(
        "window of depths",
        lambda: replaced((descent, "settings", ("estimator.kept_m=2000",))),
        (DEEP_GRID,),
        ("estimator ms per s", "drift end m"),
        timed=True,
    ),
    *of("ADCP bias by beam as states", given(adcp={"beam_bias_sd_mps": 0.0}), (FORETOLD, ONE_FIX), ERRORS),
    *of("ADCP bias of near cells as states", given(adcp={"near_bias_sd_mps": 0.0}), (FORETOLD, ONE_FIX), ERRORS),
    *of("ADCP mounting as states", given(adcp={"mounting_known_to_rad": 0.0}), (FORETOLD, ONE_FIX), ERRORS),
    *of("compass bias as a state", given(compass={"bias_sd_rad": 0.0}), (FORETOLD, LONG), (*CONSISTENT, *HEADING)),
)
