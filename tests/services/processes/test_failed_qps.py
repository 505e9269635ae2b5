"""Failed QPs: each is written to a file once, up to a maximum number of files."""

from __future__ import annotations

import json
from types import SimpleNamespace

import numpy as np
import pytest

from ltv_mpc.control.config import Weights
from ltv_mpc.control.failed_qp import NamedQp
from ltv_mpc.control.linearisation import linearise
from ltv_mpc.control.ocp.assembly import problem_along, scales
from ltv_mpc.control.problem_data import Constants
from ltv_mpc.messages import Solve, SolveStatus
from ltv_mpc.vehicle.parameters import Vehicle
from services.cli.app import run
from services.processes.controller import FailedQps


@pytest.fixture
def failure():
    """Return what makes a failed QP, of a vehicle at rest 5 m from its point: it wants more than the slew limit."""
    vehicle = Vehicle.load("paper")
    lin = linearise(np.zeros((6, 8)), np.zeros((6, 2)), np.zeros((6, 2)), 0.3, vehicle.coefficients())
    target = np.array([[5.0, 0.0]] * 5 + [[0.0, 0.0]])
    problem = problem_along(lin, target, Constants.of(vehicle, Weights(), np.arange(6.0)))
    solve = Solve(status=SolveStatus.ITERATION_LIMIT, iterations=400, why="slew of port in stage 2 violated by 3 N")
    return lambda: NamedQp.of(problem, scales(vehicle), solve)


def shown(writer, t_ns):
    writer.show(SimpleNamespace(t_ns=t_ns))


def test_each_failure_is_written_once_and_announced_up_to_a_number_of_files(failure, tmp_path):
    recorder, lines, folder = SimpleNamespace(failed=None), [], tmp_path / "failed"
    writer = FailedQps(recorder, folder, lines.append, max_files=2)
    shown(writer, 1)
    assert not folder.exists()
    for t_ns in (2, 4, 6):
        recorder.failed = failure()
        shown(writer, t_ns)
        shown(writer, t_ns + 1)
    assert {path.name for path in folder.iterdir()} == {"qp-2.qp", "qp-4.qp"}
    path = folder / "qp-2.qp"
    assert len(lines) == 2
    assert lines[0] == f"a QP was not solved (slew of port in stage 2 violated by 3 N); saved: ltv-mpc qp show {path}"
    np.testing.assert_array_equal(NamedQp.load(path).qp.q, recorder.failed.qp.q)


def test_a_folder_that_cannot_be_written_is_reported(failure, tmp_path):
    (tmp_path / "file").write_text("in the way")
    lines = []
    shown(FailedQps(SimpleNamespace(failed=failure()), tmp_path / "file", lines.append), 1)
    assert "cannot be saved" in lines[0]


def test_qp_show_solves_it_again_and_lists_the_active_rows(failure, tmp_path, capsys):
    failed = failure()
    failed.save(tmp_path / "one.qp")
    assert run(["qp", "show", str(tmp_path / "one.qp"), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["rows"] == len(failed.rows)
    assert printed["failed"]["iterations"] == 400
    assert printed["solved_again"]["status"] == "solved"
    assert printed["solved_again"]["stationarity"] < 1e-4
    slew = [name for name in printed["solved_again"]["active"] if name.startswith("slew of")]
    assert slew
    assert run(["qp", "show", str(tmp_path / "one.qp")]) == 0
    text = capsys.readouterr().out
    assert "slew of port in stage 2 violated by 3 N" in text
    assert "active    slew of" in text


def test_a_missing_file_is_rejected(tmp_path, capsys):
    assert run(["qp", "show", str(tmp_path / "none.qp")]) == 2
    assert "no such file" in capsys.readouterr().err
