"""Water that changes as its prior does not foresee: how the filter sees it, and what it then grants the water.

Seen    A ping's innovations are fitted, by least squares over its rows, with a velocity of all water past the vehicle
        and with a shear, D of ``innovation_tests.py``. Water that changes everywhere at once, as a front does, shows
        in the
        velocity's two horizontal parts, internal waves in the shear; what shows in the vertical part is no water.
        Slower fronts hardly show in any mean, but in what ``glr_detector.py`` sums.
Granted a random walk of all nodes that are states, smooth over depth,
            P_water += q^2 dt exp(-|z_i - z_j| / 30 m),  north and east,
        of one of two strengths q, while it lasts:
            slow  3 mm/s per sqrt(s), after a shear: waves of 5 cm/s in 300 s change by 1 cm/s within 10 s
            fast  5 cm/s per sqrt(s), after a velocity: ten times less or more makes no difference while a front passes,
                  for the vehicle's velocity then rests on the inertial unit alone
        What fast does not account for is not water but the unit or the profiler: it is left to the gate and said to be
        inconsistent. (0.5 m/s per sqrt(s) took a failed accelerometer for water, and the filter with it.)
Unit    A gyro that fails slowly tilts the level, g b t^2 / 2 of velocity that looks like a front: of 30 deg/h, granted
        as water again and again, 200 m came in 150 s. But a front passes, in 3 s the sums are full of it; a fault's
        does not. So what shows over 10 s alone, or again when a front has just been granted, is granted both: the fast
        walk, and once, at the beginning, doubt of gyros and level and of how much of the water's motion was the
        vehicle's. The filter then learns the gyro's bias as soon as the walk is over, and its covariance holds either.
On      What was granted as fast for 10 s is granted for as long as the water drifts on (``front_or_gyro_test.py``),
        and where that
        grows as a tilt makes it grow, it is the unit.
Old     What ``glr_detector.py`` finds to have begun before that which ``BACK_NS`` reaches is made up for there and
        then:
        estimate and covariance become what they would be, had it been known; and the fast walk is granted from now on,
        should it not be over yet.
Back    A front is seen three to ten seconds after it came; until then the filter has taken it for a tilt and a
        velocity of the vehicle, and is sure of them. So it is granted from ``BACK_NS`` before it was seen: the filter
        goes back and does these seconds again (``out_of_sequence.py``).
Cost    Nothing is granted while nothing is seen: known water is filtered to the bit as without any of this.
Blind   What no detector can see (``benchmarks/water_detectability.py``): a front of 10 cm/s in 30 s or more, with
        realistic sensors internal waves of 5 cm/s. Say ``current_change_mps_per_rts`` where that is to be expected.
"""

from __future__ import annotations

import enum
import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ltv_mpc.jit import jit
from ltv_mpc.localisation.adaptive import innovation_tests
from ltv_mpc.localisation.adaptive.front_or_gyro_test import FrontOrGyroTest
from ltv_mpc.localisation.adaptive.glr_detector import JOINT_THRESHOLD, THRESHOLD, GlrDetector, OnsetDetection
from ltv_mpc.localisation.adaptive.innovation_tests import InnovationMeanTest
from ltv_mpc.localisation.filter.state import ATTITUDE, GYRO_BIAS, VELOCITY, Belief
from ltv_mpc.messages import Array

BACK_NS = 10_000_000_000

_SMOOTH_M = 30.0
_MEANS_S = (1.0, 3.0, 10.0)
_SLOPES_S = (3.0, 10.0, 30.0)
"""Over which they are taken."""

_CUT = 2.0
"""Deviations to which each row is cut before it is fitted, so that an outlier counts as two."""
_WORST = 100.0
"""Condition of a fit, of columns of one length, up to which beams are held to point in enough directions."""

_LIMIT_1, _LIMIT_2 = innovation_tests.threshold(1), innovation_tests.threshold(2)
_LIMIT_FAST = innovation_tests.threshold(2, 1e-7)
"""What is granted as fast is taken from the velocity, for as long as the dive lasts: one false alarm in 5,000 dives, of
three sums with 600 independent looks each. By ``_LIMIT_2`` it was one in 200, and one of them ended 36 m away.
"""

