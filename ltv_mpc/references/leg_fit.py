"""Legs through sampled points: few straight legs near points that are dense, noisy or doubled.

Planners, logs and mission editors write points whose corners are not corners of the path. Four steps find its legs:

0. Sparse points that turn evenly are samples of a curve: the cubic spline through them, drawn in where it leaves the
   straight lines between them by more than ``corner_m``, adds points (the turn of a corner is not that of its
   neighbours).
1. Neighbours are averaged in pairs while their distance is below ``NOISY_STEPS`` standard deviations of the noise: the
   median, and each one below twice that, so that a long rest does not blur the way to it.
2. Points within a tolerance of the leg between two others are left out (Douglas & Peucker 1973). A leg never goes back
   along itself: the point at which the path turns back is kept.
3. The ends of the legs move to the least-squares fit of all points. Legs that noise made of one corner become one, a
   leg shorter than the largest tolerance between long ones too.

    tolerance = sigma (1 + sqrt(2 ln K)), at most corner_m / 4, at least ACCURACY_M

The largest of K errors of standard deviation sigma is about sigma sqrt(2 ln K). Fourth differences of the points show
sigma: a smooth curve hardly has any.
"""

from __future__ import annotations

import itertools
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ltv_mpc.messages import Array

Numbers = npt.NDArray[np.int64]

ACCURACY_M = 0.01
"""Smallest tolerance, also where the vehicle stops at corners: a curve without noise is followed within it."""
CORNER_SHARE = 0.25
"""Largest tolerance over ``corner_m``."""
DENSE_M = 1.5
"""Largest distance between points of which the noise is estimated."""
SPARSE_M = 0.025
"""Least tolerance of a point that is farther from one beside it: its noise is not known."""
FOURTH_DIFFERENCE = 9.85
"""Median length of a fourth difference in the plane over the standard deviation: sqrt(70), and 1.177 for two axes."""
NOISY_STEPS, MAX_AVERAGES = 5.0, 20
REFINEMENTS = 3
"""Number of fits after which legs are joined."""
SHORT_LEG, MAX_SHORT_M, SHORT_OFF = 6.0, 0.3, 3.0
"""Length of a leg that noise or means may have made of a corner: in tolerances, and in distances of means, up to
``MAX_SHORT_M``. Distance of its end from the line past it, in tolerances.
"""
ALONE = 4.0
"""Length of the legs beside a short one over its own, from which a corner is doubled."""
OUTLIER, MOST_IN_A_ROW, BESIDE = 4.0, 3, 4
"""A point is an outlier if the steps to and from it have this many lengths of the usual step, the median of those up to
``BESIDE`` points away, and lead back: so many points in a row at most.
"""
EVEN, LEAST_COSINE, SAME_STEP, BULGE_M = 0.3, 0.501, 2.0, 0.015
"""Samples of a curve: the distance of a point from the cubic through its four neighbours is smaller than this share of
the step aside there, its turn below 60 degrees, the ratio of the steps beside it smaller, and the curve leaves the
lines between the samples by more.
"""


class LegFit(NamedTuple):
    """V ends of legs, and where the K given points are on them."""

    ends: Array  # (V, 3) north, east, depth (m)
    at: Array  # (K,) number of the leg plus the share of it, increasing
    deviation_m: float  # largest distance of a given point from its place on the legs, at most ``corner_m`` or 2 cm
    curve_m: float = 0.0  # largest distance of the legs from the lines between the given points, where these are sparse


def fit_legs(points: Array, corner_m: float, *, curves: bool = True) -> LegFit:
    """Return the legs near the points, in their order.

    Parameters
    ----------
    points : (K, 3) north, east, depth (m); depths may all be NaN.
    corner_m : largest distance between a corner and the arc that rounds it (m), which bounds the tolerance.
    curves : sparse points may be samples of a curve.
    """
    given = np.nan_to_num(points)
    dense, number, curve_m = _curved(given, corner_m if curves else 0.0)
    ends, at = _smooth_legs(dense, max(CORNER_SHARE * corner_m, ACCURACY_M))
    deviation_m = _deviation_m(given, ends, at[number])
    if deviation_m > max(corner_m, 2.0 * ACCURACY_M):  # no noise, but a path in small steps
        kept = _simplified(dense, ACCURACY_M)
        ends, at = dense[kept], _least_squares(dense, kept, dense[kept])[1]
        deviation_m = _deviation_m(given, ends, at[number])
    if np.isnan(points[:, 2]).all():
        ends[:, 2] = np.nan
    return LegFit(ends, np.maximum.accumulate(at)[number], deviation_m, curve_m)


