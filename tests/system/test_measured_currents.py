"""Descents through measured currents, as processes over Zenoh and in lock step."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from ltv_mpc.currents import read_profile
from services.run.run_config import Override, RunConfig, resolve
from services.tools import lockstep_run

DATA = Path(__file__).resolve().parents[2].parent / "shared" / "data"
FILES = (
    "MORIA-80_ladcp.csv",
    "glider_comet_2016_current_profile.csv",
    "kolumbo_dive_a_mean.csv",
    "kolumbo_dive_e_mean.csv",
)


def measured(name: str) -> Path:
    path = DATA / name
    if not path.exists():
        pytest.skip(f"{path} is not there: the measured currents are kept beside the checkout, not in it")
    return path


def sim(tmp_path: Path, *options: str) -> dict[str, Any]:
    """Run `ltv-mpc sim` as a user does and return the summary."""
    command = [sys.executable, "-P", "-m", "services.cli", "sim", *options, "--json", "--out", str(tmp_path / "run")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=200, check=False)
    assert done.returncode == 0, done.stderr
    summary: dict[str, Any] = json.loads(done.stdout)
    return summary


def test_processes_run_through_a_measured_current_without_a_message_rejected_or_lost(tmp_path):
    """The strongest current; the others run in lock step, because to the processes they are all alike."""
    current = str(measured(FILES[-1]))
    summary = sim(tmp_path, "descent", "--currents", current, "--duration-s", "16", "--speed", "10")
    assert summary["mode"] == "services"
    assert summary["messages"]["rejected"] == 0
    assert summary["messages"]["dropped"] == 0
    assert summary["plans_refused"] == 0
    assert summary["messages"]["published"] > 3000
    assert summary["thrust"]["max_slew_N_per_s"] <= 100.0 + 1e-6


def in_current(path: Path, *settings: str) -> RunConfig:
    return resolve("descent", [Override("test", ["water.kind=measured", f"water.file={path}", *settings])])


def test_a_vehicle_holds_a_strong_measured_current_that_carries_others_away():
    path, known = measured("kolumbo_dive_e_mean.csv"), ("run.perfect_state=true", "run.duration_s=60")
    held = lockstep_run.run(in_current(path, *known))
    carried = lockstep_run.run(in_current(path, *known, "controller.lateral=false"))
    assert carried.true_error_m.final > 3.0
    assert held.true_error_m.final < 0.2


@pytest.mark.parametrize("name", FILES)
def test_a_profile_is_held_constant_beyond_both_ends_and_the_run_says_so(name):
    profile, here = read_profile(measured(name)), in_current(measured(name))
    for end, beyond_m in ((0, -1.0), (-1, 30.0)):
        velocity = profile.north_mps[end], profile.east_mps[end]
        assert here.water.at(profile.depth_m[end], 0) == pytest.approx(velocity)
        assert here.water.at(profile.depth_m[end] + beyond_m, 10**11) == pytest.approx(velocity)
    assert any(name in note and "constant" in note for note in here.notes)
