"""Half-planes of fence and corridor: their derivatives, their cost, and the same optimum of every solver."""

from __future__ import annotations

import math
from typing import NamedTuple

import msgspec
import numpy as np
import pytest

from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.control.linearisation import Linearisation
from ltv_mpc.control.ocp import assembly, fence
from ltv_mpc.control.ocp.fence import (
    CORRIDOR_PENALTY,
    CORRIDOR_ROWS,
    NO_PATH,
    PENALTY,
    Scene,
    cross_track,
    fence_cost,
    surplus_m,
)
from ltv_mpc.control.problem_data import Constants
from ltv_mpc.control.resolution import settled
from ltv_mpc.control.solvers import make
from ltv_mpc.geofence.allowed_path import NO_ZONES
from ltv_mpc.geofence.fence import Fence
from ltv_mpc.geofence.half_planes import ROWS
from ltv_mpc.geofence.zones import pack_zones
from ltv_mpc.messages import Array, SolveStatus
from tests.ltv_mpc.control.fence_scenes import SMALL, STAGES, scene
from tests.ltv_mpc.control.problems import LIMITS, PAPER, Form, answer, equidistant, motion
from tests.ltv_mpc.geofence.shapes import disc

N, M = STAGES, 3


def settings(solver: str = "osqp") -> ControllerConfig:
    return ControllerConfig(max_iterations=4000, horizon_s=N * 0.3, solver=solver)


def problem(seed: int, distance: float) -> tuple[Linearisation, Array, Array]:
    """Return a problem with a wall between its nominal end and its target, and one row that is not used."""
    lin, target = motion(seed, N)
    rows, rng = np.zeros((N, M, 4)), np.random.default_rng(seed)
    away = lin.X[N, :2] - target[N - 1]
    angle = np.arctan2(away[1], away[0])
    for j in range(2):
        m = np.array([np.cos(angle), np.sin(angle)])
        angle += rng.uniform(-0.8, 0.8)
        wall = m @ lin.X[N, :2] - distance * (j + 1)
        rows[:, j, :2] = m
        rows[:, j, 2] = wall - lin.X[1:, :2] @ m
    rows[:, 2, 2] = -np.inf
    rows[:, :, 3] = PENALTY
    return lin, target, rows


def form() -> Form:
    config = settled(settings(), PAPER)
    return Form(equidistant(N), LIMITS, config.weights)


@pytest.mark.parametrize("solver", ["osqp", "riccati"])
@pytest.mark.parametrize("overlap", [0.1, 0.5, 3.0])
def test_two_walls_that_leave_no_room_between_them_are_no_hard_problem(solver: str, overlap: float) -> None:
    """Both walls are exceeded in all stages, and their penalties cancel."""
    of = form()
    for seed in range(8):
        lin, target, rows = problem(seed, 0.05)
        rows[:, 1, :2] = -rows[:, 0, :2]
        rows[:, :2, 2] += overlap
        rows[:, 1, 2] = overlap - rows[:, 0, 2]
        made = make(PAPER, msgspec.structs.replace(settings(solver), max_iterations=70))
        commands, solve = answer(made, of, lin, target, rows=rows)
        assert solve.status is SolveStatus.SOLVED, solve.why
        np.testing.assert_allclose(commands, of.optimum(lin, target, rows), atol=0.1)


def corridor(half_width_m: float) -> Scene:
    angle = np.linspace(0.0, 1.5, 30)
    path = np.column_stack([4.0 * np.sin(angle) - 2.0, 4.0 - 4.0 * np.cos(angle) - 2.0])
    targets = np.linspace(3, 26, N).astype(np.int64)
    return scene(path=path, targets=targets, path_reach=8, half_width_m=half_width_m)


class Filled(NamedTuple):
    """Nominal positions, and the rows of a scene there."""

    X: Array
    rows: Array  # (N, R, 4) normal of dp over the scale, bound, penalty


def rows_of(o: Constants, lin: Linearisation, of: Scene, rows: int) -> Array:
    """Return the rows (N, R, 4) of a scene along a motion."""
    p = assembly.empty(len(lin.Phi), rows)
    fence.fill(o, lin.X, of, rows, p)
    scale = o.state_scale[:2]
    first = p.sizes[3] - rows
    parts = p.G[1:, first:, :2] / scale, p.low[1:, first:, None], p.penalty[1:, first:, None]
    return np.concatenate(parts, axis=2)


