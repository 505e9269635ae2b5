"""A recording beside somebody else's vehicle: controller, recorder and the foreign craft as processes of their own.

A vehicle needs neither the simulation nor the tools: the processes aboard run from a copy without both.
"""

from __future__ import annotations

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
from services.supervisor import loopback
from tests.foreign_plant.flight import HERE, HULL
from tests.foreign_plant.plant import AHEAD_NS
from tests.system.alone import started

FLOWN_S = 7.0
ROOT = Path(__file__).resolve().parents[2]


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
    """Record a flight of the craft, which starts last, behind a router that starts after those who wait for it."""
    place, cli = tmp_path_factory.mktemp("vehicle"), (*python, "-m", "services.cli")
    (place / "point.toml").write_text('kind = "point"\nnorth_m = 0.0\neast_m = 0.0\n')
    endpoint = f"tcp/127.0.0.1:{loopback.free_port()}"
    aboard = ("--vehicle", str(HULL), "--reference", str(place / "point.toml"), "--log-json")
    recorder_of_run = (*cli, "recorder", "--connect", endpoint, "--out", str(place / "run"))
    with (
        started(*cli, "controller", "--connect", endpoint, *aboard) as (stops_first, controller),
        started(*recorder_of_run) as (process, recorder),
    ):
        for lines in (controller, recorder):
            lines.until(lambda line: f"`ltv-mpc router --listen {endpoint}` starts one" in line, within_s=300.0)
        with started(*cli, "router", "--listen", endpoint) as (stops_last, _):
            recorder.until(lambda line: "waiting for an estimate" in line)
            with started(sys.executable, "-P", str(HERE / "plant.py"), endpoint) as (_, plant):
                recorder.until(lambda line: "following the vehicle's own clock" in line)
                plant.until(lambda line: line.startswith("{") and json.loads(line)["t_s"] >= FLOWN_S)
            told = {"note", "health", "authority", "source"}
            controller.until(lambda _: told <= {json.loads(line)["kind"] for line in controller.said})
            stops_first.terminate()
            assert stops_first.wait(20.0) == 0
            process.terminate()
            recorder.until(lambda line: "messages recorded, none lost" in line)
            assert process.wait(20.0) == 0
            stops_last.terminate()
            assert stops_last.wait(20.0) == 0
    return place / "run"


def test_the_copy_has_neither_simulation_nor_tools(python: tuple[str, ...]) -> None:
    for module in ("sim", "services.tools"):
        found = subprocess.run([*python, "-c", f"import {module}"], capture_output=True, text=True, check=False)
        assert f"No module named '{module}'" in found.stderr


@pytest.mark.timeout(600)
def test_it_is_whole_and_dated_and_replays_to_the_byte_and_has_a_report(recording: Path, capsys) -> None:
    """What each command shows beside a vehicle: tests/services/recording, replay and reporting."""
    assert run(["log", "info", str(recording), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["vehicle"], found["mode"], found["missing"], found["whole"]) == ("foreign", "vehicle", 0, True)
    start_s = datetime.fromisoformat(found["start_utc"]).timestamp()
    assert abs(start_s - (time.time() + AHEAD_NS / 1e9)) < 600.0
    rates = {key["key"]: key["rate_hz"] for key in found["keys"]}
    assert rates["estimate"] == pytest.approx(10.0, rel=0.2)
    assert {"plan", "applied", "command", "settings/controller", "record/controller"} <= rates.keys()
    assert run(["replay", str(recording), "--json"]) == 0
    verdict = json.loads(capsys.readouterr().out)
    (controller,) = verdict["nodes"]
    assert (controller["node"], verdict["identical"]) == ("controller", True)
    assert controller["steps_run"] == controller["steps_identical"] >= 20
    assert run(["report", str(recording)]) == 0
