"""Who may pass a node's door: finite numbers, lengths that agree, times in order, values that a vehicle can have.

One pure function, ``refusal(signal)``, stands in front of every node, in lock step and in processes alike. It runs on
each message, so it only compares: ``low <= x <= high`` is false for NaN and for both infinities. The bounds are those
of plausibility for any vehicle on earth; a vehicle's own limits (box, slew) belong to the node.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import cache
from types import NoneType
from typing import Annotated, Any, TypeAlias, get_args, get_origin

import msgspec
import numpy as np
from scipy.linalg.lapack import dpotrf

from ltv_mpc.messages import (
    AdcpPing,
    Array,
    BottomTrack,
    Command,
    ControllerState,
    ControllerStatus,
    CurrentProfile,
    CycleTiming,
    DroppedNode,
    Estimate,
    EstimatorState,
    InboxEntry,
    InputReport,
    LocalisationReport,
    Message,
    Plan,
    ReferenceStart,
    SensorReport,
    StepRecord,
    TdcpFix,
    Times,
)
from ltv_mpc.ranges import COUNT, MICROSECONDS, RANGES, SLANT_RANGE, SPEED

Reason: TypeAlias = str | None
Judged: TypeAlias = Message | InboxEntry | InputReport | SensorReport | ReferenceStart | DroppedNode


def refusal(signal: Judged) -> Reason:
    """Why a node must not see this signal, or None. A type without a row is refused."""
    kind = type(signal)
    judge = JUDGES.get(kind)
    return f"{kind.__name__} is not admitted anywhere" if judge is None else judge(signal)


def _out_of_range(signal: Judged) -> Reason:
    """Of which field a number does not lie in its range, in words."""
    kind = type(signal)
    for name, inside in _by_field(kind).items():
        if not inside(signal):
            value, (low, high, unit) = getattr(signal, name), RANGES[kind][name]
            shown = "an entry" if isinstance(value, np.ndarray) else value
            return f"{name} = {shown}: must be from {low:g} to {high:g} ({unit})"
    return None


def _between(values: Array, low: float, high: float) -> bool:
    """NaN is the least and the largest of all, passes through products, and fails the comparison."""
    if values.size == 0:
        return True
    # One number too large makes a sum of squares too large: a product, where least and largest take two passes.
    if values.dtype == np.float64 and low < 0.0 < high and np.vdot(values, values) <= min(low * low, high * high):
        return True
    # By their places: a third of what ``min`` and ``max`` take.
    return bool(low <= values.item(values.argmin()) and values.item(values.argmax()) <= high)


def _increases(values: Array | Times) -> bool:
    """From each to the next; NaN does not. To count takes a fifth of what ``all`` does."""
    return bool(np.count_nonzero(values[1:] > values[:-1]) == len(values) - 1)


def _tdcp(s: TdcpFix) -> Reason:
    return None if s.from_t_ns < s.t_ns else f"from_t_ns = {s.from_t_ns}: must be before t_ns = {s.t_ns}"


def _adcp(s: AdcpPing) -> Reason:
    if s.range_m.ndim != 1 or not len(s.range_m) or s.beam_velocity_mps.shape != (4, len(s.range_m)):
        return f"range_m {s.range_m.shape}, beam_velocity_mps {s.beam_velocity_mps.shape}: must be (K,), (4, K)"
    if not _increases(s.range_m):
        return "range_m: must increase"
    # NaN is a beam without return, and passes; infinity is rubbish, and does not.
    if (np.abs(s.beam_velocity_mps) > SPEED.high).any():
        return f"beam_velocity_mps: at most {SPEED.high:g} m/s either way, or null"
    return None


def _bottom_track(s: BottomTrack) -> Reason:
    if s.range_m.shape != (4,) or s.beam_velocity_mps.shape != (4,):
        return f"range_m {s.range_m.shape}, beam_velocity_mps {s.beam_velocity_mps.shape}: must be (4,), (4,)"
    # NaN is a beam that has not found the bottom.
    if (np.isnan(s.range_m) != np.isnan(s.beam_velocity_mps)).any():
        return "range_m, beam_velocity_mps: must be null for the same beams"
    if (s.range_m < 0).any() or (s.range_m > SLANT_RANGE.high).any():
        return f"range_m: must be from 0 to {SLANT_RANGE.high:g} m, or null"
    if (np.abs(s.beam_velocity_mps) > SPEED.high).any():
        return f"beam_velocity_mps: at most {SPEED.high:g} m/s either way, or null"
    return None


def _profile(s: CurrentProfile) -> Reason:
    shape = s.depth_m.shape
    if len(shape) != 1 or not shape[0] or s.north_mps.shape != shape or s.east_mps.shape != shape:
        return "depth_m, north_mps, east_mps: must be of one length, at least 1"
    if s.sd_mps is not None and s.sd_mps.shape != shape:
        return "sd_mps: must have one entry for each depth"
    return None if _increases(s.depth_m) else "depth_m: must increase"


ASYMMETRY = 1e-9
INDEFINITE = 1e-6 * np.eye(6)
"""What rounding may leave in a filter's covariance, in correlations: metres and radians differ by orders."""


