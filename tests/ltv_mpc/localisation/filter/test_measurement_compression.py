"""Measurement compression: many rows of few states against fewer equivalent rows."""

import numpy as np
import pytest

from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.filter import correction
from ltv_mpc.localisation.filter.correction import correct, update_covariance
from ltv_mpc.localisation.filter.measurement_compression import (
    _root,
    compress,
    project,
    sparse_rows,
    touched_innovation_covariance,
    touched_states,
)
from ltv_mpc.localisation.filter.state import Belief, Layout
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.sensors import adcp
from ltv_mpc.localisation.sensors.rows import Rows
from ltv_mpc.localisation.sensors.sensor import Context
from ltv_mpc.localisation.water.current_model import write_prior
from ltv_mpc.messages import AdcpPing

N = 80
SUITE, CONFIG = SensorConfig.load("paper"), EstimatorConfig()


@pytest.fixture
def P():
    root = np.random.default_rng(0).standard_normal((N, N)) / 5
    P = root @ root.T
    return 0.5 * (P + P.T)


def differences(m, seed=1):
    """Rows each of which is told two common states less their sum, and the difference of two neighbours of thirty: so
    they tell neither the first two apart nor what all thirty have in common.
    """
    rng = np.random.default_rng(seed)
    k = np.sort(rng.integers(0, 29, m))
    state = np.stack([np.full(m, 3), np.full(m, 40), 45 + k, 46 + k, np.zeros(m, dtype=int)], axis=1)
    c, d = rng.uniform(0.5, 2.0, (2, m))
    partial = np.stack([c, c, d, -d, np.zeros(m)], axis=1)  # the last is padding
    return Rows(state, partial, 0.3 * rng.standard_normal(m), rng.uniform(0.1, 1.0, m))


def ping(belief, seed=2):
    """Return a ping of a level vehicle at 10 m, linearised about the belief."""
    rng = np.random.default_rng(seed)
    z = 0.05 * rng.standard_normal((4, 30))
    message = AdcpPing(t_ns=0, range_m=1.0 + np.arange(30.0), beam_velocity_mps=z)
    return adcp.linearise(belief, message, SUITE.adcp, Context(SUITE, CONFIG.cell_m, (0.0, 0.0, 0.0))).rows


@pytest.fixture
def belief():
    """Return the belief of a vehicle with a small tilt, with typical uncertainty during a descent."""
    belief = Belief.blank(Layout.of(SUITE, CONFIG), 0)
    belief.x[2] = 10.3
    write_prior(belief, CONFIG)
    belief.P[np.arange(15), np.arange(15)] = np.repeat([0.1, 1e-3, 1e-5, 1e-10, 1e-8], 3)
    return belief


def test_touched_states_are_listed_once_with_common_ones_last():
    rows = differences(120)
    places, local = touched_states(rows.state, rows.partial, N)
    assert sorted(places) == sorted(set(rows.state[rows.partial != 0.0]))
    assert list(places[-2:]) == [3, 40]
    np.testing.assert_array_equal(places[local[:, :4]], rows.state[:, :4])
    assert (local[:, 4] == -1).all()


def test_innovations_and_projection_are_the_textbooks(P):
    rows = differences(60)
    places, local = touched_states(rows.state, rows.partial, N)
    H = rows.dense(N)
    S = touched_innovation_covariance(P, places, local, rows.partial, rows.variance)
    np.testing.assert_allclose(S, H @ P @ H.T + np.diag(rows.variance), rtol=1e-12, atol=1e-13)
    np.testing.assert_array_equal(S, S.T)
    np.testing.assert_allclose(project(sparse_rows(rows.state, rows.partial), P), H @ P, rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("m", [60, 61, 200])
def test_compressed_rows_have_the_same_information_even_if_singular(P, m):
    """H'^T H' = H^T R^-1 H and H'^T z' = H^T R^-1 z, without the rows of weight zero."""
    rows = differences(m)
    places, local = touched_states(rows.state, rows.partial, N)
    weight = 1.0 / rows.variance
    weight[::7] = 0.0
    CT, told = _root(local, rows.partial, weight, rows.residual, len(places))
    H = rows.dense(N)[:, places]
    J = H.T @ (weight[:, None] * H)
    assert np.linalg.matrix_rank(J) < len(places)
    np.testing.assert_allclose(CT.T @ CT, J, atol=1e-10 * J.max())
    np.testing.assert_allclose(CT.T @ told, H.T @ (weight * rows.residual), atol=1e-9)
    _, HP, S, z = compress(P, places, local, rows.partial, weight, rows.residual)
    full = np.zeros((len(places), N))
    full[:, places] = CT
    np.testing.assert_allclose(HP, full @ P, atol=1e-9)
    np.testing.assert_allclose(S, full @ P @ full.T + np.eye(len(places)), rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(S, S.T)
    np.testing.assert_array_equal(z, told)


def test_an_update_by_compressed_rows_is_the_textbooks(P):
    rows, before = differences(120), P.copy()
    H, R = rows.dense(N), np.diag(rows.variance)
    K = np.linalg.solve(H @ P @ H.T + R, H @ P).T
    correction = update_covariance(P, rows, 1e9)
    np.testing.assert_allclose(correction.error, K @ rows.residual, atol=1e-10)
    np.testing.assert_allclose(P, before - K @ H @ before, atol=1e-10)


def test_a_row_beyond_the_gate_is_in_no_compressed_row(P):
    rows, without = differences(120), P.copy()
    rows.residual[[7, 50]] = 1e3
    keep = ~np.isin(np.arange(120), [7, 50])
    one = update_covariance(P, rows, 10.8)
    np.testing.assert_array_equal(one.accepted, keep)
    other = update_covariance(without, Rows(*(column[keep] for column in rows)), 1e9)
    np.testing.assert_allclose(one.error, other.error, atol=1e-12)
    np.testing.assert_allclose(P, without, atol=1e-12)


@pytest.mark.parametrize("turn", [0.0, 0.7])
def test_a_ping_gives_the_same_update_compressed_or_not(belief, monkeypatch, turn):
    belief.R[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
    rows, by_all = ping(belief), belief.copy()
    fewer = []
    monkeypatch.setattr(correction, "compress", lambda *a: fewer.append(1) or compress(*a))
    correct(belief, rows, 10.8)
    assert fewer
    monkeypatch.setattr(correction, "_COMPRESSION_RATIO", 0.0)
    correct(by_all, rows, 10.8)
    assert len(fewer) == 1
    sd = np.sqrt(np.maximum(np.diag(by_all.P), 1e-12))  # the satellites' epoch is certain
    np.testing.assert_allclose(belief.x / sd, by_all.x / sd, atol=1e-9)
    np.testing.assert_allclose(belief.P / np.outer(sd, sd), by_all.P / np.outer(sd, sd), atol=1e-9)


def test_a_ping_leaves_few_entries_in_the_root(belief):
    """A grid point is coupled only to its neighbours and to the common states, so cost does not grow with cells."""
    rows = ping(belief)
    places, local = touched_states(rows.state, rows.partial, len(belief.P))
    CT, _ = _root(local, rows.partial, 1.0 / rows.variance, rows.residual, len(places))
    assert np.count_nonzero(CT, axis=1).max() <= 14
    assert len(places) <= 70
