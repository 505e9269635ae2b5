"""Diagnosis of a QP that was not solved: its errors as text, and the problem as a file (``ltv-mpc qp show FILE``)."""

from __future__ import annotations

import math
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple
from zipfile import BadZipFile, ZipFile

import msgspec
import numpy as np
from numpy.lib import format as npy
from scipy.sparse import csc_array

from ltv_mpc.config import open_file
from ltv_mpc.control.ocp import limits
from ltv_mpc.control.qp import QP
from ltv_mpc.control.solvers.sparse import DYNAMICS, EXCESS, LOWER, UPPER, SparseLayout
from ltv_mpc.errors import ConfigError
from ltv_mpc.messages import Array, Solve

FORMAT = "ltv-mpc qp 1"
FILE = "QP file"

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
        place = f"in stage {knot + 1}" if name.startswith("slew") else f"at the end of stage {knot}"
        named.append(ConstraintRow(f"{OF_KIND.get(kind, '')}{name} {place}", of, unit))
    return tuple(named)


@dataclass(frozen=True)
class FailedQp:
    """QP that was not solved, the names of its rows, and the solver's report."""

    qp: QP
    rows: tuple[ConstraintRow, ...]
    solve: Solve

    def save(self, path: Path) -> None:
        """Write the problem to one file in numpy's npz format.

        Parameters
        ----------
        path : name of the file; an existing one is replaced. numpy adds ``.npz`` to a name without it.
        """
        qp = self.qp
        parts: dict[str, Any] = {"format": FORMAT, "q": qp.q, "l": qp.l, "u": qp.u}
        for name, matrix in (("P", qp.P), ("A", qp.A)):
            parts |= {f"{name}_data": matrix.data, f"{name}_indices": matrix.indices, f"{name}_indptr": matrix.indptr}
        parts |= {
            "row_of": np.array([row.name for row in self.rows]),
            "row_scale": np.array([row.scale for row in self.rows]),
            "row_unit": np.array([row.unit for row in self.rows]),
            "solve": msgspec.json.encode(self.solve).decode(),
        }
        np.savez_compressed(path, **parts)

    @classmethod
    def load(cls, path: Path) -> FailedQp:
        """Read a file that ``save`` wrote.

        Parameters
        ----------
        path : the file.

        Raises
        ------
        ConfigError : the file is missing or unreadable, or ``save`` did not write it.
        """
        try:
            with open_file(path, what=FILE) as file:
                parts = _parts(file)
        except ConfigError:
            raise
        except UNREADABLE as error:
            raise ConfigError(f"{FILE} {path}", "", f"cannot be read: {str(error)[:200]}") from None
        try:
            return cls._from_parts(parts)
        except (LookupError, ValueError, TypeError, ArithmeticError) as error:
            problem = f"is not a QP saved by this program: {str(error)[:200]}"
            raise ConfigError(f"{FILE} {path}", "", problem) from None

    @classmethod
    def _from_parts(cls, parts: dict[str, Any]) -> FailedQp:
        """Return the problem from the arrays of its file. Raises an exception of any kind if they do not fit."""
        if str(parts["format"]) != FORMAT:
            raise ValueError(f"format {parts['format']}, must be {FORMAT}")
        for name in ("q", "l", "u", "P_data", "A_data"):
            _checked(parts, name, "f")
        for name in ("P_indices", "P_indptr", "A_indices", "A_indptr"):
            _checked(parts, name, "iu")
        for name, kinds in (("row_of", "U"), ("row_scale", "f"), ("row_unit", "U")):
            _checked(parts, name, kinds)
        n, m = len(parts["q"]), len(parts["l"])

        def matrix(name: str, rows: int) -> csc_array:
            data, indices, indptr = (parts[f"{name}_{part}"] for part in ("data", "indices", "indptr"))
            checked = csc_array((data, indices, indptr), shape=(rows, n))
            checked.check_format()
            return checked

        rows = tuple(
            ConstraintRow(str(name), float(scale), str(unit))
            for name, scale, unit in zip(parts["row_of"], parts["row_scale"], parts["row_unit"], strict=True)
        )
        if not len(rows) == len(parts["u"]) == m:
            raise ValueError(f"{m} lower bounds, {len(parts['u'])} upper, {len(rows)} rows: must be equal numbers")
        qp = QP(matrix("P", n), parts["q"], matrix("A", m), parts["l"], parts["u"])
        return cls(qp, rows, msgspec.json.decode(str(parts["solve"]), type=Solve))

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


MAX_BYTES = 1 << 26
"""Largest size of all parts: the QP of the longest horizon has a hundredth of it."""

UNREADABLE = (
    *(OSError, ValueError, TypeError, EOFError, LookupError, ArithmeticError, MemoryError),
    *(NotImplementedError, RuntimeError, BadZipFile, zlib.error),
)
"""Exceptions of zipfile, zlib and numpy for bytes that are no npz file."""


def _parts(npz: BinaryIO) -> dict[str, Any]:
    """Return the arrays of an npz file by name. Raises ``UNREADABLE``, also if a size contradicts another."""
    with ZipFile(npz) as archive:
        entries = archive.infolist()
        if sum(entry.file_size for entry in entries) > MAX_BYTES:
            raise ValueError(f"more than {MAX_BYTES} bytes unpacked")
        for entry in entries:
            with archive.open(entry) as file:
                version = npy.read_magic(file)
                head = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
                shape, _, dtype = head(file)
            if not 0 <= math.prod(shape) * dtype.itemsize <= entry.file_size:
                raise ValueError(f"{entry.filename}: shape {shape} of {entry.file_size} bytes")
    npz.seek(0)
    with np.load(npz, allow_pickle=False) as archive:
        return {name: archive[name] for name in archive.files}


def _checked(parts: dict[str, Any], name: str, kinds: str) -> None:
    """Check that a part has one dimension and numbers of these kinds (numpy's letters)."""
    part = parts[name]
    if part.ndim != 1 or part.dtype.kind not in kinds:
        raise ValueError(f"{name}: {part.dtype} {part.shape}")


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
