"""Each peer solves what the controller solves; those that are not installed are left out."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import numpy as np
import pytest

from benchmarks import along
from benchmarks.peers import known
from benchmarks.peers.peer import Peer
from ltv_mpc.control.config import STAGE_NS, ControllerConfig
from ltv_mpc.control.horizon_limits import HorizonLimits
from ltv_mpc.control.linearisation import Linearisation, linearise, roll_out
from ltv_mpc.control.ocp.assembly import problem_along
from ltv_mpc.control.problem_data import CHANGES, COMMANDS
from ltv_mpc.control.resolution import settled
from ltv_mpc.control.solvers import solve_qp
from ltv_mpc.control.solvers.interface import Result
from ltv_mpc.control.solvers.sparse import solution_of, sparse_qp
from ltv_mpc.messages import Array, SolveStatus
from ltv_mpc.vehicle.dynamics import rates
from ltv_mpc.vehicle.flow import substeps
from ltv_mpc.vehicle.parameters import Vehicle

H = STAGE_NS * 1e-9
N = 8
VEHICLE = Vehicle.load("paper")
CONFIG = settled(ControllerConfig(horizon_s=N * H), VEHICLE)
LIMITS = HorizonLimits.from_vehicle(VEHICLE, H)
NO_SLEW = HorizonLimits(LIMITS.low, LIMITS.high, np.full(2, 1e3), LIMITS.state_scale)
P = VEHICLE.coefficients()

# What the peers' own packages warn of is theirs.
pytestmark = pytest.mark.filterwarnings("ignore")


def peer_of(file: str) -> type[Peer]:
    """Or a skipped test."""
    name, needs = known.FILES[file]
    for package in needs:
        pytest.importorskip(package)
    peer: type[Peer] = getattr(import_module(f"benchmarks.peers.{file}"), name)
    return peer


def trajectory(seed: int, gap: float) -> tuple[Linearisation, Array]:
    """Along commands drawn at random, inside box and slew, in a current that turns; ``gap``: off the exact flow."""
    draw = np.random.default_rng(seed)
    C = 0.03 * np.stack([np.cos(np.linspace(0, 1, N + 1)), np.sin(np.linspace(0, 1, N + 1))], axis=1)
    U = LIMITS.clip(np.cumsum(draw.normal(0.0, 3.0, (N + 1, 2)), axis=0), CONFIG.knots)
    ahead = 1.0 if seed % 2 else -1.0  # to be stopped, or to be backed: both limits of each kind are met
    X = roll_out(np.array([0.15 * ahead, 0.1, 0.2 * ahead, 0.01, 0.2, 0.02, *U[0]]), U, C, np.full(N, H), P)
    X[1:] += gap * draw.normal(size=(N, 8))
    return linearise(X, U, C, H, P), np.array([[0.02, -0.01]] * N + [[0.0, 0.0]])


def under(commands: Array, lin: Linearisation) -> Linearisation:
    """Return the exact flow under other commands."""
    return linearise(roll_out(lin.X[0], commands, lin.C, np.full(N, H), P), commands, lin.C, H, P)


def optimum(lin: Linearisation, target: Array, limits: HorizonLimits = LIMITS) -> Array:
    """Return the commands (N+1, 2) of the QP."""
    problem = problem_along(lin, target, CONFIG.knots, limits, CONFIG.weights)
    return commands_of(solution_of(problem, solve_qp(sparse_qp(problem), "daqp").x), lin)


def commands_of(z: Array, lin: Linearisation) -> Array:
    """Return the commands (N+1, 2) of a solution."""
    return lin.U + z[:, COMMANDS:CHANGES] * LIMITS.thrust_scale


def solved(peer: Peer, lin: Linearisation, target: Array, limits: HorizonLimits = LIMITS) -> Result:
    """Return a peer's solution of the problem along a motion."""
    along.is_at(lin, target)
    peer.build(problem_along(lin, target, CONFIG.knots, limits, CONFIG.weights))
    peer.update()
    return peer.solve()


@pytest.mark.parametrize("file", ["with_qpmpc", "with_cvxpy"])
def test_peers_that_solve_the_qp_find_its_optimum(file: str) -> None:
    peer = peer_of(file)(CONFIG, LIMITS, VEHICLE)
    for seed in range(4):  # the second and later ones go through what the first has set up
        lin, target = trajectory(seed, gap=0.01)
        answer = solved(peer, lin, target)
        assert answer.solve.status is SolveStatus.SOLVED
        np.testing.assert_allclose(commands_of(answer.z, lin), optimum(lin, target), atol=0.02)


@pytest.mark.parametrize(
    ("file", "limits", "within_N"),
    [
        ("with_casadi", LIMITS, 0.1),
        ("with_do_mpc", LIMITS, 0.1),  # its collocation is a coarser flow
        ("with_scipy", NO_SLEW, 0.1),  # has no slew limit
    ],
)
def test_nonlinear_peers_find_what_repeated_linearisation_converges_to(
    file: str, limits: HorizonLimits, within_N: float
) -> None:
    peer = peer_of(file)(CONFIG, limits, VEHICLE)
    for seed in range(2):
        lin, target = trajectory(seed, gap=0.0)
        for _ in range(40):
            commands = optimum(lin, target, limits)
            lin = under(commands, lin)
        assert np.abs(optimum(lin, target, limits) - lin.U).max() < 1e-3  # converged
        guess = lin.U.copy()
        guess[2:] *= 0.98
        near = under(guess, lin)
        answer = solved(peer, near, target, limits)
        assert answer.solve.status is SolveStatus.SOLVED
        np.testing.assert_allclose(commands_of(answer.z, near), lin.U, atol=within_N)


def test_the_symbolic_motion_is_the_controllers() -> None:
    ca: Any = pytest.importorskip("casadi")
    symbolic = import_module("benchmarks.peers.symbolic")
    draw = np.random.default_rng(0)
    for _ in range(20):
        X, F, c, cr = draw.normal(size=8), draw.normal(0, 30, 2), draw.normal(size=2), draw.normal(size=2)
        expected = rates(*X[2:6], *F, *c, *cr, P)
        np.testing.assert_allclose(symbolic.rates(ca.DM(X[:6]), F, c, cr, P).full().ravel(), expected, rtol=1e-12)
    u, C = draw.normal(0, 20, (2, 2)), draw.normal(0, 0.1, (2, 2))
    X = np.array([0.1, 0.2, 0.3, 0.02, 1.0, 0.1, 3.0, -4.0])
    expected = roll_out(X, u, C, np.array([H]), P)[1]
    np.testing.assert_allclose(symbolic.stage(H, substeps(H), P)(X, *u, *C).full().ravel(), expected, atol=1e-12)
    np.testing.assert_allclose(symbolic.stage(H, 1, P)(X, *u, *C).full().ravel(), expected, atol=2e-4)
