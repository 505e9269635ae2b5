"""Recovery of truncated, damaged or segmented recordings: every complete message is kept, losses are reported."""

from __future__ import annotations

import random
import struct
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from ltv_mpc.errors import ConfigError
from services.cli.app import run
from services.recording import recover
from services.recording.reader import Recording
from services.recording.records import LARGE_BYTES, MAGIC, Records
from services.recording.recover import Recovery, recovered_path, segments
from services.reporting.plots import recorded as plots
from tests.services.recording.recordings import START_NS, chunk, chunks, depth, record, text, write_depths


def messages(path: Path) -> list[tuple[str, int, bytes]]:
    return [(line.key, line.t_ns, line.data) for line in Recording(path).stored()]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write three thousand messages in about ten chunks."""
    return write_depths(tmp_path_factory.mktemp("whole") / "run.mcap", range(3000))


def recovered(path: Path) -> Recovery:
    return recover.recover(segments(path), recovered_path(path))


def test_all_chunks_before_a_cut_are_recovered_into_a_complete_file(whole: Path, tmp_path: Path) -> None:
    data, complete = whole.read_bytes(), messages(whole)
    path = tmp_path / "run.mcap"
    expected = 0
    for offset, length, count in chunks(whole):
        for end, lost in ((offset + length - 1, length - 1), (offset + length, 0)):
            path.write_bytes(data[:end])
            expected += 0 if lost else count
            if not expected:
                continue
            recovered_path(path).unlink(missing_ok=True)
            made = recovered(path)
            assert (made.messages, made.lost_bytes, made.segments[0].whole) == (expected, lost, False)
            out = Path(made.file)
            assert messages(out) == complete[:expected]
            assert recover.is_whole(out)
    with out.open("rb") as file:  # mcap's own reader needs the index at the end
        assert len(list(make_reader(file, validate_crcs=True).iter_messages())) == 3000


def damaged(whole: Path, path: Path, number: int) -> tuple[Path, int, int]:
    """Damage a chunk of a copy. Return the copy, offset and length of the chunk."""
    offset, length, _ = chunks(whole)[number]
    data = bytearray(whole.read_bytes())
    data[offset + length // 2] ^= 0x10
    path.write_bytes(data)
    return path, offset, length


def test_a_damaged_chunk_costs_itself_alone(whole: Path, tmp_path: Path) -> None:
    path, offset, length = damaged(whole, tmp_path / "run.mcap", 2)
    made = recovered(path)
    lost = chunks(whole)[2][-1]
    assert made.messages == 3000 - lost
    (loss,) = made.segments[0].losses
    assert (loss.offset, loss.length) == (offset, length)
    there = {data for _, _, data in messages(Path(made.file))}
    assert sum(data not in there for _, _, data in messages(whole)) == lost


def test_messages_whose_channel_is_lost_are_left_out_and_counted(whole: Path, tmp_path: Path) -> None:
    records = Records(damaged(whole, tmp_path / "run.mcap", 0)[0])
    assert not [record for record in records if type(record).__name__ == "Message"]
    assert records.orphans == 3000 - chunks(whole)[0][-1]
    assert not records.whole


def test_segments_are_joined_in_the_order_of_their_numbers_in_one_time(tmp_path: Path) -> None:
    """Segment 10 does not follow segment 1; a recorder that started later has another start time."""
    write_depths(tmp_path / "run.mcap", range(10))
    write_depths(tmp_path / "run.2.mcap", range(12, 20))
    (tmp_path / "run.3.mcap").write_bytes(b"")  # of a writer that was killed at once
    (tmp_path / "run.4.mcap").write_bytes(MAGIC[:5])
    write_depths(tmp_path / "run.10.mcap", range(20, 30), start_ns=START_NS + 5_000_000)
    write_depths(tmp_path / "other.2.mcap", range(1))
    made = recovered(tmp_path / "run.mcap")
    assert [(part.file, part.whole) for part in made.segments] == [
        *(("run.mcap", True), ("run.2.mcap", True), ("run.3.mcap", False), ("run.4.mcap", False)),
        ("run.10.mcap", True),
    ]
    there = [*range(10), *range(12, 30)]
    assert [t_ns for _, t_ns, _ in messages(Path(made.file))] == [depth(i).t_ns for i in there]
    assert segments(Path(made.file)) == (Path(made.file),)
    with Path(made.file).open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert (len(summary.channels), len(summary.schemas)) == (1, 1)


def test_recovery_keeps_the_run_s_metadata_and_each_frame_s_checksum(tmp_path: Path) -> None:
    path = write_depths(tmp_path / "run.mcap", range(500))
    path.write_bytes(path.read_bytes()[:-200])
    made = recovered(path)
    lines = Recording(Path(made.file))
    assert len(list(lines)) == 500
    assert lines.metadata["seed"] == "7"
    assert lines.others == {"recovery": {"run.mcap": f"500 messages, {made.lost_bytes} bytes lost"}}

    def sequences(path: Path) -> list[int]:
        with path.open("rb") as file:
            return [message.sequence for _, _, message in make_reader(file).iter_messages()]

    write_depths(tmp_path / "again.mcap", range(500))
    assert sequences(Path(made.file)) == sequences(tmp_path / "again.mcap")


def test_where_nothing_can_be_saved_nothing_is_left_behind(whole: Path, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    for content, problem in (
        (whole.read_bytes()[:300], "holds no complete message"),
        (b"depth_m\n1\n", "not an MCAP file"),
    ):
        path.write_bytes(content)
        with pytest.raises(ConfigError, match=problem):
            recovered(path)
    assert list(tmp_path.iterdir()) == [path]


CHANNEL = record(4, struct.pack("<HH", 1, 0) + text(b"k") + text(b"json") + struct.pack("<I", 0))
MESSAGE = record(5, struct.pack("<HIQQ", 1, 0, 5, 5) + b"{}")
BOMB = zstandard.ZstdCompressor().compress(bytes(LARGE_BYTES + 1))


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (record(5, b"", claimed=2**62), "cut in a record of 4611686018427387904 bytes"),
        (chunk(b"", size=2**50), "more than 20 times as many"),
        (chunk(b"", size=2**50, compressed=BOMB)[:-1], "cut in a chunk"),
        (chunk(record(5, b"", claimed=2**62), by=b"")[:-1], "cut in a chunk"),
        (chunk(b"", by=b"zip" * 9)[:-1], "cut in a chunk"),
        (chunk(b"", size=100, compressed=BOMB), "too many bytes"),
        (chunk(bytes(LARGE_BYTES)), "more than 200 times as many"),  # it would be read for seconds
        (chunk(b"", size=100, compressed=b"rubbish"), "chunk"),
        (chunk(CHANNEL + bytes(90)), "a record type that a chunk cannot hold"),  # millions would be read for seconds
        (chunk(CHANNEL + MESSAGE[:-1]), "chunk"),
        (chunk(record(5, b"", claimed=2**62)), "chunk"),
        (record(5, b"x"), "message"),
        (record(4, b"\x01\x00\x00\x00\xff\xff\xff\xff"), "channel"),
        (record(12, text(b"\xff") + text(b"")), "metadata"),
    ],
)
def test_a_record_that_lies_costs_no_memory_and_is_a_loss_with_its_reason(content, why, tmp_path) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(MAGIC + CHANNEL + MESSAGE + content)
    records = Records(path)
    assert [type(found).__name__ for found in records] == ["Channel", "Message"]
    (loss,) = records.losses
    assert why in loss.why
    assert (loss.offset, loss.length) == (len(MAGIC + CHANNEL + MESSAGE), len(content))


def test_an_lz4_frame_grows_to_the_size_that_its_chunk_claims_and_no_further(tmp_path: Path) -> None:
    bomb = lz4.frame.compress(CHANNEL + MESSAGE * 100_000, store_size=False)
    (path := tmp_path / "run.mcap").write_bytes(MAGIC + chunk(CHANNEL, compressed=bomb, by=b"lz4"))
    assert [type(found).__name__ for found in Records(path)] == ["Channel"]


def test_a_whole_recording_may_be_one_chunk(tmp_path: Path) -> None:
    content = random.Random(1).randbytes(LARGE_BYTES)
    message = record(5, struct.pack("<HIQQ", 1, 0, 5, 5) + content)
    (path := tmp_path / "run.mcap").write_bytes(MAGIC + chunk(CHANNEL + message, compressed=CHANNEL + message, by=b""))
    records = Records(path)
    assert [type(found).__name__ for found in records] == ["Channel", "Message"]
    assert not records.losses


def rewritten(whole: Path, path: Path, **how) -> Path:
    """Write the messages anew as another program does."""
    with whole.open("rb") as before, path.open("wb") as file:
        reader, writer, channels = make_reader(before), Writer(file, **how), dict[int, int]()
        writer.start(profile="", library="other")
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            if channel.id not in channels:
                number = writer.register_schema(schema.name, schema.encoding, schema.data) if schema else 0
                channels[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, number)
            known = channels[channel.id]
            writer.add_message(known, message.log_time, message.data, message.publish_time, message.sequence)
        writer.finish()
    return path


@pytest.mark.parametrize("how", [{"compression": CompressionType.LZ4}, {"chunk_size": 1 << 26}])
def test_a_file_that_another_program_has_written_anew_is_whole(how, whole, tmp_path) -> None:
    records = Records(rewritten(whole, tmp_path / "run.mcap", **how))
    assert sum(type(found).__name__ == "Message" for found in records) == 3000
    assert records.whole


@pytest.mark.parametrize("compression", CompressionType)
def test_of_a_chunk_that_is_cut_the_beginning_is_recovered(
    compression: CompressionType, whole: Path, tmp_path: Path
) -> None:
    """The only chunk of a file, which 30 % of its bytes less would cost otherwise."""
    path = rewritten(whole, tmp_path / "run.mcap", compression=compression, chunk_size=1 << 26)
    complete, data, ((offset, length, _),) = messages(path), path.read_bytes(), chunks(path)
    path.write_bytes(data[: offset + 7 * length // 10])
    made = recovered(path)
    assert 3000 * 0.25 < made.messages < 3000
    assert messages(Path(made.file)) == complete[: made.messages]
    (loss,) = made.segments[0].losses
    assert loss.why == f"cut in a chunk of {length - 9} bytes, of which the first {made.messages + 2} records are read"


@pytest.mark.parametrize(
    ("schema", "encoding", "says"),
    [
        (("nav_msgs/msg/Odometry", "ros2msg", b""), "cdr", r"A bag of ROS 2.*/odom, nav_msgs/msg/Odometry as cdr"),
        (("foxglove.Pose", "jsonschema", b"{}"), "json", r"was not written by.*/odom, foxglove.Pose as json"),
        (None, "json", "holds no message"),
    ],
)
def test_a_recording_of_another_program_is_said_to_be_one(
    schema: tuple[str, str, bytes] | None, encoding: str, says: str, tmp_path: Path
) -> None:
    with (tmp_path / "run.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2", library="rosbag2")
        if schema is not None:
            number = writer.register_schema(*schema)
            writer.add_message(writer.register_channel("/odom", encoding, number), 0, bytes(9), 0)
        writer.finish()
    with pytest.raises(ConfigError, match=says):
        plots.read(tmp_path / "run.mcap")
    for command in (["report"], ["log", "export"], ["log", "info"])[: 2 if schema is None else 3]:
        assert run([*command, str(tmp_path)]) == 2


def test_bytes_after_the_end_are_a_loss(whole: Path, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(whole.read_bytes() + b"more")
    records = Records(path)
    assert sum(type(found).__name__ == "Message" for found in records) == 3000
    assert records.lost_bytes == len(MAGIC) + 4
    assert records.losses[0].why == "bytes behind the end of the MCAP file"
    assert not records.whole