def fit_legs_between(points: Array, corner_m: float, fixed: npt.NDArray[np.bool_]) -> LegFit:
    """Return the legs near the points, of which some are ends of legs.

    Parameters
    ----------
    points : (K, 3) north, east, depth (m); depths may all be NaN.
    corner_m : as in ``fit_legs``.
    fixed : (K,) True for a point that is an end of a leg.
    """
    between = [0, *(1 + np.flatnonzero(fixed[1:-1])).tolist(), len(points) - 1]
    if len(between) == 2:
        return fit_legs(points, corner_m)
    ends, at, legs, deviation_m, curve_m = [points[:1]], [np.zeros(1)], 0, 0.0, 0.0
    for i, j in itertools.pairwise(between):
        run = LegFit(points[i : j + 1], np.array([0.0, 1.0]), 0.0)
        if j > i + 1:
            run = fit_legs(points[i : j + 1], corner_m)
        ends += [run.ends[1:-1], points[j : j + 1]]
        at.append(legs + run.at[1:])
        legs += len(run.ends) - 1
        deviation_m, curve_m = max(deviation_m, run.deviation_m), max(curve_m, run.curve_m)
    return LegFit(np.concatenate(ends), np.concatenate(at), deviation_m, curve_m)


def outliers(points: Array, least_m: float, t_s: Array, least_mps: float) -> Numbers:
    """Return the numbers of points that are far beside those around them, as logs of positions have them.

    Parameters
    ----------
    points : (K, 3) north, east, depth (m).
    least_m, least_mps : smallest length and speed of the steps to and from an outlier.
    t_s : (K,) times (s), increasing.
    """
    steps, duration = _steps(points), np.diff(t_s)
    speed = steps / duration
    around = np.lib.stride_tricks.sliding_window_view(np.pad(speed, BESIDE, mode="edge"), 2 * BESIDE + 1)
    usual = np.median(around, axis=1)
    jumps = np.flatnonzero((steps > least_m) & (speed > np.maximum(OUTLIER * usual, least_mps))).tolist()
    found: list[int] = []
    for a, b in itertools.chain(*(zip(jumps, jumps[k:], strict=False) for k in range(1, MOST_IN_A_ROW + 1))):
        back_m = np.hypot(*(points[b + 1] - points[a])[:2])
        if b - a <= MOST_IN_A_ROW and back_m <= OUTLIER * usual[a] * (t_s[b + 1] - t_s[a]):
            found += range(a + 1, b + 1)
    return np.unique(np.array(found, dtype=np.int64))


def _curved(p: Array, corner_m: float) -> tuple[Array, Numbers, float]:
    """Return the points with more between samples of a curve, the numbers of the given ones, and ``curve_m``."""
    K, legs, steps = len(p), np.diff(p[:, :2], axis=0), _steps(p)
    shorter, longer = np.sort([steps[1:], steps[:-1]], axis=0)
    aside, off = np.zeros(K), np.zeros(K)
    cross = legs[:-1, 0] * legs[1:, 1] - legs[:-1, 1] * legs[1:, 0]
    aside[1:-1] = np.abs(cross) / np.where(longer > 0.0, longer, 1.0)
    off[2:-2] = np.hypot(*np.diff(legs, 3, axis=0).T) / 6.0  # from the cubic through the four neighbours
    even = off <= EVEN * np.max([np.roll(aside, shift) for shift in (-1, 0, 1)], axis=0)
    even[1:-1] &= longer < SAME_STEP * shorter
    even[1:-1] &= (legs[1:] * legs[:-1]).sum(axis=1) > LEAST_COSINE * shorter * longer
    bulge_m = np.maximum(aside[1:], aside[:-1]) / 8.0
    smooth = np.pad(even[1:] & even[:-1] & (bulge_m < corner_m), 1)
    smooth = smooth[1:-1] & (smooth[2:] | smooth[:-2])
    bent = smooth & (bulge_m > BULGE_M)
    if not bent.any():
        return p, np.arange(K), 0.0
    parts = np.where(bent, np.ceil(np.sqrt(4.0 * bulge_m / ACCURACY_M)), 1.0).astype(np.int64)
    number = np.concatenate([[0], np.cumsum(parts)])
    leg, at = np.repeat(np.arange(K - 1), parts), np.interp(np.arange(number[-1]), number, np.arange(K))
    dense = along(p, at)
    from scipy.interpolate import make_interp_spline  # for sampled curves alone

    aside = np.zeros((len(at), 2))
    ends: Any = 2 * ([(3, np.zeros(2))],)  # third derivatives: a curve begins and ends as a parabola
    for begin, end in np.flatnonzero(np.diff(smooth, prepend=False, append=False)).reshape(-1, 2).tolist():
        inside, points = slice(*number[[begin, end]]), np.arange(begin, end + 1)
        curve = make_interp_spline(points, p[points, :2], bc_type=ends)
        aside[inside] = curve(at[inside]) - dense[inside, :2]
    curve_m = np.hypot(*aside.T)
    scale = (corner_m / np.maximum(np.maximum.reduceat(curve_m, number[:-1]), corner_m))[leg]
    dense[:, :2] += scale[:, None] * aside
    return np.vstack([dense, p[-1:]]), number, float((scale * curve_m).max())


