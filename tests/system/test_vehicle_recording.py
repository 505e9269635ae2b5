"""A recording beside somebody else's vehicle: controller, recorder and the foreign craft as processes of their own."""

from __future__ import annotations

import contextlib
import io
import json
import sys
import time
from datetime import datetime
from pathlib import Path

import pytest

from services.cli.app import run
from services.reporting.static_files import NoPlotly, plotly
from services.supervisor import loopback
from tests.foreign_plant.flight import HERE, HULL
from tests.foreign_plant.plant import AHEAD_NS
from tests.services.reporting.test_report import data
from tests.system.alone import CLI, started

FLOWN_S = 8.0


def ltv_mpc(*words: str) -> str:
    """Return what a command prints; it must succeed."""
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        assert run(list(words)) == 0, printed.getvalue()
    return printed.getvalue()


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Record a flight of the craft; the recorder starts last but for the craft itself."""
    place = tmp_path_factory.mktemp("vehicle")
    (place / "point.toml").write_text('kind = "point"\nnorth_m = 0.0\neast_m = 0.0\n')
    endpoint = f"tcp/127.0.0.1:{loopback.free_port()}"
    aboard = ("--vehicle", str(HULL), "--reference", str(place / "point.toml"))
    with (
        started(*CLI, "router", "--listen", endpoint) as (_, router),
        started(*CLI, "controller", "--connect", endpoint, *aboard) as (stops_first, controller),
    ):
        router.until(lambda line: "ready at" in line)
        controller.until(lambda line: "waiting for" in line, within_s=300.0)
        with started(*CLI, "recorder", "--connect", endpoint, "--out", str(place / "run")) as (process, recorder):
            recorder.until(lambda line: "waiting for an estimate" in line)
            with started(sys.executable, "-P", str(HERE / "plant.py"), endpoint) as (_, plant):
                recorder.until(lambda line: "following the vehicle's own clock" in line)
                plant.until(lambda line: line.startswith("{") and json.loads(line)["t_s"] >= FLOWN_S)
            stops_first.terminate()
            stops_first.wait(20.0)
            process.terminate()
            recorder.until(lambda line: "messages recorded, none lost" in line)
            assert process.wait(20.0) == 0
    return place / "run"


@pytest.mark.timeout(600)
def test_log_info_describes_the_vehicle_its_clock_and_every_key(recording: Path) -> None:
    found = json.loads(ltv_mpc("log", "info", str(recording), "--json"))
    assert (found["vehicle"], found["mode"], found["missing"], found["whole"]) == ("foreign", "vehicle", 0, True)
    start_s = datetime.fromisoformat(found["start_utc"]).timestamp()
    assert abs(start_s - (time.time() + AHEAD_NS / 1e9)) < 600.0
    assert FLOWN_S <= found["duration_s"] < 120.0
    rates = {key["key"]: key["rate_hz"] for key in found["keys"]}
    assert rates["estimate"] == pytest.approx(10.0, rel=0.2)
    assert {"plan", "applied", "command", "settings/controller", "record/controller"} <= rates.keys()
    assert found["made_by"]["numpy"]


@pytest.mark.timeout(600)
def test_replay_repeats_every_step_of_its_controller_to_the_byte(recording: Path) -> None:
    verdict = json.loads(ltv_mpc("replay", str(recording), "--json"))
    assert verdict["identical"]
    (controller,) = verdict["nodes"]
    assert controller["node"] == "controller"
    assert controller["steps_run"] == controller["steps_identical"] >= 20


@pytest.mark.timeout(600)
def test_the_report_has_track_thrusts_and_delays_and_no_empty_plot(recording: Path) -> None:
    try:
        plotly()
    except NoPlotly as missing:
        pytest.skip(str(missing))
    ltv_mpc("report", str(recording))
    text = (recording / "report.html").read_text()
    shown = data(text)
    assert [plot["name"] for plot in shown["plots"]] == [
        *("track", "tracking", "north", "east", "heading", "thrust", "yaw_rate", "latency", "stages", "histogram")
    ]
    assert "vehicle foreign, times from 20" in text
    (run,) = shown["runs"]
    for plot in shown["plots"]:
        for series in plot["series"]:
            assert series["label"] != "true"
            assert any(value is not None for value in run["tables"][series["table"]][series["y"]])
    assert run["values"]["port_max_N"] == 42.0
    times = run["tables"]["thrust"]["t_s"]
    assert 0.0 <= times[0] < times[-1] < 120.0
    assert "arm accepted" in [mark["text"] for mark in run["marks"]]
