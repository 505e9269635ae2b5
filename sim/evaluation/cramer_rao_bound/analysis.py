"""Posterior Cramer-Rao bound: information about the errors, accumulated along a true trajectory.

J (n, n) is the information about all errors at one instant. Measurements add to it, in any order: J := J + H^T H.
From one instant to the next the joint information of the moving errors, x before and y after, is
    [[J_xx + Phi^T Q^-1 Phi, -Phi^T Q^-1, J_xs], [., Q^-1, 0], [., ., J_ss]]        s: the constant errors
and x is marginalised (Schur complement). A position that is needed later, at a satellite epoch or at t = 0, is not
marginalised but joins s, so no covariance is cloned. J^-1 is the bound on the covariance of the errors.
From t = 0 on the moving position is d = p - p_0: a drift of 0.2 m is small against a position known to 5 m.
Drift   of published positions, e(t) - e(0), where e(0) is not corrected later:
            cov = cov(d | data to t) + cov(p_0 | data to 0) - cov(p_0 | data to t)
        because the knowledge of p_0 gained after t = 0 is independent of the remaining error at t.
Source  Tichavsky, Muravchik & Nehorai 1998, IEEE T-SP 46(5); exact where the model is linear.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.messages import Array
from sim.evaluation.cramer_rao_bound.model import (
    EPOCH,
    MOVING,
    POSITION,
    START,
    WATER,
    ErrorModel,
    Instant,
    Trajectory,
    at,
)

TOGETHER_S = 0.02
"""Largest distance of measurements that share one instant (s), such as a fix at 1 s and a ping at 0.999999999 s."""


class Events(NamedTuple):
    """Measurements of one instant."""

    t_s: float
    kinds: frozenset[str]
    depths: int  # number of pressure readings


def schedule(
    sensor_config: SensorConfig, extra: Sequence[float], surface_s: float, without: Collection[str]
) -> list[Events]:
    """Return all instants from the first satellite fix to the last requested one.

    ``extra`` are the requested times (s), ``surface_s`` is the time at the surface before t = 0, and ``without`` are
    missing sensors. Pressure readings count at the nearest instant.
    """
    last = max(extra)
    gnss_s = sensor_config.gnss.period_ns * 1e-9
    first = -math.floor(surface_s / gnss_s + 1e-9) * gnss_s
    due: list[tuple[float, str]] = [(t, "") for t in extra]
    for kind, period_ns, until in (
        ("gnss", sensor_config.gnss.period_ns, 0.0),
        ("tdcp", sensor_config.tdcp.period_ns, 0.0),
        ("adcp", sensor_config.adcp.period_ns, last),
        ("compass", sensor_config.compass.period_ns, last),
    ):
        h = period_ns * 1e-9
        if kind not in without:
            due += [(k * h, kind) for k in range(math.ceil(first / h - 1e-6), math.floor(until / h + 1e-6) + 1)]
    due = sorted((min(max(t, first), last), kind) for t, kind in due)
    groups: list[tuple[float, set[str]]] = []
    for t, kind in due:
        if not groups or t - groups[-1][0] > TOGETHER_S:
            groups.append((0.0 if abs(t) <= TOGETHER_S else t, set()))
        groups[-1][1].add(kind)
    times = np.array([t for t, _ in groups])
    depths = np.zeros(len(times), dtype=int)
    if "pressure" not in without:
        h = sensor_config.pressure.period_ns * 1e-9
        readings = h * np.arange(math.ceil(first / h - 1e-6), math.floor(last / h + 1e-6) + 1)
        nearest = np.searchsorted(0.5 * (times[1:] + times[:-1]), readings)
        np.add.at(depths, nearest, 1)
    return [Events(t, frozenset(kinds), int(n)) for (t, kinds), n in zip(groups, depths, strict=True)]


CORE = 15
"""Position, velocity, attitude, gyro bias, accelerometer bias."""


class Bound(NamedTuple):
    """Bound at M instants. Errors that are taken as known have covariance 0."""

    t_s: Array  # (M,)
    covariance: Array  # (M, 15, 15) of position, velocity, attitude, gyro bias, accelerometer bias
    drift: Array  # (M, 3, 3) of the position drift since t = 0; 0 before it

    @property
    def drift_rms_m(self) -> Array:
        """Bound on the drift along one horizontal axis (m), (M,)."""
        return np.sqrt(0.5 * (self.drift[:, 0, 0] + self.drift[:, 1, 1]))


def bound(
    sensor_config: SensorConfig,
    config: EstimatorConfig,
    trajectory: Trajectory,
    *,
    at_s: Sequence[float],
    surface_time_s: float,
    known: Collection[str] = (),
    without: Collection[str] = (),
    calibration_s: float = 0.0,
) -> Bound:
    """Compute the bound along a trajectory.

    Measurements count at their validity times, without latency. Bottom track, LBL, USBL and a water prior from a file
    are not included.

    Parameters
    ----------
    sensor_config : sensors of the vehicle.
    config : assumptions of the estimator about the water.
    trajectory : true motion, from ``-surface_time_s`` on.
    at_s : instants of the bound (s).
    surface_time_s : time at the surface before t = 0 (s).
    known : errors that are taken as known (keys of ``model.NAMES``).
    without : sensors that are missing (``"gnss"``, ``"tdcp"``, ``"adcp"``, ``"pressure"``, ``"compass"``).
    calibration_s : time (s) for which biases and mounting are calibrated before the first fix.

    Raises
    ------
    ValueError
        If ``at_s`` has a time before the first satellite fix.
    LinAlgError
        If the remaining sensors do not determine the errors.
    """
    model = ErrorModel(sensor_config, config, known, calibration_s)
    events = schedule(sensor_config, [*at_s, 0.0], surface_time_s, without)
    if min(at_s) < events[0].t_s - TOGETHER_S:
        raise ValueError(
            f"the bound is undefined before the first satellite fix at {events[0].t_s:g} s: {min(at_s):g} s"
        )
    information = _Information(model, config.current_change_mps_per_rts)
    wanted = sorted(at_s)
    cores, drifts = [], []
    start: Array | None = None  # covariance of the position at t = 0 from the data up to then
    seen_epoch = False
    for i, (t, kinds, depths) in enumerate(events):
        now = at(trajectory, t)
        for rows in _rows(model, now, trajectory.water_mps, kinds, depths, first=i == 0, epoch=seen_epoch):
            information.add(rows)
        if t == 0.0:
            start = information.covariance(POSITION)
        while wanted and abs(wanted[0] - t) <= TOGETHER_S:
            wanted.pop(0)
            cores.append(information.covariance(slice(0, CORE)))
            drifts.append(information.drift(start) if start is not None and t > 0 else np.zeros((3, 3)))
        if i + 1 < len(events):
            ahead = events[i + 1].t_s
            if "gnss" in kinds and t < 0.0:  # the last fix, at t = 0, is kept as START
                information.marginalise(EPOCH)
                keep: slice | None = EPOCH
                seen_epoch = True
            else:
                keep = START if t == 0.0 else None
            Phi, Q = model.growth(now, at(trajectory, ahead), ahead - t)
            information.propagate(Phi, Q, ahead - t, keep)
    return Bound(np.array(sorted(at_s)), np.array(cores), np.array(drifts))


def _rows(
    model: ErrorModel,
    now: Instant,
    water: Array,
    kinds: frozenset[str],
    depths: int,
    *,
    first: bool,
    epoch: bool,
) -> list[Array]:
    rows = []
    if first:
        rows.append(model.levelling(now))
    if "gnss" in kinds:
        rows.append(model.gnss(now))
    if "tdcp" in kinds and epoch:
        rows.append(model.tdcp())
    if "adcp" in kinds:
        rows.append(model.adcp(now, water))
    if "compass" in kinds:
        rows.append(model.compass(now))
    if depths:
        rows.append(model.pressure(now, depths))
    return rows


class _Information:
    """Information matrix J of the errors that exist at one instant."""

    def __init__(self, model: ErrorModel, water_walk: float) -> None:
        self._J = model.prior()
        self._present = model.free.copy()
        self._present[EPOCH] = self._present[START] = False
        self._relative = False  # True: the moving position is relative to that at t = 0
        self._walk = water_walk
        self._moving = np.arange(model.size) < MOVING
        if water_walk > 0:
            self._moving[WATER:] = True

    def add(self, rows: Array) -> None:
        """Add measurements, J := J + H^T H."""
        if self._relative:
            rows[:, START] += rows[:, POSITION]  # p = d + p_0
        self._J += rows.T @ rows

    def marginalise(self, states: slice) -> None:
        """Marginalise states that are not needed any more."""
        gone = np.zeros_like(self._present)
        gone[states] = self._present[states]
        if gone.any():
            left = self._present & ~gone
            i, j = np.flatnonzero(left), np.flatnonzero(gone)
            self._J[np.ix_(i, i)] = _schur_complement(
                self._J[np.ix_(i, i)], self._J[np.ix_(j, i)], self._J[np.ix_(j, j)]
            )
            self._present = left
        self._J[states] = 0.0
        self._J[:, states] = 0.0

    def propagate(self, Phi: Array, Q: Array, dt: float, keep: slice | None) -> None:
        """Propagate to the next instant. The present position is kept in the states ``keep``; d starts at ``START``."""
        n = len(self._J)
        x = np.flatnonzero(self._present & self._moving)
        s = np.flatnonzero(self._present & ~self._moving)
        core = x[x < MOVING]
        c, q = len(core), len(x)
        step, spread = np.eye(q), np.eye(q) * self._walk**2 * dt
        step[:c, :c], spread[:c, :c] = Phi[np.ix_(core, core)], Q[np.ix_(core, core)]
        kept = np.zeros(q, dtype=bool)
        clone = np.empty(0, dtype=int)
        if keep is not None:
            kept = x < POSITION.stop
            clone = keep.start + x[kept]
            self._present[clone] = True
        if keep == START:
            self._relative = True
            step[:, kept] = 0.0  # d after the step does not depend on the position before
        inverse = np.linalg.inv(spread)
        back = inverse @ step  # Q^-1 Phi
        # Remaining states in order: the moving errors after the step, the kept position, the constant errors.
        y, old = slice(0, q), self._J[np.ix_(x, x)] + step.T @ back
        k = slice(q, q + len(clone))
        rest = slice(k.stop, k.stop + len(s))
        after = np.zeros((rest.stop, rest.stop))
        after[y, y] = inverse
        after[rest, rest] = self._J[np.ix_(s, s)]
        after[k, k] = old[np.ix_(kept, kept)]
        after[y, k] = -back[:, kept]
        after[k, y] = after[y, k].T
        after[k, rest] = self._J[np.ix_(x[kept], s)]
        after[rest, k] = after[k, rest].T
        cross = np.hstack([-back.T[~kept], old[np.ix_(~kept, kept)], self._J[np.ix_(x[~kept], s)]])
        order = np.concatenate([x, clone, s])
        self._J = np.zeros((n, n))
        self._J[np.ix_(order, order)] = _schur_complement(after, cross, old[np.ix_(~kept, ~kept)])

    def covariance(self, states: slice) -> Array:
        """Return the bound on the covariance of states; 0 for states that do not exist."""
        return self._covariance(np.eye(len(self._J))[states])

    def drift(self, start: Array) -> Array:
        """Return the bound on the drift of published positions; ``start`` is cov(p_0 | data to 0)."""
        own, then = np.eye(len(self._J))[POSITION], np.eye(len(self._J))[START]
        return self._covariance(own - then) + start - self._covariance(then)

    def _covariance(self, of: Array) -> Array:
        """Return the bound on linear combinations (w, n) of errors, with POSITION as p."""
        if self._relative:
            of = of.copy()
            of[:, START] += of[:, POSITION]
        present = np.flatnonzero(self._present)
        unit = of[:, present].T
        C: Array = unit.T @ cho_solve(cho_factor(self._J[np.ix_(present, present)], lower=True), unit)
        return 0.5 * (C + C.T)


def _schur_complement(A: Array, B: Array, C: Array) -> Array:
    """Return the Schur complement A - B^T C^-1 B."""
    L = np.linalg.cholesky(C)
    W = solve_triangular(L, B, lower=True)
    S: Array = A - W.T @ W
    return 0.5 * (S + S.T)
