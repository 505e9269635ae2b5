"""Diagnosis of a QP that was not solved: its errors as text, and the problem as a file (``ltv-mpc qp show FILE``)."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
from scipy.sparse import csc_array

from ltv_mpc.array_encoding import from_wire, to_wire
from ltv_mpc.config import read_bytes
from ltv_mpc.control.ocp import limits
from ltv_mpc.control.ocp.problem import Problem
from ltv_mpc.control.solvers.sparse import DYNAMICS, EXCESS, LOWER, QP, UPPER, SparseLayout
from ltv_mpc.errors import ConfigError
from ltv_mpc.messages import Array, Solve

FILE = "QP file"
MAX_BYTES = 1 << 26
"""Largest size of a file: the QP of the longest horizon has a hundredth of it."""

STATES = (
    *(("north", "m"), ("east", "m"), ("surge", "m/s"), ("sway", "m/s"), ("heading", "rad"), ("yaw rate", "rad/s")),
    *((f"{side}'s {kind}", "N") for kind in ("thrust", "command") for side in ("port", "starboard")),
)
"""Name and unit of the states of a problem (ocp/assembly.py)."""


class ConstraintRow(NamedTuple):
    """Name, scale and unit of one row of A."""

    name: str  # "slew of port in stage 4"
    scale: float  # the row times this has the unit ``unit``
    unit: str


OF_KIND = {EXCESS: "excess of ", UPPER: "upper ", LOWER: "lower "}
"""Beginning of the name of a soft limit's row."""


def row_names(layout: SparseLayout, scale: Array) -> tuple[ConstraintRow, ...]:
    """Return name, scale and unit of each row of the QP of a cycle.

    Parameters
    ----------
    layout : its layout.
    scale : (12,) what is 1 in states and inputs (ocp/assembly.py).
    """
    of_limits = limits.names(scale)
    M, named = layout.masks.low.shape[1], []
    for kind, source in zip(layout.places.kind.tolist(), layout.places.source.tolist(), strict=True):
        if kind == DYNAMICS:
            stage, i = divmod(source, len(STATES))
            named.append(ConstraintRow(f"dynamics of {STATES[i][0]} in stage {stage + 1}", scale[i], STATES[i][1]))
            continue
        knot, row = divmod(source, M)
        if row < len(of_limits):
            name, of, unit = of_limits[row]
        else:
            name, of, unit = f"row {row - len(of_limits) + 1} of your limits and of the fence", float(scale[0]), "m"
            name += " at the end of stage {knot}"
        name = name.format(knot=knot, stage=knot + 1)
        named.append(ConstraintRow(OF_KIND.get(kind, "") + name, of, unit))
    return tuple(named)


class NamedQp(msgspec.Struct, frozen=True, eq=False, tag_field="format", tag="ltv-mpc qp 3"):
    """QP of a cycle, the names of its rows, and the solver's report; a file is a MessagePack map of them."""

    qp: QP
    rows: tuple[ConstraintRow, ...]
    solve: Solve

    @classmethod
    def of(cls, problem: Problem, scale: Array, solve: Solve) -> NamedQp:
        """Return the QP of a problem.

        Parameters
        ----------
        problem : of a cycle.
        scale : (12,) what is 1 in its states and inputs (ocp/assembly.py).
        solve : the solver's report.
        """
        layout = SparseLayout(problem)
        return cls(layout.qp(problem), row_names(layout, scale), solve)

    def save(self, path: Path) -> None:
        """Write the problem to one file.

        Parameters
        ----------
        path : name of the file; an existing one is replaced.
        """
        path.write_bytes(msgspec.msgpack.encode(self, enc_hook=_to_wire))

    @classmethod
    def load(cls, path: Path) -> NamedQp:
        """Read a file that ``save`` wrote.

        Parameters
        ----------
        path : the file.

        Raises
        ------
        ConfigError : the file is missing or unreadable, or ``save`` did not write it.
        """
        try:
            content = read_bytes(path, what=FILE, max_bytes=MAX_BYTES)
            named: NamedQp = msgspec.msgpack.decode(content, type=cls, dec_hook=_from_wire)
            qp, n, m = named.qp, *named.qp.A.shape[::-1]
            sizes = qp.P.shape, qp.q.shape, qp.l.shape, qp.u.shape, len(named.rows)
            if sizes != ((n, n), (n,), (m,), (m,), m):
                raise ValueError(f"{m} rows of {n} numbers: sizes of P, q, l, u, names must fit, got {sizes}")
            return named
        except ConfigError:
            raise
        except (ValueError, ArithmeticError, RecursionError) as error:
            problem = f"is not a QP saved by this program: {str(error)[:200]}"
            raise ConfigError(f"{FILE} {path}", "", problem) from None

    def faults(self) -> list[str]:
        """Return descriptions of the errors in the problem: numbers that are not finite, contradictory bounds."""
        qp = self.qp
        errors = []
        for name, values in (("P", qp.P.data), ("q", qp.q), ("A", qp.A.data)):
            bad = int((~np.isfinite(values)).sum())
            if bad:
                errors.append(f"{name}: {bad} of {len(values)} numbers are not finite")
        for name, bound in (("l", qp.l), ("u", qp.u)):
            errors += [f"{name} of {self.rows[i].name} is not a number" for i in np.flatnonzero(np.isnan(bound))]
        for i in np.flatnonzero(qp.l > qp.u):
            row = self.rows[i]
            errors.append(
                f"{row.name}: lower bound above the upper one by {(qp.l[i] - qp.u[i]) * row.scale:.3g} {row.unit}"
            )
        return errors


def worst_violation(qp: QP, x: Array, rows: tuple[ConstraintRow, ...]) -> str:
    """Describe the row that a point violates most.

    Violations are compared in the QP's own scaling, where rows are of order one.

    Parameters
    ----------
    qp : problem.
    x : (n,) primal point.
    rows : names of its rows.

    Returns
    -------
    Name of the row and violation with its unit; empty if no row is violated.
    """
    Ax = qp.A @ x
    over = np.maximum(qp.l - Ax, Ax - qp.u)
    if not np.isfinite(over).all() or over.max() <= 0.0:
        return ""
    i = int(np.argmax(over))
    return f"{rows[i].name} violated by {over[i] * rows[i].scale:.3g} {rows[i].unit}"


def _to_wire(value: Any) -> Any:
    """Return a sparse matrix as its numbers, their rows, the columns' begins, and its shape (encoder hook)."""
    return (value.data, value.indices, value.indptr, value.shape) if isinstance(value, csc_array) else to_wire(value)


def _from_wire(kind: type, value: Any) -> Any:
    """Return what ``_to_wire`` was given (decoder hook). Raises ValueError if the parts do not fit."""
    if kind is not csc_array:
        return from_wire(kind, value)
    data, indices, indptr, (rows, columns) = value
    parts = from_wire(np.ndarray, data), np.array(indices, np.int32), np.array(indptr, np.int32)
    array = csc_array(parts, shape=(rows, columns))
    array.check_format()
    return array