def _covariance(P: Array) -> Reason:
    if P.shape != (6, 6):
        return f"covariance {P.shape}: must be (6, 6)"
    if not math.isfinite(np.vdot(P, P)):  # else infinity over infinity below
        return "covariance: must be finite"
    if P.tobytes() == P.T.tobytes() and dpotrf(P, lower=1, clean=0)[1] == 0:  # as a filter writes it
        return None
    variances = P.diagonal().tolist()
    if min(variances) < 0.0:
        return "covariance: its diagonal must not be negative"
    # exactly known: its row must be zero, else the factorisation below fails
    scale = np.array([1.0 / math.sqrt(v) if v > 0.0 else 1.0 for v in variances])
    R = P * scale * scale[:, None]
    if not abs(R - R.T).max() <= ASYMMETRY:
        return "covariance: must be symmetric"
    _, info = dpotrf(R + INDEFINITE, lower=1, clean=0, overwrite_a=1)
    return None if info == 0 else "covariance: must be positive semidefinite"


def _estimate(s: Estimate) -> Reason:
    reason = None if s.covariance is None else _covariance(s.covariance)
    return reason or (None if s.current is None else refusal(s.current))


def _plan(s: Plan) -> Reason:
    knots = len(s.t_ns) if s.t_ns.ndim == 1 else 0
    if knots < 2 or s.thrust_N.shape != (knots, 3) or s.states.shape != (knots, 6):
        shapes = f"t_ns {s.t_ns.shape}, thrust_N {s.thrust_N.shape}, states {s.states.shape}"
        return f"{shapes}: must be (N+1,), (N+1, 3), (N+1, 6), N at least 1"
    if not _increases(s.t_ns):
        return "t_ns: knots must increase"
    return refusal(s.solve)


LONGEST_REFERENCE = 65_536
"""Characters of a reference that travels: it is parsed within a cycle."""

MOST_DELAYS = 1000
"""Measurements in a checkpoint, which a process that is started anew is given by a pipe."""


def _command(s: Command) -> Reason:
    if len(s.reference_toml) > LONGEST_REFERENCE:
        return f"reference_toml: {len(s.reference_toml)} characters, at most {LONGEST_REFERENCE}"
    return None


def _controller_checkpoint(s: ControllerState) -> Reason:
    if len(s.reference_toml) > LONGEST_REFERENCE:
        return f"reference_toml: {len(s.reference_toml)} characters, at most {LONGEST_REFERENCE}"
    for name, times in (("plan_delays_ns", s.plan_delays_ns), ("cycle_times_ns", s.cycle_times_ns)):
        if len(times) > MOST_DELAYS:
            return f"{name}: {len(times)} entries, at most {MOST_DELAYS}"
    if s.model_products is not None and s.model_products.shape != (4, 4):
        return f"model_products {s.model_products.shape}: must be (4, 4)"
    return _first_of(s.began, s.plan, s.estimate)


def _dropped_node(s: DroppedNode) -> Reason:
    q = s.given.shape
    if len(q) != 1 or s.regression.shape != (2, *q):
        return f"given {q}, regression {s.regression.shape}: must be (q,), (2, q)"
    small = {"covariance": s.covariance, "with_position": s.with_position, "position": s.position}
    return next((f"{name} {of.shape}: must be (2, 2)" for name, of in small.items() if of.shape != (2, 2)), None)


