"""Message validation: each frame is accepted once, in order; the others are counted by reason."""

from __future__ import annotations

import base64
import contextlib
from collections import Counter
from collections.abc import Iterable, Iterator

import msgpack
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ltv_mpc.messages import Estimate, GnssFix, Manual, PressureDepth
from ltv_mpc.validation import MAX_KINDS
from services.bus.mailbox import Frame, Mailbox
from services.bus.message_validation import MessageValidator, RateExceeded, rejection
from services.bus.rate_limit import RateLimit
from services.bus.sequence_check import MAX_SOURCES, silence_us
from services.bus.topics import BY_TYPE, source_of, topic_at
from services.bus.wire import Header, WireError, crc, encode, epoch_of, unpack

TOPIC = BY_TYPE[PressureDepth]
MANUAL = Manual(thrust_N=(0.0, 0.0, 0.0))


def frame(sequence: int, *, epoch: int = 1, depth_m: float = 1.0, key: str = TOPIC.key, at_ms: int = 0) -> Frame:
    header = Header(epoch=epoch, sequence=sequence, sent_monotonic_us=0)
    return Frame(TOPIC, key, encode(PressureDepth(t_ns=0, depth_m=depth_m), header), at_ms * 1000)


def by_hand(sequence: int, epoch: int) -> Frame:
    topic = BY_TYPE[Manual]
    return Frame(topic, topic.key, encode(MANUAL, Header(epoch=epoch, sequence=sequence)), 0)


Course = Iterable[tuple[int, int, int, str]]
"""Frames: epoch, sequence, time (ms) and the reason for which each is refused."""

COURSES: dict[str, tuple[Course, tuple[int, int, int]]] = {
    # it joined late: what was before 5 it never was to have
    "a gap": ([(1, 5, 0, ""), (1, 6, 0, ""), (1, 9, 0, "")], (3, 2, 0)),
    "doubled": ([(1, 3, 0, ""), (1, 7, 0, ""), (1, 7, 0, "out of order"), (1, 8, 0, "")], (3, 3, 1)),
    "reordered": ([(1, 3, 0, ""), (1, 7, 0, ""), (1, 3, 0, "out of order"), (1, 8, 0, "")], (3, 3, 1)),
    "a restarted source takes over after half a second, and no source is banned": (
        [
            (1, 100, 0, ""),
            (2, 0, 499, "second source: epoch 2 while epoch 1 publishes"),
            (2, 1, 500, ""),
            (1, 101, 600, "second source: epoch 1"),
            (2, 2, 600, ""),
            (1, 99, 1100, "out of order"),
            (1, 100, 1100, "out of order"),
            (1, 101, 1100, ""),
        ],
        (4, 0, 4),
    ),
    "another source beside one that still publishes": (
        [one for k in range(20) for one in ((1, k, 100 * k, ""), (9, 500 + k, 100 * k + 50, "second source"))],
        (20, 0, 20),
    ),
    "a damaged sequence": ([(1, 56, 0, ""), (1, 2**40, 0, "far ahead"), (1, 57, 0, ""), (1, 58, 0, "")], (3, 0, 1)),
    "a damaged epoch": ([(1, 56, 0, ""), (2**40, 57, 0, "second source"), (1, 57, 0, ""), (1, 58, 0, "")], (3, 0, 1)),
    "two frames behind a long silence are believed": (
        [(1, 56, 0, ""), (1, 19_999, 600, "far ahead"), (1, 20_000, 700, ""), (1, 20_001, 800, "")],
        (3, 20_000 - 56 - 2, 1),
    ),
    "two frames of another source are believed": (
        [(1, 56, 0, ""), (2, 19_999, 600, "far ahead"), (2, 20_000, 700, ""), (2, 20_001, 800, "")],
        (3, 0, 1),
    ),
    "two that disagree are not": (
        [(1, 56, 0, ""), *[(1, 2**k, 0, "far ahead") for k in (40, 30, 41)], (1, 57, 0, "")],
        (2, 0, 3),
    ),
    "two of two epochs do not make one source": (
        [(1, 56, 0, ""), *[(2**40 + k, 500 + k, 600, "far ahead") for k in range(3)], (1, 57, 700, "")],
        (2, 0, 3),
    ),
    "where most is lost half of the rest comes in": (
        [(1, sequence, 0, "far ahead" if sequence % 60 else "") for sequence in range(0, 3000, 30)],
        (50, 2940 - 49 - 49, 50),
    ),
}


