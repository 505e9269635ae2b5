"""Message validation: the bounds of each field, compiled from ``messages.py``, and the relations between fields.

``rejection_reason(message)`` checks each message before it enters a node, in lock step and in processes. The check of
one type is a generated function of plain comparisons, compiled at its first use. (msgspec checks messages that it
decodes, but not those that are constructed.) ``low <= x <= high`` is false for NaN and for both infinities.
"""

from __future__ import annotations

import math
import operator
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from functools import cache, lru_cache
from typing import Any, NamedTuple, TypeAlias

import msgspec
import numpy as np
from msgspec import inspect

from ltv_mpc.messages import (
    AdcpPing,
    Array,
    BottomTrack,
    ControllerState,
    CurrentProfile,
    DisturbanceState,
    Estimate,
    EstimatorState,
    ImuSamples,
    Obstacle,
    Plan,
    TdcpFix,
    Times,
    ZoneInForce,
)

Reason: TypeAlias = str | None
Validator: TypeAlias = Callable[[Any], Reason]


VALUES = re.compile(r"[:=(0-9]")
"""Start of the values in a reason."""

MAX_KINDS = 100
"""Largest number of kinds that are counted separately: the sender chooses the name of an unknown field."""


class ReasonCounts(Counter[str]):
    """Counts of reasons by their kind, which is the text before the values."""

    def add(self, reason: str) -> None:
        """Count a reason.

        Parameters
        ----------
        reason : why something was rejected.
        """
        kind = VALUES.split(reason, maxsplit=1)[0].strip()
        self[kind if kind in self or len(self) < MAX_KINDS else "other"] += 1


class Bounds(NamedTuple):
    """Closed interval of every number of a field: a scalar, or the entries of a tuple, a map or an array."""

    low: float
    high: float
    unit: str
    has_gaps: bool  # NaN in an array, null on the wire: a missing value

    @property
    def text(self) -> str:
        """Text of the bounds in a reason."""
        return f"must be from {self.low:g} to {self.high:g} ({self.unit}){', or null' if self.has_gaps else ''}"


def rejection_reason(message: msgspec.Struct) -> Reason:
    """Return the reason why a message is not valid, or None if it is valid."""
    return validator(type(message))(message)


@cache
def validator(kind: type[msgspec.Struct]) -> Validator:
    """Compile the check of messages of ``kind``. Raises ``TypeError`` if a number has no bounds."""
    names: dict[str, Any] = {
        "between": _between,
        "between_or_nan": _between_or_nan,
        "entry": _entry_outside,
        "relation": relation_reason,
    }
    lines = [
        line
        for name, field_type in _types(kind).items()
        for line in _checks(field_type, name, f"m.{name}", names, f"{kind.__name__}.")
    ]
    lines.append("return relation(m)" if kind in SHAPES or kind in RELATIONS else "return None")
    exec("def check(m):\n" + "\n".join(f"    {line}" for line in lines), names)
    check: Validator = names["check"]
    return check


@cache
def bounds(kind: type[msgspec.Struct]) -> Mapping[str, Bounds]:
    """Return the bounds of each field of ``kind`` that contains numbers, in the order of the fields."""
    by_name = {name: _bounds(field_type) for name, field_type in _types(kind).items()}
    return {name: limits for name, limits in by_name.items() if limits is not None}


def plain_type(field_type: inspect.Type) -> inspect.Type:
    """Return the type of a field without its annotations; for an array, the list that represents it on the wire."""
    if not isinstance(field_type, inspect.Metadata):
        return field_type
    wire = (field_type.extra or {}).get("wire")
    return plain_type(field_type.type if wire is None else inspect.type_info(wire))


# --- the generated check of one type ----------------------------------------------------------------------------------


def _types(kind: type[msgspec.Struct]) -> dict[str, inspect.Type]:
    info = inspect.type_info(kind)
    assert isinstance(info, inspect.StructType)
    return {field.name: field.type for field in info.fields}


def _bounds(field_type: inspect.Type, unit: str | None = None) -> Bounds | None:
    """Return the bounds of the numbers in a field, or None if it contains none or a struct inside defines them."""
    if isinstance(field_type, inspect.Metadata):
        unit = (field_type.extra or {}).get("unit", unit)
    match plain_type(field_type):
        case inspect.IntType(ge=low, le=high) | inspect.FloatType(ge=low, le=high):
            if low is None or high is None or unit is None:
                raise TypeError("a number needs ge, le and a unit")
            return Bounds(low, high, unit, has_gaps=False)
        case inspect.UnionType(types=types):
            return next(_bounds(member, unit) for member in types if not isinstance(member, inspect.NoneType))
        case inspect.TupleType(item_types=items):
            return _bounds(items[0], unit)
        case inspect.VarTupleType(item_type=item):
            return _bounds(item, unit)
        case inspect.ListType(item_type=item):
            limits = _bounds(item, unit)
            return limits and limits._replace(has_gaps=limits.has_gaps or isinstance(item, inspect.UnionType))
        case inspect.DictType(value_type=value):
            return _bounds(value, unit)
    return None


