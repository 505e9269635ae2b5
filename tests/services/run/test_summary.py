"""Summary of a recording of processes, written by hand: losses, restarts, rejections, wall times."""

from __future__ import annotations

from pathlib import Path

import pytest
from msgspec.structs import replace

from ltv_mpc.messages import CycleTiming, Estimate, NodeStatus, PressureDepth, RejectedFrame
from services.bus import wire
from services.recording.writer import RunWriter
from services.run.run_config import Override, resolve
from services.run.summary import GrowingSummary, summarise_recording
from sim.evaluation.summary import Messages, Summary
from tests.services.recording.recordings import write_depths
from tests.services.words import status
from tests.waiting import until

ESTIMATE = Estimate.at_rest()
REJECTED = RejectedFrame(t_ns=0, node="estimator", key="sensor/depth", reason="range", crc=0, payload_base64="")
DEPTH = PressureDepth(t_ns=0, depth_m=1.0)


def timing(ms: int) -> CycleTiming:
    return CycleTiming(
        t_ns=0,
        compute_ns=10 * ms * 1_000_000,
        compute_wall_ns=ms * 1_000_000,
        estimate_age_ns=50_000_000,
        stage_us={"solve": 100.0 * ms},
    )


def rejecting(node: str, count: int) -> NodeStatus:
    return replace(status(node), rejected=count)


@pytest.fixture
def summary(tmp_path: Path) -> Summary:
    path = tmp_path / "run.mcap"
    with RunWriter(path, start_ns=0, metadata={}) as writer:
        for node, signal, epoch, sequence in (
            ("controller", status("controller"), 11, 0),
            ("controller", status("controller"), 11, 1),
            ("controller", timing(1), 11, 0),
            ("controller", timing(3), 11, 3),  # two are missing
            ("estimator", status("estimator"), 13, 0),
            ("estimator", REJECTED, 13, 0),
            ("estimator", ESTIMATE, 13, 0),
            ("sensors", DEPTH, 14, 0),
            ("sensors", rejecting("sensors", 4), 14, 0),  # whose messages about it were lost
            ("recorder", rejecting("recorder", 3), 17, 0),
            ("recorder", replace(REJECTED, node="recorder"), 17, 0),  # the estimator's, once more
            ("router", rejecting("router", 30_000), 15, 0),
            ("router", rejecting("router", 39_000), 15, 1),
            ("router", rejecting("router", 786), 16, 0),  # restarted
            ("controller", status("controller"), 12, 0),  # started anew
        ):
            t_ns = 20_000_000_000 if epoch in (12, 16) else 0
            writer.write(node, signal, wire.Header(epoch=epoch, sequence=sequence, sent_monotonic_us=5), t_ns)
        # An estimate that no node would let in.
        rubbish = wire.to_map(ESTIMATE, wire.Header(epoch=13, sequence=1, sent_monotonic_us=5)) | {"north_m": None}
        writer.write_plain("estimate", Estimate, rubbish, 0)
    return summarise_recording(resolve("descent", [Override("test", ["run.speed=10"])]), path)[0]


def test_gaps_of_the_sequences_are_dropped_messages(summary: Summary) -> None:
    published = 3 + 4 + 1 + 1 + 1 + 1 + 2 + 4
    assert summary.messages == Messages(published=published, dropped=2, rejected=1 + 4, denied=39_786)


def test_each_further_epoch_of_a_process_is_a_restart(summary: Summary) -> None:
    assert summary.restarts == 2


def test_times_are_in_vehicle_and_in_wall_seconds(summary: Summary) -> None:
    assert summary.speed == 10.0
    assert (summary.compute_delay_s.median, summary.compute_delay_wall_s.median) == (0.02, 0.002)


def test_a_run_that_never_began_has_no_errors_and_no_duration(summary: Summary) -> None:
    assert (summary.mode, summary.duration_s, summary.cycles) == ("services", 0.0, 0)
    assert summary.true_error_m.mean is None


def test_what_is_written_is_read_beside_it_and_a_file_without_an_end_is_left_to_its_recovery(tmp_path: Path) -> None:
    run_config, path, whole = resolve("descent"), tmp_path / "run.mcap", write_depths(tmp_path / "whole", range(2000))
    content, at_once = whole.read_bytes(), []
    half = len(content) // 2
    path.write_bytes(content[:half])
    growing, cut = GrowingSummary(run_config, path), GrowingSummary(run_config, path)
    (records,) = growing._recording.parts
    until(lambda: records.position > half // 2)
    assert cut.result(at_once.append) is None
    with path.open("ab") as file:
        file.write(content[half:])
    assert growing.result(at_once.append) == summarise_recording(run_config, whole)
    assert 0.0 <= min(at_once) <= max(at_once) <= 1.0  # the second may not have begun to read
