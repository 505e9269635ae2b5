"""Adaptive process noise of the water: inflation of its random walk when the current departs from its prior.

Detection   Innovations of a ping are fitted by least squares with a uniform current past the vehicle and with a shear,
        the contrasts d = D^T r below. A front, which changes the current at all depths at once,
        shows in the two horizontal components of the uniform current; internal waves show in the shear. What shows in
        the vertical component is no current. Slower fronts show in the sums of ``glr_detector.py`` only.
Inflation   All grid points in the state get a random walk that is smooth over depth,
            P_water += q^2 dt exp(-|z_i - z_j| / 30 m),  north and east,
        of one of two strengths q, for a limited time:
            SLOW  3 mm/s per sqrt(s), after a shear: waves of 5 cm/s in 300 s change by 1 cm/s within 10 s
            FAST  5 cm/s per sqrt(s), after a uniform current. A tenth or ten times of it makes no difference while a
                  front passes, because the vehicle's velocity then rests on the IMU alone
        What FAST does not explain is caused by the IMU or the ADCP, not by the water. It is left to the gate, and the
        filter is reported as inconsistent.
IMU     A slow gyro fault tilts the level. The velocity error g b t^2 / 2 looks like a front. But a front passes: the
        sums show it within 3 s. A fault does not pass. So if only the 10 s sum is significant, or if FAST ended a short
        time ago, the level is FAST_AND_IMU: FAST, and once, at its start, inflation of gyro bias, level, and the part
        of the current that may be motion of the vehicle. When the walk is over, the filter learns the gyro bias; its
        covariance holds in either case.
Duration    FAST lasts 10 s, and longer while the current drifts (``front_or_gyro_test.py``). If that drift grows as a
        tilt makes it grow, the level becomes FAST_AND_IMU.
Old drifts  A drift that ``glr_detector.py`` finds to be older than ``BACK_NS`` is compensated at once: estimate and
        covariance become what they would be if it had been known. FAST follows, in case the drift continues.
Going back  A front is detected three to ten seconds after it started. Until then the filter mistakes it for a tilt and
        a velocity of the vehicle, with a small covariance. So the inflation starts ``BACK_NS`` before the detection:
        the filter goes back and repeats this time (``out_of_sequence.py``).
Cost    Without detection nothing is inflated, and the estimate is bitwise the same as without this file.
Limits  No detector sees a front of 10 cm/s in 30 s or more, nor, with realistic sensors, internal waves of 5 cm/s
        (docs/notes/localisation-studies.md). Set ``current_change_mps_per_rts`` where they are to be expected.
Notes   docs/notes/localisation-studies.md: settings that were tried.

The mean of innovations over many messages shows small lasting errors long before their squares. The innovations r ~
N(0, S) of a consistent filter are white: those of different messages are independent. Contrasts d = D^T r of one
message (for example the mean over its rows) have the covariance V = D^T S D. With exponential forgetting,

    s := lambda s + d,  W := lambda^2 W + V,  lambda = exp(-dt / tau),

s^T W^-1 s is chi-square distributed for any tau, with as many degrees of freedom as d has entries.
Example: an error of a tenth of the noise in each of a hundred rows hardly changes their squares. In d, the mean over
these rows, it is one standard deviation, and it grows with each message.

One message moves s by at most ``MAX_SD`` standard deviations: one bad ping does not exceed ``threshold(2)``, two do.

Source  Mehra 1970, IEEE T-AC 15(2) (whiteness); Bar-Shalom, Li & Kirubarajan 2001, section 5.4.
"""

from __future__ import annotations

import enum
import math

import numpy as np
import numpy.typing as npt
from scipy.special import chdtri

from ltv_mpc.localisation.adaptive.front_or_gyro_test import FrontOrGyroTest
from ltv_mpc.localisation.adaptive.glr_detector import JOINT_THRESHOLD, THRESHOLD, GlrDetector, OnsetDetection
from ltv_mpc.localisation.filter.state import ATTITUDE, GYRO_BIAS, VELOCITY, Belief
from ltv_mpc.messages import Array

