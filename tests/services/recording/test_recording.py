"""Recording file: written here, read by mcap's own reader and by ours, complete and truncated."""

from __future__ import annotations

import os
from pathlib import Path

import msgspec
import numpy as np
import pytest
from mcap.reader import make_reader

from ltv_mpc.messages import AdcpPing, Estimate, Message, PressureDepth
from services.bus import schema, wire
from services.recording.reader import Recording, StoredMessage
from services.recording.records import report_progress
from services.recording.writer import RunWriter
from tests.services.recording.recordings import START_NS, chunks, depth, foreign, sequences, write, write_depths
from tests.services.words import status


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "run.mcap"


def header(sequence: int) -> wire.Header:
    return wire.Header(epoch=1, sequence=sequence)


def put(writer: RunWriter, sequence: int) -> None:
    writer.write("sensors", depth(sequence), header(sequence), depth(sequence).t_ns)


def test_mcaps_own_reader_finds_channels_schemas_times_checksums_and_metadata(path: Path) -> None:
    """What every node writes has a channel for each node, and one schema."""
    both = [(node, status(node), 1, 0, START_NS) for node in ("plant", "sensors")]
    write(path, [*(("sensors", depth(i), 1, i, depth(i).t_ns) for i in range(5)), *both], seed="7")
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        messages = list(reader.iter_messages(topics=["sensor/depth"]))
        metadata = list(reader.iter_metadata())
        summary = reader.get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == 7
    assert sorted(one.topic for one in summary.channels.values()) == ["sensor/depth", "status/plant", "status/sensors"]
    assert [kind.name for kind in summary.schemas.values()] == ["ltv_mpc.PressureDepth", "ltv_mpc.NodeStatus"]
    assert [(m.name, m.metadata) for m in metadata] == [("run", {"start_ns": str(START_NS), "seed": "7"})]
    for i, (kind, channel, message) in enumerate(messages):
        assert channel.message_encoding == "json"
        assert kind is not None
        assert (kind.encoding, kind.data) == ("jsonschema", schema.text(PressureDepth))
        assert message.log_time == message.publish_time == i * 1_000_000
        assert message.sequence == wire.crc(wire.encode(depth(i), header(i)))
        assert msgspec.json.decode(message.data) == wire.to_map(depth(i), header(i))


def test_messages_come_back_as_they_were_bit_for_bit(path: Path) -> None:
    """Finite numbers exactly, also awkward ones; NaN as null; vehicle time with its sign, but not before the start."""
    awkward = [0.1 + 0.2, -0.0, 5e-324, 1.7976931348623157e308, 1 / 3, -1e-17]
    half = np.random.Generator(np.random.PCG64(1)).standard_normal((6, 6))
    estimate = msgspec.structs.replace(
        Estimate.at_rest(north_m=0.1 + 0.2, east_m=-1e-17), covariance=half @ half.T, t_ns=-3
    )
    ping = AdcpPing(t_ns=5, range_m=np.array([0.1, 0.7]), beam_velocity_mps=np.array([[np.nan, -0.0]] * 4))
    sent: list[tuple[str, Message]] = [("estimator", estimate), ("sensors", ping)]
    with RunWriter(path, start_ns=START_NS, metadata={}) as writer:
        for node, message in sent:
            writer.write(node, message, header(0), -3)
        writer.write_plain("sensor/depth", PressureDepth, {"sequence": 0, "awkward": awkward}, START_NS - 5)
    *messages, last = Recording(path)
    assert [stored.t_ns for stored in (*messages, last)] == [-3, -3, START_NS]
    for stored, (_, message) in zip(messages, sent, strict=True):
        got, got_header = stored.typed()
        assert got_header == header(0)
        assert wire.encode(got, got_header) == wire.encode(message, header(0))
    assert [x.hex() for x in last.plain["awkward"]] == [x.hex() for x in awkward]