def filled(of: Scene, seed: int, rows: int, stages: int = N) -> tuple[Filled, Constants]:
    """Return random nominal positions with the rows of a scene, and the constants."""
    o = Constants.of(SMALL, settled(settings(), SMALL).weights, equidistant(stages))
    lin = Linearisation.empty(stages)
    rng = np.random.default_rng(seed)
    lin.X[...] = 0.0
    lin.X[:, :2] = rng.uniform((-2.5, -2.5), (4.5, 3.5), (stages + 1, 2))
    return Filled(lin.X, rows_of(o, lin, of, rows)), o


def test_a_row_is_the_derivative_of_the_clearance_of_its_zone() -> None:
    """The most violated row of a knot: its bound is the lack of the nearest zone, and its normal the slope of that."""
    of, checked = scene(), 0
    for seed in range(20):
        lin, o = filled(of, seed, ROWS)
        scale = o.state_scale[0]
        assert scale != 1.0
        for k in range(N):
            at, t_s = lin.X[k + 1, :2], 0.3 * (k + 1)

            def lack(dn: float, de: float, at: Array = at, t_s: float = t_s) -> float:
                return max(-surplus_m(of, z, at[0] + dn, at[1] + de, t_s) for z in range(4))

            if lack(0.0, 0.0) <= 0.0:
                assert lin.rows[k, 0, 2] <= 0.0
                continue
            assert lin.rows[k, 0, 2] * scale == pytest.approx(lack(0.0, 0.0), abs=1e-9)
            h = 1e-6
            slope = np.array([lack(h, 0.0) - lack(-h, 0.0), lack(0.0, h) - lack(0.0, -h)]) / (2.0 * h)
            if np.hypot(*slope) > 0.999:  # at an edge between two zones there is none
                np.testing.assert_allclose(lin.rows[k, 0, :2] * scale, -slope, atol=1e-4)
                checked += 1
    assert checked > 50


def test_the_rows_of_a_long_stage_are_those_of_its_point_of_least_clearance() -> None:
    """Between the knots the zones have the chord's sag v r h^2 / 8 in addition; obstacles are where they are then."""
    lengths = np.concatenate([np.ones(5), np.full(N - 5, 2.5)])
    knots = np.concatenate([[0.0], np.cumsum(lengths)])
    o = Constants.of(SMALL, settled(settings(), SMALL).weights, knots)
    scale, of, seen = o.state_scale[0], scene(), {"knot": 0, "between": 0}
    for seed in range(20):
        lin, rng = Linearisation.empty(N), np.random.default_rng(seed)
        lin.X[...] = 0.0
        lin.X[:, :2] = rng.uniform((-2.5, -2.5), (4.5, 3.5), (N + 1, 2))
        lin.X[:, 2], lin.X[:, 5] = 0.5, 0.4
        rows = rows_of(o, lin, of, ROWS)
        for k, g in enumerate(lengths):
            parts = np.arange(math.ceil(g), 0, -1) / math.ceil(g)
            points = lin.X[k, :2] + parts[:, None] * (lin.X[k + 1, :2] - lin.X[k, :2])
            times_s = 0.3 * (knots[k] + parts * g)
            lacks = np.array(
                [[-surplus_m(of, z, *p, t) for z in range(4)] for p, t in zip(points, times_s, strict=True)]
            )
            worst = int(np.argmax(np.maximum(lacks, 0.0).max(axis=1)))
            if lacks[worst].max() <= 0.0:
                continue
            sag_m = 0.5 * 0.4 * (0.3 * g) ** 2 / 8.0 if parts[worst] < 1.0 else 0.0
            expected = max(lacks[worst, :3].max() + sag_m, lacks[worst, 3])
            assert rows[k, 0, 2] * scale == pytest.approx(expected, abs=1e-9)
            assert rows[k, 0, 3] == PENALTY * g
            seen["between" if parts[worst] < 1.0 else "knot"] += 1
    assert min(seen.values()) > 20


def test_a_row_without_a_zone_bounds_nothing() -> None:
    nothing = {"need": np.array([0.5]), "exits": np.zeros((1, 4)), "discs": np.empty((0, 7))}
    lin, _ = filled(
        scene(zones=pack_zones(Fence(margin_m=0.2, keep_out_disc=(disc(0.0, 0.0, 3.0),))), **nothing), 0, ROWS
    )
    assert (lin.rows[:, 0, :2] != 0.0).any(axis=1).all()
    np.testing.assert_array_equal(lin.rows[:, 1:, :2], 0.0)
    np.testing.assert_array_equal(lin.rows[:, 1:, 2], -np.inf)


