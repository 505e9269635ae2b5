"""Validation: each number of each message is checked against its annotation, in lock step and on the wire."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Annotated, Any, NamedTuple

import msgspec
import numpy as np
import pytest
from msgspec import Meta

from ltv_mpc.array_encoding import to_wire
from ltv_mpc.messages import AdcpPing, BottomTrack, ControllerState, ControllerStatus, Estimate, Message, Plan
from ltv_mpc.validation import RELATIONS, Bounds, bounds, rejection_reason, validator
from services.bus.topics import TOPICS
from services.bus.wire import WireError, from_map
from tests.services.bus.messages import EXAMPLES, HEADER

PLAN = next(message for message in EXAMPLES if isinstance(message, Plan))
STATUS = next(message for message in EXAMPLES if isinstance(message, ControllerStatus))
MESSAGES = (
    *EXAMPLES,
    msgspec.structs.replace(PLAN, reference_depth_m=5.0, progress=0.5, cross_track_m=-1.0, remaining_m=9.0),
    msgspec.structs.replace(STATUS, applied_age_ns=5, progress=0.5),
)
"""Messages with a number in every field that may be None."""

NUMBER = int | float | np.integer | np.floating


class Place(NamedTuple):
    """Number inside a message: its path by names and indices, and the bounds of its field."""

    way: tuple[Any, ...]
    limits: Bounds


def places(part: Any, way: tuple[Any, ...] = (), limits: Bounds | None = None) -> Iterator[Place]:
    """Yield every number in a message; of an array the first and the last entry."""
    if isinstance(part, msgspec.Struct):
        for name in part.__struct_fields__:
            yield from places(getattr(part, name), (*way, name), bounds(type(part)).get(name))
    elif isinstance(part, np.ndarray):
        for at in {(0,) * part.ndim, tuple(n - 1 for n in part.shape)}:
            yield from places(part[at], (*way, at), limits)
    elif isinstance(part, tuple):
        for i, entry in enumerate(part):
            yield from places(entry, (*way, i), limits)
    elif isinstance(part, dict):
        for key, entry in part.items():
            yield from places(entry, (*way, key), limits)
    elif isinstance(part, NUMBER) and not isinstance(part, bool):
        assert limits is not None, way
        yield Place(way, limits)


def structs(part: Any) -> Iterator[msgspec.Struct]:
    """Yield a message and the structs inside it."""
    if isinstance(part, msgspec.Struct):
        yield part
        for name in part.__struct_fields__:
            yield from structs(getattr(part, name))
    elif isinstance(part, tuple):
        for entry in part:
            yield from structs(entry)


def changed(part: Any, way: tuple[Any, ...], number: Any) -> Any:
    """Return the message with another number at one place."""
    if not way:
        return number
    first, *rest = way
    if isinstance(part, msgspec.Struct):
        return msgspec.structs.replace(part, **{first: changed(getattr(part, first), tuple(rest), number)})
    if isinstance(part, np.ndarray):
        other = part.copy()
        other[first] = number
        return other
    if isinstance(part, dict):
        return part | {first: changed(part[first], tuple(rest), number)}
    return (*part[:first], changed(part[first], tuple(rest), number), *part[first + 1 :])


def on_the_wire(message: Message) -> str | None:
    plain = msgspec.to_builtins(message, enc_hook=to_wire)
    header = {"epoch": plain.get("epoch", HEADER.epoch), "sequence": 0, "sent_monotonic_us": 0}
    try:
        from_map(type(message), header | plain)
    except WireError as error:
        return str(error)
    return None


def is_of_bounds(reason: str | None) -> bool:
    """Return True if a number is rejected for its bounds, not for a relation between fields."""
    return reason is not None and ("must be from" in reason or "Expected `" in reason)


def beyond(limits: Bounds) -> tuple[Any, Any]:
    if isinstance(limits.low, int):
        return limits.low - 1, limits.high + 1
    return math.nextafter(limits.low, -math.inf), math.nextafter(limits.high, math.inf)


@pytest.mark.parametrize("message", MESSAGES, ids=lambda message: type(message).__name__)
def test_each_number_may_equal_its_bounds_but_not_exceed_them(message: Message) -> None:
    assert rejection_reason(message) is None
    for way, limits in places(message):
        # The header has narrower bounds for a step record's epoch, which is its own.
        judges = (rejection_reason,) if way == ("epoch",) else (rejection_reason, on_the_wire)
        for judge in judges:
            for number in (limits.low, limits.high):
                reason = judge(changed(message, way, number))
                assert not is_of_bounds(reason), (way, number, reason)
            for number in (*beyond(limits), *([math.inf, -math.inf] if isinstance(limits.low, float) else [])):
                reason = judge(changed(message, way, number))
                assert is_of_bounds(reason), (way, number, reason)
                assert str(way[0]) in str(reason)
        if isinstance(limits.low, float):
            not_a_number = rejection_reason(changed(message, way, math.nan))
            assert is_of_bounds(not_a_number) != limits.has_gaps, way


@pytest.mark.parametrize("message", MESSAGES, ids=lambda message: type(message).__name__)
def test_what_is_no_number_is_rejected_on_the_wire(message: Message) -> None:
    for way, _ in places(message):
        if not isinstance(way[-1], tuple):  # an array converts it
            for wrong in ("1", True, []):
                assert on_the_wire(changed(message, way, wrong)) is not None, (way, wrong)


def test_every_field_with_numbers_was_tried() -> None:
    tried: dict[type, set[str]] = {}
    for message in MESSAGES:
        for part in structs(message):
            values = {name: getattr(part, name) for name in bounds(type(part))}
            given = {name for name, value in values.items() if list(places(value, (), bounds(type(part))[name]))}
            tried.setdefault(type(part), set()).update(given)
    assert {topic.message_type for topic in TOPICS} | set(RELATIONS) <= set(tried)
    assert [(kind, name) for kind, names in tried.items() for name in bounds(kind) if name not in names] == []


def test_a_reason_names_field_entry_value_and_bound_also_of_inner_structs() -> None:
    estimate = next(m for m in EXAMPLES if isinstance(m, Estimate) and m.current is not None)
    assert estimate.current is not None
    depth_m = estimate.current.depth_m.copy()
    depth_m[3] = 12_001.0
    deep = msgspec.structs.replace(estimate, current=msgspec.structs.replace(estimate.current, depth_m=depth_m))
    reason = "current.depth_m[3] = 12001.0: must be from -100 to 12000 (m)"
    assert rejection_reason(deep) == on_the_wire(deep) == reason
    far = msgspec.structs.replace(estimate, north_m=1e7)
    assert rejection_reason(far) == "north_m = 10000000.0: must be from -1e+06 to 1e+06 (m)"
    assert on_the_wire(far) == "north_m = 10000000.0: Expected `float` <= 1000000.0"


def test_nan_is_valid_only_in_arrays_with_missing_values() -> None:
    gaps = {
        (topic.message_type.__name__, name)
        for topic in TOPICS
        for name, of in bounds(topic.message_type).items()
        if of.has_gaps
    }
    assert gaps == {
        (AdcpPing.__name__, "beam_velocity_mps"),
        (BottomTrack.__name__, "range_m"),
        (BottomTrack.__name__, "beam_velocity_mps"),
    }


@pytest.mark.parametrize(("name", "entry", "most"), [("reference_toml", "#", 65_536), ("plan_delays_ns", (1,), 1000)])
def test_texts_and_lists_have_a_largest_length(name: str, entry: Any, most: int) -> None:
    whole = next(m for m in EXAMPLES if isinstance(m, ControllerState))
    fits, exceeds = (msgspec.structs.replace(whole, **{name: entry * count}) for count in (most, most + 1))
    assert rejection_reason(fits) is on_the_wire(fits) is None
    assert f"{name}: {most + 1} " in str(rejection_reason(exceeds))
    assert name in str(on_the_wire(exceeds))


def test_a_number_without_bounds_or_unit_is_rejected_with_its_type() -> None:
    class Unbounded(Message, frozen=True, kw_only=True, eq=False):
        """A message whose number is left without bounds."""

        depth_m: float

    class Unitless(Message, frozen=True, kw_only=True, eq=False):
        """A message whose number is left without a unit."""

        depth_m: Annotated[float, Meta(ge=0.0, le=1.0)]

    for kind in (Unbounded, Unitless):
        with pytest.raises(TypeError, match=f"{kind.__name__}.depth_m: a number needs"):
            validator(kind)
