"""Weak thruster: when a loss of thrust becomes a smaller box, and when it ends."""

from __future__ import annotations

import pytest

from ltv_mpc.messages import Health
from ltv_mpc.safety.health import NOMINAL
from ltv_mpc.safety.weak_thruster import CONFIRMING_CYCLES, LEAST_NS, MIN_SHARE, RECOVERY_NATS, WeakThruster, attribute
from ltv_mpc.vehicle.parameters import Vehicle

PAPER = Vehicle.load("paper")
LATER_NS = LEAST_NS + 1


def after(*losses: tuple[float, float], cycles: int = CONFIRMING_CYCLES) -> WeakThruster:
    """State after so many cycles with an alarm and each of these losses."""
    weak = WeakThruster()
    for loss in losses:
        for _ in range(cycles):
            weak.update(0, attribute(loss), 0.0)
    return weak


@pytest.mark.parametrize(("loss", "shares"), [((0.4, 0.0), (0.6, 1.0)), ((0.0, 0.31), (1.0, 0.7))])
def test_a_loss_that_some_cycles_attribute_to_one_thruster_is_its_share(loss, shares):
    assert after(loss, cycles=CONFIRMING_CYCLES - 1).shares == (1.0, 1.0)
    assert after(loss).shares == pytest.approx(shares)


@pytest.mark.parametrize("loss", [(0.4, 0.4), (0.15, 0.0), (0.3, 0.25)])
def test_a_small_loss_or_one_of_both_thrusters_is_not_acted_on(loss):
    assert not after(loss).is_weak


def test_cycles_that_blame_different_thrusters_confirm_nothing():
    assert not after(*[(0.4, 0.0), (0.0, 0.4)] * 5, cycles=CONFIRMING_CYCLES - 1).is_weak


def test_a_dead_thruster_keeps_a_share_that_can_show_its_recovery():
    assert after((1.0, 0.0)).shares == (MIN_SHARE, 1.0)


@pytest.mark.parametrize(("loss", "may_be_weaker"), [(0.0, False), (0.6, False), (0.8, True), (1.0, True)])
def test_with_the_smallest_share_a_thruster_may_be_weaker(loss, may_be_weaker):
    assert after((loss, 0.0)).may_be_weaker is may_be_weaker


def test_the_share_follows_in_steps_and_not_the_noise():
    weak = after((0.4, 0.0))
    for loss, share in ((0.36, 0.6), (0.44, 0.6), (0.52, 0.5), (0.46, 0.5), (0.7, 0.3)):
        weak.update(LATER_NS, attribute((loss, 0.0)), 0.0)
        assert weak.shares == pytest.approx((share, 1.0))


def test_without_an_alarm_or_by_the_other_thruster_it_stays_as_it_is():
    weak = after((0.4, 0.0))
    for found in (None, attribute((0.0, 0.8)), attribute((0.5, 0.5))):
        weak.update(LATER_NS, found, 0.3 * RECOVERY_NATS)
        assert weak.shares == pytest.approx((0.6, 1.0))


def test_it_ends_by_the_sum_of_evidence_for_a_recovery_which_a_loss_resets():
    weak = after((0.4, 0.0))
    for gain in (0.5, 0.49, -1.0, 0.5, 0.49):
        assert not weak.update(LATER_NS, None, gain * RECOVERY_NATS)
    assert weak.update(LATER_NS, None, 0.02 * RECOVERY_NATS)
    assert weak.shares == (1.0, 1.0)
    assert not weak.update(LATER_NS, attribute((0.4, 0.0)), 0.0)  # to be confirmed again
    assert not weak.is_weak


def test_while_it_may_recover_the_share_stays():
    weak = after((0.4, 0.0))
    weak.update(LATER_NS, attribute((0.3, 0.0)), 0.1)
    assert weak.shares == pytest.approx((0.6, 1.0))
    weak.update(LATER_NS, attribute((0.3, 0.0)), -0.2)
    assert weak.shares == pytest.approx((0.7, 1.0))


def test_health_names_the_thruster_and_the_largest_thrust_that_is_left():
    assert after((0.4, 0.0)).health(PAPER) == (Health.DEGRADED, "port thruster weak: box reduced to 37.5 N")
    assert "starboard" in after((0.0, 0.4)).health(PAPER).why
    assert after((0.1, 0.0)).health(PAPER) == NOMINAL


def test_a_restored_one_continues_with_its_side_and_share():
    weak = WeakThruster()
    weak.restore((1.0, 0.5))
    assert "starboard" in weak.health(PAPER).why
    weak.update(LATER_NS, attribute((0.0, 0.7)), 0.0)
    assert weak.shares == pytest.approx((1.0, 0.3))
    weak.restore((1.0, 1.0))
    assert weak.health(PAPER) == NOMINAL


def test_a_loss_lasts_for_ten_seconds_at_least():
    weak = after((0.4, 0.0))
    for seconds in range(1, 10):
        assert not weak.update(seconds * 1_000_000_000, None, RECOVERY_NATS)
    assert weak.update(LEAST_NS, None, RECOVERY_NATS)
    assert not weak.is_weak
