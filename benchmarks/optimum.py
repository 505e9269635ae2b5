"""One QP and a line search against the converged optimum of the nonlinear problem: CasADi and IPOPT.

    PYTHON -m benchmarks.optimum [--seeds N] [--every N] [--set KEY=VALUE ...] [--out FILE.json]

PYTHON has casadi beside what the project needs; the project itself never imports it. On each N-th (20th) cycle of the
paper's descent, seeds 0 to N-1 (20), state known, IPOPT minimises the controller's own cost over the horizon, under box
and slew and the same Runge-Kutta steps. It is started twice: from what the cycle was linearised along, and from what
the cycle came to. Where both starts end at one cost (to 1e-4 of it) and the same commands (to 1 N), the cycle is in the
basin of the optimum that its own start leads to; where they do not, the two are different local optima. Costs are those
of the exact flow under the commands, ours and IPOPT's alike.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from rich.console import Console
from rich.progress import Progress

from benchmarks.loop import Loop, run_config
from ltv_mpc.control.config import STAGE_NS, ResolvedConfig
from ltv_mpc.control.controller import Controller
from ltv_mpc.control.cost import cost
from ltv_mpc.control.horizon_limits import HorizonLimits
from ltv_mpc.control.linearisation import roll_out
from ltv_mpc.control.problem_data import pack_objective, unpack_objective
from ltv_mpc.messages import Array
from ltv_mpc.vehicle.flow import STATES, lag_weights, substeps
from ltv_mpc.vehicle.parameters import Coefficients, Vehicle

STAGE_S = STAGE_NS * 1e-9
SAME_COST, SAME_N = 1e-4, 1.0
"""Two starts ended at the same optimum."""


class Watched(Controller):
    """A controller that keeps, of each cycle that solves, what it started from and what it came to."""

    def __init__(self, *parts: Any) -> None:
        super().__init__(*parts)
        self.cycles: list[dict[str, Array]] = []

    def _solve(self, *parts: Any) -> Any:
        result, lin = super()._solve(*parts), self._lin
        copied = {"X": lin.X.copy(), "U": lin.U.copy(), "C": lin.C.copy(), "target": self._target.copy()}
        self.cycles.append({**copied, "ours": result.U})
        return result


class Optimum:
    """Nonlinear problem of N stages, by multiple shooting and IPOPT."""

    def __init__(self, vehicle: Vehicle, config: ResolvedConfig) -> None:
        self._p, self._weights = vehicle.coefficients(), config.weights
        self._limits = HorizonLimits.from_vehicle(vehicle, STAGE_S)
        self._packed = pack_objective(config.knots, self._limits, self._weights)
        self._N = N = config.stages
        self._knots, self._g = config.knots, np.diff(config.knots)
        self._h = self._g * STAGE_S
        X, U = ca.SX.sym("X", STATES, N), ca.SX.sym("U", 2, N)
        X0, U0 = ca.SX.sym("X0", STATES), ca.SX.sym("U0", 2)
        C, target = ca.SX.sym("C", 2, N + 1), ca.SX.sym("target", 2, N + 1)
        stage = {h: _stage(self._p, h) for h in sorted(set(self._h.tolist()))}
        xs, us = [X0, *ca.horzsplit(X)], [U0, *ca.horzsplit(U)]
        gaps = [stage[self._h[k]](xs[k], us[k], us[k + 1], C[:, k], C[:, k + 1]) - xs[k + 1] for k in range(N)]
        steps = [us[k + 1] - us[k] for k in range(N)]
        w, scale = self._weights, ca.DM(self._limits.thrust_scale)
        objective = 0
        for k in range(N):
            g = self._g[k]
            position = w.position_per_m2 * g + (w.terminal_position_per_m2 if k == N - 1 else 0.0)
            objective += position * ca.sumsqr(xs[k + 1][:2] - target[:, k])
            objective += w.thrust * g * ca.sumsqr(us[k + 1] / scale)
            objective += w.thrust_change / g * ca.sumsqr(steps[k] / scale)
        dn, de, *_ = _rates(xs[N][2], xs[N][3], xs[N][4], xs[N][5], 0, 0, C[0, N], C[1, N], 0, 0, self._p)
        off = ca.vertcat(dn, de) - target[:, N]
        objective += w.terminal_velocity_s2_per_m2 * ca.sumsqr(off)
        problem = {
            "x": ca.veccat(X, U),
            "p": ca.veccat(X0, U0, C, target),
            "f": objective,
            "g": ca.veccat(*gaps, *steps),
        }
        options = {"print_time": False, "ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-9, "max_iter": 500}}
        self._solve = ca.nlpsol("optimum", "ipopt", problem, options)

    def cost(self, X0: Array, U: Array, C: Array, target: Array) -> float:
        """Return the cost of commands U (N+1, 2) along the exact flow."""
        return cost(self.roll(X0, U, C), U, C, target, unpack_objective(self._packed))

    def roll(self, X0: Array, U: Array, C: Array) -> Array:
        """Compute the exact flow (N+1, 8) under commands U (N+1, 2)."""
        return roll_out(X0, U, C, self._h, self._p)

    def solve(self, X: Array, U: Array, C: Array, target: Array) -> tuple[Array, bool]:
        """Return commands (N+1, 2) from a guess X (N+1, 8), U (N+1, 2), and whether IPOPT converged."""
        N, limits = self._N, self._limits
        low, high = limits.box(U[0], self._knots)
        free, change = np.full(N * STATES, np.inf), np.outer(self._g, limits.max_change).ravel()
        answer = self._solve(
            x0=np.concatenate([X[1:].ravel(), U[1:].ravel()]),
            p=np.concatenate([X[0], U[0], C.ravel(), target.ravel()]),
            lbx=np.concatenate([-free, low.ravel()]),
            ubx=np.concatenate([free, high.ravel()]),
            lbg=np.concatenate([np.zeros(N * STATES), -change]),
            ubg=np.concatenate([np.zeros(N * STATES), change]),
        )
        commands = np.array(answer["x"]).ravel()[N * STATES :].reshape(N, 2)
        enforced: Array = limits.clip(np.concatenate([U[:1], commands]), self._knots)
        return enforced, bool(self._solve.stats()["success"])


def _rates(
    u: Any, v: Any, psi: Any, r: Any, F1: Any, F2: Any, cn: Any, ce: Any, crn: Any, cre: Any, p: Coefficients
) -> tuple[Any, ...]:
    """Write the equations of vehicle/dynamics.py in symbols."""
    cos, sin = ca.cos(psi), ca.sin(psi)
    surge = F1 + F2 - (p.linear_surge + p.quadratic_surge * ca.fabs(u)) * u
    du = (surge + p.mass_sway * v * r - p.dry_mass * (cos * crn + sin * cre)) / p.mass_surge
    sway = -(p.linear_sway + p.quadratic_sway * ca.fabs(v)) * v
    dv = (sway - p.mass_surge * u * r - p.dry_mass * (cos * cre - sin * crn)) / p.mass_sway
    yaw = F1 * p.arm_port - F2 * p.arm_starboard - (p.linear_yaw + p.quadratic_yaw * ca.fabs(r)) * r
    dr = (yaw + (p.mass_surge - p.mass_sway) * u * v) / p.inertia_yaw
    return cos * u - sin * v + cn, sin * u + cos * v + ce, du, dv, r, dr


def _stage(p: Coefficients, h: float) -> Callable[..., Any]:
    """Write the flow of vehicle/flow.py over a stage of h seconds in symbols: (8,), (2,), (2,), (2,), (2,) to (8,)."""
    X, u0, uh, c0, ch = (ca.SX.sym(name, size) for name, size in (("X", 8), ("u0", 2), ("uh", 2), ("c0", 2), ("ch", 2)))
    steps = substeps(h)
    d, cr = h / steps, (ch - c0) / h

    def thrust(t: float) -> Any:
        port, starboard = lag_weights(t, h, p.lag_port), lag_weights(t, h, p.lag_starboard)
        return [w[0] * X[6 + i] + w[1] * u0[i] + w[2] * uh[i] for i, w in enumerate((port, starboard))]

    def slope(x: Any, t: float) -> Any:
        c = c0 + cr * t
        return ca.vertcat(*_rates(x[2], x[3], x[4], x[5], *thrust(t), c[0], c[1], cr[0], cr[1], p))

    x = X[:6]
    for i in range(steps):
        t = i * d
        k1 = slope(x, t)
        k2 = slope(x + d / 2 * k1, t + d / 2)
        k3 = slope(x + d / 2 * k2, t + d / 2)
        k4 = slope(x + d * k3, t + d)
        x = x + d / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return ca.Function("stage", [X, u0, uh, c0, ch], [ca.vertcat(x, *thrust(h))])


def compare(optimum: Optimum, cycle: dict[str, Array]) -> dict[str, Any]:
    """One cycle against the optima that its start and its end lead to."""
    X, U, C, target, ours = (cycle[name] for name in ("X", "U", "C", "target", "ours"))
    rolled = optimum.roll(X[0], ours, C)
    theirs, converged = optimum.solve(X, U, C, target)
    onward, also = optimum.solve(rolled, ours, C, target)
    costs = {
        name: optimum.cost(X[0], commands, C, target)
        for name, commands in (("start", U), ("ours", ours), ("optimum", theirs), ("onward", onward))
    }
    near = abs(costs["onward"] - costs["optimum"]) <= SAME_COST * costs["optimum"]
    same = near and float(np.abs(onward - theirs).max()) <= SAME_N
    return {
        **costs,
        "converged": converged and also,
        "same": bool(same),
        "first_N": float(np.abs(ours[1] - theirs[1]).max()),
    }


def main() -> None:
    """Run, print, and keep where asked to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--every", type=int, default=20)
    parser.add_argument("--set", action="append", default=[], help="KEY=VALUE of the scenario, as often as wanted")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    rows: list[dict[str, Any]] = []
    optimum: Optimum | None = None  # the same for all seeds
    with Progress(console=Console(stderr=True)) as progress:
        task = progress.add_task("descents", total=options.seeds)
        for seed in range(options.first_seed, options.first_seed + options.seeds):
            s = run_config(f"run.seed={seed}", *options.set)
            controller = Watched(s.vehicle, s.reference, s.controller)
            Loop(run_config=s, controller=controller).fly()
            optimum = optimum or Optimum(s.vehicle, s.controller)
            rows += [compare(optimum, cycle) for cycle in controller.cycles[options.every :: options.every]]
            progress.advance(task)
    print(text(rows, " ".join(options.set) or "defaults"))
    if options.out is not None:
        options.out.write_text(json.dumps(rows, indent=1) + "\n")


