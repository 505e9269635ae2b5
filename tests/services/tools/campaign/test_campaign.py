"""Campaigns of short runs: interrupted and gone on with, in this process and by a worker the same bytes."""

from __future__ import annotations

import json
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

from services.cli.app import run
from services.run.run_config import Override, resolve
from services.tools import lockstep_run
from services.tools.batch import executor
from services.tools.campaign import campaign
from tests.waiting import until

FILE = """
title = "test"
minimise = "tracking_error_m.mean"
seeds.first = 3
seeds.count = 3
[set]
run.perfect_state = true
run.duration_s = 0.9
[vary]
controller.horizon_s = [0.6, 1.2]
vehicle.thruster.port.arm_m = [0.15, 0.2]
"""


def told(capsys: pytest.CaptureFixture[str], *options: object, code: int = 0) -> dict[str, Any]:
    assert run(["campaign", *map(str, options), "--json"]) == code
    return json.loads(capsys.readouterr().out)


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("campaign") / "c.toml"
    path.write_text(FILE)
    return path


def run_each_here(work: Callable[[Any], Any], jobs: Sequence[Any], **_: object) -> Iterator[tuple[int, Any]]:
    """Execute the jobs in this process, which has all compiled code; the results come in another order."""
    return reversed(list(enumerate(map(work, jobs))))


@pytest.fixture(scope="module")
def finished(file: Path) -> Path:
    """Finish the campaign without a worker."""
    out = file.parent / "one"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(campaign, "run_each", run_each_here)
        assert run(["campaign", str(file), "--out", str(out), "--json"]) == 0
    return out


def results(folder: Path) -> bytes:
    return (folder / "results.parquet").read_bytes()


def lines(folder: Path) -> list[str]:
    """Return the lines of the store: the settings, and one row for each run."""
    return (folder / "results.jsonl").read_text().splitlines(keepends=True)


def test_each_row_is_the_run_that_its_settings_make(finished: Path) -> None:
    rows = pq.read_table(finished / "results.parquet").to_pylist()
    assert [(row["point"], row["seed"]) for row in rows] == [(p, s) for p in range(4) for s in (3, 4, 5)]
    assert all(row["failed"] is None for row in rows)
    settings = ["run.perfect_state=true", "run.duration_s=0.9", "controller.horizon_s=1.2", "run.seed=4"]
    summary = lockstep_run.run(resolve("descent", [Override("test", settings)]))
    (row,) = (r for r in rows if r["point"] == 3 and r["seed"] == 4)  # 1.2 s and the arm of the file itself
    assert row["vehicle.thruster.port.arm_m"] == 0.2
    assert row["tracking_error_m.mean"] == summary.tracking_error_m.mean
    assert row["thrust.travel_N"] == summary.thrust.travel_N
    assert row["qp_status.solved"] == summary.qp_status["solved"]
    (shorter,) = (r for r in rows if r["point"] == 2 and r["seed"] == 4)  # a shorter arm on one side
    assert shorter["thrust.travel_N"] != row["thrust.travel_N"]


def test_nothing_measured_is_in_the_results(finished: Path) -> None:
    columns = pq.read_schema(finished / "results.parquet").names
    assert not [name for name in columns if "wall" in name or "host" in name or "speed" in name]
    timing = pq.read_table(finished / "timing.parquet").to_pylist()
    assert all(row["wall_s"] > 0 and row["host"] for row in timing)
    assert len(timing) == 12


@pytest.mark.timeout(700)
def test_with_a_worker_interrupted_and_gone_on_with_it_gives_the_same_bytes(
    file: Path, finished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """12 runs, so that some are left each time. A row may be cut off."""
    out, ended = tmp_path / "out", threading.Event()

    def interrupt() -> None:
        until(lambda: ended.is_set() or ((out / "results.jsonl").exists() and len(lines(out)) > 1))
        if not ended.is_set():
            os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=interrupt)
    thread.start()
    try:
        assert run(["campaign", str(file), "--out", str(out), "--workers", "1"]) == 130
    finally:
        ended.set()
        thread.join()
    assert "of 12 runs left: continue with the same command and --out" in capsys.readouterr().err
    interrupted = lines(out)
    assert len(interrupted) < 13
    (out / "results.jsonl").write_text("".join([*interrupted, interrupted[-1][:40]]))
    monkeypatch.setattr(campaign, "run_each", run_each_here)
    going_on = told(capsys, file, "--out", out)
    assert (going_on["runs"], going_on["done"], going_on["failed"]) == (12, 12, 0)
    assert lines(out)[: len(interrupted)] == interrupted  # not done again
    assert len(lines(out)) == 13
    assert results(out) == results(finished)


def test_runs_that_cannot_be_made_are_listed_and_the_rest_goes_on(tmp_path, capsys, monkeypatch) -> None:
    """Each value is good alone; a cell of 3 m in a column of 2 m is not."""
    text = FILE.replace("controller.horizon_s = [0.6, 1.2]", "water.cell_m = [1.0, 3.0]\nwater.deepest_m = [2.0, 70.0]")
    text = text.replace("vehicle.thruster.port.arm_m = [0.15, 0.2]", "").replace("seeds.count = 3", "seeds.count = 1")
    path = tmp_path / "c.toml"
    path.write_text(text)
    monkeypatch.setattr(campaign, "run_each", run_each_here)
    said = told(capsys, path, "--out", tmp_path / "out")
    assert (said["done"], said["failed"]) == (4, 1)
    rows = pq.read_table(tmp_path / "out" / "results.parquet").to_pylist()
    (failed,) = (row for row in rows if row["failed"])
    assert (failed["water.cell_m"], failed["water.deepest_m"]) == (3.0, 2.0)
    assert "[water] cell_m = 3.0" in failed["failed"]
    assert failed["tracking_error_m.mean"] is None


def test_a_value_outside_its_bounds_is_refused_before_anything_is_made(tmp_path, capsys) -> None:
    path = tmp_path / "c.toml"
    path.write_text(FILE.replace("[0.15, 0.2]", "[0.15, -0.2]"))
    assert run(["campaign", str(path), "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert "[vary] vehicle.thruster.port.arm_m" in said
    assert "-0.2" in said
    assert not (tmp_path / "out").exists()


def test_a_scheduler_that_is_not_there_is_refused(file, tmp_path, free_port, capsys, monkeypatch) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr(executor, "CLUSTER_TIMEOUT_S", 0.2)
    cluster = f"tcp://127.0.0.1:{free_port}"
    assert run(["campaign", str(file), "--out", str(tmp_path / "out"), "--cluster", cluster]) == 2
    assert f'option --cluster: "{cluster}"' in capsys.readouterr().err
