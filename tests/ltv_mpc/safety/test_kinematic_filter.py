"""Rate check: rates that are not those of the values are replaced, and right ones are believed whatever the noise."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ltv_mpc.safety.kinematic_filter import AGREED, KinematicFilter

TOP_MPS, ACCELERATION_MPS2, CLEAN_M, PERIOD_S = 1.4, 1.0, 0.03, 0.3


def track(number: int, period_s: float = PERIOD_S) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return times (ns), positions and velocities of a vehicle that sails curves at changing speeds."""
    t = period_s * np.arange(number)
    heading, speed = 0.3 * t + 0.5 * np.sin(0.2 * t), 0.7 + 0.3 * np.sin(0.15 * t)
    fine = np.linspace(0.0, t[-1], 200 * number)
    v = np.interp(fine, t, speed)[:, None] * np.stack(
        [np.cos(0.3 * fine + 0.5 * np.sin(0.2 * fine)), np.sin(0.3 * fine + 0.5 * np.sin(0.2 * fine))], axis=1
    )
    way = np.concatenate([np.zeros((1, 2)), np.cumsum(0.5 * np.diff(fine)[:, None] * (v[1:] + v[:-1]), axis=0)])
    x = np.stack([np.interp(t, fine, way[:, i]) for i in range(2)], axis=1)
    return (t * 1e9).astype(int), x, speed[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1)


def checked(t_ns, x, w, sd=(0.0, 0.0)) -> tuple[KinematicFilter, list[tuple[np.ndarray, np.ndarray] | None]]:
    """Return the check after a track, and what it gave at each estimate."""
    check, found = KinematicFilter(TOP_MPS, ACCELERATION_MPS2, CLEAN_M), []
    for t, *row in zip(t_ns, x, w, strict=True):
        used = check.update(int(t), *row, sd)
        assert (used[1] is row[1]) is not check.failed
        found.append(used if check.failed else None)
    return check, found


@pytest.mark.parametrize("period_s", [0.02, 0.3, 1.0])
@pytest.mark.parametrize("noise_m", [0.0, 0.3, 2.0])
def test_right_rates_are_believed_whatever_the_noise_of_the_positions(period_s, noise_m):
    rng = np.random.default_rng(3)
    t_ns, x, w = track(round(90.0 / period_s), period_s)
    assert not any(checked(t_ns, x + noise_m * rng.standard_normal(x.shape), w)[1])