def text(rows: list[dict[str, Any]], what: str) -> str:
    """Format the figures, ratios of costs first."""
    counts = Counter("not converged" if not row["converged"] else ("same" if row["same"] else "other") for row in rows)
    same = [row for row in rows if row["converged"] and row["same"]]
    other = [row for row in rows if row["converged"] and not row["same"]]
    lines = [
        f"{what}: {len(rows)} cycles, same local optimum {counts['same']}, another {counts['other']}, "
        f"IPOPT did not converge {counts['not converged']}",
        "| cost over that of IPOPT from the same start | cycles | p50 | p95 | p99 | max |",
        "|---|---|---|---|---|---|",
    ]
    for name, some in (("same local optimum", same), ("another", other)):
        if some:
            ratio = np.array([row["ours"] / row["optimum"] for row in some])
            p50, p95, p99, most = np.quantile(ratio, [0.5, 0.95, 0.99, 1.0])
            lines.append(f"| {name} | {len(some)} | {p50:.4f} | {p95:.4f} | {p99:.4f} | {most:.3f} |")
    if same:
        off = np.quantile([row["first_N"] for row in same], [0.5, 0.95, 1.0])
        lines.append(f"first free knot off by {off[0]:.2f} N (median), {off[1]:.2f} (p95), {off[2]:.1f} (max)")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
