"""Generalised likelihood ratio (GLR) detector of slow fronts: current drifts that started recently at all depths.

The filter mistakes a slow front for a tilt and a velocity of the vehicle, and innovations hardly show it. A change of
10 cm/s in 15 s moves the estimated velocity by ten standard deviations, and every mean of innovations by less than
four. But innovations show a known signature at the start of the front and, with the opposite sign, at its end
(``failure_signatures.py``).

Hypotheses  The current at all depths accelerates by nu (m/s2, north and east) from one instant of a time grid of step
        ``STEP_NS`` until a later one or until now. Each instant has two columns of E; a drift that has ended is the
        column of its start minus the column of its end. With score d, information J and prior nu ~ N(0, s^2 I):
            2 ln L = d^T (J + I / s^2)^-1 d,    evidence = L |I + s^2 J|^-1/2
Detection   if the largest 2 ln L exceeds ``THRESHOLD``, or ``JOINT_THRESHOLD`` if a mean of innovations is significant
        too (``process_noise.py``).
Compensation    of an old drift: nearly all evidence is with hypotheses that started earlier than the filter's buffer
        reaches back. Estimate and covariance become those of the mixture of all hypotheses, weighted by their evidence;
        each moves the estimate by E nu and adds E (J + I / s^2)^-1 E^T to the covariance. For a younger drift the
        filter goes back and repeats the time since then with inflated process noise, which assumes no shape.
Gyros   Hypotheses of a gyro fault did not change what was detected, so there are none.
Source  Willsky & Jones 1976, A generalized likelihood ratio approach to the detection and estimation of jumps in linear
        systems, IEEE T-AC 21(1); Bar-Shalom, Li & Kirubarajan 2001, section 1.4.16 (moments of a mixture).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ltv_mpc.jit import jit
from ltv_mpc.localisation.filter.state import Belief
from ltv_mpc.messages import Array

Instants = npt.NDArray[np.int64]

STEP_NS, STEPS = 3_000_000_000, 14
"""Step and number of the instants at which a drift may start or end."""

COLUMNS = 2 * STEPS
"""Number of columns of E: north and east for each instant."""

THRESHOLD = 32.0
"""Smallest 2 ln L of a detection. Sixty descents through water that follows its prior reached at most 28."""

JOINT_THRESHOLD = 26.0
"""Smallest 2 ln L of a detection if a mean of innovations is significant too."""

_SD_MPS2 = 0.01
"""Prior standard deviation s of nu (m/s2): 10 cm/s in 10 s."""

_OLD = 0.9
"""Smallest evidence of old hypotheses. A drift that has just started may look like one that has just ended."""

_SHAPE_ERROR = 0.15
"""Standard deviation of the compensation relative to itself, because a front is not exactly a ramp."""

_NONE_NS = -(2**62)
"""Start time of an instant that is not in use."""

_MIN_EVIDENCE = 1e-4
"""Smallest share of the evidence of a hypothesis in the mixture."""


class OnsetDetection(NamedTuple):
    """Detected drift: the mean error of the mixture, and a square root of the covariance that compensation adds."""

    statistic: float  # largest 2 ln L
    is_old: bool  # with high probability it started earlier than the filter's buffer reaches back
    error: Array  # (n,) mean error
    root: Array  # (n, r) the added covariance is root root^T

    def compensate(self, belief: Belief) -> None:
        """Add the mean error to the estimate and its uncertainty to the covariance.

        Parameters
        ----------
        belief : state estimate; estimate and covariance change.
        """
        belief.apply_error(self.error)
        belief.P += self.root @ self.root.T


class GlrDetector:
    """GLR detector: start times of the hypotheses in a belief's signatures. Filter snapshots contain it."""

    def __init__(self) -> None:
        self._start_ns: Instants = np.full(STEPS, _NONE_NS)
        self._pending_s = 0.0

    def copy(self) -> GlrDetector:
        """Return an independent copy."""
        other = GlrDetector()
        other._start_ns, other._pending_s = self._start_ns.copy(), self._pending_s
        return other

    def reset(self, belief: Belief) -> None:
        """Discard all hypotheses and their evidence.

        Parameters
        ----------
        belief : state estimate whose signatures are cleared.
        """
        belief.signatures.clear()
        self._start_ns[:] = _NONE_NS
        self._pending_s = 0.0

    def add_elapsed(self, dt: float) -> None:
        """Let the drift of all started hypotheses continue for ``dt`` (s).

        Parameters
        ----------
        dt : time (s).
        """
        self._pending_s += dt

    def start_hypothesis(self, belief: Belief) -> None:
        """Bring the signatures to the time of the belief, before rows that depend on the current are used.

        At a new instant of the time grid a hypothesis starts in the columns of the oldest one.

        Parameters
        ----------
        belief : state estimate; its signatures change.
        """
        signatures, t_ns = belief.signatures, belief.t_ns
        if not signatures.score.size:
            return
        layout = belief.layout
        _grow(signatures.error, self._pending_s, layout.mean.start, layout.north.start, layout.east.start)
        self._pending_s = 0.0
        slot = t_ns // STEP_NS % STEPS
        if self._start_ns[slot] // STEP_NS != t_ns // STEP_NS:
            self._start_ns[slot] = t_ns
            signatures.clear(slice(2 * slot, 2 * slot + 2))

    def detect(self, belief: Belief, limit: float, reach_ns: int) -> OnsetDetection | None:
        """Return the detected drift, or None.

        Parameters
        ----------
        belief : state estimate with its signatures.
        limit : smallest 2 ln L of a detection.
        reach_ns : time that the filter's buffer reaches back.
        """
        signatures = belief.signatures
        if not signatures.score.size:
            return None
        first, last, statistic, evidence, nu, covariance = _evaluate(
            signatures.score, signatures.information, self._start_ns
        )
        if not statistic.max(initial=0.0) > limit:
            return None
        share = np.exp(evidence - evidence.max())
        share /= share.sum()
        selected = np.flatnonzero(share > _MIN_EVIDENCE)
        E, means, roots = signatures.error, [], []
        for k in selected:
            since = E[:, first[k] : first[k] + 2]
            signature = since if last[k] < 0 else since - E[:, last[k] : last[k] + 2]
            means.append(signature @ nu[k])
            roots.append(math.sqrt(share[k]) * signature @ np.linalg.cholesky(covariance[k]))
        error = share[selected] @ np.array(means)
        roots += [math.sqrt(share[k]) * (mean - error)[:, None] for k, mean in zip(selected, means, strict=True)]
        roots.append(_SHAPE_ERROR * error[:, None])
        old = share[self._start_ns[first // 2] <= belief.t_ns - reach_ns].sum() > _OLD
        return OnsetDetection(float(statistic.max()), bool(old), error, np.concatenate(roots, axis=1))


@jit
def _grow(E: Array, dt: float, mean: int, north: int, east: int) -> None:
    """Add ``dt`` to the signatures of all currents; ``mean``, ``north``, ``east`` are their first indices."""
    for axis, start in enumerate((north, east)):
        for i in range(start, start + east - north):
            for j in range(axis, E.shape[1], 2):
                E[i, j] += dt
        for j in range(axis, E.shape[1], 2):
            E[mean + axis, j] += dt


@jit
def _evaluate(
    score: Array, information: Array, start_ns: Instants
) -> tuple[Instants, Instants, Array, Array, Array, Array]:
    """Evaluate all hypotheses.

    Return for each: first column of its start and of its end (-1: no end), 2 ln L, ln evidence, nu (2,) and the
    covariance of nu (2, 2).
    """
    n = len(start_ns)
    count_max = n * (n + 1) // 2
    first, last = np.empty(count_max, dtype=np.int64), np.empty(count_max, dtype=np.int64)
    statistic, evidence, nu, covariance = (
        np.empty(count_max),
        np.empty(count_max),
        np.empty((count_max, 2)),
        np.empty((count_max, 2, 2)),
    )
    prior = 1.0 / (_SD_MPS2 * _SD_MPS2)
    count = 0
    for i in range(n):
        if start_ns[i] == _NONE_NS:
            continue
        a = 2 * i
        for k in range(-1, n):
            d0, d1 = score[a], score[a + 1]
            J00, J01, J11 = information[a, a], information[a, a + 1], information[a + 1, a + 1]
            if k >= 0:
                if start_ns[k] <= start_ns[i]:
                    continue
                b = 2 * k
                d0 -= score[b]
                d1 -= score[b + 1]
                J00 += information[b, b] - 2.0 * information[a, b]
                J01 += information[b, b + 1] - information[a, b + 1] - information[b, a + 1]
                J11 += information[b + 1, b + 1] - 2.0 * information[a + 1, b + 1]
            J00 += prior
            J11 += prior
            det = J00 * J11 - J01 * J01
            nu[count, 0] = (J11 * d0 - J01 * d1) / det
            nu[count, 1] = (J00 * d1 - J01 * d0) / det
            covariance[count, 0, 0], covariance[count, 1, 1] = J11 / det, J00 / det
            covariance[count, 0, 1] = covariance[count, 1, 0] = -J01 / det
            statistic[count] = nu[count, 0] * d0 + nu[count, 1] * d1
            evidence[count] = 0.5 * statistic[count] - 0.5 * math.log(det / (prior * prior))
            first[count], last[count] = a, 2 * k if k >= 0 else -1
            count += 1
    return first[:count], last[:count], statistic[:count], evidence[:count], nu[:count], covariance[:count]
