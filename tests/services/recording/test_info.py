"""Summary of a recording: counts, rates, times, gaps by key and source, events, completeness."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ltv_mpc.messages import Estimate, NodeSettings, RunEvent
from services.recording import info
from services.recording.loss_accounting import SequenceGaps
from services.recording.recover import segments
from services.recording.writer import VEHICLE_MODE
from services.reporting import log_text
from tests.services.recording.recordings import START_NS, depth, foreign, write, write_depths

S = 1_000_000_000


@given(st.lists(st.integers(0, 30), min_size=1, max_size=60))
def test_gaps_are_what_a_set_says_whatever_the_order(sequences: list[int]) -> None:
    gaps = SequenceGaps()
    for sequence in sequences:
        gaps.add(sequence)
    missing = sorted(set(range(max(sequences) + 1)) - set(sequences))
    assert gaps.published == max(sequences) + 1
    assert gaps.missing == len(missing)
    assert gaps.doubled == len(sequences) - len(set(sequences))
    assert [i for first, last in gaps.ranges for i in range(first, last + 1)] == missing
    assert all(b[0] > a[1] + 1 for a, b in zip(gaps.ranges, gaps.ranges[1:], strict=False))


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """10 Hz from -1 s on with a gap; then a second start of the source; an event; a second, truncated segment."""
    there = [i for i in range(20) if i not in (5, 6, 9)]
    first = [("sensors", depth(i), 7, i, START_NS + i * S // 10) for i in there]
    event = RunEvent(t_ns=S, node="plant", kind="slowed", text="by 0.4 s")
    path = write(
        tmp_path / "run.mcap",
        [*first, ("plant", event, 3, 0, S)],
        seed="7",
        mode="services",
        **{"scenario.toml": 'title = "a title"\n[made_by]\npython = "3.13"\n'},
    )
    second = tmp_path / "run.2.mcap"
    write_depths(second, range(4), epoch=8)
    second.write_bytes(second.read_bytes()[:-30])
    return path


def test_the_figures_of_a_recording_in_two_segments(recording: Path) -> None:
    found = info.read(segments(recording))
    assert (found.scenario, found.mode, found.seed, found.made_by) == ("a title", "services", "7", {"python": "3.13"})
    assert (found.messages, found.missing, found.unreadable) == (22, 3, 0)
    assert found.duration_s == pytest.approx(2.0)
    by_key = {key.key: key for key in found.keys}
    depths = by_key["sensor/depth"]
    assert (depths.message, depths.messages, depths.missing) == ("PressureDepth", 21, 3)
    assert (depths.first_s, depths.last_s) == (-1.0, pytest.approx(0.9))
    assert depths.rate_hz == pytest.approx(20 / 1.9)
    assert [(of.epoch, of.messages, of.gaps) for of in depths.sources] == [(7, 17, ((5, 6), (9, 9))), (8, 4, ())]
    assert by_key["event/plant"].rate_hz is None
    (event,) = found.events
    assert (event.t_s, event.node, event.kind, event.text) == (1.0, "plant", "slowed", "by 0.4 s")
    assert [(part.file, part.whole, part.messages) for part in found.segments] == [
        ("run.mcap", True, 18),
        ("run.2.mcap", False, 4),
    ]
    assert not found.whole


def test_a_person_reads_the_gaps_the_cut_and_what_to_do(recording: Path) -> None:
    words = log_text.text(info.read(segments(recording)))
    assert "sensor/depth, epoch 7: 3 of 20; sequence 5 to 6, 9" in words
    assert "INCOMPLETE" in words
    assert "ltv-mpc log recover RUN" in words
    assert "plant: slowed: by 0.4 s" in words


def test_messages_without_a_valid_header_are_counted_separately(tmp_path: Path) -> None:
    huge = b"1" + b"0" * 400
    messages = (b"[]", b"{", b'{"epoch":1,"sequence":%s}' % huge, b'{"epoch":%s,"sequence":0}' % huge)
    good = b'{"epoch":1,"sequence":0,"t_ns":%s,"node":"x","kind":"y","text":"z"}' % huge
    found = info.read([foreign(tmp_path / "run.mcap", "event/x", *messages, good, start_ns="1e9")])
    assert (found.messages, found.unreadable, found.events_total, found.events) == (1, 4, 1, ())


BEGAN_NS = 1_790_000_000 * S
"""2026-09-21T14:13:20Z, by a vehicle's clock that counts from 1970."""


@pytest.fixture
def beside_a_vehicle(tmp_path: Path) -> Path:
    """Write what a late recorder has: 10 Hz from sequence 500 on, a loss, a silence of 6 s, another publisher."""
    estimate = Estimate.at_rest(depth_m=None, heading_rad=0.0)
    settings = NodeSettings(node="controller", files={"config/vehicle.toml": 'name = "otter"'}, made_by={"numpy": "2"})
    first = [("estimator", estimate, 7, 500 + i, BEGAN_NS + i * S // 10) for i in range(20) if i != 15]
    second = [("estimator", estimate, 8, i, BEGAN_NS + 8 * S + i * S // 10) for i in range(5)]
    messages = [*first, ("controller", settings, 9, 3, BEGAN_NS + S), *second]
    return write(tmp_path / "run.mcap", messages, start_ns=0, mode=VEHICLE_MODE)


def test_a_recording_beside_a_vehicle_is_described_by_vehicle_date_and_versions(beside_a_vehicle: Path) -> None:
    found = info.read([beside_a_vehicle])
    assert (found.vehicle, found.start_utc, found.made_by) == ("otter", "2026-09-21T14:13:20.000Z", {"numpy": "2"})
    (estimates,) = (key for key in found.keys if key.key == "estimate")
    assert estimates.missing == found.missing == 1  # what came before the recorder is not missing
    assert [(source.first_s, source.last_s) for source in estimates.sources] == [
        (BEGAN_NS / S, pytest.approx(BEGAN_NS / S + 1.9)),
        (BEGAN_NS / S + 8, pytest.approx(BEGAN_NS / S + 8.4)),
    ]
    text = log_text.text(found)
    assert "vehicle otter\nstart 2026-09-21T14:13:20.000Z by the vehicle's own clock, 8.4 s; numpy 2" in text
    assert "estimate, epoch 8: 5 messages, 8.00 to 8.40 s" in text
    assert "estimate: 6.10 s without a message, from 1.90 s on" in text
    assert "estimate, epoch 7: 1 of 20; sequence 515" in text


def test_a_clock_that_counts_from_its_boot_has_no_date(tmp_path: Path) -> None:
    path = write(tmp_path / "run.mcap", [("sensors", depth(0), 7, 0, 5000 * S)], start_ns=0, mode=VEHICLE_MODE)
    found = info.read([path])
    assert (found.start_utc, found.start_s, found.vehicle) == (None, 5000.0, "unknown")
    assert "start at 5000.000 s by the vehicle's own clock" in log_text.text(found)
