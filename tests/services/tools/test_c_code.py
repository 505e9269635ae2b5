"""The exported C code is compiled with the system's compiler and gives the same thrust."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from benchmarks import exported_c
from services.cli.app import run
from services.tools.c_code import MAX_ITERATIONS

needs_compiler = pytest.mark.skipif(
    shutil.which("cc") is None or shutil.which("make") is None,
    reason="the exported code needs a C compiler (cc) and make, which this machine does not have",
)


@needs_compiler
@pytest.mark.parametrize("horizon_s", [1.5, 5.0])
def test_the_compiled_code_gives_the_controller_s_thrust(
    horizon_s: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    settings, folder = tmp_path / "controller.toml", tmp_path / "c"
    settings.write_text(f"horizon_s = {horizon_s}\n")
    assert run(["qp", "export-c", str(folder), "--settings", str(settings), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["stages"] == round(horizon_s / 0.3)
    built = subprocess.run(["make", "-C", str(folder)], check=True, capture_output=True, text=True, timeout=120)
    assert "-O2" in built.stdout
    answer = subprocess.run([str(folder / "emosqp")], check=True, capture_output=True, text=True, timeout=20)
    status, _, *thrust, _ = answer.stdout.split()
    assert status == "1"  # OSQP_SOLVED
    np.testing.assert_allclose([float(x) for x in thrust], said["thrust_N"], atol=0.05)
    assert np.abs(said["thrust_N"]).min() > 5.0  # the sample is not a vehicle at rest
    layout = dict(re.findall(r"#define (\w+) (\S+)", (folder / "mpc_layout.h").read_text()))
    before = [float(layout[f"MPC_{side}_BEFORE"]) for side in ("PORT", "STARBOARD")]
    assert np.abs(np.array(said["thrust_N"]) - before).max() > 1.0  # else what is solved for would not be seen
    assert (int(layout["MPC_VARIABLES"]), int(layout["MPC_ROWS"])) == (said["variables"], said["rows"])


@needs_compiler
def test_the_compiled_code_solves_any_problem_of_the_vehicle_from_nothing(tmp_path: Path) -> None:
    solved = exported_c.solve("paper", exported_c.problems("paper", 24), tmp_path)
    assert (solved.status == 1).all()
    assert solved.error_N.max() <= 0.05
    assert solved.iterations.max() > 200  # some of them are far from the start
    assert solved.iterations.max() <= MAX_ITERATIONS / 2


def test_a_folder_that_is_not_empty_is_left_alone_without_force(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "mine.c").write_text("int x;")
    assert run(["qp", "export-c", str(tmp_path)]) == 2
    assert "--force" in capsys.readouterr().err
    assert [entry.name for entry in tmp_path.iterdir()] == ["mine.c"]
    assert run(["qp", "export-c", str(tmp_path), "--force"]) == 0
    assert (tmp_path / "mine.c").read_text() == "int x;"
    assert (tmp_path / "mpc_workspace.c").exists()


def test_another_solver_is_refused_by_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    settings = tmp_path / "controller.toml"
    settings.write_text('solver = "riccati"\n')
    assert run(["qp", "export-c", str(tmp_path / "c"), "--settings", str(settings)]) == 2
    assert "must be osqp: OSQP" in capsys.readouterr().err
    assert not (tmp_path / "c").exists()
