"""Newton's method for a few equations. To import ``scipy.optimize`` would take a fifth of the start of each process."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ltv_mpc.messages import Array

MAX_ITERATIONS = 100
TOLERANCE = 1e-12
"""Size of the last step relative to the root, or to 1 if the root is smaller."""

DIFFERENCE = 1e-7
"""Step of the finite differences, with the same reference."""


def find_root(residual: Callable[[Array], Array], start: Array) -> Array | None:
    """Return a root of n equations in n unknowns; None if the iteration does not converge.

    Parameters
    ----------
    residual : returns the residuals (n,) at a point (n,).
    start : (n,) first point.
    """
    at = np.array(start, dtype=np.float64)
    for _ in range(MAX_ITERATIONS):
        size, value = np.maximum(np.abs(at), 1.0), residual(at)
        changes = np.diag(DIFFERENCE * size)
        jacobian = np.column_stack([(residual(at + change) - value) / change.sum() for change in changes])
        try:
            step = np.linalg.solve(jacobian, value)
        except np.linalg.LinAlgError:
            return None
        at -= step
        if (np.abs(step) <= TOLERANCE * size).all():
            return at
    return None
