"""A recording beside somebody else's vehicle: controller, recorder and the foreign craft as processes of their own.

A vehicle needs neither the simulation nor the tools: the processes aboard run from a copy without both.
"""

from __future__ import annotations

import contextlib
import io
import json
import shutil
import subprocess
import sys
import sysconfig
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
from tests.system.alone import started

FLOWN_S = 8.0
ROOT = Path(__file__).resolve().parents[2]


def ltv_mpc(*words: str) -> str:
    """Return what a command prints; it must succeed."""
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        assert run(list(words)) == 0, printed.getvalue()
    return printed.getvalue()


@pytest.fixture(scope="module")
def python(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, ...]:
    """Return the command line of Python with a copy of the packages without sim/ and services/tools/."""
    place = tmp_path_factory.mktemp("aboard")
    for package in ("ltv_mpc", "services"):
        shutil.copytree(ROOT / package, place / package, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.rmtree(place / "services" / "tools")
    # -S leaves out the link from site-packages to this checkout, whose sim and tools would be found otherwise.
    return "env", f"PYTHONPATH={place}:{sysconfig.get_path('purelib')}", sys.executable, "-S", "-P"


@pytest.fixture(scope="module")
def recording(python: tuple[str, ...], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Record a flight of the craft; the recorder starts last but for the craft itself."""
    place, cli = tmp_path_factory.mktemp("vehicle"), (*python, "-m", "services.cli")
    (place / "point.toml").write_text('kind = "point"\nnorth_m = 0.0\neast_m = 0.0\n')
    endpoint = f"tcp/127.0.0.1:{loopback.free_port()}"
    aboard = ("--vehicle", str(HULL), "--reference", str(place / "point.toml"), "--log-json")
    with (
        started(*cli, "router", "--listen", endpoint) as (_, router),
        started(*cli, "controller", "--connect", endpoint, *aboard) as (stops_first, controller),
    ):
        router.until(lambda line: "ready at" in line)
        controller.until(lambda line: "waiting for" in line, within_s=300.0)
        with started(*cli, "recorder", "--connect", endpoint, "--out", str(place / "run")) as (process, recorder):
            recorder.until(lambda line: "waiting for an estimate" in line)
            with started(sys.executable, "-P", str(HERE / "plant.py"), endpoint) as (_, plant):
                recorder.until(lambda line: "following the vehicle's own clock" in line)
                plant.until(lambda line: line.startswith("{") and json.loads(line)["t_s"] >= FLOWN_S)
            told = {"note", "health", "authority", "source"}
            controller.until(lambda _: told <= {json.loads(line)["kind"] for line in controller.said})
            stops_first.terminate()
            stops_first.wait(20.0)
            process.terminate()
            recorder.until(lambda line: "messages recorded, none lost" in line)
            assert process.wait(20.0) == 0
    return place / "run"


def test_the_copy_has_neither_simulation_nor_tools(python: tuple[str, ...]) -> None:
    for module in ("sim", "services.tools"):
        found = subprocess.run([*python, "-c", f"import {module}"], capture_output=True, text=True, check=False)
        assert f"No module named '{module}'" in found.stderr


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