@pytest.mark.parametrize(
    "seen",
    {
        "a fix moves the position by 4 m": lambda x: x + 4.0 * (np.arange(len(x)) > 150)[:, None],
        "single outliers": lambda x: x + 3.0 * (np.arange(len(x)) % 40 == 7)[:, None],
        "positions come at 1 Hz": lambda x: x[np.arange(len(x)) // 10 * 10],
        "positions are rounded": lambda x: np.round(x / 0.11) * 0.11,
        "positions have stopped": lambda x: np.zeros_like(x),
    }.values(),
)
def test_right_rates_are_believed_while_positions_jump_or_stand(seen):
    t_ns, x, w = track(600, 0.1)
    assert not any(checked(t_ns, seen(x), w)[1])


def test_what_the_given_standard_deviations_allow_is_believed():
    t_ns, x, w = track(200)
    off = w + np.array([0.3, 0.0])
    assert checked(t_ns, x, off)[0].failed
    assert not checked(t_ns, x, off, (0.0, 0.1))[0].failed
    assert not checked(t_ns, x, off, (0.3, 0.0))[0].failed


@pytest.mark.parametrize(
    "slip",
    [lambda w: 0.0 * w, lambda w: 1.944 * w, lambda w: -w, lambda w: w + np.array([0.25, 0.0]), lambda w: 57.3 * w],
)
@pytest.mark.parametrize("noise_m", [0.0, 0.02])
def test_a_wrong_rate_is_found_in_4_s_and_the_derived_one_is_right(slip, noise_m):
    t_ns, x, w = track(300)
    x = x + noise_m * np.random.default_rng(2).standard_normal(x.shape)
    found = checked(t_ns, x, slip(w))[1]
    first = next(k for k, derived in enumerate(found) if derived)
    assert first * PERIOD_S <= 4.0
    assert all(found[first:])
    velocities = np.array([derived[1] for derived in found[first + 10 :]])
    off = np.hypot(*(velocities - w[first + 10 :]).T)
    assert np.sqrt(np.mean(off**2)) < 0.05 + 3.0 * noise_m


def test_a_rate_that_agrees_again_for_long_enough_in_motion_is_believed():
    t_ns, x, w = track(AGREED + 200)
    given = np.where(np.arange(len(w))[:, None] < 50, 0.0, w)
    found = checked(t_ns, x, given)[1]
    last = max(k for k, derived in enumerate(found) if derived)
    assert AGREED + 50 <= last <= AGREED + 70


def test_a_clock_that_is_set_back_and_a_long_gap_begin_anew_and_a_repeated_estimate_changes_nothing():
    t_ns, x, w = track(100)
    check, found = checked(t_ns, x, 0.0 * w)
    again = check.update(int(t_ns[-1]), x[-1], 0.0 * w[-1], (0.0, 0.0))
    assert np.array_equal(again, found[-1])
    later = check.update(int(t_ns[-1]) + 5_000_000_000, x[-1] + 4.0, w[-1], (0.0, 0.0))
    assert check.failed
    assert np.isfinite(later).all()
    check.update(0, x[0], w[0], (0.0, 0.0))
    assert not check.failed
    t_ns, x, w = track(400, 2.5)
    assert not any(checked(t_ns, x, 0.0 * w)[1])  # nothing is known of the velocity in between


@pytest.mark.parametrize("noise_m", [0.05, 0.3, 2.0])
def test_noisy_positions_without_a_deviation_are_filtered_and_clean_ones_are_used_as_they_are(noise_m):
    t_ns, x, w = track(400)
    noisy = x + noise_m * np.random.default_rng(4).standard_normal(x.shape)
    check = KinematicFilter(TOP_MPS, ACCELERATION_MPS2, CLEAN_M)
    filtered = np.array([check.update(int(t), *row, (0.0, 0.0))[0] for t, *row in zip(t_ns, noisy, w, strict=True)])
    assert np.sqrt(np.mean((filtered - x)[100:] ** 2)) < 0.3 * noise_m + 0.01
    for given, sd in ((noisy, (noise_m, 0.0)), (x, (0.0, 0.0)), (x + 4.0 * (t_ns > 3e10)[:, None], (0.0, 0.0))):
        check = KinematicFilter(TOP_MPS, ACCELERATION_MPS2, CLEAN_M)
        assert all(check.update(int(t), *row, sd)[0] is row[0] for t, *row in zip(t_ns, given, w, strict=True))


def test_a_value_that_is_repeated_moves_on_by_its_rate_and_stands_still_after_3_s_of_way():
    t_ns, x, w = track(100)
    check = KinematicFilter(TOP_MPS, ACCELERATION_MPS2, CLEAN_M)
    for k in range(100):
        used, _ = check.update(int(t_ns[k]), x[min(k, 40)], w[k], (0.0, 0.0))
        assert used == pytest.approx(x[k], abs=0.02)
        far = np.hypot(*(x[k] - x[min(k, 40)])) > TOP_MPS
        assert check.stands == (far and t_ns[k] - t_ns[40] > 3e9)
    check.update(int(t_ns[-1]) + 300_000_000, x[-1], w[-1], (0.0, 0.0))
    assert not check.stands


@pytest.mark.parametrize("sense", [-1.0, 1.0])
def test_a_yaw_rate_fails_and_a_heading_stands_still_to_either_side(sense):
    t = PERIOD_S * np.arange(60)
    heading, rate = sense * 0.5 * t[:, None], np.full((60, 1), sense * 0.5)
    assert checked((t * 1e9).astype(int), heading, 0.0 * rate)[0].failed
    standing = KinematicFilter(1.0, 1.0)
    for t_ns in (t * 1e9).astype(int).tolist():
        standing.update(t_ns, heading[0], rate[0], (0.0, 0.0))
    assert standing.stands


def test_noise_of_a_yaw_rate_and_an_angle_that_is_unwrapped_are_no_failure():
    rng = np.random.default_rng(1)
    t = PERIOD_S * np.arange(400)
    heading, rate = 0.8 * t, 0.8 + 0.1 * rng.standard_normal(len(t))
    assert not any(checked((t * 1e9).astype(int), heading[:, None], rate[:, None])[1])
    assert math.isclose(
        checked((t * 1e9).astype(int), heading[:, None], 0.0 * rate[:, None])[1][-1][1][0], 0.8, rel_tol=0.01
    )
