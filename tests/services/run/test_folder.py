"""Folder of a run: where it is made, what is rejected, what is written."""

from __future__ import annotations

import json
import os
from pathlib import Path

import msgspec
import numpy as np
import pytest

from ltv_mpc.currents import WaterPrior, read_prior
from ltv_mpc.errors import ConfigError
from services.cli import app
from services.run import folder

FILES = {"scenario.toml": 'title = "abc"\n', "config/vehicle.toml": 'name = "Ä"\n'}


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_without_out_it_is_named_by_utc_time_and_scenario_and_the_last_one_is_the_latest() -> None:
    made = [folder.make("descent", FILES).path for _ in range(3)]  # within one second
    assert len(set(made)) == 3
    assert {path.parent for path in made} == {Path("runs")}
    stamp, _, name = made[0].name.partition("-")
    assert (len(stamp), name) == (len("20261121T054500Z"), "descent")
    assert os.readlink("runs/latest") == made[-1].name  # the tree may be moved


def test_the_settings_files_are_written_as_they_are() -> None:
    made = folder.make("descent", FILES, out=Path("a/b"))
    assert made.scenario.read_text() == FILES["scenario.toml"]
    assert made.config("vehicle").read_text(encoding="utf-8") == FILES["config/vehicle.toml"]
    assert not Path("runs").exists()


def test_an_empty_folder_is_taken_and_one_that_is_not_is_refused_untouched() -> None:
    Path("empty").mkdir()
    folder.make("descent", FILES, out=Path("empty"))
    before = sorted(Path("empty").rglob("*"))
    with pytest.raises(ConfigError, match=r"--out.*empty.*--force"):
        folder.make("descent", {"other.toml": ""}, out=Path("empty"))
    assert sorted(Path("empty").rglob("*")) == before


def test_force_takes_a_full_folder_and_removes_only_what_would_be_taken_for_this_run() -> None:
    Path("full").mkdir()
    for name in ("run.mcap", "run.2.mcap", "summary.json", "currents.csv", "notes.txt"):
        Path("full", name).write_text("old")
    folder.make("descent", FILES, out=Path("full"), force=True)
    assert sorted(p.name for p in Path("full").iterdir()) == ["config", "notes.txt", "scenario.toml"]


@pytest.mark.parametrize("out", [Path("file"), Path("file/below"), None])
def test_a_file_in_the_way_is_refused_in_words(out: Path | None) -> None:
    for name in ("file", "runs"):
        Path(name).write_text("")
    with pytest.raises(ConfigError, match=r"option --out: .*cannot be written"):
        folder.make("descent", FILES, out=out)


class Result(msgspec.Struct):
    """Result of a run."""

    cycles: int
    max_abs_N: float | None = None


def test_the_summary_is_json_with_nulls_the_water_a_prior_and_neither_leaves_a_draft() -> None:
    made = folder.make("descent", {}, out=Path("here"))
    made.write_result(Result(3), None)
    assert json.loads((made.path / "summary.json").read_text()) == {"cycles": 3, "max_abs_N": None}
    assert [p.name for p in Path("here").iterdir()] == ["summary.json"]
    one = np.ones(1)
    water = WaterPrior(depth_m=one, north_mps=one, east_mps=-one, sd_mps=one / 3, sd_common_mps=0.1)
    made.write_result(Result(3), water)
    assert read_prior(made.path / "currents.csv").sd_mps[0] == 1 / 3
    assert sorted(p.name for p in Path("here").iterdir()) == ["currents.csv", "summary.json"]


def test_a_run_is_found_by_its_folder_its_recording_or_as_the_latest() -> None:
    made = [folder.make(name, FILES) for name in ("first", "second", "third")]
    for run in made:
        run.recording.write_bytes(b"any")
    Path("runs/notes").mkdir()
    os.utime(made[1].scenario, ns=(2**62, 2**62))  # begun last, whatever it is called and wherever the link points
    assert folder.find("latest") == made[1].recording
    vehicle = Path("runs/vehicle/run.mcap")  # without a scenario
    vehicle.parent.mkdir()
    vehicle.write_bytes(b"any")
    assert folder.find("latest") == made[1].recording
    os.utime(vehicle, ns=(2**62 + 1, 2**62 + 1))
    assert folder.find("latest") == vehicle
    assert folder.find(str(made[0].path)) == folder.find(str(made[0].recording)) == made[0].recording
    bare = Path("elsewhere.mcap")
    bare.write_bytes(b"any")
    assert folder.find("elsewhere.mcap") == bare


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        ("latest", "no run below .*runs: name the folder of a run"),
        ("empty", r"RUN empty: there is no run\.mcap in this folder: name the folder"),
        ("bag", r"RUN bag: .*it has bag_0\.db3, bag_0\.mcap; name an \.mcap file"),
        ("a\0b", "cannot be read|no such folder or file"),
    ],
)
def test_what_is_no_run_is_refused_with_what_would_be(text: str, wrong: str) -> None:
    Path("empty").mkdir()
    folder.write_files(Path("bag"), dict.fromkeys(("bag_0.mcap", "bag_0.db3", "metadata.yaml"), ""))
    with pytest.raises(ConfigError, match=wrong):
        folder.find(text)


def test_a_folder_that_a_run_writes_is_refused_to_a_second_one_even_by_force(tmp_path, capsys) -> None:
    out = tmp_path / "run"
    with folder.reserve("descent", FILES, out=out) as made:
        made.recording.write_bytes(b"any")
        scenario = str(made.scenario)
        for words in (["sim", "--lockstep", "--force"], ["recorder", "--force"], ["recorder", scenario, "--continue"]):
            assert app.run([*words, "--out", str(out)]) == 2
            assert "another run writes into this folder: wait for its end" in capsys.readouterr().err
        assert made.recording.exists()
    with folder.reserve("descent", FILES, out=out, force=True) as made:
        assert not made.recording.exists()
    with folder.reserve("descent", FILES):
        assert app.run(["recorder", "--force", "--out", "runs/latest"]) == 2


def test_a_recording_is_continued_only_in_the_folder_of_its_scenario(capsys: pytest.CaptureFixture[str]) -> None:
    made = folder.make("descent", FILES, out=Path("here"))
    for words in (
        ["--continue"],
        ["--continue", "--out", "here"],
        [str(made.scenario), "--continue"],
        ["descent", "--out", "here", "--continue"],
    ):
        assert app.run(["recorder", *words]) == 2
        assert "option --continue: needs --out DIR" in capsys.readouterr().err
    with folder.reserve("descent", {}, out=Path("here"), resume=True) as same:
        assert same.scenario.read_text() == FILES["scenario.toml"]