def test_a_damaged_chunk_is_lost_alone_and_not_believed(path: Path) -> None:
    recording = Recording(write_depths(path, range(3000)))
    assert (len(list(recording)), recording.cut) == (3000, False)
    data = bytearray(path.read_bytes())
    data[chunks(path)[2][0] + 1000] ^= 0x10
    path.write_bytes(data)
    recording = Recording(path)
    got = [message.plain for message in recording]
    assert recording.cut
    kept = sorted(plain["sequence"] for plain in got)
    assert 0 < len(got) < 3000
    assert {kept[0], kept[-1]} == {0, 2999}
    assert got == [wire.to_map(depth(i), header(i)) for i in kept]


@pytest.mark.parametrize("message", [b"[1]", b"null", b"{", b'{"x":"\xff"}', b"[" * 10_000])
def test_an_impossible_message_is_an_error_of_its_own(path: Path, message: bytes) -> None:
    recording = Recording(foreign(path, "sensor/depth", b'{"epoch":1}', message, b'{"epoch":2}', start_ns="7"))
    first, impossible, last = recording
    assert (first.t_ns, first.plain, last.plain) == (7, {"epoch": 1}, {"epoch": 2})
    with pytest.raises(wire.WireError):
        impossible.plain  # noqa: B018


@pytest.mark.parametrize("metadata", [{}, {"start_ns": ""}, {"start_ns": "1e9"}, {"start_ns": "9" * 400}])
def test_a_start_that_is_no_time_is_0(path: Path, metadata: dict[str, str]) -> None:
    assert [found.t_ns for found in Recording(foreign(path, "sensor/depth", b"{}", **metadata))] == [0]


def test_flushed_messages_survive_a_writer_that_never_finishes(path: Path) -> None:
    """It flushes by itself, also while nothing arrives."""
    writer = RunWriter(path, start_ns=START_NS, metadata={"seed": "7"}, flush_s=1e9)
    put(writer, 0)
    assert sequences(path) == []
    writer.flush_s = 0.0
    writer.flush_if_due()
    assert sequences(path) == [0]
    put(writer, 1)
    recording = Recording(path)
    assert len(list(recording)) == 2
    assert (recording.cut, recording.metadata["seed"]) == (True, "7")
    writer.close()
    size = path.stat().st_size
    writer.close()
    assert path.stat().st_size == size


def test_a_map_that_json_cannot_hold_is_refused_and_leaves_the_file_as_it_was(path: Path) -> None:
    with RunWriter(path, start_ns=0, metadata={}) as writer:
        put(writer, 0)
        with pytest.raises(wire.WireError, match="not a plain map"):
            writer.write_plain("sensor/depth", PressureDepth, {"sequence": 1, "depth_m": object()}, 0)
        put(writer, 2)
    assert sequences(path) == [0, 2]


def test_a_disk_that_fills_up_ends_the_writing_with_its_error_and_the_file_is_closed(path: Path) -> None:
    with pytest.raises(OSError, match="No space left"):
        RunWriter(Path("/dev/full"), start_ns=0, metadata={"much": "x" * 100_000})
    writer = RunWriter(path, start_ns=0, metadata={}, flush_s=0.0)
    with Path("/dev/full").open("wb") as full:
        os.dup2(full.fileno(), writer.file.fileno())
    with pytest.raises(OSError, match="No space left"), writer:
        put(writer, 0)
    assert writer.file.closed


def test_a_key_that_no_topic_has_stays_readable_as_a_plain_map() -> None:
    message = StoredMessage("elsewhere", None, 0, 0, b'{"epoch":1}')
    with pytest.raises(wire.WireError, match="elsewhere"):
        message.typed()


def test_progress_is_reported_within_its_context_only(path: Path) -> None:
    write_depths(path, range(3000))
    shares: list[float] = []
    with report_progress(shares.append):
        assert len(list(Recording(path))) == 3000
    heard = list(shares)
    list(Recording(path))
    assert heard == sorted(heard)
    assert heard[0] < 0.001
    assert 0.9 < heard[-1] < 1.0  # its end is no message
    assert shares == heard