@pytest.mark.parametrize(("course", "counts"), COURSES.values(), ids=COURSES)
def test_each_frame_is_accepted_once_and_in_order(course: Course, counts: tuple[int, int, int]) -> None:
    validator = MessageValidator()
    for epoch, sequence, at_ms, reason in course:
        with pytest.raises(WireError, match=reason) if reason else contextlib.nullcontext():
            validator.validate(frame(sequence, epoch=epoch, at_ms=at_ms))
    assert (validator.received, validator.dropped, validator.rejected) == counts


@pytest.mark.parametrize(("kind", "silence_ms"), [(PressureDepth, 500), (GnssFix, 1500), (Manual, 500)])
def test_the_silence_after_which_another_takes_over_is_three_periods_within_bounds(kind, silence_ms) -> None:
    assert silence_us(BY_TYPE[kind].period_ns) == silence_ms * 1000


def test_what_a_door_remembers_does_not_grow_with_what_strangers_send() -> None:
    """Epochs on one key, operators, reasons: each bounded, and who speaks all the time is not forgotten for them."""
    validator = MessageValidator()
    for k in range(MAX_SOURCES + 500):
        validator.validate(frame(0, epoch=k, at_ms=1000 * k))
        validator.validate(by_hand(0, k))
        letters = "".join(chr(ord("a") + int(digit)) for digit in str(k))
        with pytest.raises(WireError, match="unknown field"):
            validator.validate(Frame(TOPIC, TOPIC.key, msgpack.packb({**unpack(frame(0).payload), letters: 0}), 0))
    assert len(validator.rejected_by_reason) == MAX_KINDS + 1
    assert validator.rejected == MAX_SOURCES + 500
    # The operators' last MAX_SOURCES - 1 epochs are remembered, beside the sensor's key, and its own former epochs.
    with pytest.raises(WireError, match="out of order"):
        validator.validate(by_hand(0, 501))
    validator.validate(by_hand(0, 500))
    at_ms = 1000 * (MAX_SOURCES + 500)
    with pytest.raises(WireError, match="out of order"):
        validator.validate(frame(0, epoch=499, at_ms=at_ms))
    validator.validate(frame(0, epoch=498, at_ms=at_ms))


def test_refusals_are_counted_by_kind_not_by_value_so_that_the_count_stays_small() -> None:
    validator = MessageValidator()
    for i in range(100):
        for bad in (frame(i, depth_m=2e4 + i), Frame(TOPIC, TOPIC.key, b"", 0), Frame(None, "who/knows", b"", 0)):
            with pytest.raises(WireError):
                validator.validate(bad)
    assert validator.rejected == 300
    assert len(validator.rejected_by_reason) == 3
    assert validator.rejected_by_reason["depth_m"] == 100


def test_keys_are_counted_apart_and_an_invalid_frame_does_not_move_the_sequence() -> None:
    validator = MessageValidator()
    validator.validate(frame(0))
    validator.validate(frame(5, key="status/a"))
    with pytest.raises(WireError):
        validator.validate(frame(900, depth_m=float("nan")))
    validator.validate(frame(1))
    assert validator.dropped == 0


def test_a_rejection_holds_the_frame_by_its_crc_and_at_most_four_kibibytes_of_it() -> None:
    payload = msgpack.packb(list(range(100_000)))
    rejected = rejection(Frame(TOPIC, TOPIC.key, payload, 0), "not a map", node="estimator", t_ns=5)
    assert rejected.crc == crc(payload)
    assert len(rejected.payload_base64) <= 4096
    assert payload.startswith(base64.b64decode(rejected.payload_base64))


def test_a_mailbox_gives_back_in_order_of_arrival_and_drops_beyond_its_capacity() -> None:
    box = Mailbox(capacity=3)
    for key in "abcde":
        box.offer(None, key, b"")
    taken = [box.take(0.0) for _ in range(4)]
    assert [frame.key if frame else None for frame in taken] == ["a", "b", "c", None]
    assert box.overflowed == 2
    box.wake()
    assert box.take(60.0) is None  # at once