MAX_SD = 5.0
"""Largest change of a sum by one message, in standard deviations."""

FALSE_ALARM = 3e-6
"""Probability of a false alarm per test of one sum. 200 s are about 600 independent tests: one dive in 500."""


def threshold(degrees: int, false_alarm: float = FALSE_ALARM) -> float:
    """Return the value that a consistent s^T W^-1 s exceeds with probability ``false_alarm``.

    Parameters
    ----------
    degrees : degrees of freedom, the number of contrasts.
    false_alarm : probability.
    """
    return float(chdtri(degrees, false_alarm))


class InnovationMeanTest:
    """Sums s (T, G) and covariances W (T, G, G) of G contrasts, one or two, for T time constants at once.

    Parameters
    ----------
    tau_s : T time constants (s).
    size : number of contrasts G.
    """

    def __init__(self, tau_s: tuple[float, ...], size: int) -> None:
        self.s = np.zeros((len(tau_s), size))
        self.W = np.zeros((len(tau_s), size, size))
        self._tau_ns = 1e9 * np.array(tau_s)
        self._t_ns: int | None = None

    def add(self, t_ns: int, d: Array, V: Array) -> None:
        """Add the contrasts of one message.

        Parameters
        ----------
        t_ns : time of the message, not before the last.
        d : (G,) contrasts.
        V : (G, G) their covariance.
        """
        keep = np.zeros(len(self.s)) if self._t_ns is None else np.exp((self._t_ns - t_ns) / self._tau_ns)
        self._t_ns = t_ns
        sd = math.sqrt(max(_squares(d[None], V[None])[0], MAX_SD**2))
        self.s = keep[:, None] * self.s + MAX_SD / sd * d
        self.W = keep[:, None, None] ** 2 * self.W + V

    def chi_square(self) -> Array:
        """Return s^T W^-1 s for each time constant, (T,); 0 before the first message."""
        if self._t_ns is None:
            return np.zeros(len(self.s))
        return _squares(self.s, self.W)


def _squares(s: Array, W: Array) -> Array:
    """Return s^T W^-1 s, (T,), for s (T, G) and W (T, G, G)."""
    squares: Array = (s * np.linalg.solve(W, s[..., None])[..., 0]).sum(axis=-1)
    return squares


BACK_NS = 10_000_000_000
"""Time before its detection at which an inflation starts."""

_CORRELATION_LENGTH_M = 30.0
"""Correlation length of the inflation over depth (m)."""

_MEANS_S = (1.0, 3.0, 10.0)
_SHEARS_S = (3.0, 10.0, 30.0)
"""Time constants of the sums of the uniform current and of the shear (s)."""

_CLIP = 2.0
"""Bound of each row before the fit, in standard deviations, so that an outlier counts as two."""

_MAX_CONDITION = 100.0
"""Largest condition number of a fit with columns of unit length. Above it the beams span too few directions."""

_LIMIT_1, _LIMIT_2 = threshold(1), threshold(2)
_LIMIT_FAST = threshold(2, 1e-7)
"""Limit for FAST: one false alarm in 5,000 dives, from three sums with 600 independent tests each. A false alarm costs
velocity accuracy for the rest of a dive (docs/notes/localisation-studies.md).
"""

_MAX_DURATION_NS = 120_000_000_000
"""Longest duration of one inflation."""

_INCONSISTENT_NS = 2_000_000_000
"""Time for which an inconsistency is remembered: two report periods of one second."""

_MAX_FRONT_S = 50.0
"""Longest duration of a front (s). A drift that lasts longer is not water."""

_EXTENSION_NS = 1_000_000_000
"""Time before the end of an inflation at which it is decided whether to extend it, and length of the extension."""


