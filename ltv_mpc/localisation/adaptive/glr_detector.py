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

_COLUMNS_OF = np.eye(COLUMNS).reshape(COLUMNS, STEPS, 2).transpose(1, 0, 2)
"""(STEPS, COLUMNS, 2), the two columns of each instant."""

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
        layout, E = belief.layout, signatures.error
        for axis, nodes in enumerate((layout.north, layout.east)):
            E[nodes, axis::2] += self._pending_s
            E[layout.mean.start + axis, axis::2] += self._pending_s
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
        D, start_ns = self._hypotheses()
        d, precision = signatures.score @ D, D.transpose(0, 2, 1) @ signatures.information @ D + np.eye(2) / _SD_MPS2**2
        covariance = np.linalg.inv(precision)
        nu = (covariance @ d[..., None])[..., 0]
        statistic = (d * nu).sum(axis=1)
        if not statistic.max(initial=0.0) > limit:
            return None
        evidence = 0.5 * (statistic - np.log(np.linalg.det(precision)))
        share = np.exp(evidence - evidence.max())
        share /= share.sum()
        selected = np.flatnonzero(share > _MIN_EVIDENCE)
        means, roots = [], []
        for k in selected:
            signature = signatures.error @ D[k]
            means.append(signature @ nu[k])
            roots.append(math.sqrt(share[k]) * signature @ np.linalg.cholesky(covariance[k]))
        error = share[selected] @ np.array(means)
        roots += [math.sqrt(share[k]) * (mean - error)[:, None] for k, mean in zip(selected, means, strict=True)]
        roots.append(_SHAPE_ERROR * error[:, None])
        old = share[start_ns <= belief.t_ns - reach_ns].sum() > _OLD
        return OnsetDetection(float(statistic.max()), bool(old), error, np.concatenate(roots, axis=1))

    def _hypotheses(self) -> tuple[Array, Instants]:
        """Return D (H, COLUMNS, 2), which takes the columns of each hypothesis, and the start times (H,) (ns)."""
        start_ns = self._start_ns
        used = start_ns != _NONE_NS
        starts, ends = np.nonzero(used[:, None] & (start_ns[:, None] < start_ns))
        D = np.concatenate([_COLUMNS_OF[used], _COLUMNS_OF[starts] - _COLUMNS_OF[ends]])
        return D, start_ns[np.concatenate([np.flatnonzero(used), starts])]