def test_on_a_key_on_which_operators_command_each_is_a_source_of_its_own() -> None:
    validator = MessageValidator()
    for sequence, epoch in ((0, 1), (7, 2), (1, 1), (8, 2)):
        validator.validate(by_hand(sequence, epoch))
    for sequence, epoch in ((1, 1), (8, 2)):
        with pytest.raises(WireError, match="out of order"):
            validator.validate(by_hand(sequence, epoch))
    assert (validator.received, validator.dropped, validator.rejected) == (4, 0, 2)


def test_what_is_turned_back_after_it_was_let_in_is_counted_as_refused() -> None:
    validator = MessageValidator()
    validator.validate(frame(0))
    validator.reject("no time yet: it would be late")
    assert (validator.received, validator.rejected, dict(validator.rejected_by_reason)) == (0, 1, {"no time yet": 1})


ESTIMATE = BY_TYPE[Estimate]


def estimate(sequence: int, at_us: int, *, epoch: int = 1, key: str = ESTIMATE.key) -> Frame:
    payload = encode(Estimate.at_rest(), Header(epoch=epoch, sequence=sequence, sent_monotonic_us=0))
    return Frame(ESTIMATE, key, payload, at_us)


def accepted(validator: MessageValidator, frames: Iterable[Frame]) -> Counter[int]:
    """Return the number of accepted frames by epoch."""
    counts: Counter[int] = Counter()
    for one in frames:
        with contextlib.suppress(WireError):
            counts[validator.validate(one)[1].epoch] += 1
    return counts


@pytest.mark.parametrize("epochs", ["one", "many"])
def test_a_flood_is_dropped_undecoded_and_the_publisher_beside_it_loses_no_frame(epochs: str) -> None:
    """Ten seconds at 2,000 frames a second beside ten a second, of one source or each of another."""
    validator = MessageValidator(RateLimit())

    def frames() -> Iterator[Frame]:
        for k in range(20_000):
            if k % 200 == 0:
                yield estimate(k // 200, k * 500)
            yield estimate(k, k * 500, epoch=7 if epochs == "one" else 1000 + k)

    counts = accepted(validator, frames())
    assert counts.pop(1) == 100
    assert counts.total() <= 1100  # a hundred a second, and a burst
    dropped = validator.rejected_by_reason["above the rate limit"]
    assert dropped >= 18_000


def test_the_limit_is_per_key_and_in_vehicle_time() -> None:
    for speed, limit in ((1.0, 260), (10.0, 600)):
        validator = MessageValidator(RateLimit(lambda speed=speed: speed))
        frames = [estimate(k, k * 3333) for k in range(600)]  # two seconds at 300 a second
        assert accepted(validator, frames)[1] <= limit
        assert accepted(validator, [estimate(0, 2_000_000, key="estimate/gnss")])[1] == 1
    assert accepted(validator, [estimate(0, 2_000_000, epoch=3)])[3] == 1


def test_a_source_is_admitted_again_once_one_of_many_has_been_silent_for_a_second() -> None:
    validator = MessageValidator(RateLimit())
    assert accepted(validator, [estimate(0, 0, epoch=100 + k) for k in range(50)]).total() == 16
    with pytest.raises(RateExceeded):
        validator.validate(estimate(0, 900_000, epoch=1))
    validator.validate(estimate(0, 1_100_000, epoch=1))


@given(epoch=st.integers(0, 2**48 - 1), sequence=st.integers(0, 2**53 - 1))
def test_the_epoch_of_a_frame_is_found_without_decoding_it(epoch: int, sequence: int) -> None:
    header = Header(epoch=epoch, sequence=sequence, sent_monotonic_us=0)
    assert epoch_of(encode(MANUAL, header)) == epoch
    assert epoch_of(msgpack.packb({"sequence": sequence, "epoch": epoch, "thrust_N": [0.0] * 3})) == epoch


def test_a_named_source_has_a_key_of_its_own() -> None:
    assert topic_at("estimate/gnss-2") is ESTIMATE
    assert (source_of("estimate/gnss-2"), source_of("estimate")) == ("gnss-2", "default")
    for key in ("estimate/", "estimate/default", "estimate/GNSS", "estimate/a/b", "estimate/-", "plan/b"):
        assert topic_at(key) is None
    validator = MessageValidator()
    for k in range(5):
        validator.validate(estimate(k, 0))
        validator.validate(estimate(k, 0, epoch=2, key="estimate/gnss"))
    assert validator.rejected == 0
