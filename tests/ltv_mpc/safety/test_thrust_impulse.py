"""Impulse of the reported thrusts: its value, and how long it is known."""

from __future__ import annotations

import pytest

from ltv_mpc.safety.motion_fit import KEPT_S, ThrustImpulse

S = 1_000_000_000
KEPT_NS = round(KEPT_S * S)


def test_it_is_the_integral_of_thrusts_that_are_linear_between_reports():
    impulse = ThrustImpulse()
    for t_s, thrust in ((0, (0.0, 4.0)), (1, (2.0, 4.0)), (3, (2.0, -4.0))):
        impulse.add(t_s * S, [*thrust, 0.0])
    assert impulse.until(S // 2) == pytest.approx((0.25, 2.0))
    assert impulse.until(2 * S) == pytest.approx((3.0, 6.0))
    assert impulse.until(4 * S) == pytest.approx((7.0, 0.0))  # constant after the last report


def test_before_the_first_report_it_is_unknown():
    impulse = ThrustImpulse()
    assert impulse.until(0) is None
    impulse.add(S, [1.0, 1.0, 0.0])
    assert impulse.until(S - 1) is None


@pytest.mark.parametrize("period_ns", [5_000_000, S // 10, 2 * S])
def test_reports_are_kept_by_their_age_and_not_by_their_number(period_ns):
    impulse, count = ThrustImpulse(), 10 * S // period_ns
    for k in range(count + 1):
        impulse.add(k * period_ns, [3.0, -1.0, 0.0])
    newest_ns = count * period_ns
    assert impulse.until(newest_ns - KEPT_NS) == pytest.approx((15.0, -5.0))
    assert impulse.until(newest_ns - KEPT_NS - 2 * period_ns - S) is None


def test_a_repeated_report_changes_nothing():
    impulse = ThrustImpulse()
    for _ in range(3):
        impulse.add(0, [1.0, 1.0, 0.0])
    assert impulse.until(S) == (1.0, 1.0)