_LONGEST_NS = 120_000_000_000
_BEYOND_NS = 2_000_000_000
"""For so long a call for what no water does is remembered: a second, the time between two reports, and another."""
_LONGEST_FRONT_S = 50.0
"""Since what was granted began. What goes on for longer is not water."""
_BEFORE_NS = 1_000_000_000
"""So long before a grant ends it is asked whether it is still needed, and then for so long more."""


class NoiseLevel(enum.IntEnum):
    """How much the water is granted."""

    NONE = 0
    SLOW = 1
    FAST = 2
    FAST_AND_IMU = 3  # as FAST, and the inertial unit is doubted


WALK_MPS_PER_RTS = {NoiseLevel.NONE: 0.0, NoiseLevel.SLOW: 0.003, NoiseLevel.FAST: 0.05, NoiseLevel.FAST_AND_IMU: 0.05}
_HOLD_NS = {NoiseLevel.SLOW: 60_000_000_000, NoiseLevel.FAST: 10_000_000_000, NoiseLevel.FAST_AND_IMU: 10_000_000_000}

_GYRO_SD_RADPS, _TILT_SD_RAD, _VELOCITY_SD_MPS = 5e-4, 0.01, 0.3
"""What is opened once with UNIT: 100 deg/h, what that makes of the tilt in 20 s, and of the velocity in 10 s."""


