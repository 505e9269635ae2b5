"""A run in lock step with the real nodes: the same bits, nothing measured, and enough on record to replay it."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
from pathlib import Path

import msgspec
import pytest

from ltv_mpc.messages import AdcpPing, Estimate, ImuSamples
from services.cli.app import run
from services.recording.loss_accounting import LossAccounting
from services.recording.reader import Recording
from services.run import folder
from services.run.folder import RunFolder
from services.run.nodes import make_nodes
from services.run.run_config import Override, RunConfig, resolve
from services.run.summary import summarise_recording
from services.supervisor import jit_cache
from services.tools import lockstep_run
from sim.evaluation.summary import Summary


def run_config(*settings: str) -> RunConfig:
    return resolve("descent", [Override("test", settings)])


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[RunConfig, RunFolder, Summary]:
    """Four seconds with every node and a delay."""
    here = run_config("run.duration_s=4", "run.compute_delay_s=0.71", "run.seed=3")
    place = folder.make("descent", here.files, out=tmp_path_factory.mktemp("run") / "out")
    return here, place, lockstep_run.run(here, place)


def test_a_process_with_another_hash_seed_and_folder_writes_the_same_bytes(recorded, tmp_path: Path) -> None:
    _, place, _ = recorded
    out = "another/much/longer/name"
    options = ("--lockstep", "--duration-s", "4", "--compute-delay-s", "0.71", "--seed", "3", "--out", out)
    command, env = [sys.executable, "-P", "-m", "services.cli", "sim", "descent", *options], os.environ.copy()
    subprocess.run(command, cwd=tmp_path, env=env | {"PYTHONHASHSEED": "4242"}, check=True, timeout=200)
    assert place.recording.read_bytes() == (tmp_path / out / "run.mcap").read_bytes()


def test_messages_are_in_order_of_time_without_a_gap_and_all_are_counted(recorded) -> None:
    here, place, summary = recorded
    losses, times = LossAccounting(), []
    for message in Recording(place.recording):
        losses.add(message.key, message.plain["epoch"], message.plain["sequence"])
        times.append(message.t_ns)
    assert times == sorted(times)
    assert times[0] == here.scenario.start_ns
    assert times[-1] == here.scenario.end_ns
    assert losses.missing == 0
    assert summary.messages.published == losses.published == len(times)


def test_the_summary_on_disk_is_the_one_returned_and_says_what_was_asked_for(recorded) -> None:
    _, place, summary = recorded
    assert msgspec.json.decode((place.path / "summary.json").read_bytes(), type=Summary) == summary
    assert (summary.scenario, summary.mode, summary.seed, summary.speed) == ("descent", "lockstep", 3, None)
    assert (summary.duration_s, summary.stages, summary.horizon_s) == (4.0, 34, 13.8)
    assert summary.compute_delay_s.median == summary.compute_delay_s.max == 0.71
    assert summary.compute_delay_wall_s.median is None
    assert summary.cycles == sum(summary.qp_status.values()) == sum(summary.plan_origin.values())


def test_what_nobody_reads_is_measured_for_a_recording_alone_and_changes_nothing(tmp_path: Path) -> None:
    here = run_config("run.duration_s=2", "run.perfect_state=true")
    _, sensors, _ = make_nodes(here, publish_unread_topics=False)
    assert sensors.writes == (Estimate,)
    place = folder.make("descent", here.files, out=tmp_path / "run")
    summary, alone = lockstep_run.run(here, place), lockstep_run.run(here)
    assert {ImuSamples, AdcpPing} <= {message.kind for message in Recording(place.recording)}
    assert msgspec.structs.replace(alone, messages=summary.messages) == summary


def test_with_known_state_there_is_no_estimator_and_no_localisation_error() -> None:
    here = run_config("run.duration_s=2", "run.perfect_state=true")
    assert [node.name for node in make_nodes(here)] == ["plant", "sensors", "controller"]
    summary = lockstep_run.run(here)
    assert summary.localisation_error_absolute_m.max == 0.0
    assert summary.tracking_error_m == summary.true_error_m


def test_the_summary_of_a_recording_is_that_of_the_run_itself(recorded: tuple[RunConfig, RunFolder, Summary]) -> None:
    """But for what only processes have: a speed, and wall times."""
    here, place, summary = recorded
    again, _ = summarise_recording(here, place.recording)
    assert again.mode == "services"
    lockstep = msgspec.structs.replace(
        again,
        mode=summary.mode,
        speed=summary.speed,
        compute_delay_wall_s=summary.compute_delay_wall_s,
        end_to_end_delay_wall_s=summary.end_to_end_delay_wall_s,
    )
    assert lockstep == summary


def test_a_disk_that_stays_full_leaves_the_verdict_exit_1_and_no_draft(tmp_path, capsys) -> None:
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, limits[1]))  # room for the settings, not for the recording
    try:
        code = run(["sim", "--lockstep", "--duration-s", "20", "--out", str(tmp_path / "run")])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, before)
    verdict, said = capsys.readouterr()
    assert code == 1
    assert f"{tmp_path / 'run'}: the run cannot be stored: File too large" in said
    assert "localisation" in verdict
    assert not list((tmp_path / "run").rglob("*.part"))


def test_compiling_is_announced_and_a_signal_ends_it(tmp_path, monkeypatch, capsys) -> None:
    """In place of the compiler a process sends the signal, and would then go on for ten minutes."""
    program = "import os, signal, time; os.kill(os.getppid(), signal.SIGTERM); time.sleep(600)"
    monkeypatch.setattr(jit_cache, "CACHE", tmp_path / "empty")
    monkeypatch.setattr(jit_cache, "command", lambda *_: [sys.executable, "-c", program])
    assert run(["sim", "--lockstep", "--horizon-s", "9", "--out", str(tmp_path / "run")]) == 1
    said = capsys.readouterr().err.splitlines()
    assert jit_cache.NOTE in said
    assert said[-1] == "stopped while compiling"
