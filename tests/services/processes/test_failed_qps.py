"""What the controller could not solve ends up in files, once each, and not without end."""

from __future__ import annotations

import json
from types import SimpleNamespace

import numpy as np
import pytest

from ltv_mpc.control.config import Weights
from ltv_mpc.control.qp.failed_qp import FailedQp
from ltv_mpc.control.qp.sparse import SparseQp
from ltv_mpc.messages import Solve, SolveStatus
from services.cli.app import run
from services.processes import failed_qps
from services.processes.failed_qps import FailedQps
from tests.ltv_mpc.control.problems import LIMITS, equidistant, motion


@pytest.fixture
def failure():
    form = SparseQp(equidistant(5), LIMITS, Weights())
    qp = form.build(*motion(3, 5))
    solve = Solve(status=SolveStatus.ITERATION_LIMIT, iterations=400, why="slew of port in stage 2 violated by 3 N")
    return lambda: FailedQp(qp, form.row_names, solve)


def shown(keeper, t_ns):
    keeper.show(SimpleNamespace(t_ns=t_ns), 0)


def test_each_failure_is_kept_once_and_a_person_is_told_how_to_see_it(failure, tmp_path):
    controller, said = SimpleNamespace(failed=None), []
    keeper = FailedQps(controller, tmp_path / "failed", said.append)
    shown(keeper, 1)
    assert not (tmp_path / "failed").exists()
    controller.failed = failure()
    shown(keeper, 2)
    shown(keeper, 3)
    (path,) = (tmp_path / "failed").iterdir()
    assert path.name == "qp-2.npz"
    assert said == [
        f"a QP was not solved (slew of port in stage 2 violated by 3 N); saved: ltv-mpc qp show {path}",
    ]
    np.testing.assert_array_equal(FailedQp.load(path).qp.q, controller.failed.qp.q)


def test_it_keeps_no_more_than_it_says(failure, tmp_path, monkeypatch):
    monkeypatch.setattr(failed_qps, "MOST", 2)
    controller = SimpleNamespace(failed=None)
    keeper = FailedQps(controller, tmp_path, lambda _text: None)
    for t_ns in range(4):
        controller.failed = failure()
        shown(keeper, t_ns)
    assert len(list(tmp_path.iterdir())) == 2


def test_a_folder_that_cannot_be_written_is_said_and_ends_nothing(failure, tmp_path):
    (tmp_path / "file").write_text("in the way")
    said = []
    shown(FailedQps(SimpleNamespace(failed=failure()), tmp_path / "file", said.append), 1)
    assert "cannot be saved" in said[0]


def test_qp_show_solves_it_again_and_says_what_holds_it_back(failure, tmp_path, capsys):
    kept = failure()
    kept.save(tmp_path / "one.npz")
    assert run(["qp", "show", str(tmp_path / "one.npz"), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["rows"] == len(kept.rows)
    assert told["failed"]["iterations"] == 400
    assert told["solved_again"]["status"] == "solved"
    assert told["solved_again"]["stationarity"] < 1e-4
    x = [name for name in told["solved_again"]["active"] if name.startswith("slew of")]
    assert x  # 30 N a stage is less than the motion drawn at random asks for
    assert run(["qp", "show", str(tmp_path / "one.npz")]) == 0
    text = capsys.readouterr().out
    assert "slew of port in stage 2 violated by 3 N" in text
    assert "active    slew of" in text


def test_a_file_that_is_none_is_refused(tmp_path, capsys):
    assert run(["qp", "show", str(tmp_path / "none.npz")]) == 2
    assert "no such file" in capsys.readouterr().err
