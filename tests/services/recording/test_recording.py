"""Recording file: written here, read by mcap's own reader and by ours, complete and truncated."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from mcap.reader import make_reader

from ltv_mpc.errors import ConfigError
from ltv_mpc.messages import AdcpPing, Estimate, Message, PressureDepth
from services.bus import schema, wire
from services.recording.loss_accounting import LossAccounting
from services.recording.reader import Recording, StoredMessage
from services.recording.records import report_progress
from services.recording.writer import RunWriter
from tests.services.recording.recordings import foreign
from tests.services.words import status

S = 1_000_000_000
START_NS = -S


def header(sequence: int) -> wire.Header:
    return wire.Header(epoch=1, sequence=sequence, sent_monotonic_us=0)


def depth(i: int) -> PressureDepth:
    return PressureDepth(t_ns=START_NS + i * 1_000_000, depth_m=i / 7)


def write_depths(path: Path, count: int, **options: Any) -> None:
    with RunWriter(path, start_ns=START_NS, metadata={"seed": "7"}, **options) as writer:
        for i in range(count):
            writer.write("sensors", depth(i), header(i), depth(i).t_ns)
            if i % 300 == 299:
                writer.flush()  # which ends a chunk


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "run.mcap"


def test_mcaps_own_reader_finds_channels_schemas_times_checksums_and_metadata(path: Path) -> None:
    write_depths(path, 5)
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        messages = list(reader.iter_messages())
        metadata = list(reader.iter_metadata())
        summary = reader.get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == 5
    assert [(m.name, m.metadata) for m in metadata] == [("run", {"start_ns": str(START_NS), "seed": "7"})]
    for i, (kind, channel, message) in enumerate(messages):
        assert (channel.topic, channel.message_encoding) == ("sensor/depth", "json")
        assert (kind.name, kind.encoding, kind.data) == (
            "ltv_mpc.PressureDepth",
            "jsonschema",
            schema.text(PressureDepth),
        )
        assert message.log_time == message.publish_time == i * 1_000_000
        assert message.sequence == wire.crc(wire.encode(depth(i), header(i)))
        assert msgspec.json.decode(message.data) == wire.to_map(depth(i), header(i))


def test_what_every_node_writes_has_a_channel_for_each_node_and_one_schema(path: Path) -> None:
    with RunWriter(path, start_ns=0, metadata={}) as writer:
        for node in ("plant", "sensors"):
            writer.write(node, status(node), header(0), 0)
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert sorted(channel.topic for channel in summary.channels.values()) == ["status/plant", "status/sensors"]
    assert [kind.name for kind in summary.schemas.values()] == ["ltv_mpc.NodeStatus"]


def test_signals_come_back_as_they_were_bit_for_bit(path: Path) -> None:
    """Finite numbers exactly, also awkward ones; NaN as null; vehicle time with its sign."""
    awkward = [0.1 + 0.2, -0.0, 5e-324, 1.7976931348623157e308, 1 / 3, -1e-17]
    half = np.random.Generator(np.random.PCG64(1)).standard_normal((6, 6))
    estimate = msgspec.structs.replace(
        Estimate.at_rest(north_m=0.1 + 0.2, east_m=-1e-17), covariance=half @ half.T, t_ns=-3
    )
    ping = AdcpPing(t_ns=5, range_m=np.array([0.1, 0.7]), beam_velocity_mps=np.array([[np.nan, -0.0]] * 4))
    sent: list[tuple[str, Message]] = [("estimator", estimate), ("sensors", ping)]
    with RunWriter(path, start_ns=START_NS, metadata={}) as writer:
        for node, signal in sent:
            writer.write(node, signal, header(0), -3)
        writer.write_plain("sensor/depth", PressureDepth, {"sequence": 0, "awkward": awkward}, 0)
    *messages, last = Recording(path)
    assert [message.t_ns for message in messages] == [-3, -3]
    for message, (_, signal) in zip(messages, sent, strict=True):
        got, got_header = message.typed()
        assert got_header == header(0)
        assert wire.encode(got, got_header) == wire.encode(signal, header(0))
    assert [x.hex() for x in last.plain["awkward"]] == [x.hex() for x in awkward]


def test_a_message_with_a_negative_time_is_logged_at_time_zero(path: Path) -> None:
    with RunWriter(path, start_ns=0, metadata={}) as writer:
        writer.write("sensors", depth(0), header(0), -5)
    assert [message.t_ns for message in Recording(path)] == [0]


def test_a_complete_file_is_not_cut(path: Path) -> None:
    write_depths(path, 3)
    recording = Recording(path)
    assert len(list(recording)) == 3
    assert recording.metadata["seed"] == "7"
    assert not recording.cut


def test_a_cut_file_reads_up_to_its_last_whole_chunk_wherever_it_was_cut(path: Path, tmp_path: Path) -> None:
    write_depths(path, 3000)
    whole = path.read_bytes()
    complete = [message.plain for message in Recording(path)]
    counts = []
    for share in np.linspace(0.0, 0.999, 40):
        part = tmp_path / "part.mcap"
        part.write_bytes(whole[: int(share * len(whole))])
        recording = Recording(part)
        got = [message.plain for message in recording]
        assert recording.cut
        assert got == complete[: len(got)]
        counts.append(len(got))
    assert counts == sorted(counts)
    assert counts[0] == 0
    assert counts[-1] == 3000  # only the index is missing
    assert len(set(counts)) > 4  # chunks come one by one


def test_a_damaged_chunk_ends_the_reading_and_is_not_believed(path: Path) -> None:
    write_depths(path, 3000)
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    data = bytearray(path.read_bytes())
    data[summary.chunk_indexes[2].chunk_start_offset + 1000] ^= 0x10
    path.write_bytes(data)
    recording = Recording(path)
    got = [message.plain for message in recording]
    assert recording.cut
    assert 0 < len(got) < 3000
    assert got == [wire.to_map(depth(i), header(i)) for i in range(len(got))]


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


def test_a_file_that_is_no_recording_is_refused_by_name(path: Path) -> None:
    path.write_text("depth_m,north_mps\n" * 10)
    with pytest.raises(ConfigError, match=r"run\.mcap.*not an MCAP file"):
        list(Recording(path))


def test_flushed_messages_survive_a_writer_that_never_finishes(path: Path) -> None:
    writer = RunWriter(path, start_ns=START_NS, metadata={"seed": "7"}, flush_s=None)
    for i in range(4):
        writer.write("sensors", depth(i), header(i), depth(i).t_ns)
    assert list(Recording(path)) == []
    writer.flush()
    recording = Recording(path)
    assert [message.plain["sequence"] for message in recording] == [0, 1, 2, 3]
    assert recording.cut
    assert recording.metadata["seed"] == "7"
    writer.close()


def test_a_writer_with_a_period_flushes_by_itself_also_while_nothing_arrives(path: Path) -> None:
    writer = RunWriter(path, start_ns=START_NS, metadata={}, flush_s=0.0)
    writer.write("sensors", depth(0), header(0), 0)
    assert len(list(Recording(path))) == 1
    writer.close()
    path.unlink()
    late = RunWriter(path, start_ns=START_NS, metadata={}, flush_s=1e9)
    late.write("sensors", depth(0), header(0), 0)
    assert list(Recording(path)) == []
    late.flush_s = 0.0
    late.flush_if_due()
    assert len(list(Recording(path))) == 1
    late.close()


def test_a_map_that_json_cannot_hold_is_refused_and_leaves_the_file_as_it_was(path: Path) -> None:
    with RunWriter(path, start_ns=0, metadata={}) as writer:
        writer.write("sensors", depth(0), header(0), 0)
        with pytest.raises(wire.WireError, match="not a plain map"):
            writer.write_plain("sensor/depth", PressureDepth, {"sequence": 1, "depth_m": object()}, 0)
        writer.write("sensors", depth(2), header(2), 0)
        assert writer.messages == 2
    assert [message.plain["sequence"] for message in Recording(path)] == [0, 2]


def test_closing_twice_is_closing_once(path: Path) -> None:
    writer = RunWriter(path, start_ns=0, metadata={})
    writer.close()
    size = path.stat().st_size
    writer.close()
    assert path.stat().st_size == size


def test_a_disk_that_fills_up_ends_the_writing_with_its_error_and_the_file_is_closed(path: Path) -> None:
    with pytest.raises(OSError, match="No space left"):
        RunWriter(Path("/dev/full"), start_ns=0, metadata={"much": "x" * 100_000})
    writer = RunWriter(path, start_ns=0, metadata={}, flush_s=0.0)
    with Path("/dev/full").open("wb") as full:
        os.dup2(full.fileno(), writer.file.fileno())
    with pytest.raises(OSError, match="No space left"), writer:
        writer.write("sensors", depth(0), header(0), 0)
    assert writer.file.closed


def test_a_partly_written_chunk_is_truncated(path: Path) -> None:
    writer = RunWriter(path, start_ns=0, metadata={}, flush_s=1e9)
    writer.write("sensors", depth(0), header(0), 0)
    writer.flush()
    whole = path.read_bytes()
    writer.write("sensors", depth(1), header(1), 0)
    assert writer.unsafe == 1
    writer.file.write(b"half of a chunk")
    writer.file.flush()
    writer.abandon()
    assert path.read_bytes() == whole
    assert writer.file.closed


def test_a_key_that_no_topic_has_stays_readable_as_a_plain_map() -> None:
    message = StoredMessage("elsewhere", None, 0, 0, b'{"epoch":1}')
    with pytest.raises(wire.WireError, match="elsewhere"):
        message.typed()


def test_losses_are_the_gaps_of_each_key_and_epoch() -> None:
    losses = LossAccounting()
    for key, epoch, sequence in (
        ("plan", 5, 0),
        ("plan", 5, 1),
        ("plan", 5, 4),
        ("plan", 6, 0),  # its source was started anew
        ("estimate", 9, 2),  # nothing before the third
        ("applied", 1, 0),
    ):
        losses.add(key, epoch, sequence)
    assert losses.published == 5 + 1 + 3 + 1
    assert losses.missing == 2 + 2
    assert losses.by_key() == {"plan": 2, "estimate": 2}


def test_the_recording_package_starts_without_the_simulation() -> None:
    """The package is used on real vehicles."""
    code = (
        "import sys, services.recording.reader, services.recording.writer, services.recording.loss_accounting;"
        "print([m for m in sys.modules if m.partition('.')[0] in ('sim', 'zenoh', 'numba')])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, env={"PATH": os.environ["PATH"]}
    )
    assert done.stdout.strip() == "[]"


def test_progress_is_reported_within_its_context_only(path: Path) -> None:
    write_depths(path, 5000)
    shares: list[float] = []
    with report_progress(shares.append):
        assert len(list(Recording(path))) == 5000
    heard = list(shares)
    list(Recording(path))
    assert heard == sorted(heard)
    assert heard[0] < 0.001
    assert 0.9 < heard[-1] < 1.0  # its end is no message
    assert shares == heard
