"""A vehicle needs neither the simulation nor the tools: with both deleted, plans arrive and are recorded."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

from services.recording.reader import Recording
from services.supervisor import loopback
from tests.system.alone import arm, started

ROOT = Path(__file__).resolve().parents[2]
PUBLISHER = ROOT / "examples" / "python" / "publisher.py"


@pytest.fixture
def command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[str, ...]:
    """Return the command line of a copy of the packages without sim/ and services/tools/, without compilation."""
    place = tmp_path / "vehicle"
    for package in ("ltv_mpc", "services"):
        shutil.copytree(ROOT / package, place / package, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.rmtree(place / "services" / "tools")
    # -S leaves out the link from site-packages to this checkout, whose sim and tools would be found otherwise.
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(place), sysconfig.get_path("purelib")]))
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "1")
    return sys.executable, "-S", "-P"


def test_the_copy_has_neither_simulation_nor_tools(command: tuple[str, ...]) -> None:
    for module in ("sim", "services.tools"):
        found = subprocess.run([*command, "-c", f"import {module}"], capture_output=True, text=True, check=False)
        assert f"No module named '{module}'" in found.stderr


def test_plans_reach_a_publisher_and_the_recording(command: tuple[str, ...], tmp_path: Path) -> None:
    cli, endpoint = (*command, "-m", "services.cli"), f"tcp/127.0.0.1:{loopback.free_port()}"
    here, out = ("--connect", endpoint), tmp_path / "run"
    (tmp_path / "point.toml").write_text('kind = "point"\nnorth_m = 0.0\neast_m = 0.0\n')
    plans = ("--reference", str(tmp_path / "point.toml"), "--horizon-s", "3")  # short: nothing is compiled
    with started(*cli, "router", "--listen", endpoint) as (_, router):
        router.until(lambda line: "ready at" in line)
        with (
            started(*cli, "recorder", "--out", str(out), *here) as (recorder, _),
            started(*cli, "controller", "--log-json", *plans, *here) as (_, controller),
        ):
            controller.until(lambda line: "waiting for" in line)
            with started(*command, str(PUBLISHER), endpoint) as (_, vehicle):
                vehicle.until(lambda line: "disarmed" in line)
                arm(cli, endpoint)
                vehicle.until(lambda line: line.rstrip().endswith("controller"))  # it obeys plans
            controller.until(lambda line: json.loads(line)["text"] == "authority: controller")
            recorder.terminate()
            assert recorder.wait(10.0) == 0
    kinds = {json.loads(line)["kind"] for line in controller.said}
    assert {"note", "health", "authority", "source"} <= kinds
    assert sum(message.key == "plan" for message in Recording(out / "run.mcap")) > 0
