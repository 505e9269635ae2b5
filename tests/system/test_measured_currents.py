"""Descents through measured currents, in lock step; to the processes of a run all currents are alike."""

from __future__ import annotations

from pathlib import Path

import pytest

from ltv_mpc.currents import read_profile
from services.run import folder
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


def in_current(path: Path, *settings: str) -> RunConfig:
    return resolve("descent", [Override("test", ["water.kind=measured", f"water.file={path}", *settings])])


def test_a_vehicle_holds_a_strong_measured_current_that_carries_others_away():
    path, known = measured("kolumbo_dive_e_mean.csv"), ("run.perfect_state=true", "run.duration_s=60")
    held = lockstep_run.run(in_current(path, *known))
    carried = lockstep_run.run(in_current(path, *known, "controller.lateral=false"))
    assert carried.true_error_m.final > 3.0
    assert held.true_error_m.final < 0.2


@pytest.mark.parametrize("name", FILES)
def test_a_profile_is_held_constant_beyond_both_ends_and_the_run_and_its_folder_say_so(name, tmp_path):
    profile, here = read_profile(measured(name)), in_current(measured(name))
    with folder.reserve(here.name, here.files, out=tmp_path / "run") as made:
        in_processes = resolve(str(made.scenario))
    for end, beyond_m in ((0, -1.0), (-1, 30.0)):
        velocity, depth_m = (profile.north_mps[end], profile.east_mps[end]), profile.depth_m[end]
        for run in (here, in_processes):
            assert run.water.at(depth_m, 0) == pytest.approx(velocity)
            assert run.water.at(depth_m + beyond_m, 10**11) == pytest.approx(velocity)
    assert any(name in note and "constant" in note for note in here.notes)
