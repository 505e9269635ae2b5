"""Recording in segments, after a restart and with a full disk: segments can be read, losses are counted."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from types import SimpleNamespace

import pytest

from ltv_mpc.messages import PressureDepth
from services.bus import wire
from services.recording import recover, segments
from services.recording.segments import SegmentWriter
from tests.disk import largest_file
from tests.services.recording.recordings import sequences

KEY = "sensor/depth"


def put(writer: SegmentWriter, sequence: int) -> None:
    header = wire.Header(epoch=7, sequence=sequence, sent_monotonic_us=0)
    message = wire.to_map(PressureDepth(t_ns=sequence, depth_m=1.0), header)
    writer.write_plain(KEY, PressureDepth, message, sequence, wire.crc(wire.pack(message)))


def fill_up(writer: SegmentWriter) -> None:
    """Make the disk of the open segment full from now on."""
    assert writer.segment is not None
    with Path("/dev/full").open("wb") as full:
        os.dup2(full.fileno(), writer.segment.file.fileno())


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "run.mcap"


def opened(path: Path) -> SegmentWriter:
    return SegmentWriter(path, start_ns=0, metadata={"seed": "7"})


def test_a_restarted_recorder_writes_the_next_segment_and_the_join_is_complete(path: Path) -> None:
    """The second one was killed: it counts up to its last whole message."""
    for first in (0, 3, 6):
        with opened(path) as writer:
            assert writer.resumes == (first > 0)
            for sequence in range(first, first + 2):
                put(writer, sequence)
                writer.flush_if_due(now=True)
                if sequence == 3:
                    flushed = path.with_name("run.2.mcap").read_bytes()
    assert [p.name for p in sorted(path.parent.iterdir())] == ["run.2.mcap", "run.3.mcap", "run.mcap"]
    path.with_name("run.2.mcap").write_bytes(flushed + b"\x06\x00\x10")
    (said,) = recover.join(path)
    assert said == "3 segments of the recording joined, 5 messages; 3 bytes were damaged"
    assert sequences(path) == [0, 1, 3, 6, 7]
    assert [p.name for p in path.parent.iterdir()] == ["run.mcap"]
    assert list(recover.join(path)) == []


def test_a_join_for_which_there_is_no_room_leaves_every_segment_as_it_is(path, monkeypatch) -> None:
    for sequence in range(2):
        with opened(path) as writer:
            put(writer, sequence)

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(recover, "recover", full)
    (said,) = recover.join(path)
    assert "not joined" in said
    assert os.strerror(errno.ENOSPC) in said
    assert sequences(path) == [0]
    assert sequences(path.with_name("run.2.mcap")) == [1]


def test_a_full_disk_counts_what_it_cannot_store_and_the_next_segment_has_what_follows(path: Path, monkeypatch) -> None:
    now_s = 0.0
    monkeypatch.setattr(segments, "time", SimpleNamespace(monotonic=lambda: now_s))
    with opened(path) as writer:
        assert writer.segment is not None
        writer.segment.flush_s = 0.0
        put(writer, 0)
        flushed = path.read_bytes()
        writer.segment.flush_s = 1e9
        writer.segment.file.write(b"half of a chunk")
        writer.segment.file.flush()
        fill_up(writer)
        put(writer, 1)
        put(writer, 2)
        assert writer.lost == 0  # nobody knows yet
        writer.flush_if_due(now=True)
        now_s = 0.5 * segments.RETRY_S
        put(writer, 3)
        assert writer.lost == 3
        (news,) = writer.news()
        assert "No space left" in news
        now_s = 1.5 * segments.RETRY_S
        put(writer, 4)
        assert writer.news() == ["recording continues in run.2.mcap"]
    assert path.read_bytes() == flushed
    assert sequences(path) == [0]
    assert sequences(path.with_name("run.2.mcap")) == [4]


def test_while_there_is_no_room_every_try_is_in_vain_and_leaves_no_file(path: Path, monkeypatch) -> None:
    """There is not even room for the head of a file, of which a part is written."""
    monkeypatch.setattr(segments, "RETRY_S", 0.0)
    with opened(path) as writer:
        fill_up(writer)
        put(writer, 0)
        writer.flush_if_due(now=True)
        with largest_file(20):
            for sequence in range(1, 4):
                put(writer, sequence)
        assert [p.name for p in path.parent.iterdir()] == ["run.mcap"]
        put(writer, 4)
        assert writer.lost == 4
    assert sequences(path.with_name("run.2.mcap")) == [4]


def test_messages_lost_at_the_end_of_the_file_are_counted_too(path: Path) -> None:
    writer = opened(path)
    put(writer, 0)
    fill_up(writer)
    writer.close()
    assert writer.lost == 1


def test_a_file_that_may_not_be_written_is_refused_at_once_and_nothing_is_left_of_it(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="No such file"):
        opened(tmp_path / "nowhere" / "run.mcap")
