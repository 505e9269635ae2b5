"""Text output of ``ltv-mpc qp show``: size and faults of a saved QP, and the result of solving it again."""

from __future__ import annotations

from typing import Any

import numpy as np
from msgspec.structs import asdict
from numpy.typing import NDArray

from ltv_mpc.control.failed_qp import NamedQp, worst_violation
from ltv_mpc.control.solvers.sparse import Solution, residuals


def figures(failed: NamedQp, solver: str, solution: Solution) -> dict[str, Any]:
    """Return all results as plain values, as printed by ``--json``."""
    qp, solve = failed.qp, solution.solve
    finite = bool(np.isfinite(solution.x).all() and np.isfinite(solution.y).all())
    kkt = residuals(qp, solution.x, solution.y) if finite else None
    return {
        "variables": len(qp.q),
        "rows": len(qp.l),
        "equalities": int((qp.l == qp.u).sum()),
        "P": _range(qp.P.data),
        "A": _range(qp.A.data),
        "q": _range(qp.q),
        "failed": asdict(failed.solve),
        "faults": failed.faults(),
        "solved_again": {
            "solver": solver,
            "status": solve.status.value,
            "why": solve.why,
            "objective": float(0.5 * solution.x @ (qp.P @ solution.x) + qp.q @ solution.x) if finite else None,
            "stationarity": None if kkt is None else kkt.stationarity,
            "primal": None if kkt is None else kkt.primal,
            "violated": worst_violation(qp, solution.x, failed.rows) if finite else "",
            "active": active(failed, solution.x) if finite else [],
        },
    }


ACTIVE = 1e-6
"""Largest distance from a bound, in the scale of the QP, at which it counts as active."""


def active(failed: NamedQp, x: NDArray[np.float64]) -> list[str]:
    """List the inequality rows that are active at x (n,)."""
    qp = failed.qp
    Ax = qp.A @ x
    at = (qp.l != qp.u) & (np.minimum(np.abs(Ax - qp.l), np.abs(Ax - qp.u)) <= ACTIVE)
    return [failed.rows[i].name for i in np.flatnonzero(at)]


def text(plain: dict[str, Any]) -> str:
    """Format the result of ``figures`` as text."""
    failed, again = plain["failed"], plain["solved_again"]
    lines = [
        f"QP        {plain['variables']} variables, {plain['rows']} rows, {plain['equalities']} of them equalities",
        *(f"|{name}|{' ' * (9 - len(name) - 1)}{_words(plain[name])}" for name in ("P", "A", "q")),
        f"failed    {failed['status']} after {failed['iterations']} iterations: {failed['why'] or 'no reason'}",
        *(f"wrong     {fault}" for fault in plain["faults"]),
    ]
    outcome = f"again     {again['solver']}: {again['status']}"
    if again["objective"] is not None:
        outcome += f", objective {again['objective']:.6g}"
        outcome += f", stationarity {again['stationarity']:.1e}, violation {again['primal']:.1e}"
    lines.append(f"{outcome}: {again['why']}" if again["why"] else outcome)
    if again["violated"]:
        lines.append(f"          {again['violated']}")
    lines += [f"active    {name}" for name in again["active"]]
    return "\n".join(lines)


def _range(values: NDArray[np.float64]) -> list[float] | None:
    """Return the smallest and largest magnitude of the finite, non-zero values."""
    sizes = np.abs(values[np.isfinite(values) & (values != 0.0)])
    return [float(sizes.min()), float(sizes.max())] if sizes.size else None


def _words(span: list[float] | None) -> str:
    return "all zero" if span is None else f"{span[0]:.2g} to {span[1]:.2g}"
