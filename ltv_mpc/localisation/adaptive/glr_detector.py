"""What began lately: all water that drifts. Found by what it would have done to the filter, and made up for.

A slow front is taken for a tilt of the vehicle and its velocity, and innovations hardly show it: 10 cm/s in 15 s moves
the velocity by ten deviations, and no mean of innovations by four. But they show it in a known way, at its beginning
and, the other way round, at its end; ``failure_signatures.py`` keeps what each hypothesis would have done.

Hypotheses, each of two numbers nu, by when it began and ended: all water goes faster and faster, by nu (m/s2, north and
        east), from one instant of a grid of ``STEP_NS`` on, until another one or until now. Each instant has two
        columns; a drift that has ended is one that began less one that began later. With d the score, J the
        information and nu ~ N(0, s^2 I) before anything was heard,
            2 ln L = d^T (J + I / s^2)^-1 d,    evidence = L |I + s^2 J|^-1/2
Found   where 2 ln L of the best of them passes ``THRESHOLD``, or ``JOINT_THRESHOLD`` where innovations have a mean as
        well.
Old     where those that began longer ago than the filter goes back have nearly all evidence: then estimate and
        covariance become those of the mixture of all, weighed by their evidence; each moves the estimate by its E nu
        and adds E (J + I / s^2)^-1 E^T. What began since is done again with a walk of the water (``process_noise.py``),
        which asks for no shape.
Gyros   That a gyro began to fail could be asked in the same way; what was found was the same with it and without.
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
COLUMNS = 2 * STEPS

THRESHOLD = 32.0
"""Sixty descents through water as foretold: 23 at most with the paper's sensors, 28 with realistic ones."""
JOINT_THRESHOLD = 26.0

_SD_MPS2 = 0.01
"""10 cm/s in 10 s."""
_OLD = 0.9
"""A drift that has just begun may look like one that has just ended."""
_SHAPE = 0.15
"""A front is not quite a ramp: so much of what the estimate is moved by is doubted besides."""
_NONE_NS = -(2**62)
_LEAST = 1e-4
"""Share of the evidence below which a hypothesis is not mixed in."""


class OnsetDetection(NamedTuple):
    """Of the mixture: by how much the estimate is to be moved, and a root of what that adds to its covariance."""

    statistic: float  # the largest 2 ln L
    is_old: bool  # very likely
    error: Array  # (n,)
    root: Array  # (n, r)

    def compensate(self, belief: Belief) -> None:
        """Move the estimate."""
        belief.apply_error(self.error)
        belief.P += self.root @ self.root.T


class GlrDetector:
    """Which columns of the belief's signatures began when. Part of what a filter goes back to."""

    def __init__(self) -> None:
        self._began: Instants = np.full(STEPS, _NONE_NS)
        self._to_grow_s = 0.0

    def copy(self) -> GlrDetector:
        """Independent of this one."""
        other = GlrDetector()
        other._began, other._to_grow_s = self._began.copy(), self._to_grow_s
        return other

    def reset(self, belief: Belief) -> None:
        """What has been heard so far."""
        belief.signatures.clear()
        self._began[:] = _NONE_NS
        self._to_grow_s = 0.0

    def add_elapsed(self, dt: float) -> None:
        """All water has drifted for ``dt`` more (s)."""
        self._to_grow_s += dt

    def start_hypothesis(self, belief: Belief) -> None:
        """What has grown, before rows that look at water are used, and where it is time an instant in the place of the
        oldest.
        """
        signatures, t_ns = belief.signatures, belief.t_ns
        if not signatures.score.size:
            return
        layout = belief.layout
        _grow(signatures.error, self._to_grow_s, layout.mean.start, layout.north.start, layout.east.start)
        self._to_grow_s = 0.0
        slot = t_ns // STEP_NS % STEPS
        if self._began[slot] // STEP_NS != t_ns // STEP_NS:
            self._began[slot] = t_ns
            signatures.clear(slice(2 * slot, 2 * slot + 2))

    def detect(self, belief: Belief, limit: float, reach_ns: int) -> OnsetDetection | None:
        """None while no 2 ln L is beyond ``limit``; ``reach_ns``: how far the filter goes back."""
        signatures = belief.signatures
        if not signatures.score.size:
            return None
        first, last, twice, evidence, nu, covariance = _weighed(signatures.score, signatures.information, self._began)
        if not twice.max(initial=0.0) > limit:
            return None
        share = np.exp(evidence - evidence.max())
        share /= share.sum()
        some = np.flatnonzero(share > _LEAST)
        E, moves, roots = signatures.error, [], []
        for k in some:
            since = E[:, first[k] : first[k] + 2]
            its = since if last[k] < 0 else since - E[:, last[k] : last[k] + 2]
            moves.append(its @ nu[k])
            roots.append(math.sqrt(share[k]) * its @ np.linalg.cholesky(covariance[k]))
        error = share[some] @ np.array(moves)
        roots += [math.sqrt(share[k]) * (move - error)[:, None] for k, move in zip(some, moves, strict=True)]
        roots.append(_SHAPE * error[:, None])
        old = share[self._began[first // 2] <= belief.t_ns - reach_ns].sum() > _OLD
        return OnsetDetection(float(twice.max()), bool(old), error, np.concatenate(roots, axis=1))


@jit
def _grow(E: Array, dt: float, mean: int, north: int, east: int) -> None:
    """E of all water by ``dt``; places of its mean and of its first nodes."""
    for axis, start in enumerate((north, east)):
        for i in range(start, start + east - north):
            for j in range(axis, E.shape[1], 2):
                E[i, j] += dt
        for j in range(axis, E.shape[1], 2):
            E[mean + axis, j] += dt


@jit
def _weighed(
    score: Array, information: Array, began: Instants
) -> tuple[Instants, Instants, Array, Array, Array, Array]:
    """Of each hypothesis: the first column of its beginning and of its end (-1: none), 2 ln L, ln evidence, nu (2,),
    and nu's covariance (2, 2).
    """
    n = len(began)
    most = n * (n + 1) // 2
    first, last = np.empty(most, dtype=np.int64), np.empty(most, dtype=np.int64)
    twice, evidence, nu, covariance = np.empty(most), np.empty(most), np.empty((most, 2)), np.empty((most, 2, 2))
    prior = 1.0 / (_SD_MPS2 * _SD_MPS2)
    count = 0
    for i in range(n):
        if began[i] == _NONE_NS:
            continue
        a = 2 * i
        for k in range(-1, n):
            d0, d1 = score[a], score[a + 1]
            J00, J01, J11 = information[a, a], information[a, a + 1], information[a + 1, a + 1]
            if k >= 0:
                if began[k] <= began[i]:
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
            twice[count] = nu[count, 0] * d0 + nu[count, 1] * d1
            evidence[count] = 0.5 * twice[count] - 0.5 * math.log(det / (prior * prior))
            first[count], last[count] = a, 2 * k if k >= 0 else -1
            count += 1
    return first[:count], last[:count], twice[:count], evidence[:count], nu[:count], covariance[:count]