class NoiseLevel(enum.IntEnum):
    """Level of the process noise of the water."""

    NONE = 0
    SLOW = 1
    FAST = 2
    FAST_AND_IMU = 3  # as FAST, with gyro bias and level inflated once


WALK_MPS_PER_RTS = {NoiseLevel.NONE: 0.0, NoiseLevel.SLOW: 0.003, NoiseLevel.FAST: 0.05, NoiseLevel.FAST_AND_IMU: 0.05}
_DURATION_NS = {
    NoiseLevel.SLOW: 60_000_000_000,
    NoiseLevel.FAST: 10_000_000_000,
    NoiseLevel.FAST_AND_IMU: 10_000_000_000,
}

_GYRO_SD_RADPS, _TILT_SD_RAD, _VELOCITY_SD_MPS = 5e-4, 0.01, 0.3
"""Standard deviations added once with FAST_AND_IMU: a gyro bias of 100 deg/h, the tilt that it causes in 20 s, and the
velocity that this tilt causes in 10 s.
"""


class AdaptiveProcessNoise:
    """Adaptive process noise of one filter. Filter snapshots contain it.

    Parameters
    ----------
    cell_m : step of the depth grid (m).
    from_ns : nothing is inflated before this time.
    """

    def __init__(self, cell_m: float, from_ns: int) -> None:
        self._cell_m = cell_m
        self._from_ns = from_ns
        self._until_ns: dict[NoiseLevel, int] = {}
        self._lasted_ns: dict[NoiseLevel, int] = {}
        self._inflates_imu = False  # at the next propagation
        self._glr = GlrDetector()
        self._drift: FrontOrGyroTest | None = None  # while the level is FAST
        self._is_gyro_fault = False
        self._clear()

    def reset_tests(self, belief: Belief) -> None:
        """Discard the evidence of the pings so far, because it is explained. The current inflation stays.

        Parameters
        ----------
        belief : state estimate whose signatures are cleared.
        """
        self._glr.reset(belief)
        self._clear()

    def _clear(self) -> None:
        self._means, self._vertical = InnovationMeanTest(_MEANS_S, 2), InnovationMeanTest(_MEANS_S, 1)
        self._shears = InnovationMeanTest(_SHEARS_S, 2)
        self._inconsistent_ns: int | None = None

    def level(self, t_ns: int) -> NoiseLevel:
        """Return the level at ``t_ns``.

        Parameters
        ----------
        t_ns : time.
        """
        return max((c for c, until_ns in self._until_ns.items() if t_ns < until_ns), default=NoiseLevel.NONE)

    def walk_mps_per_rts(self, t_ns: int) -> float:
        """Return the random walk q of the water at ``t_ns`` (m/s per sqrt(s)).

        Parameters
        ----------
        t_ns : time.
        """
        return WALK_MPS_PER_RTS[self.level(t_ns)]

    def is_inconsistent(self, t_ns: int) -> bool:
        """Return True if recent innovations cannot be water: a vertical current, or more than FAST explains.

        Parameters
        ----------
        t_ns : time.
        """
        return self._inconsistent_ns is not None and t_ns - self._inconsistent_ns < _INCONSISTENT_NS

    def add_innovations(self, t_ns: int, u: Array, cell: npt.NDArray[np.int64], r: Array, S: Array) -> None:
        """Add the innovations of one ping to the sums.

        Parameters
        ----------
        t_ns : time of the ping.
        u : (m, 3) unit vector of each row's beam, NED.
        cell : (m,) cell number of each row.
        r : (m,) innovations (m/s).
        S : (m, m) their covariance.
        """
        bound = _CLIP * np.sqrt(np.diagonal(S))
        clipped = np.clip(r, -bound, bound)
        uniform = _contrast(u, clipped, S)
        if uniform is not None:
            d, V = uniform
            self._means.add(t_ns, d[:2], V[:2, :2])
            self._vertical.add(t_ns, d[2:], V[2:, 2:])
        shear = _contrast((cell - cell.mean())[:, None] * u[:, :2], clipped, S)
        if shear is not None:
            self._shears.add(t_ns, *shear)

    def start_ping(self, belief: Belief) -> None:
        """Bring the GLR detector to the time of the belief, before a ping is used.

        Parameters
        ----------
        belief : state estimate; its signatures change.
        """
        self._glr.start_hypothesis(belief)

    def detect_onset(self, belief: Belief) -> OnsetDetection | None:
        """Return a drift that started recently, or None.

        Parameters
        ----------
        belief : state estimate after the last ping.
        """
        if belief.t_ns < self._from_ns or self.is_inconsistent(belief.t_ns):
            return None
        found = self._glr.detect(belief, JOINT_THRESHOLD, BACK_NS)
        if found is None or found.statistic > THRESHOLD:
            return found
        means = self._means.chi_square() > _LIMIT_FAST
        moves = (
            means.any() and not self._is_persistent(means, belief.t_ns) and self.level(belief.t_ns) < NoiseLevel.FAST
        )
        return found if moves else None

    def required_level(self, t_ns: int, onset: OnsetDetection | None = None) -> NoiseLevel:
        """Return the level that the last ping requires if it is above the level at ``t_ns``, else NONE.

        Parameters
        ----------
        t_ns : time of the last ping.
        onset : drift found by ``detect_onset``.
        """
        level, chi_square = self.level(t_ns), self._means.chi_square()
        means = chi_square > _LIMIT_FAST
        if (self._vertical.chi_square() > _LIMIT_1).any() or (chi_square[0] > _LIMIT_2 and level >= NoiseLevel.FAST):
            self._inconsistent_ns = t_ns
        if self.is_inconsistent(t_ns) or t_ns < self._from_ns:
            return NoiseLevel.NONE
        if self._is_gyro_fault:
            return NoiseLevel.FAST_AND_IMU
        if means.any() and level < NoiseLevel.FAST:
            return NoiseLevel.FAST_AND_IMU if self._is_persistent(means, t_ns) else NoiseLevel.FAST
        if onset is not None and not onset.is_old and level < NoiseLevel.FAST:
            return NoiseLevel.FAST
        if (self._shears.chi_square() > _LIMIT_2).any() and level < NoiseLevel.SLOW:
            return NoiseLevel.SLOW
        return NoiseLevel.NONE

    def inflate(self, level: NoiseLevel, until_ns: int, now_ns: int) -> None:
        """Inflate the process noise.

        Parameters
        ----------
        level : level from now on.
        until_ns : end, from ``inflation_end_ns``.
        now_ns : start: the time to which the filter has gone back.
        """
        self._lasted_ns[level] = until_ns - now_ns
        self._until_ns[level] = until_ns
        self._inflates_imu = level is NoiseLevel.FAST_AND_IMU
        self._is_gyro_fault = False

    def _is_persistent(self, means: npt.NDArray[np.bool_], t_ns: int) -> bool:
        """Return True if only the longest sum is significant, or if FAST ended a short time ago."""
        return (
            not means[:-1].any()
            or self._was_recent(NoiseLevel.FAST, t_ns)
            or self._was_recent(NoiseLevel.FAST_AND_IMU, t_ns)
        )

    def _was_recent(self, level: NoiseLevel, t_ns: int) -> bool:
        """Return True if a level was in force and ended no longer ago than it lasted."""
        return level in self._until_ns and t_ns < self._until_ns[level] + self._lasted_ns[level]

    def inflation_end_ns(self, level: NoiseLevel, now_ns: int) -> int:
        """Return the end of an inflation that starts now: twice as long as the last one if that was recent.

        Parameters
        ----------
        level : level to inflate to.
        now_ns : start of the inflation.
        """
        last_ns, duration_ns = self._lasted_ns.get(level, 0), _DURATION_NS[level]
        if last_ns and now_ns < self._until_ns[level] + 2 * last_ns:
            duration_ns = min(2 * last_ns, _MAX_DURATION_NS)
        return now_ns + duration_ns

    def add_correction(self, belief: Belief, shallower: npt.NDArray[np.int64], error: Array) -> None:
        """Add the correction of one ping to the drift test.

        Parameters
        ----------
        belief : state estimate after the ping.
        shallower : (m,) grid point above each cell of the ping.
        error : (n,) correction of the states.
        """
        if self.level(belief.t_ns) is NoiseLevel.FAST:
            north, east = error[belief.layout.north], error[belief.layout.east]
            self._follow(belief, np.array([north[shallower].mean(), east[shallower].mean()]))
        else:
            self._drift = None

    def _follow(self, belief: Belief, moved_mps: Array) -> None:
        """Follow the current while the level is FAST; extend it while the current drifts."""
        if self._drift is None:
            self._drift = FrontOrGyroTest()
        self._drift.add(belief, moved_mps)
        if self._until_ns[NoiseLevel.FAST] > belief.t_ns + _EXTENSION_NS:
            return
        level = np.diagonal(belief.P)[ATTITUDE][:2]
        if self._drift.is_drifting(math.sqrt(level.max())):
            if self._drift.duration_s > _MAX_FRONT_S or self._drift.is_gyro_fault():
                self._is_gyro_fault = True
            else:
                self._until_ns[NoiseLevel.FAST] = belief.t_ns + _EXTENSION_NS

    def propagate(self, belief: Belief, dt: float) -> None:
        """Add the inflated process noise over the last ``dt`` (s) to the covariance.

        Parameters
        ----------
        belief : state estimate; its covariance changes.
        dt : time (s).
        """
        self._glr.add_elapsed(dt)
        if not (self._until_ns or self._inflates_imu):
            return
        q = self.walk_mps_per_rts(belief.t_ns)
        if q > 0.0:
            layout = belief.layout
            k = np.arange(layout.north.stop - layout.north.start)
            smooth = q * q * dt * np.exp(-np.abs(k[:, None] - k[None, :]) * self._cell_m / _CORRELATION_LENGTH_M)
            for axis in (layout.north, layout.east):
                belief.P[axis, axis] += smooth
        if self._inflates_imu:
            self._inflates_imu = False
            _inflate_imu(belief)


