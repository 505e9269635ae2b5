"""Scalar measurements, linearised about a belief: the form in which every sensor reaches the filter.

Row     residual_i = z_i - h_i(belief) = sum_j partial_ij error[state_ij] + n_i,  n_i ~ N(0, variance_i), independent
        Each row depends on few of the states and names them. A padded entry has partial 0 and any state.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from ltv_mpc.messages import Array

Indices: TypeAlias = npt.NDArray[np.int64]


class Rows(NamedTuple):
    """Set of m scalar measurements of one instant, each of which depends on at most w states."""

    state: Indices  # (m, w)
    partial: Array  # (m, w)
    residual: Array  # (m,)
    variance: Array  # (m,)

    def dense(self, size: int) -> Array:
        """Return the measurement matrix H, (m, n), for a state of ``size`` n.

        Parameters
        ----------
        size : number of states n.
        """
        H = np.zeros((len(self.residual), size))
        for i, (state, partial) in enumerate(zip(self.state, self.partial, strict=True)):
            np.add.at(H[i], state, partial)
        return H


_NO_ROWS = Rows(np.empty((0, 1), dtype=np.int64), np.empty((0, 1)), np.empty(0), np.empty(0))


@dataclass(frozen=True, slots=True, kw_only=True)
class Linearised:
    """Rows of one message, and the number of its scalar measurements that cannot be used, by reason."""

    rows: Rows
    indices: Indices | None = None  # (m,), of each row in its message; None: 0, 1, 2, ...
    unused: Mapping[str, int] = field(default_factory=dict)


def unusable(reason: str, count: int) -> Linearised:
    """Return the result for a message of which no measurement can be used.

    Parameters
    ----------
    reason : key of the account.
    count : number of scalar measurements in the message.
    """
    return Linearised(rows=_NO_ROWS, unused={reason: count})
