"""The index of a long recording's chunks: on disk until its end, the same in the file."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from ltv_mpc.messages import GnssFix, Message, PressureDepth
from services.bus import topics
from services.bus.wire import Header
from services.recording import chunk_index
from services.recording.writer import RunWriter

CHUNKS = 1500


def of_chunk(i: int) -> tuple[Message, ...]:
    return (
        PressureDepth(t_ns=1_000_000 * i, depth_m=i / 7),
        GnssFix(t_ns=1_000_000 * i, north_m=i / 3, east_m=0.0, velocity_north_mps=0.1, velocity_east_mps=0.0),
    )


def write(path: Path, chunks: int = CHUNKS) -> int:
    """So many chunks of two topics; by how many bytes a chunk the memory that Python has handed out grew."""
    with RunWriter(path, start_ns=0, metadata={}, flush_s=None) as writer:
        tracemalloc.start()
        try:
            for i in range(chunks):
                for signal in of_chunk(i):
                    writer.write("sensors", signal, Header(epoch=1, sequence=i), 1_000_000 * i)
                writer.flush()
                if i == chunks // 3:  # whatever is kept of anything is there
                    before, _ = tracemalloc.get_traced_memory()
            after, _ = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
    return (after - before) // (chunks - chunks // 3)


def test_a_recorder_does_not_grow_with_its_chunks(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """More than is kept in memory at all; the package's own list takes some 700 bytes for two topics."""
    monkeypatch.setattr(chunk_index, "IN_MEMORY_BYTES", 10_000)
    assert write(path) < 20


def test_the_file_is_the_same_as_with_the_packages_own_list(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(path, 300)
    monkeypatch.setattr(chunk_index, "IN_MEMORY_BYTES", 100)
    write(tmp_path / "on_disk.mcap", 300)
    monkeypatch.setattr(chunk_index, "_ENTRIES", "there_is_none")
    write(tmp_path / "plain.mcap", 300)
    assert path.read_bytes() == (tmp_path / "on_disk.mcap").read_bytes() == (tmp_path / "plain.mcap").read_bytes()
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
        assert summary is not None
        assert len(summary.chunk_indexes) == 300
        assert sum(1 for _ in make_reader(file).iter_messages(topics=topics.key_of(GnssFix, "sensors"))) == 300
    assert not [other for other in tmp_path.iterdir() if other.suffix != ".mcap"]


def test_a_writer_that_has_something_in_its_list_keeps_it(tmp_path: Path) -> None:
    with (tmp_path / "own.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start("", "test")
        writer.add_message(writer.register_channel("a", "json", 0), 0, b"{}", 0)
        writer.flush()
        with chunk_index.on_disk(writer, tmp_path):
            writer.finish()
    with (tmp_path / "own.mcap").open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert len(summary.chunk_indexes) == 1


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "run.mcap"