def _checks(field_type: inspect.Type, field: str, value: str, names: dict[str, Any], prefix: str) -> Iterator[str]:
    """Generate the lines that return a reason if the expression ``value`` of this type is not valid."""
    try:
        limits = _bounds(field_type)
    except TypeError as error:
        raise TypeError(f"{prefix}{field}: {error}") from None
    low, high = (limits.low, limits.high) if limits else (0, 0)
    reject = f'return f"{field} = {{{value}}}: {limits.text}"' if limits else ""
    match plain_type(field_type):
        case inspect.UnionType(types=types):
            (given,) = (member for member in types if not isinstance(member, inspect.NoneType))
            yield f"if {value} is not None:"
            yield from (f"    {line}" for line in _checks(given, field, value, names, prefix))
        case inspect.IntType() | inspect.FloatType():
            yield f"if not {low!r} <= {value} <= {high!r}: {reject}"
        case inspect.TupleType(item_types=items):
            inside = " and ".join(f"{low!r} <= {value}[{i}] <= {high!r}" for i in range(len(items)))
            yield f"if not ({inside}): {reject}"
        case inspect.ListType():
            within = "between_or_nan" if limits and limits.has_gaps else "between"
            names[f"{field}_bounds"] = limits
            yield f'if not {within}({value}, {low!r}, {high!r}): return entry("{field}", {value}, {field}_bounds)'
        case inspect.DictType() if limits:
            yield f"if not all({low!r} <= x <= {high!r} for x in {value}.values()): {reject}"
        case inspect.StrType(max_length=int(most)):
            yield f'if len({value}) > {most}: return f"{field}: {{len({value})}} characters, at most {most}"'
        case inspect.VarTupleType(item_type=item, max_length=most):
            if most is not None:
                yield f'if len({value}) > {most}: return f"{field}: {{len({value})}} entries, at most {most}"'
            if limits:
                yield f"if not all({low!r} <= x <= {high!r} for x in {value}): {reject}"
            elif isinstance(inner := plain_type(item), inspect.StructType):
                names[f"check_{field}"] = validator(inner.cls)
                yield f"for i, x in enumerate({value}):"
                yield f"    reason = check_{field}(x)"
                yield f'    if reason is not None: return f"{field}[{{i}}].{{reason}}"'
        case inspect.StructType(cls=cls):
            names[f"check_{field}"] = validator(cls)
            yield f"reason = check_{field}({value})"
            yield f'if reason is not None: return "{field}." + reason'


def _between(values: Array, low: float, high: float) -> bool:
    """Return True if all entries are within bounds; NaN is returned by argmin and argmax, and fails the comparison."""
    if values.size == 0:
        return True
    # sufficient condition by the sum of squares: one product instead of two passes for minimum and maximum
    if values.dtype == np.float64 and low < 0.0 < high and np.vdot(values, values) <= min(low * low, high * high):
        return True
    # argmin and argmax take a third of the time of min and max
    return bool(low <= values.item(values.argmin()) and values.item(values.argmax()) <= high)


def _between_or_nan(values: Array, low: float, high: float) -> bool:
    """Return True if all entries are within bounds or NaN."""
    return not (np.count_nonzero(values < low) or np.count_nonzero(values > high))


def _entry_outside(field: str, values: Array, limits: Bounds) -> str:
    """Return the reason that names the first entry of an array out of bounds."""
    inside = (limits.low <= values) & (values <= limits.high)
    if limits.has_gaps:
        inside |= np.isnan(values)
    place = tuple(np.argwhere(~inside)[0].tolist())
    return f"{field}{''.join(f'[{i}]' for i in place)} = {values[place]}: {limits.text}"


# --- shapes of arrays, and relations between the fields of one message, checked after their bounds -------------------


def relation_reason(message: msgspec.Struct) -> Reason:
    """Return the reason why the shapes or relations of a message, whose numbers may be any, are not valid, or None."""
    kind, reason = type(message), None
    if kind in SHAPES:
        reason = _shape_reason(kind, *[getattr(getattr(message, field), "shape", None) for field in SHAPES[kind]])
    return reason or (RELATIONS[kind](message) if kind in RELATIONS else None)


@lru_cache
def _shape_reason(kind: type, *shapes: tuple[int, ...] | None) -> Reason:
    """Return the reason that names the first array of another shape; the first array of a letter says its number."""
    sizes: dict[int | str, int] = {}
    for (field, wanted), shape in zip(SHAPES[kind].items(), shapes, strict=True):
        for size, number in zip(wanted, shape or (), strict=False):
            sizes.setdefault(size, size if isinstance(size, int) else max(number, LEAST[size]))
        if shape not in (None, tuple(sizes.get(size) for size in wanted)):
            known = ", ".join(f"{size} = {number}" for size, number in sizes.items() if isinstance(size, str))
            return f"{field} {shape}: must be ({', '.join(map(str, wanted))}){known and f' with {known}'}"
    return None