class AdaptiveProcessNoise:
    """Of one filter; part of what it goes back to."""

    def __init__(self, cell_m: float, from_ns: int) -> None:
        """Before ``from_ns`` nothing is granted."""
        self._cell_m = cell_m
        self._from_ns = from_ns
        self._until_ns: dict[NoiseLevel, int] = {}
        self._held_ns: dict[NoiseLevel, int] = {}
        self._to_open = False  # the inertial unit's doubt, when time goes on
        self._onsets = GlrDetector()
        self._drift: FrontOrGyroTest | None = None  # while FAST is granted
        self._tilts = False  # it is the unit's
        self._clear()

    def copy(self) -> AdaptiveProcessNoise:
        """Independent of this one."""
        other = AdaptiveProcessNoise.__new__(AdaptiveProcessNoise)
        other.__dict__.update(self.__dict__)
        other._means, other._downward, other._slopes = self._means.copy(), self._downward.copy(), self._slopes.copy()
        other._until_ns, other._held_ns = dict(self._until_ns), dict(self._held_ns)
        other._onsets = self._onsets.copy()
        other._drift = None if self._drift is None else self._drift.copy()
        return other

    def reset_tests(self, belief: Belief) -> None:
        """What pings have shown so far: it was the profiler's, or is accounted for. What is granted stays."""
        self._onsets.reset(belief)
        self._clear()

    def _clear(self) -> None:
        self._means, self._downward, self._slopes = (
            InnovationMeanTest(_MEANS_S, 2),
            InnovationMeanTest(_MEANS_S, 1),
            InnovationMeanTest(_SLOPES_S, 2),
        )
        self._beyond_ns: int | None = None

    def level(self, t_ns: int) -> NoiseLevel:
        """Granted at ``t_ns``."""
        return max((c for c, until_ns in self._until_ns.items() if t_ns < until_ns), default=NoiseLevel.NONE)

    def walk_mps_per_rts(self, t_ns: int) -> float:
        """What is granted, q."""
        return WALK_MPS_PER_RTS[self.level(t_ns)]

    def is_inconsistent(self, t_ns: int) -> bool:
        """Means have just called for what no water does: more than fast, or up and down."""
        return self._beyond_ns is not None and t_ns - self._beyond_ns < _BEYOND_NS

    def add_innovations(self, t_ns: int, u: Array, cell: npt.NDArray[np.int64], r: Array, S: Array) -> None:
        """Innovations r (m,) of one ping with covariance S; u (m, 3) each row's beam in NED."""
        ways, shear = _contrasts(u, cell, r, S)
        if ways.known:
            self._means.add(t_ns, ways.d[:2], ways.V[:2, :2])
            self._downward.add(t_ns, ways.d[2:], ways.V[2:, 2:])
        if shear.known:
            self._slopes.add(t_ns, shear.d, shear.V)

    def start_ping(self, belief: Belief) -> None:
        """A ping is to be used."""
        self._onsets.start_hypothesis(belief)

    def detect_onset(self, belief: Belief) -> OnsetDetection | None:
        """What the sums of the pings so far show of what began lately; None: nothing."""
        if belief.t_ns < self._from_ns or self.is_inconsistent(belief.t_ns):
            return None
        found = self._onsets.detect(belief, JOINT_THRESHOLD, BACK_NS)
        if found is None or found.statistic > THRESHOLD:
            return found
        means = self._means.chi_square() > _LIMIT_FAST
        moves = means.any() and not self._lasting(means, belief.t_ns) and self.level(belief.t_ns) < NoiseLevel.FAST
        return found if moves else None

    def required_level(self, t_ns: int, began: OnsetDetection | None = None) -> NoiseLevel:
        """What the last ping calls for beyond what is granted at ``t_ns``; NONE: nothing."""
        granted, lately = self.level(t_ns), self._means.chi_square()
        means = lately > _LIMIT_FAST
        if (self._downward.chi_square() > _LIMIT_1).any() or (lately[0] > _LIMIT_2 and granted >= NoiseLevel.FAST):
            self._beyond_ns = t_ns
        if self.is_inconsistent(t_ns) or t_ns < self._from_ns:
            return NoiseLevel.NONE
        if self._tilts:
            return NoiseLevel.FAST_AND_IMU
        if means.any() and granted < NoiseLevel.FAST:
            return NoiseLevel.FAST_AND_IMU if self._lasting(means, t_ns) else NoiseLevel.FAST
        if began is not None and not began.is_old and granted < NoiseLevel.FAST:
            return NoiseLevel.FAST
        if (self._slopes.chi_square() > _LIMIT_2).any() and granted < NoiseLevel.SLOW:
            return NoiseLevel.SLOW
        return NoiseLevel.NONE

    def inflate(self, change: NoiseLevel, until_ns: int, now_ns: int) -> None:
        """From now on, wherever "now" has gone back to. ``until_ns`` comes from ``hold``."""
        self._held_ns[change] = until_ns - now_ns
        self._until_ns[change] = until_ns
        self._to_open = change is NoiseLevel.FAST_AND_IMU
        self._tilts = False

    def _lasting(self, means: npt.NDArray[np.bool_], t_ns: int) -> bool:
        """It shows over the longest time alone, or again."""
        return (
            not means[:-1].any() or self._lately(NoiseLevel.FAST, t_ns) or self._lately(NoiseLevel.FAST_AND_IMU, t_ns)
        )

    def _lately(self, change: NoiseLevel, t_ns: int) -> bool:
        """It was granted, and has ended no longer ago than it was held."""
        return change in self._until_ns and t_ns < self._until_ns[change] + self._held_ns[change]

    def inflation_end_ns(self, change: NoiseLevel, now_ns: int) -> int:
        """Until when it is granted: twice as long as the last time where that was not long ago."""
        last_ns, hold_ns = self._held_ns.get(change, 0), _HOLD_NS[change]
        if last_ns and now_ns < self._until_ns[change] + 2 * last_ns:
            hold_ns = min(2 * last_ns, _LONGEST_NS)
        return now_ns + hold_ns

    def add_correction(self, belief: Belief, upper: npt.NDArray[np.int64], error: Array) -> None:
        """Take note of one ping's corrections (n,). Its cells lie below the nodes ``upper`` of the grid."""
        if self.level(belief.t_ns) is NoiseLevel.FAST:
            layout, slots = belief.layout, upper - belief.column.first
            self._follow(belief, np.array([error[layout.north][slots].mean(), error[layout.east][slots].mean()]))
        else:
            self._drift = None

    def _follow(self, belief: Belief, moved_mps: Array) -> None:
        """Where the water goes while FAST is granted: for longer where it goes on."""
        if self._drift is None:
            self._drift = FrontOrGyroTest()
        self._drift.add(belief, moved_mps)
        if self._until_ns[NoiseLevel.FAST] > belief.t_ns + _BEFORE_NS:
            return
        level = np.diagonal(belief.P)[ATTITUDE][:2]
        if self._drift.is_drifting(math.sqrt(level.max())):
            if self._drift.duration_s > _LONGEST_FRONT_S or self._drift.is_gyro_fault():
                self._tilts = True
            else:
                self._until_ns[NoiseLevel.FAST] = belief.t_ns + _BEFORE_NS

    def propagate(self, belief: Belief, dt: float) -> None:
        """What is granted over the last ``dt`` (s), into the covariance."""
        self._onsets.add_elapsed(dt)
        if not (self._until_ns or self._to_open):
            return
        q = self.walk_mps_per_rts(belief.t_ns)
        if q > 0.0:
            layout = belief.layout
            k = np.arange(layout.north.stop - layout.north.start)
            smooth = q * q * dt * np.exp(-np.abs(k[:, None] - k[None, :]) * self._cell_m / _SMOOTH_M)
            for axis in (layout.north, layout.east):
                belief.P[axis, axis] += smooth
        if self._to_open:
            self._to_open = False
            _doubt(belief)