def _inflate_imu(belief: Belief) -> None:
    """Inflate gyro bias, level, and the motion common to vehicle and water, P += s^2 j j^T.

    j is 1 on the velocity and on all currents of one axis: the ADCP has measured only their difference.
    """
    layout, P = belief.layout, belief.P
    gyro, level = np.arange(GYRO_BIAS.start, GYRO_BIAS.stop), np.arange(ATTITUDE.start, ATTITUDE.stop)[:2]
    P[gyro, gyro] += _GYRO_SD_RADPS**2
    P[level, level] += _TILT_SD_RAD**2
    for axis, nodes in enumerate((layout.north, layout.east)):
        j = np.r_[VELOCITY.start + axis, layout.mean.start + axis, nodes]
        P[np.ix_(j, j)] += _VELOCITY_SD_MPS**2


def _contrast(X: Array, r: Array, S: Array) -> tuple[Array, Array] | None:
    """Return the contrasts d = D^T r, (k,), and their covariance D^T S D, (k, k), of the least-squares fit D^T X = I.

    Return None if the beams span too few directions.
    """
    normal = X.T @ X
    sd = np.sqrt(np.maximum(np.diagonal(normal), 1e-12))
    shares = np.linalg.eigvalsh(normal / np.outer(sd, sd))
    if not shares[-1] < _MAX_CONDITION * shares[0]:
        return None
    D = X @ np.linalg.inv(normal)
    return D.T @ r, D.T @ S @ D
