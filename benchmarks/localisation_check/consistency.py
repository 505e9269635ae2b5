"""Consistency of estimates with their covariance: normalised squared errors against chi-square, over many runs.

NEES    e^T P^-1 e of true minus estimated, absolute errors;  NIS  r^T S^-1 r of an innovation before any gate
Band    If the filter is consistent, the sum over the runs at an instant is chi-square with the sum of their degrees of
        freedom. It lies between the quantiles 2.5 % and 97.5 % at 95 % of the instants in the long run. Errors that
        hardly change, such as constant biases, are one draw per run: all instants are inside or all outside.
Observed  Only currents that a beam has measured count: the two grid points around each of its cells.
Water   The true current c(z) has any shape; the filter's profile is linear between grid points. Its true state is
            c* = argmin of the integral of |sum_k c_k hat_k(z) - c(z)|^2 over the grid,   hat_k: 1 at k, 0 at others
            M c* = f,  M_kl = integral of hat_k hat_l,  f_k = integral of hat_k c
        c* equals c at the grid points only if c is linear between them. Beams measure all depths of a cell while the
        vehicle passes, so the mean of many pings tends to c*, not to c at the grid points. The rest c - c* is finer
        than a cell and not a state. Between the bends of c and the grid points every integrand is quadratic: Simpson's
        rule is exact.
Source  Bar-Shalom, Li & Kirubarajan 2001, Estimation with applications to tracking and navigation, section 5.4; L2
        projection on linear splines: e.g. de Boor 2001, A practical guide to splines, chapter III.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.interpolate import make_lsq_spline
from scipy.linalg import solve_triangular
from scipy.stats import chi2

from ltv_mpc.frames import rotation_log
from ltv_mpc.localisation.filter.state import ACCELEROMETER_BIAS, ATTITUDE, GYRO_BIAS, POSITION, VELOCITY, Belief
from ltv_mpc.messages import Array

Mask = npt.NDArray[np.bool_]


class TrueState(NamedTuple):
    """True values of the filter's states. Biases that the sensor configuration lacks are not read."""

    position_m: Array  # (3,)
    velocity_mps: Array  # (3,)
    rotation: Array  # (3, 3)
    gyro_bias_radps: Array  # (3,)
    accelerometer_bias_mps2: Array  # (3,)
    beam_bias_mps: Array  # (4,)
    near_bias_mps: Array  # (4,)
    mounting: Array  # (3, 3)
    compass_bias_rad: float
    water_mps: Array  # (G, 2) projection onto the filter's grid (``GridProjection``)


class Consistency(NamedTuple):
    """Consistency of one quantity over R runs at T instants."""

    total: Array  # (T,) sum of normalised squares over the runs
    dof: npt.NDArray[np.int64]  # (T,) their degrees of freedom
    low: Array  # (T,) lower limit of the band
    high: Array  # (T,) upper limit

    @property
    def in_band(self) -> float:
        """Share of the instants inside the band."""
        return float(np.mean((self.low <= self.total) & (self.total <= self.high)))

    @property
    def per_dof(self) -> float:
        """Mean square per degree of freedom: 1 if consistent, more if overconfident."""
        return float(self.total.sum() / self.dof.sum())


def squared(error: Array, covariance: Array) -> float:
    """Return e^T P^-1 e. Raises ``LinAlgError`` if P is not positive definite."""
    # P = D C D with correlations C: water (m/s) and gyro biases (rad/s) differ by 1e4 in size
    variance = np.diagonal(covariance)
    d = np.sqrt(np.where(variance > 0, variance, 1.0))
    y = solve_triangular(np.linalg.cholesky(covariance / np.outer(d, d)), error / d, lower=True)
    return float(y @ y)


def band(dof: npt.ArrayLike, probability: float = 0.95) -> tuple[Array, Array]:
    """Return the chi-square quantiles that enclose ``probability``, with equal tails."""
    low, high = chi2.interval(probability, dof)
    return low, high


def consistency(squares: npt.ArrayLike, dof: npt.ArrayLike) -> Consistency:
    """Combine normalised squares (R, T) with degrees of freedom (R, T), 0 if a run has no value at an instant.

    Instants without any value are left out. Raises ``ValueError`` if none remains.
    """
    total, degrees = np.sum(squares, axis=0), np.sum(dof, axis=0)
    some = degrees > 0
    if not some.any():
        raise ValueError("no sample has a degree of freedom")
    low, high = band(degrees[some])
    return Consistency(total[some], degrees[some], low, high)