def _smooth_legs(given: Array, largest_m: float) -> tuple[Array, Array]:
    """Return the ends of legs by least squares and the places of the points, for a largest tolerance (m)."""
    p, number = _averaged(given, largest_m)
    noise_m = _noise_m(p) * (1.0 + np.sqrt(2.0 * np.log(len(p))))
    tolerance = max(min(noise_m, largest_m), ACCURACY_M)
    alone = np.pad(_steps(p), 1, constant_values=0.0) >= DENSE_M
    limit = np.where(alone[1:] | alone[:-1], max(tolerance, min(SPARSE_M, largest_m)), tolerance)
    short_m = SHORT_LEG * tolerance
    if len(p) < len(given):
        short_m = max(short_m, min(SHORT_LEG * float(np.median(_steps(p))), MAX_SHORT_M))
    kept = _simplified(p, limit)
    ends = p[kept]
    for _ in range(REFINEMENTS):
        ends, _ = _least_squares(p, kept, ends)
        still = np.delete(np.arange(len(ends)), _at_short_legs(ends, short_m, SHORT_OFF * tolerance, largest_m))
        still = still[_simplified(ends[still], limit[kept[still]])]
        kept, ends = kept[still], ends[still]
    ends, at = _least_squares(p, kept, ends)
    return ends, np.interp(np.arange(len(given)), number, np.maximum.accumulate(at))


def _deviation_m(given: Array, ends: Array, at: Array) -> float:
    """Return the largest distance (m) of a point from its place on the legs."""
    return float(np.hypot(*(given - along(ends, at))[:, :2].T).max())


def along(ends: Array, at: Array) -> Array:
    """Return the points (K, 3) at places on legs, as in ``LegFit``.

    Parameters
    ----------
    ends : (V, 3) north, east, depth (m).
    at : (K,) number of the leg plus the share of it.
    """
    return np.column_stack([np.interp(at, np.arange(len(ends)), column) for column in ends.T])


def _steps(p: Array) -> Array:
    """Return the horizontal distances (K-1,) in m of successive points."""
    steps: Array = np.hypot(*np.diff(p[:, :2], axis=0).T)
    return steps


def _noise_m(p: Array) -> float:
    """Return the standard deviation (m) of the noise of one coordinate where points are dense; 0 elsewhere."""
    if len(p) < 5:
        return 0.0
    steps = np.lib.stride_tricks.sliding_window_view(_steps(p), 4)
    fourth = np.hypot(*np.diff(p[:, :2], 4, axis=0)[steps.max(axis=1) < DENSE_M].T)
    return float(np.median(fourth)) / FOURTH_DIFFERENCE if len(fourth) else 0.0


def _averaged(p: Array, largest_m: float) -> tuple[Array, Array]:
    """Return points of which noisy neighbours are averaged, and their numbers among the given ones."""
    number = np.arange(len(p), dtype=float)[:, None]
    for _ in range(MAX_AVERAGES):
        steps = _steps(p)
        dense = steps < DENSE_M
        noise_m = _noise_m(p)
        if not dense.any() or np.median(steps[dense]) >= NOISY_STEPS * noise_m or noise_m > largest_m:
            break
        alone, apart = np.ones(len(p), dtype=bool), steps >= min(DENSE_M, 2.0 * NOISY_STEPS * noise_m)
        alone[1::2] = apart[::2]  # or the first of its group
        alone[-1] &= apart[-1]
        first = np.flatnonzero(alone)
        size = np.diff(first, append=len(p))[:, None]
        p, number = (np.add.reduceat(of, first) / size for of in (p, number))
    return p, number[:, 0]


