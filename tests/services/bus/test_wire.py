"""Wire format: decoding returns what was sent or rejects it, by json, a second decoder, and 10,000 hostile frames."""

from __future__ import annotations

import json
import math
from typing import Any

import msgpack
import msgspec
import numpy as np
import pytest

from ltv_mpc.messages import AdcpPing, Estimate, Message, Plan, PressureDepth, StepRecord
from ltv_mpc.validation import rejection_reason
from services.bus.topics import TOPICS
from services.bus.wire import MAX_PAYLOAD_BYTES, Header, WireError, crc, decode, encode, header_of, to_map, unpack
from tests.services.bus.messages import EXAMPLES, HEADER


def test_every_topic_has_an_example_here() -> None:
    assert {topic.message_type for topic in TOPICS} == {type(example) for example in EXAMPLES}


@pytest.mark.parametrize("signal", EXAMPLES, ids=lambda s: type(s).__name__)
def test_what_is_decoded_is_what_was_sent_to_the_last_bit_and_survives_strict_json(signal: Message) -> None:
    decoded, header = decode(type(signal), encode(signal, HEADER))
    assert header == HEADER
    assert type(decoded) is type(signal)
    assert encode(decoded, HEADER) == encode(signal, HEADER)
    # A recording keeps the map as JSON: no NaN in it, and nothing that JSON would change.
    message = to_map(signal, HEADER)
    assert list(message)[:3] == ["epoch", "sequence", "sent_monotonic_us"]
    assert json.loads(json.dumps(message, allow_nan=False)) == json.loads(msgspec.json.encode(message))
    assert unpack(encode(signal, HEADER)) == json.loads(json.dumps(message, allow_nan=False))


def test_a_beam_without_return_is_null_on_the_wire_and_nan_inside() -> None:
    ping = next(e for e in EXAMPLES if isinstance(e, AdcpPing))
    message = to_map(ping, HEADER)
    assert message["beam_velocity_mps"][0][0] is None
    assert math.isnan(decode(AdcpPing, encode(ping, HEADER))[0].beam_velocity_mps[0, 0])


def test_a_record_cannot_be_sent_under_another_epoch_than_its_own() -> None:
    record = next(e for e in EXAMPLES if isinstance(e, StepRecord))
    with pytest.raises(ValueError, match="epoch"):
        encode(record, Header(epoch=5, sequence=0, sent_monotonic_us=0))


def test_the_crc_is_that_of_every_other_implementation() -> None:
    assert crc(b"123456789") == 0xCBF43926  # the check value of CRC-32/ISO-HDLC


HEADLESS = {"epoch": 1, "sequence": 0, "sent_monotonic_us": 0}
RUBBISH = {
    "empty": (b"", "incomplete"),
    "reserved": (b"\xc1", "."),
    "list": (msgpack.packb([1, 2]), "not a map"),
    "no header": (msgpack.packb({}), "epoch"),
    "no body": (msgpack.packb(HEADLESS), "t_ns"),
    "epoch": (msgpack.packb(HEADLESS | {"epoch": 2**48}), "epoch = 281474976710656: Expected `int` <= 281474976710655"),
    "bool": (msgpack.packb(HEADLESS | {"epoch": True}), "epoch = True: Expected `int`"),
    "deep": (b"\x91" * 100_000, "."),
    "long": (b"\xdd\xff\xff\xff\xff", "."),
    "utf8": (b"\xa1\xff", "."),
    "big": (b"\x00" * (MAX_PAYLOAD_BYTES + 1), "too large"),
}


@pytest.mark.parametrize(("payload", "reason"), RUBBISH.values(), ids=RUBBISH)
def test_rubbish_is_refused_by_reason(payload: bytes, reason: str) -> None:
    with pytest.raises(WireError, match=reason):
        decode(PressureDepth, payload)


def changed(signal: Message, **fields: Any) -> bytes:
    return msgpack.packb(to_map(signal, HEADER) | fields)  # type: ignore[no-any-return]


DEPTH = PressureDepth(t_ns=0, depth_m=12.5)
ESTIMATE = next(e for e in EXAMPLES if isinstance(e, Estimate) and e.covariance is not None)
PLAN = next(e for e in EXAMPLES if isinstance(e, Plan))
SKEW = np.diag([1.0] * 6)
SKEW[0, 1] = 0.5
INDEFINITE = np.diag([1.0] * 6)
INDEFINITE[0, 1] = INDEFINITE[1, 0] = 1.5


@pytest.mark.parametrize(
    ("kind", "payload", "reason"),
    [
        (PressureDepth, changed(DEPTH, depth_m="12"), "float"),
        (PressureDepth, changed(DEPTH, depth_ft=1.0), "depth_ft"),
        (Estimate, changed(ESTIMATE, covariance=SKEW.tolist()), "symmetric"),
        (Estimate, changed(ESTIMATE, covariance=INDEFINITE.tolist()), "semidefinite"),
        (Estimate, changed(ESTIMATE, covariance=(-np.eye(6)).tolist()), "diagonal"),
        (Estimate, changed(ESTIMATE, covariance=np.eye(5).tolist()), "6, 6"),
        (Estimate, changed(ESTIMATE, covariance=[[1.0], [1.0, 2.0]]), "one length"),
        (Estimate, changed(ESTIMATE, current={"depth_m": [1, 0], "north_mps": [0, 0], "east_mps": [0, 0]}), "increase"),
        (Estimate, changed(ESTIMATE, current={"depth_m": [], "north_mps": [], "east_mps": []}), "depth_m"),
        (Plan, changed(PLAN, thrust_N=PLAN.thrust_N[:-1].tolist()), "thrust_N"),
        (Plan, changed(PLAN, t_ns=PLAN.t_ns[::-1].tolist()), "increase"),
        (Plan, changed(PLAN, t_ns=[0] * 17 + [2**64 - 1]), "."),
    ],
)
def test_a_frame_of_right_form_and_wrong_meaning_is_refused_by_reason(kind, payload, reason) -> None:
    with pytest.raises(WireError, match=reason):
        decode(kind, payload)


def test_a_singular_covariance_passes_and_a_perfectly_known_state_too() -> None:
    rank_one = np.outer([5.0, 5.0, 1e-2, 1e-2, 1e-2, 1e-5], [5.0, 5.0, 1e-2, 1e-2, 1e-2, 1e-5])
    for covariance in (rank_one, np.zeros((6, 6))):
        assert rejection_reason(msgspec.structs.replace(ESTIMATE, covariance=covariance)) is None


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("epoch", -1),
        ("sequence", -1),
        ("sequence", 2**53),
        ("sent_monotonic_us", -1),
        ("sent_monotonic_us", 2**62),
        ("sequence", 1.0),
        ("epoch", None),
    ],
)
def test_a_header_out_of_bounds_is_rejected_even_if_the_message_is_not_decoded(field: str, value: Any) -> None:
    message = {"epoch": 2**48 - 1, "sequence": 2**53 - 1, "sent_monotonic_us": 0}
    assert header_of(message).epoch == 2**48 - 1
    with pytest.raises(WireError, match=field):
        header_of(message | {field: value})
