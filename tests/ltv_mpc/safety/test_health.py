"""Health by ages alone."""

from __future__ import annotations

import pytest

from ltv_mpc.safety.health import Period, health

MS = 1_000_000


@pytest.mark.parametrize(
    ("age_ms", "period_ms", "word"),
    [
        (None, 100, "degraded"),
        (-20, 100, "nominal"),
        (0, 0, "nominal"),
        (500, 100, "nominal"),
        (501, 100, "degraded"),
        (599, 200, "nominal"),
        (601, 200, "degraded"),
        (2999, 1000, "nominal"),
        (3001, 1000, "degraded"),
    ],
)
def test_degraded_after_three_periods_and_not_before_half_a_second(age_ms, period_ms, word):
    assert health(age_ns=None if age_ms is None else age_ms * MS, period_ns=period_ms * MS) == word


def test_the_period_is_the_median_spacing_so_that_a_lost_estimate_and_a_burst_do_not_move_it():
    period = Period()
    assert period.median_ns == 0
    for t_ms in (0, 200, 400, 600, 1400, 1401, 1402, 1600, 1800, 2000):
        period.stamped(t_ms * MS)
    assert period.median_ns == 200 * MS
    for t_ms in range(2020, 2200, 20):
        period.stamped(t_ms * MS)
    assert period.median_ns == 20 * MS
