"""The page of the formulation: its motion, read as symbols, and its cost and limits give the controller's QP."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
import pytest
import qpsolvers

from ltv_mpc import Vehicle, build_qp, solve_qp
from ltv_mpc.control.linearisation import roll_out
from ltv_mpc.control.scaling import default_weights
from ltv_mpc.messages import Array
from tests.docs.pages import ROOT

VEHICLE = Vehicle.load("paper")
P = VEHICLE.coefficients()
SYMBOLS = {
    r"M_x": P.mass_surge, r"M_y": P.mass_sway, r"I_z": P.inertia_yaw, r"m": P.dry_mass,
    r"d_x": P.linear_surge, r"d_y": P.linear_sway, r"d_\psi": P.linear_yaw,
    r"D_x": P.quadratic_surge, r"D_y": P.quadratic_sway, r"D_\psi": P.quadratic_yaw,
    r"a_1": P.arm_port, r"a_2": P.arm_starboard,
}  # fmt: skip
TOKEN = re.compile(
    r"\\dot [a-z]_[a-z]|\\dot ?\\?[a-z]+|[A-Za-z]_(?:\\psi|\w)|\\(?:cos|sin)\\psi|\\psi|\|[a-z]\||[a-z]|[-+()]"
)
N, H = 8, 0.3


def value(latex: str, symbols: dict[str, float]) -> float:  # noqa: ARG001 (in the evaluated text)
    """Evaluate one side of an equation of the page; factors stand beside each other."""
    text, before = "", ""
    for token in TOKEN.findall(latex.replace(r"\,", "")):
        factor = f"symbols[{token!r}]" if token not in "+-()" else token
        text += ("*" if before not in ("", "+", "-", "(") and token not in "+-)" else "") + factor
        before = token
    return float(eval(text))


def motion() -> Callable[[Array, Array, Array], Array]:
    """Return the page's [n', e', u', v', psi', r'] of a state (8,), a current and its rate of change (2,)."""
    page = (ROOT / "docs" / "formulation.md").read_text(encoding="utf-8")
    block = page.split("## The motion")[1].split(r"\begin{aligned}")[1].split(r"\end{aligned}")[0]
    sides = [side.strip() for line in block.split(r"\\") for side in re.split(r"&=|&", line)]
    equations = dict(zip(sides[::2], sides[1::2], strict=True))
    order = [next(left for left in equations if left.endswith(end)) for end in
             (r"\dot n", r"\dot e", r"\dot u", r"\dot v", r"\dot\psi", r"\dot r")]  # fmt: skip

    def rates(x: Array, c: Array, change: Array) -> Array:
        _, _, u, v, psi, r, port, starboard = x
        symbols = {
            **SYMBOLS, "u": u, "v": v, "r": r, "|u|": abs(u), "|v|": abs(v), "|r|": abs(r), "F_1": port,
            "F_2": starboard, r"\cos\psi": np.cos(psi), r"\sin\psi": np.sin(psi), "c_n": c[0], "c_e": c[1],
            r"\dot c_n": change[0], r"\dot c_e": change[1],
        }  # fmt: skip
        mass = [1.0 if left.startswith(r"\dot") else SYMBOLS[left[:3]] for left in order]
        return np.array([value(equations[left], symbols) for left in order]) / mass

    return rates


def flow(rates: Callable[..., Array], x: Array, u0: Array, u1: Array, c0: Array, c1: Array, steps: int = 6) -> Array:
    """Integrate a stage: commands and current are linear in time, thrusts follow with a first-order lag."""
    lag = np.array([P.lag_port, P.lag_starboard])

    def slope(t: float, x: Array) -> Array:
        command, c = u0 + (u1 - u0) * t / H, c0 + (c1 - c0) * t / H
        return np.concatenate([rates(x, c, (c1 - c0) / H), (command - x[6:]) / lag])

    d = H / steps
    for i in range(steps):
        t = i * d
        a = slope(t, x)
        b = slope(t + d / 2, x + d / 2 * a)
        c = slope(t + d / 2, x + d / 2 * b)
        x = x + d / 6 * (a + 2 * b + 2 * c + slope(t + d, x + d * c))
    return x