def _estimator_checkpoint(s: EstimatorState) -> Reason:
    n = s.x.size
    if s.x.ndim != 1 or s.covariance.shape != (n * (n + 1) // 2,):
        return f"x {s.x.shape}, covariance {s.covariance.shape}: must be (n,), (n (n + 1) / 2,)"
    if s.attitude.shape != (3, 3) or s.mounting.shape != (3, 3):
        return f"attitude {s.attitude.shape}, mounting {s.mounting.shape}: must be (3, 3)"
    if not (s.covariance[np.cumsum(np.arange(1, n + 1)) - 1] >= 0).all():
        return "covariance: its diagonal must not be negative"
    if s.seen_nodes.ndim != 1:
        return "seen_nodes: must be a list"
    return _first_of(*s.dropped, s.estimate)


def _first_of(*parts: Judged | None) -> Reason:
    """Return the first reason to refuse one of these parts of a message."""
    return next(filter(None, (refusal(part) for part in parts if part is not None)), None)


def _timing(s: CycleTiming) -> Reason:
    low, high, unit = MICROSECONDS
    if all(low <= x <= high for x in s.stage_us.values()):
        return None
    return f"stage_us: must be from {low:g} to {high:g} ({unit})"


def _sensor_report(s: SensorReport) -> Reason:
    low, high, unit = COUNT
    return None if all(low <= n <= high for n in s.refused.values()) else f"refused: must be {unit}"


def _controller_status(s: ControllerStatus) -> Reason:
    low, high, unit = COUNT
    if not all(low <= n <= high for n in s.rejected.values()):
        return f"rejected: must be {unit}"
    return next(filter(None, map(refusal, s.inputs)), None)


def _localisation_report(s: LocalisationReport) -> Reason:
    return next(filter(None, map(refusal, s.sensors)), None)


def _record(s: StepRecord) -> Reason:
    return next(filter(None, map(refusal, s.inbox)), None)


CONSISTENCY: Mapping[type, Callable[[Any], Reason]] = {
    TdcpFix: _tdcp,
    AdcpPing: _adcp,
    BottomTrack: _bottom_track,
    SensorReport: _sensor_report,
    LocalisationReport: _localisation_report,
    CurrentProfile: _profile,
    Estimate: _estimate,
    Plan: _plan,
    Command: _command,
    ControllerState: _controller_checkpoint,
    ControllerStatus: _controller_status,
    CycleTiming: _timing,
    DroppedNode: _dropped_node,
    EstimatorState: _estimator_checkpoint,
    StepRecord: _record,
}
"""What relates one field to another, judged first: lengths, shapes, order."""


def _comparison(value: str, of: Any, low: float, high: float) -> str:
    """That the expression ``value`` of the type ``of`` lies in a range."""
    if get_origin(of) is Annotated:
        of = get_args(of)[0]
    arguments = get_args(of)
    if NoneType in arguments:
        (given,) = (argument for argument in arguments if argument is not NoneType)
        return f"({value} is None or {_comparison(value, given, low, high)})"
    if get_origin(of) is np.ndarray:
        return f"_between({value}, {low!r}, {high!r})"
    if get_origin(of) is not tuple:
        return f"{low!r} <= {value} <= {high!r}"
    if Ellipsis in arguments:
        return f"all({low!r} <= x <= {high!r} for x in {value})"
    return " and ".join(f"{low!r} <= {value}[{i}] <= {high!r}" for i in range(len(arguments)))


def _comparisons(kind: type) -> dict[str, str]:
    """That the numbers of each field of the signal ``s`` lie in its range."""
    types = {field.name: field.type for field in msgspec.structs.fields(kind)}
    return {name: _comparison(f"s.{name}", types[name], low, high) for name, (low, high, _) in RANGES[kind].items()}


def _compiled(expression: str) -> Callable[[Any], bool]:
    """Of the signal ``s``."""
    compiled: Callable[[Any], bool] = eval(f"lambda s: {expression}", {"_between": _between})
    return compiled


@cache
def _by_field(kind: type) -> dict[str, Callable[[Any], bool]]:
    """Each field by itself."""
    return {name: _compiled(comparison) for name, comparison in _comparisons(kind).items()}


def _judge(kind: type) -> Callable[[Any], Reason]:
    """``refusal`` of one type."""
    # One expression: every message comes by here, and a loop over its fields takes four times as long.
    inside, consistency = _compiled(" and ".join(_comparisons(kind).values()) or "True"), CONSISTENCY.get(kind)
    if consistency is None:
        return lambda signal: None if inside(signal) else _out_of_range(signal)
    return lambda signal: consistency(signal) or (None if inside(signal) else _out_of_range(signal))


JUDGES = {kind: _judge(kind) for kind in RANGES}
"""Of each type that is admitted anywhere."""