def _simplified(p: Array, tolerance: Array | float) -> Numbers:
    """Return the numbers of the points that are kept as ends of legs, for a tolerance (m) of all or of each (K,)."""
    tolerance = np.broadcast_to(tolerance, len(p))
    # A corner between points that are not dense is kept without a search: a long mission consists of these.
    far_apart = _steps(p) >= DENSE_M
    _, off = _places(p[1:-1], p[:-2], p[2:] - p[:-2])
    corner = far_apart[1:] & far_apart[:-1] & (off > 2.0 * tolerance[1:-1])
    kept = {0, *(1 + np.flatnonzero(corner)).tolist(), len(p) - 1}
    parts = list(itertools.pairwise(sorted(kept)))
    while parts:
        a, b = parts.pop()
        if b - a < 2:
            continue
        leg = p[b] - p[a]
        share, off = _places(p[a + 1 : b], p[a], leg)
        k = int(np.argmax(off / tolerance[a + 1 : b]))
        if off[k] <= tolerance[a + 1 + k]:
            far = np.maximum.accumulate(share)
            back = (far - share) * np.hypot(*leg[:2])
            if (back <= 2.0 * tolerance[a + 1 : b]).all():
                continue
            k = int(np.searchsorted(far, far[np.argmax(back)]))
        kept.add(a + 1 + k)
        parts += [(a, a + 1 + k), (a + 1 + k, b)]
    return np.array(sorted(kept))


def _at_short_legs(ends: Array, short_m: float, off_m: float, largest_m: float) -> Numbers:
    """Return the numbers of the ends that go with short legs: of each leg, the end nearer to a line past it."""
    off, steps = np.full(len(ends), np.inf), _steps(ends)
    _, off[1:-1] = _places(ends[1:-1], ends[:-2], ends[2:] - ends[:-2])
    beside = np.pad(steps, 1, constant_values=np.inf)
    alone = (steps < largest_m) & (ALONE * steps < np.minimum(beside[2:], beside[:-2])) & (len(ends) > 2)
    short = np.flatnonzero((steps < short_m) | alone)
    nearer = np.where(off[short] < off[short + 1], short, short + 1)
    return np.unique(nearer[off[nearer] < np.where(alone[short], np.inf, off_m)])


def _places(p: Array, begin: Array, leg: Array) -> tuple[Array, Array]:
    """Return where the points nearest to p (K, 3) are on legs (share 0 .. 1), and their distances (m), each (K,)."""
    square = (leg[..., :2] ** 2).sum(axis=-1)
    share = ((p - begin)[:, :2] * leg[..., :2]).sum(axis=1) / np.where(square > 0.0, square, 1.0)
    share = np.clip(share, 0.0, 1.0)
    off = p - begin - share[:, None] * leg
    return share, np.maximum(np.hypot(off[:, 0], off[:, 1]), np.abs(off[:, 2]))


def _least_squares(p: Array, kept: Numbers, ends: Array) -> tuple[Array, Array]:
    """Return the ends (V, 3) that minimise the squared distances of points from their places on legs, and the places.

    Parameters
    ----------
    p : (K, 3) points (m).
    kept : (V,) numbers of the points at the ends.
    ends : (V, 3) ends by which the places (leg and share) are found.
    """
    from scipy.linalg import solveh_banded  # 14 MB, for paths of many points alone

    legs = len(kept) - 1
    leg = np.clip(np.searchsorted(kept, np.arange(len(p)), side="right") - 1, 0, legs - 1)
    share, _ = _places(p, ends[leg], np.diff(ends, axis=0)[leg])
    share[kept[:-1]], share[-1] = 0.0, 1.0
    banded, right = np.zeros((2, legs + 1)), np.zeros((legs + 1, 3))
    np.add.at(banded[0], leg + 1, share * (1.0 - share))
    for end, own in ((leg, 1.0 - share), (leg + 1, share)):
        np.add.at(banded[1], end, own * own)
        np.add.at(right, end, own[:, None] * p)
    return solveh_banded(banded, right), leg + share
