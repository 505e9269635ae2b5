"""``ltv-mpc log``: info, recover and export of a run's folder, its run.mcap or the latest run."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from services.cli.app import run
from tests.services.recording.recordings import write_depths


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the newest run, with 500 messages, below the working directory."""
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "runs" / "20260101T000000Z-hover"
    folder.mkdir(parents=True)
    (folder / "scenario.toml").write_text('title = "x"\n')
    write_depths(folder / "run.mcap", range(500))
    return folder


def cut(folder: Path) -> None:
    path = folder / "run.mcap"
    path.write_bytes(path.read_bytes()[:-300])


def test_info_of_a_whole_run_is_exit_0_and_of_a_cut_one_exit_1(folder, capsys) -> None:
    assert run(["log", "info", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["messages"], found["whole"]) == (500, True)
    cut(folder)
    assert run(["log", "info", str(folder)]) == 1
    assert "INCOMPLETE" in capsys.readouterr().out


def test_recover_writes_beside_and_a_whole_run_needs_none(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["log", "recover"]) == 0
    assert "nothing to recover" in capsys.readouterr().out
    cut(folder)
    assert run(["log", "recover", "--json", str(folder / "run.mcap")]) == 0
    made = json.loads(capsys.readouterr().out)
    assert made["messages"] == 500
    assert run(["log", "info", made["file"], "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["recovered"]
    assert run(["log", "recover"]) == 2
    assert "exists: name another with --out" in capsys.readouterr().err


def test_export_writes_one_folder_and_rejects_one_that_is_not_empty(folder, capsys) -> None:
    before = (folder / "run.mcap").read_bytes()
    assert run(["log", "export"]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == str(Path("runs") / folder.name / "csv")
    assert [path.name for path in (folder / "csv").iterdir()] == ["sensor-depth.csv"]
    assert run(["log", "export"]) == 2
    assert "not empty" in capsys.readouterr().err
    assert run(["log", "export", "--out", str(folder), "--force", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["files"][0]["file"].endswith("sensor-depth.csv")
    assert (folder / "run.mcap").read_bytes() == before
