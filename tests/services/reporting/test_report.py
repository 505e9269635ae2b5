"""report.html: one file that holds everything, of one run or of several, complete or cut off."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import msgspec
import pytest

from ltv_mpc.messages import Clock, LocalisationReport, NodeSettings, Truth
from services.bus.wire import Header
from services.cli import app
from services.recording.writer import VEHICLE_MODE, RunWriter
from services.reporting import static_files
from services.reporting.plots.description import Group
from tests.services.reporting import synthetic_run

NONE = {"max": None, "final": None}
SUMMARY = {
    **{"mode": "services", "speed": 10.0, "seed": 3, "cycles": 66},
    **{"true_error_m": {"mean": 0.25, **NONE}, "tracking_error_m": {"mean": 0.02, **NONE}},
    "localisation_error_m": {"mean": 0.24, **NONE},
}
OTHER = {**SUMMARY, "cycles": 60, "true_error_m": {"mean": 0.5, **NONE}, "restarts": 2}


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folders = tmp_path_factory.mktemp("runs") / "first", tmp_path_factory.mktemp("runs") / "second"
    for folder, summary in zip(folders, (SUMMARY, OTHER), strict=True):
        folder.mkdir()
        synthetic_run.record(folder / "run.mcap")
        (folder / "summary.json").write_text(json.dumps(summary))
    return folders


def data(text: str) -> dict[str, Any]:
    match = re.search(r'<script type="application/json" id="data">(.*?)</script>', text, flags=re.S)
    assert match
    found: dict[str, Any] = json.loads(match[1])
    return found


def test_a_run_s_report_is_one_small_file_in_its_folder_and_nothing_of_a_recording_is_markup(runs, capsys) -> None:
    """The text of an event contains an HTML tag and the end of a script."""
    assert app.run(["report", str(runs[0])]) == 0
    out = capsys.readouterr().out
    report = runs[0] / "report.html"
    assert out.splitlines()[-1] == str(report)
    assert re.search(r"true error, mean \(m\) +0\.250", out)
    text = report.read_text()
    assert "The vehicle was 0.250 m from the reference on average. Drift of the estimate is the larger part" in text
    assert "<code>--perfect-state</code>" in text
    assert report.stat().st_size < 8e6
    assert not re.search(r"<(script|link|img|iframe)[^>]*(src|href)=.?(http|/|\.)", text)
    (run,) = data(text)["runs"]
    assert run["tables"]["thrust"]["port_N"][0] == 15.0
    assert run["values"]["port_max_N"] == 62.5
    assert "<b>a mark</b>" not in text
    assert [mark["text"] for mark in run["marks"]][-1] == synthetic_run.EVENT.text


def test_the_first_part_says_whether_the_run_was_safe(runs: tuple[Path, Path], tmp_path: Path) -> None:
    """Before the plots; of several runs as a table, below the distance of each from the reference."""
    assert app.run(["report", str(runs[0])]) == 0
    assert app.run(["report", *map(str, runs), "--out", str(tmp_path / "both")]) == 0
    one, both = ((folder / "report.html").read_text() for folder in (runs[0], tmp_path / "both"))
    for text in (one, both):
        assert text.index(f"<h2>{Group.SAFE.value}</h2>") < text.index('<div id="plots">')
        assert "nominal in all 70 cycles" in text
    assert one.index("arm accepted") < one.index('<div id="plots">')
    assert "first: made up, vehicle paper, as processes at 10 x real time, seed 3 · The vehicle was 0.250 m" in both


def test_several_runs_lie_over_each_other_with_their_differences(runs, tmp_path, capsys) -> None:
    assert app.run(["report", *map(str, runs), "--out", str(tmp_path / "both"), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["report"] == str(tmp_path / "both" / "report.html")
    figures = {row["label"]: row for row in printed["figures"]}
    assert figures["true error, mean"]["values"] == [0.25, 0.5]
    assert figures["true error, mean"]["differences"] == [0.25]
    assert figures["cycles"]["differences"] == [-6]
    assert figures["restarts"]["differences"] == [None]
    assert "true error, largest" not in figures
    shown = data((tmp_path / "both" / "report.html").read_text())["runs"]
    assert [run["name"] for run in shown] == ["first", "second"]
    assert len({run["colour"] for run in shown}) == 2


def test_of_a_run_that_was_cut_off_the_report_says_so(runs: tuple[Path, Path], tmp_path: Path) -> None:
    whole = (runs[0] / "run.mcap").read_bytes()
    (tmp_path / "run.mcap").write_bytes(whole[: len(whole) // 2])
    assert app.run(["report", str(tmp_path)]) == 0
    text = (tmp_path / "report.html").read_text()
    assert "the recording was cut off" in text
    assert data(text)["runs"][0]["tables"]["track"]["t_s"]


def test_what_is_no_run_or_already_there_is_refused(runs, tmp_path, capsys) -> None:
    (tmp_path / "run.mcap").write_text("no recording")
    there = tmp_path / "there.html"
    there.write_text("mine")
    for arguments, word in (
        ([str(tmp_path / "nowhere")], "nowhere"),
        ([str(tmp_path)], "not an MCAP file"),
        ([str(runs[0]), "--out", str(there)], "--force"),
        ([str(runs[0])] * 41, "at most 40"),
    ):
        assert app.run(["report", *arguments]) == 2
        assert word in capsys.readouterr().err
    assert there.read_text() == "mine"
    assert not (tmp_path / "report.html").exists()


def test_without_plotly_a_run_says_in_one_line_that_it_wrote_none(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.setattr(static_files, "find_spec", lambda _: None)
    static_files.report_scripts.cache_clear()
    out = tmp_path / "run"
    assert app.run(["sim", "--lockstep", "--duration-s", "0.5", "--surface-time-s", "1", "--out", str(out)]) == 0
    said = [line for line in capsys.readouterr().err.splitlines() if "report.html" in line]
    assert said == ["no report.html: plotly is not installed: pip install plotly (extra viz)"]
    assert (out / "summary.json").exists()
    assert not (out / "report.html").exists()
    assert app.run(["report", str(out)]) == 1
    assert capsys.readouterr().err == "report: plotly is not installed: pip install plotly (extra viz)\n"


def test_beside_a_vehicle_no_plot_of_a_truth_is_drawn_and_times_count_from_the_start(tmp_path: Path) -> None:
    """The same dive, as a recorder beside a vehicle has it whose clock counts from 1970."""
    began_ns = 1_790_000_000 * synthetic_run.S
    times = {"t_ns", "cycle_t_ns", "plan_cycle_t_ns", "plan_received_t_ns"}
    settings = NodeSettings(node="controller", files={"config/vehicle.toml": synthetic_run.VEHICLE}, made_by={})
    with RunWriter(tmp_path / "run.mcap", start_ns=0, metadata={"mode": VEHICLE_MODE}) as writer:
        writer.write("controller", settings, Header(epoch=1, sequence=0), began_ns)
        for i, (node, message, t_ns) in enumerate(synthetic_run.dive()):
            if isinstance(message, (Truth, Clock)):
                continue
            later: dict[str, Any] = {
                name: getattr(message, name) + began_ns for name in times & {*message.__struct_fields__}
            }
            if isinstance(message, LocalisationReport):
                samples = (msgspec.structs.replace(one, t_ns=one.t_ns + began_ns) for one in message.innovations)
                later["innovations"] = tuple(samples)
            moved = msgspec.structs.replace(message, **later)
            writer.write(node, moved, Header(epoch=synthetic_run.EPOCH, sequence=i), t_ns + began_ns)
    assert app.run(["report", str(tmp_path)]) == 0
    text = (tmp_path / "report.html").read_text()
    assert "vehicle paper, times from 2026-09-21T14:13:20.000Z by its own clock" in text
    assert "config/vehicle.toml" in text
    shown = data(text)
    labels = {plot["name"]: [series["label"] for series in plot["series"]] for plot in shown["plots"]}
    assert labels["tracking"] == ["estimate"]
    assert labels["errors"] == ["2 sigma of the estimate"]
    assert not any("true" in label for of_plot in labels.values() for label in of_plot)
    (run,) = shown["runs"]
    assert run["values"]["port_max_N"] == 62.5
    plotted = [t for table in run["tables"].values() for t in table.get("t_s", ())]
    assert max(map(abs, plotted + [mark["t_s"] for mark in run["marks"]])) < 1000.0