def _doubt(belief: Belief) -> None:
    """Of gyros and level, and of how much of what the water seemed to do was the vehicle: P += s^2 j j^T, j over v and
    all water of one axis alike, for of their difference the profiler has told.
    """
    layout, P = belief.layout, belief.P
    gyro, level = np.arange(GYRO_BIAS.start, GYRO_BIAS.stop), np.arange(ATTITUDE.start, ATTITUDE.stop)[:2]
    P[gyro, gyro] += _GYRO_SD_RADPS**2
    P[level, level] += _TILT_SD_RAD**2
    for axis, nodes in enumerate((layout.north, layout.east)):
        j = np.r_[VELOCITY.start + axis, layout.mean.start + axis, nodes]
        P[np.ix_(j, j)] += _VELOCITY_SD_MPS**2


class _Contrast(NamedTuple):
    """d = D^T r, (k,), and V = D^T S D, (k, k), with D (m, k) of least squares, D^T X = 1."""

    known: bool  # not where beams of one plane alone say nothing across it
    d: Array
    V: Array


@jit
def _contrasts(u: Array, cell: npt.NDArray[np.int64], r: Array, S: Array) -> tuple[_Contrast, _Contrast]:
    """Of innovations r (m,), each cut to ``_CUT`` deviations: of a velocity of all water, X = u (m, 3), and of a shear,
    X = (cell - mean) u, north and east.
    """
    m = len(r)
    cut, middle = np.empty(m), cell.sum() / m
    X, SX = np.empty((5, m)), np.zeros((5, m))
    for i in range(m):
        most = _CUT * math.sqrt(S[i, i])
        cut[i] = min(max(r[i], -most), most)
        for a in range(3):
            X[a, i] = u[i, a]
        for a in range(2):
            X[3 + a, i] = (cell[i] - middle) * u[i, a]
    for i in range(m):
        for a in range(5):
            c = X[a, i]
            for j in range(m):
                SX[a, j] += c * S[i, j]
    return _contrast(X[:3], SX[:3], cut), _contrast(X[3:], SX[3:], cut)


@jit
def _contrast(XT: Array, SXT: Array, r: Array) -> _Contrast:
    """By X^T (k, m) and X^T S."""
    k = len(XT)
    normal, told, spread = np.zeros((k, k)), np.zeros(k), np.zeros((k, k))
    for a in range(k):
        for i in range(len(r)):
            told[a] += XT[a, i] * r[i]
        for b in range(k):
            for i in range(len(r)):
                normal[a, b] += XT[a, i] * XT[b, i]
                spread[a, b] += XT[a, i] * SXT[b, i]
    sd = np.sqrt(np.maximum(np.diag(normal), 1e-12))
    shares = np.linalg.eigvalsh(normal / np.outer(sd, sd))
    if not shares[k - 1] < _WORST * shares[0]:
        return _Contrast(False, np.zeros(k), np.zeros((k, k)))
    G = np.linalg.inv(normal)
    return _Contrast(True, G @ told, G @ spread @ G)
