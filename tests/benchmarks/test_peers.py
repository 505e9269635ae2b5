"""Each peer solves what the controller solves; those that are not installed are left out."""

from __future__ import annotations

import math
from importlib import import_module
from typing import Any

import numpy as np
import pytest

from benchmarks import along
from benchmarks.peers import known, table
from benchmarks.peers.loop import Entry, Held, closed
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
from services.tools.profile import machine_description, problems
from services.tools.profile.measure import SolverByName
from services.tools.profile.run import Spread

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


def test_ipopts_duals_move_with_the_plan() -> None:
    """Each row's dual goes to the row of the same kind a stage earlier: less to do for the next problem."""
    peer: Any = peer_of("with_casadi")(CONFIG, LIMITS, VEHICLE)
    solved(peer, *trajectory(0, gap=0.0))
    before = {name: dual.copy() for name, dual in peer._duals.items()}
    peer.shift_warm_start(1.1)
    for name, first, width in (("lam_x0", 0, 10), ("lam_g0", 0, 8), ("lam_g0", 8 * N, 2)):
        was, now = (duals[name][first : first + width * N].reshape(N, width) for duals in (before, peer._duals))
        np.testing.assert_array_equal(now[:-1], was[1:])
        np.testing.assert_array_equal(now[-1], was[-1])
    assert np.abs(before["lam_g0"]).max() > 0
    peer.reset_warm_start()
    assert not peer._duals


def test_a_solution_that_is_not_finite_is_none() -> None:
    class Broken(Peer):
        name, solves, packages, settings = "broken", "QP", (), ""

        def solve(self) -> Any:
            return self.answer(np.full((N, 2), np.nan))

    answer = solved(Broken(CONFIG, LIMITS, VEHICLE), *trajectory(0, gap=0.0))
    assert answer.solve.status is SolveStatus.FAILED
    assert not answer.z.any()


def test_a_peer_that_never_answers_holds_no_line() -> None:
    """The closed loop is the candidate's own."""

    class Silent(Peer):
        name, solves, packages, settings = "silent", "QP", (), ""

        def solve(self) -> Any:
            return self.answer(None, why="nothing to say")

    class Idle(Peer):
        name, solves, packages, settings = "idle", "QP", (), ""

        def solve(self) -> Any:
            starts.add(tuple(self.lin.X[0]))
            return self.answer(self.lin.U[1:])

    starts: set[tuple[float, ...]] = set()
    episode = problems.simulated(N, 40, seed=0)[2]
    assert episode.kind == "hard"
    silent, own = closed(Entry(Silent), episode), closed(SolverByName("osqp"), episode._replace(cycles=40))
    assert silent.unsolved == episode.cycles + 1
    assert closed(Entry(Idle), episode).unsolved == 0
    assert len(starts) > episode.cycles  # each problem has the start of its own cycle
    assert own.unsolved == 0
    assert silent.thrust_N < 0.1 < own.thrust_N
    assert own.off_m < silent.off_m


def test_what_is_missing_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        known, "find_spec", lambda package: None if package in ("qpmpc", "casadi", "cvxpy") else "there"
    )
    there, missing = known.installed()
    assert [peer.__name__ for peer in there] == ["ScipyLeastSquares"]
    assert missing == ["with_qpmpc", "with_cvxpy", "with_casadi", "with_do_mpc"]


def test_the_table_has_time_beside_error() -> None:
    def line(name: str, solves: str, median_us: float, off_m: float) -> table.Line:
        return table.Line(
            name=name,
            solves=solves,
            settings=f"settings of {name}",
            cycle_us=Spread(median=median_us, p90=0.0, p99=2 * median_us, max=0.0),
            repeated_us=Spread(median=math.sqrt(median_us), p90=0.0, p99=0.0, max=0.0),
            flushed_us=Spread(median=median_us + 1000.0, p90=0.0, p99=0.0, max=0.0),
            thrust_error_N=Spread(median=0.0, p90=0.0, p99=0.0123, max=0.0),
            held={"descent": Held(off_m, 11.0, 1), "hard": Held(2 * off_m, 22.0, 2)},
        )

    here = machine_description.machine(machine_description.load(), ("numpy", "casadi"))
    text = table.markdown(
        [line("ours", "QP", 80.0, 0.05), line("theirs", "NLP", 4000.0, 0.06)],
        title="T",
        notes=["N"],
        machine=here,
        packages=("numpy", "casadi"),
    )
    assert "| ours | QP | 0.08 | 0.16 | 1, 1, 1 | 0.012 | 0.050 | 0.100 | 11.0 / 22.0 | 3 |" in text
    assert "| theirs | NLP | 4 | 8 | 7.07, 50, 4.63 |  | 0.060 | 0.120 | 11.0 / 22.0 | 3 |" in text
    assert "| theirs | settings of theirs |" in text
    assert f"numpy {np.__version__}, casadi " in text