def _increases(field: str, values: Array | Times) -> Reason:
    """Return the reason unless each entry is greater than the previous one; counting is faster than ``all``."""
    increasing = np.count_nonzero(values[1:] > values[:-1]) == len(values) - 1
    return None if increasing else f"{field}: must increase"


def _tdcp(s: TdcpFix) -> Reason:
    return None if s.from_t_ns < s.t_ns else f"from_t_ns = {s.from_t_ns}: must be before t_ns = {s.t_ns}"


def _imu(s: ImuSamples) -> Reason:
    times = [sample.t_ns for sample in s.samples]
    if not times:
        return "samples: must have at least one entry"
    return None if all(map(operator.lt, times, times[1:])) else "samples: t_ns must increase"


def _bottom_track(s: BottomTrack) -> Reason:
    if np.count_nonzero(np.isnan(s.range_m) != np.isnan(s.beam_velocity_mps)):
        return "range_m, beam_velocity_mps: must be null for the same beams"
    return None


MAX_VERTICES = 500
"""Largest number of vertices of a zone."""

ASYMMETRY = 1e-9
INDEFINITE = 1e-6
"""Tolerances for rounding in the covariance of a filter, applied to correlations, because units differ by orders."""


def _covariance(s: Estimate | DisturbanceState) -> Reason:
    P = s.covariance
    # the usual case: exactly symmetric and positive definite
    if P is None or (P.tobytes() == P.T.tobytes() and _is_definite(P)):
        return None
    variances = P.diagonal().tolist()
    if min(variances) < 0.0:
        return "covariance: its diagonal must not be negative"
    # a zero variance requires a zero row, else the factorisation below fails
    scale = np.array([1.0 / math.sqrt(v) if v > 0.0 else 1.0 for v in variances])
    with np.errstate(all="ignore"):  # an overflow is rejected below
        R = P * scale * scale[:, None]
        if not abs(R - R.T).max() <= ASYMMETRY:
            return "covariance: must be symmetric"
    definite = _is_definite(R + INDEFINITE * np.eye(len(P)))
    return None if definite else "covariance: must be positive semidefinite"


def _is_definite(P: Array) -> bool:
    try:
        np.linalg.cholesky(P)  # scipy's is 5 us faster, and takes 14 MB of each process
    except np.linalg.LinAlgError:
        return False
    return True


def _estimator_state(s: EstimatorState) -> Reason:
    n = s.x.size
    if s.covariance.size != n * (n + 1) // 2:
        return f"x {s.x.shape}, covariance {s.covariance.shape}: must be (n,), (n (n + 1) / 2,)"
    if not (s.covariance[np.cumsum(np.arange(1, n + 1)) - 1] >= 0).all():
        return "covariance: its diagonal must not be negative"
    return None


def _obstacle(s: Obstacle) -> Reason:
    north, cross, east = s.covariance_m2
    if north >= 0.0 and east >= 0.0 and cross * cross <= north * east * (1.0 + ASYMMETRY):
        return None
    return f"covariance_m2 = {s.covariance_m2}: must be positive semidefinite"


def _zone(s: ZoneInForce) -> Reason:
    K = len(s.vertices_m)
    return None if K <= MAX_VERTICES else f"vertices_m: {K} vertices, at most {MAX_VERTICES}"


Shape: TypeAlias = tuple[int | str, ...]
LEAST = {"K": 1, "N + 1": 2, "n": 0, "m": 0}
"""Smallest number that each letter of a shape may stand for."""

SHAPES: Mapping[type, Mapping[str, Shape]] = {
    AdcpPing: {"range_m": ("K",), "beam_velocity_mps": (4, "K")},
    BottomTrack: {"range_m": (4,), "beam_velocity_mps": (4,)},
    CurrentProfile: dict.fromkeys(("depth_m", "north_mps", "east_mps", "sd_mps"), ("K",)),
    Estimate: {"covariance": (6, 6)},
    Plan: {"t_ns": ("N + 1",), "thrust_N": ("N + 1", 3), "states": ("N + 1", 6)},
    ControllerState: {"model_products": (6, 6)},
    DisturbanceState: {"mean": (12,), "covariance": (12, 12)},
    EstimatorState: {"x": ("n",), "covariance": ("m",), "attitude": (3, 3), "mounting": (3, 3)},
    ZoneInForce: {"vertices_m": ("K", 2)},
}
"""Shapes of the arrays of each message type that has any."""

RELATIONS: Mapping[type, Validator] = {
    TdcpFix: _tdcp,
    ImuSamples: _imu,
    AdcpPing: lambda s: _increases("range_m", s.range_m),
    BottomTrack: _bottom_track,
    CurrentProfile: lambda s: _increases("depth_m", s.depth_m),
    Estimate: _covariance,
    Plan: lambda s: _increases("t_ns", s.t_ns),
    DisturbanceState: _covariance,
    EstimatorState: _estimator_state,
    Obstacle: _obstacle,
    ZoneInForce: _zone,
}
"""Checks of relations between fields, by message type: order, covariances."""