def derivative(f: Callable[[Array], Array], at: Array) -> Array:
    return np.array([(f(at + 1e-4 * e) - f(at - 1e-4 * e)) / 2e-4 for e in np.eye(len(at))]).T


@pytest.mark.parametrize("size", [0.004, 1.0])
def test_the_symbols_of_the_page_give_the_commands_of_the_qp(size: float) -> None:
    """Far from the reference the limits of thrust and slew are active."""
    k = np.arange(N + 1.0)
    U = size * np.column_stack([5.0 + 4.0 * np.sin(k), 3.0 - 0.5 * k])
    C = size * np.column_stack([0.05 * np.cos(k), 0.02 * k])
    X = roll_out(size * np.array([0.1, 0.2, 0.3, -0.1, 0.8, 0.2, 4.0, 1.0]), U, C, np.full(N, H), P)
    reference = np.column_stack([np.full(N, 8.0 * size), 0.1 * k[1:]])
    page = motion()

    # dX[k + 1] = A dX[k] + B0 dU[k] + B1 dU[k + 1], with dU[0] = 0: dX = G dU of the commands 1 .. N
    G = np.zeros((N + 1, 8, 2 * N))
    for i in range(N):
        end = flow(page, X[i], U[i], U[i + 1], C[i], C[i + 1])
        np.testing.assert_allclose(end, X[i + 1], atol=2e-4)
        A = derivative(lambda x, i=i: flow(page, x, U[i], U[i + 1], C[i], C[i + 1]), X[i])
        B0 = derivative(lambda u, i=i: flow(page, X[i], u, U[i + 1], C[i], C[i + 1]), U[i])
        B1 = derivative(lambda u, i=i: flow(page, X[i], U[i], u, C[i], C[i + 1]), U[i + 1])
        G[i + 1] = A @ G[i]
        G[i + 1][:, 2 * i : 2 * i + 2] += B1
        if i:
            G[i + 1][:, 2 * i - 2 : 2 * i] += B0

    # cost: half of the sum of squares of rows @ dU + at
    w = default_weights(VEHICLE)
    largest, slew = VEHICLE.thrusters[0].max_N, VEHICLE.thrusters[0].slew_N_per_s * H
    change = np.eye(2 * N) - np.eye(2 * N, k=-2)
    over_ground = derivative(lambda x: page(x, C[N], np.zeros(2))[:2], X[N])
    parts = [
        (w.position_per_m2, G[1:, :2].reshape(-1, 2 * N), (X[1:, :2] - reference).ravel()),
        (w.thrust / largest**2, np.eye(2 * N), U[1:].ravel()),
        (w.thrust_change / largest**2, change, np.diff(U, axis=0).ravel()),
        (w.terminal_position_per_m2, G[N, :2], X[N, :2] - reference[-1]),
        (w.terminal_velocity_s2_per_m2, over_ground @ G[N], page(X[N], C[N], np.zeros(2))[:2]),
    ]
    hessian = sum(weight * rows.T @ rows for weight, rows, _ in parts)
    gradient = sum(weight * rows.T @ at for weight, rows, at in parts)
    box, moved = U[1:].ravel(), np.diff(U, axis=0).ravel()
    low = VEHICLE.thrusters[0].min_N
    inside = np.vstack([np.eye(2 * N), -np.eye(2 * N), change, -change])
    bound = np.concatenate([largest - box, box - low, slew - moved, slew + moved])
    expected = U[1:].ravel() + qpsolvers.solve_qp(hessian, gradient, inside, bound, solver="daqp")

    solution = solve_qp(build_qp(VEHICLE, X, U, C, reference), "daqp")
    commands = U[1:] + largest * solution.x[: 12 * N].reshape(N, 12)[:, -2:]
    assert (np.abs(commands).max() > largest - 1e-3) == (size == 1.0)
    np.testing.assert_allclose(commands.ravel(), expected, atol=0.02)
