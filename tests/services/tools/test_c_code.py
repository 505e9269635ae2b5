"""The exported C code is compiled with the system's compiler and gives the controller's thrusts."""

from __future__ import annotations

import json
import shutil
import subprocess

import numpy as np
import pytest

from ltv_mpc.control.solvers import Result
from ltv_mpc.control.solvers.recorder import RecordingSolver
from services.cli.app import run

PROGRAM = """
#include <stdio.h>
#include "osqp.h"
#include "mpc_workspace.h"
#include "mpc_layout.h"

int main(void) {
  int k, i;
  double worst = 0.0, *x;
  osqp_solve(&mpc_solver);
  x = mpc_solver.solution->x;
  printf("%d %d %zu %zu\\n", (int)mpc_solver.info->status_val, (int)mpc_solver.info->iter,
         sizeof mpc_column_scale / sizeof(double), sizeof mpc_row_factor / sizeof(double));
  for (k = 0; k < MPC_STAGES; k++)
    for (i = 0; i < 2; i++)
      printf("%.17g %.17g\\n", x[mpc_commands[k][i]] * mpc_column_scale[mpc_commands[k][i]], mpc_solution_N[k][i]);
  return 0;
}
"""


@pytest.mark.skipif(
    shutil.which("gcc") is None or shutil.which("make") is None,
    reason="the exported code needs a C compiler (gcc) and make, which this machine does not have",
)
@pytest.mark.parametrize("settings", ["horizon_s = 1.5", "[limits]\nmax_surge_mps = 0.1\nmin_surge_mps = -0.1"])
def test_the_compiled_code_gives_the_controller_s_thrusts(settings, tmp_path, capsys) -> None:
    file, folder = tmp_path / "controller.toml", tmp_path / "c"
    file.write_text(settings)
    assert run(["qp", "export-c", str(folder), "--settings", str(file), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    subprocess.run(["make", "-C", str(folder)], check=True, capture_output=True, timeout=120)
    assert "no error" in subprocess.run([folder / "emosqp"], capture_output=True, text=True, timeout=20).stdout
    (folder / "emosqp.c").write_text(PROGRAM)
    subprocess.run(["make", "-C", str(folder)], check=True, capture_output=True, timeout=120)
    answer = subprocess.run([folder / "emosqp"], check=True, capture_output=True, text=True, timeout=20).stdout
    first, *thrusts = answer.splitlines()
    status, iterations, columns, rows = map(int, first.split())
    assert (status, columns, rows) == (1, said["variables"], said["rows"])  # 1: OSQP_SOLVED
    assert iterations > 5  # it does not begin at the solution
    by_c, by_the_controller = np.array([line.split() for line in thrusts], dtype=float).T
    assert len(by_c) == 2 * said["stages"]
    np.testing.assert_allclose(by_c, by_the_controller, atol=0.05)
    assert np.abs(by_c).max() > 5.0


def test_a_problem_that_is_not_solved_is_not_exported(tmp_path, capsys, monkeypatch) -> None:
    def broken(*_: object, **__: object) -> Result:
        raise ValueError("as asked")

    monkeypatch.setattr(RecordingSolver, "solve", broken)
    assert run(["qp", "export-c", str(tmp_path / "c")]) == 2
    assert "is not solved: ValueError: as asked" in capsys.readouterr().err
    assert not (tmp_path / "c").exists()


def test_a_folder_that_is_not_empty_is_left_alone_without_force(tmp_path, capsys) -> None:
    (tmp_path / "mine.c").write_text("int x;")
    assert run(["qp", "export-c", str(tmp_path)]) == 2
    assert "--force" in capsys.readouterr().err
    assert [entry.name for entry in tmp_path.iterdir()] == ["mine.c"]
    assert run(["qp", "export-c", str(tmp_path), "--force"]) == 0
    assert (tmp_path / "mine.c").read_text() == "int x;"
    assert (tmp_path / "mpc_workspace.c").exists()
