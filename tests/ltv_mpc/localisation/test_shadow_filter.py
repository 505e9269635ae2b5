"""A shadow filter takes over if a sensor was wrong, and does not if the filter was wrong."""

from functools import cache, partial

import numpy as np
import pytest
from msgspec.structs import replace

from ltv_mpc.localisation import shadow_filter
from ltv_mpc.messages import AdcpPing, PressureDepth
from tests.ltv_mpc.localisation.dives import REALISTIC, Run, S, dive, normalised

the_dive = partial(dive, REALISTIC, 59, duration_s=34.0)
"""The dive of this file: made once, and not where only its tests are collected."""


BEGIN_NS = 15 * S
"""Begin of what is wrong in these tests."""


@cache
def healthy():
    """Return the run of the first 15 s."""
    return Run(m for m in the_dive().messages if m.t_ns <= BEGIN_NS)


def run_with(change):
    """Return the run in which ``change`` alters the messages after 15 s."""
    return healthy().continued(change(m) for m in the_dive().messages if m.t_ns > BEGIN_NS)


def returns(run):
    """Return the seconds at which the takeover is reported."""
    why = "the shadow filter has replaced the active filter"
    return [t_ns // S for t_ns, report in run.reports.items() if report.why == why]


def of_profiler(change, until_s=34.0):
    """Return a change of messages which is one of the profiler's velocities until ``until_s``."""

    def altered(message):
        if not isinstance(message, AdcpPing) or message.t_ns > until_s * S:
            return message
        return replace(message, beam_velocity_mps=change(message.beam_velocity_mps))

    return altered


def off(velocity):
    """Change each beam by 0.5 m/s, with the opposite sign for its neighbour."""
    return velocity + np.array([0.5, -0.5, 0.5, -0.5])[:, None]


def pressure_off(message):
    """Return a depth that stays wrong by 20 m; the profiler agrees with the filter all the time."""
    return replace(message, depth_m=message.depth_m + 20.0) if isinstance(message, PressureDepth) else message


def test_twelve_seconds_of_a_wrong_profiler_leave_no_error():
    """It is late, too. The position of a new filter is uncertain by 3 m, and it may have believed the profiler."""
    messages = [of_profiler(off, until_s=27.0)(m) for m in the_dive().messages if m.t_ns > BEGIN_NS]
    messages.sort(key=lambda m: m.t_ns + 510_000_000 * isinstance(m, AdcpPing))
    after = healthy().continued(messages)
    assert after.reports[27 * S].restarts == after.reports[34 * S].restarts == 1
    assert min(returns(after)) in (28, 29, 30)
    sd = {t_s: after.estimates[t_s * S].covariance[0, 0] ** 0.5 for t_s in (14, 27, 34)}
    assert sd[27] > 2.0
    assert sd[34] < sd[14] + 0.1
    assert normalised(after.estimates[34 * S], the_dive(), 4) < 18.5  # 99.9 % of chi-square of 4 degrees
    assert list(after.estimates) == list(range(min(after.estimates), 34 * S + 1, 100_000_000))
    account = after.estimator.account
    assert account["pressure.used"] + account["pressure.gate"] <= 10 * 35 + 1  # none is counted twice


def test_a_filter_whose_measurements_are_still_rejected_does_not_take_over():
    """Nor does one that was wrong: test_reinitialisation.py."""
    after = run_with(pressure_off)
    assert after.reports[34 * S].restarts == 1
    assert not returns(after)


def test_a_state_with_large_innovations_inside_the_gate_is_no_restore_point():
    """Twice the expected noise: most of it passes, and the filter is reinitialised as usual."""
    rng = np.random.default_rng(3)
    after = run_with(of_profiler(lambda velocity: velocity + 0.045 * rng.standard_normal(velocity.shape)))
    assert after.reports[34 * S].restarts == 1
    assert not returns(after)


def test_a_copy_with_the_same_state_does_not_take_over():
    """A random profiler looks like a front: both filters have inflated noise, and a reinitialisation helps."""
    rng = np.random.default_rng(4)
    random = of_profiler(lambda velocity: rng.uniform(-2.0, 2.0, velocity.shape), until_s=20.0)
    assert not returns(run_with(random))


@pytest.mark.parametrize(("limit", "value"), [("MAX_AGE_NS", 2 * S), ("MAX_SD_RATIO", 0.1)])
def test_a_copy_that_is_too_old_or_has_a_less_certain_velocity_does_not_take_over(monkeypatch, limit, value):
    monkeypatch.setattr(shadow_filter, limit, value)
    assert not returns(run_with(of_profiler(off, until_s=27.0)))
