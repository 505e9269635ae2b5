"""Metrics of one function each: a line of ``METRICS`` brings one into summary.json, its page, report and campaigns."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import msgspec
import numpy as np

from ltv_mpc.messages import Array


class Positions(NamedTuple):
    """North and east (m) at the times of the estimates after t = 0, (K, 2) each, K > 0.

    The truth is that of ``true_error_m``: for a reference that begins where the vehicle is, it is shifted to begin at
    the estimate at t = 0, so the error of the surface fix is removed.
    """

    t_s: Array  # (K,)
    estimate_m: Array
    true_m: Array
    reference_m: Array


class Metric(NamedTuple):
    """Metric of a run; its name ends with its unit."""

    name: str
    meaning: str
    of: Callable[[Positions], float]


def tracking_rms_m(at: Positions) -> float:
    """Return the root mean square of the distance of the estimate from the reference (m)."""
    return math.sqrt(np.mean(np.sum((at.estimate_m - at.reference_m) ** 2, axis=1)))


METRICS = (Metric("tracking_rms_m", "root mean square of the tracking error", tracking_rms_m),)

if TYPE_CHECKING:
    Further = msgspec.Struct
else:
    Further = msgspec.defstruct(
        "Further", [(one.name, float | None, None) for one in METRICS], frozen=True, kw_only=True, module=__name__
    )
    Further.__doc__ = """Metrics of ``METRICS``, by name."""


def further(at: Positions | None) -> Further:
    """Return all metrics; None for a run without positions."""
    found: Further = Further(**{one.name: None if at is None else one.of(at) for one in METRICS})
    return found