def errors(truth: TrueState, belief: Belief) -> Array:
    """Return the errors, true minus estimated, in the filter's order and conventions, (n,).

    States that ``TrueState`` does not contain have error 0.
    """
    layout, x = belief.layout, belief.x
    e = np.zeros(layout.size)
    water = truth.water_mps
    e[POSITION] = truth.position_m - x[POSITION]
    e[VELOCITY] = truth.velocity_mps - x[VELOCITY]
    e[ATTITUDE] = rotation_log(np.ascontiguousarray(truth.rotation @ belief.R.T))  # R_true = exp(phi^) R
    e[GYRO_BIAS] = truth.gyro_bias_radps - x[GYRO_BIAS]
    e[ACCELEROMETER_BIAS] = truth.accelerometer_bias_mps2 - x[ACCELEROMETER_BIAS]
    for states, value in (
        (layout.beam_bias, truth.beam_bias_mps),
        (layout.near_bias, truth.near_bias_mps),
        (layout.compass_bias, np.array([truth.compass_bias_rad])),
        (layout.north, water[:, 0]),
        (layout.east, water[:, 1]),
    ):
        if states.stop > states.start:
            e[states] = value - x[states]
    if layout.mounting.stop > layout.mounting.start:
        e[layout.mounting] = rotation_log(np.ascontiguousarray(truth.mounting @ belief.mounting.T))
    return e


def quantities(belief: Belief, seen: Mask) -> dict[str, npt.NDArray[np.int64]]:
    """Return the state indices of each quantity that exists; of the current only ``seen`` (G,) grid points."""
    layout = belief.layout

    def of(*slices: slice) -> npt.NDArray[np.int64]:
        return np.concatenate([np.arange(a.start, a.stop) for a in slices])

    cells = np.flatnonzero(seen)
    states = {
        "position": of(POSITION),
        "velocity": of(VELOCITY),
        "heading": of(ATTITUDE)[2:],
        "tilt": of(ATTITUDE)[:2],
        "gyro_bias": of(GYRO_BIAS),
        "accelerometer_bias": of(ACCELEROMETER_BIAS),
        "adcp_bias": of(layout.beam_bias, layout.near_bias),
        "compass_bias": of(layout.compass_bias),
        "mounting": of(layout.mounting),
        "cells": np.concatenate([layout.north.start + cells, layout.east.start + cells]),
    }
    return {name: i for name, i in states.items() if len(i)}


def nees(belief: Belief, truth: TrueState, seen: Mask) -> dict[str, tuple[float, int]]:
    """Return normalised square and degrees of freedom of each quantity. States of variance 0 are left out."""
    e, P = errors(truth, belief), belief.P
    result = {}
    for name, states in quantities(belief, seen).items():
        i = states[np.diagonal(P)[states] > 0]
        if len(i):
            result[name] = squared(e[i], P[np.ix_(i, i)]), len(i)
    return result


def nodes_around(depths_m: Array, cell_m: float, nodes: int) -> Mask:
    """Return a mask (nodes,) of the grid points 0, h, 2h, ... next to the depths ``depths_m``."""
    k = np.floor(np.ravel(depths_m) / cell_m).astype(int)
    k = k[(k >= 0) & (k <= nodes - 2)]
    seen = np.zeros(nodes, dtype=bool)
    seen[k] = seen[k + 1] = True
    return seen


class GridProjection:
    """Projection of the current in one water column onto one depth grid.

    Parameters
    ----------
    node_m : (G,) depths of the grid points, increasing (m).
    bend_m : depths between which the current is linear, increasing (m).
    """

    def __init__(self, node_m: Array, bend_m: Array) -> None:
        ends = np.union1d(node_m, bend_m[(bend_m > node_m[0]) & (bend_m < node_m[-1])])
        h = np.diff(ends)
        self.depth_m = np.interp(np.arange(2 * len(h) + 1), 2 * np.arange(len(ends)), ends)
        """(D,) sampling depths: the ends of the pieces and their middles."""
        share = np.empty(len(self.depth_m))
        share[1::2], share[::2] = 4.0 * h, np.append(h, 0.0) + np.append(0.0, h)
        self._root, self._knots = np.sqrt(share), node_m[[0, *range(len(node_m)), -1]]

    def fit(self, water_mps: Array) -> Array:
        """Return c*, (G, 2), for the current at ``depth_m``, (D, 2) (m/s)."""
        fitted: Array = make_lsq_spline(self.depth_m, water_mps, self._knots, k=1, w=self._root).c
        return fitted
