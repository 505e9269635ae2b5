"""Newton's method: roots that are known, and equations without one."""

from __future__ import annotations

import numpy as np
import pytest

from ltv_mpc.messages import Array
from ltv_mpc.newton import find_root


def test_two_equations_have_the_root_that_is_known() -> None:
    """The circle of radius 5 and the hyperbola x y = 12 meet in (3, 4)."""
    root = find_root(lambda w: np.array([w @ w - 25.0, w[0] * w[1] - 12.0]), np.array([2.0, 5.0]))
    assert root == pytest.approx([3.0, 4.0], rel=1e-12)


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_a_root_is_found_to_the_tolerance_at_any_scale(scale: float) -> None:
    def residual(x: Array) -> Array:
        return x**3 - scale**3

    root = find_root(residual, np.array([2.0 * max(scale, 1.0)]))
    assert root == pytest.approx([scale], abs=1e-9 * max(scale, 1.0), rel=0.0)


@pytest.mark.parametrize("residual", [lambda x: x**2 + 1.0, lambda x: 0.0 * x + 1.0], ids=["no root", "constant"])
def test_without_a_root_there_is_none(residual) -> None:
    assert find_root(residual, np.array([1.3])) is None
