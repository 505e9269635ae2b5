"""A shadow filter takes over if a sensor was wrong, and does not if the filter was wrong."""

from collections.abc import Callable

import msgspec
import numpy as np
import pytest

from ltv_mpc.localisation import shadow_filter
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.estimator import Estimator
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.messages import AdcpPing, Estimate, ImuSample, LocalisationReport, Message, PressureDepth

SUITE = SensorConfig.load("realistic")
SECOND = 1_000_000_000
BACK = "the shadow filter has replaced the active filter"


class Said:
    """Output of a dive of 34 s in which ``change`` alters the messages after 15 s."""

    def __init__(self, make_dive, inbox_of, change: Callable[[Message], Message], *, late: bool = False) -> None:
        self.dive = make_dive(SUITE, 50, duration_s=34.0)
        self.estimator = Estimator(SUITE, EstimatorConfig())
        self.estimates: dict[int, Estimate] = {}
        self.reports: dict[int, LocalisationReport] = {}
        waiting: list[Message] = []
        for message in self.dive.messages:
            said = change(message) if message.t_ns > 15 * SECOND else message
            if late and isinstance(said, AdcpPing):
                waiting.append(said)
            else:
                self._step(inbox_of, said)
            while waiting and waiting[0].t_ns <= message.t_ns - SECOND // 2:
                self._step(inbox_of, waiting.pop(0))

    def _step(self, inbox_of, message: Message) -> None:
        for one in self.estimator.step(message.t_ns, inbox_of(message)):
            if isinstance(one, Estimate):
                self.estimates[one.t_ns] = one
            elif isinstance(one, LocalisationReport):
                self.reports[one.t_ns] = one

    def sd(self, t_s: int) -> float:
        """Of the position north."""
        return self.estimates[t_s * SECOND].covariance[0, 0] ** 0.5

    @property
    def came_back(self) -> list[int]:
        """Seconds at which that is said."""
        return [t_ns // SECOND for t_ns, report in self.reports.items() if report.why == BACK]


def profiler_off(until_s: float) -> Callable[[Message], Message]:
    """Return a change of each beam by 0.5 m/s, with the opposite sign for its neighbour."""
    wrong = np.array([0.5, -0.5, 0.5, -0.5])[:, None]

    def change(message: Message) -> Message:
        if not isinstance(message, AdcpPing) or message.t_ns > until_s * SECOND:
            return message
        return msgspec.structs.replace(message, beam_velocity_mps=message.beam_velocity_mps + wrong)

    return change


def unit_off(message: Message) -> Message:
    """Return the message of an inertial unit that is wrong by 20 mg and 4 deg/s for 5 s."""
    if not isinstance(message, ImuSample) or message.t_ns > 20 * SECOND:
        return message
    rate = tuple(w + 0.07 for w in message.angular_rate_radps)
    force = tuple(f + 0.2 for f in message.specific_force_mps2)
    return msgspec.structs.replace(message, angular_rate_radps=rate, specific_force_mps2=force)


def pressure_off(message: Message) -> Message:
    """Return a depth that stays wrong by 20 m; the profiler agrees with the filter all the time."""
    if not isinstance(message, PressureDepth):
        return message
    return msgspec.structs.replace(message, depth_m=message.depth_m + 20.0)


@pytest.mark.parametrize("late", [False, True])
def test_twelve_seconds_of_a_wrong_profiler_leave_no_error(make_dive, inbox_of, late):
    """The position of a new filter is uncertain by 3 m, and it may have believed the wrong profiler."""
    said = Said(make_dive, inbox_of, profiler_off(27.0), late=late)
    assert said.reports[27 * SECOND].restarts == said.reports[34 * SECOND].restarts == 1
    assert min(said.came_back) in (28, 29, 30)
    assert said.sd(27) > 2.0
    assert said.sd(34) < said.sd(14) + 0.1
    last, k = said.estimates[34 * SECOND], said.dive.at(34 * SECOND)
    e = np.array([last.north_m, last.east_m, last.velocity_north_mps, last.velocity_east_mps])
    e -= np.concatenate([said.dive.position[k, :2], said.dive.velocity[k, :2]])
    assert e @ np.linalg.solve(last.covariance[:4, :4], e) < 18.5  # 99.9 % of chi-square of 4 degrees
    assert list(said.estimates) == list(range(min(said.estimates), 34 * SECOND + 1, 100_000_000))
    account = said.estimator.account
    assert account["pressure.used"] + account["pressure.gate"] <= 10 * 35 + 1  # none is counted twice


@pytest.mark.parametrize("change", [unit_off, pressure_off], ids=["unit", "pressure"])
def test_a_filter_that_was_wrong_or_is_still_rejected_does_not_take_over(make_dive, inbox_of, change):
    said = Said(make_dive, inbox_of, change)
    assert said.reports[34 * SECOND].restarts == 1
    assert not said.came_back


def test_a_state_with_large_innovations_inside_the_gate_is_no_restore_point(make_dive, inbox_of):
    """Twice the expected noise: most of it passes, and the filter is reinitialised as usual."""
    rng = np.random.default_rng(3)

    def change(message: Message) -> Message:
        if not isinstance(message, AdcpPing):
            return message
        noisy = message.beam_velocity_mps + 0.045 * rng.standard_normal(message.beam_velocity_mps.shape)
        return msgspec.structs.replace(message, beam_velocity_mps=noisy)

    said = Said(make_dive, inbox_of, change)
    assert said.reports[34 * SECOND].restarts == 1
    assert not said.came_back


def test_it_is_dropped_after_a_minute(make_dive, inbox_of, monkeypatch):
    monkeypatch.setattr(shadow_filter, "MAX_AGE_NS", 2 * SECOND)
    assert not Said(make_dive, inbox_of, profiler_off(30.0)).came_back


def test_a_copy_with_the_same_state_does_not_take_over(make_dive, inbox_of):
    """A random profiler looks like a front: both filters have inflated noise, and a reinitialisation helps."""
    rng = np.random.default_rng(4)

    def change(message: Message) -> Message:
        if not isinstance(message, AdcpPing) or message.t_ns > 20 * SECOND:
            return message
        return msgspec.structs.replace(
            message, beam_velocity_mps=rng.uniform(-2.0, 2.0, message.beam_velocity_mps.shape)
        )

    said = Said(make_dive, inbox_of, change)
    assert not said.came_back


def test_a_copy_with_a_less_certain_velocity_does_not_take_over(make_dive, inbox_of, monkeypatch):
    monkeypatch.setattr(shadow_filter, "MAX_SD_RATIO", 0.1)
    assert not Said(make_dive, inbox_of, profiler_off(27.0)).came_back