def test_every_obstacle_has_a_row_where_there_is_no_fence() -> None:
    discs = np.array([[0.0, 0.0, 0.0, 0.0, 2.0, 0.0, 0.0], [1.0, 1.0, 0.0, 0.0, 2.0, 0.0, 0.0]])
    lin, _ = filled(scene(zones=NO_ZONES, need=np.empty(0), exits=np.empty((0, 4)), discs=discs), 0, ROWS)
    np.testing.assert_array_equal((lin.rows[:, :, :2] != 0.0).any(axis=2).sum(axis=1), 2)


def test_both_rows_of_the_corridor_are_derivatives_of_the_cross_track_distance() -> None:
    of, checked = corridor(0.2), 0
    for seed in range(5):
        lin, o = filled(of, seed, ROWS + CORRIDOR_ROWS)
        scale = o.state_scale[0]
        for k in range(N):
            at = lin.X[k + 1, :2]
            x = cross_track(of, k + 1, *at)[0]
            h = 1e-6
            ahead = [cross_track(of, k + 1, at[0] + dn, at[1] + de)[0] for dn, de in ((h, 0.0), (0.0, h))]
            slope = (np.array(ahead) - x) / h
            if abs(np.hypot(*slope) - 1.0) > 1e-3:  # between two pieces
                continue
            rows = lin.rows[k, ROWS:]
            np.testing.assert_allclose(rows[:, :2] * scale, [-slope, slope], atol=1e-4)
            np.testing.assert_allclose(rows[:, 2] * scale, [x - 0.2, -x - 0.2], atol=1e-9)
            np.testing.assert_allclose(rows[:, 3], CORRIDOR_PENALTY)
            checked += 1
    assert checked > 50


def test_the_cross_track_distance_is_that_from_the_nearest_piece() -> None:
    north = np.column_stack([np.arange(5.0), np.zeros(5)])
    of = scene(path=north, targets=np.full(N, 2), path_reach=5, half_width_m=0.2)
    assert cross_track(of, 1, 1.5, 0.7) == (0.7, -0.0, 1.0)
    assert cross_track(of, 1, 7.0, -0.3)[0] == -0.3  # beyond the end it is that from the line
    bend = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]])
    near = of._replace(path=bend, targets=np.full(N, 0), path_reach=0)
    assert cross_track(near, 1, 1.0, 1.8)[0] == pytest.approx(1.8)  # the other leg is out of reach
    assert cross_track(near._replace(path_reach=2), 1, 1.0, 1.8)[0] == pytest.approx(0.2)


@pytest.mark.parametrize(("target", "starboard_m"), [(3, 0.9), (15, 0.1)])
def test_the_cross_track_distance_is_from_the_leg_of_the_target(target: int, starboard_m: float) -> None:
    """A path that leads away and comes back 1 m to starboard: the other leg is nearer to the point."""
    ahead, turn = np.arange(10.0), np.array([[0.8, 0.6], [-0.6, 0.8]])  # ahead and starboard to north and east
    path = np.vstack([np.column_stack([ahead, np.zeros(10)]), np.column_stack([ahead[::-1], np.ones(10)])]) @ turn
    of = scene(path=path, targets=np.full(N, target), path_reach=3, half_width_m=0.2)
    distance, *normal = cross_track(of, 1, *(np.array([4.5, starboard_m]) @ turn))
    assert distance == pytest.approx(0.9)
    assert normal == pytest.approx(turn[1] if target == 3 else -turn[1])


def test_the_cost_of_the_corridor_is_its_excess() -> None:
    of = corridor(0.2)
    lin, o = filled(of, 1, ROWS + CORRIDOR_ROWS)
    across = np.array([abs(cross_track(of, k, *lin.X[k, :2])[0]) for k in range(1, N + 1)])
    extra = fence_cost(lin.X, of, o.t, o.state_scale[0]) - fence_cost(
        lin.X, of._replace(path=NO_PATH), o.t, o.state_scale[0]
    )
    assert extra == pytest.approx(CORRIDOR_PENALTY * np.maximum(across - 0.2, 0.0).sum() / o.state_scale[0])


def test_without_a_path_the_rows_of_the_corridor_bound_nothing() -> None:
    lin, _ = filled(scene(), 0, ROWS + CORRIDOR_ROWS)
    np.testing.assert_array_equal(lin.rows[:, ROWS:, :2], 0.0)
    np.testing.assert_array_equal(lin.rows[:, ROWS:, 2], -np.inf)
