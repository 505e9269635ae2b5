"""A QP that was not solved: the words for it, and its file."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from ltv_mpc import Controller, ControllerConfig, Estimate, PlanOrigin, SolveStatus, Vehicle, references
from ltv_mpc.control.failed_qp import NamedQp, worst_violation
from ltv_mpc.control.ocp.assembly import scales
from ltv_mpc.control.solvers.recorder import QpRecorder
from ltv_mpc.errors import ConfigError
from ltv_mpc.messages import Solve
from tests.ltv_mpc.control.problems import Form, equidistant, motion

PAPER = Vehicle.load("paper")
FAILED = Solve(status=SolveStatus.FAILED)


def built(solve=FAILED) -> NamedQp:
    return NamedQp.of(Form(equidistant(5)).problem(*motion(3, 5)), scales(PAPER), solve)


def test_every_row_has_words_and_a_scale():
    """A change of a command shows in the row of that thruster's slew, and its sum in that of its limit, in N."""
    qp, rows = built().qp, built().rows
    assert len(rows) == len(qp.l) == len({row.name for row in rows})
    for k in range(5):
        for i, side in enumerate(("port", "starboard")):
            for place, name in (
                (12 * k + i, f"slew of {side} in stage {k + 1}"),
                (12 * k + 2 + 8 + i, f"limit of {side} at the end of stage {k + 1}"),
            ):
                step = np.zeros(len(qp.q))
                step[place] = 1.0 / 62.5  # 1 N
                moved = {
                    row.name: change * row.scale
                    for row, change in zip(rows, qp.A @ step, strict=True)
                    if change and "dynamics" not in row.name
                }
                assert moved == pytest.approx({name: 1.0})


def test_the_worst_row_is_named_with_its_violation_in_newtons():
    named = built()
    qp, rows = named.qp, named.rows
    x = np.zeros(len(qp.q))
    i = next(i for i, row in enumerate(rows) if row.name == "slew of starboard in stage 4")
    qp.l[:], qp.u[:] = -1e3, 1e3
    qp.u[i] = -0.04
    assert worst_violation(qp, x, rows) == "slew of starboard in stage 4 violated by 2.5 N"
    qp.u[i] = 0.0
    assert worst_violation(qp, x, rows) == ""


def test_faults_name_what_is_not_finite_and_bounds_that_exclude_each_other():
    named = built()
    qp = named.qp
    row = next(i for i, row in enumerate(named.rows) if row.name == "limit of port at the end of stage 2")
    qp.l[row] = qp.u[row] + 0.1
    qp.q[3] = np.nan
    qp.u[0] = np.nan
    assert named.faults() == [
        f"q: 1 of {len(qp.q)} numbers are not finite",
        "u of dynamics of north in stage 1 is not a number",
        "limit of port at the end of stage 2: lower bound above the upper one by 6.25 N",
    ]


def test_a_saved_problem_comes_back_as_it_was(tmp_path):
    kept = built(Solve(status=SolveStatus.ITERATION_LIMIT, iterations=400, why="so"))
    kept.qp.q[0] = kept.qp.A.data[1] = np.nan
    kept.save(tmp_path / "one.qp")
    back = NamedQp.load(tmp_path / "one.qp")
    for name in ("q", "l", "u"):
        np.testing.assert_array_equal(getattr(back.qp, name), getattr(kept.qp, name))
    for name in ("P", "A"):
        np.testing.assert_array_equal(getattr(back.qp, name).toarray(), getattr(kept.qp, name).toarray())
    assert back.rows == kept.rows
    assert (back.solve.status, back.solve.iterations, back.solve.why) == (SolveStatus.ITERATION_LIMIT, 400, "so")


@pytest.fixture(scope="module")
def content(tmp_path_factory):
    """Return the content of a file."""
    path = tmp_path_factory.mktemp("parts") / "one.qp"
    built().save(path)
    return msgspec.msgpack.decode(path.read_bytes())


@pytest.mark.parametrize(
    "wrong",
    [
        {"format": "ltv-mpc qp 2"},
        {"rows": [["slew", 1.0]]},
        {"rows": []},
        {"P": [[1.0], [2**40], [0, 1], [1, 1]]},
        {"A": [[1.0], [0], [0, 1], [1, 1]]},
        {"A": 1.0},
        {"u": None},
    ],
    ids=str,
)
def test_parts_of_another_kind_are_refused_by_name(tmp_path, content, wrong):
    path = tmp_path / "bad.qp"
    parts = {key: wrong.get(key, part) for key, part in content["qp"].items()}
    path.write_bytes(msgspec.msgpack.encode(content | {"qp": parts} | wrong))
    with pytest.raises(ConfigError, match=r"QP file .*bad\.qp: is not a QP saved by this program"):
        NamedQp.load(path)


def test_a_cycle_that_is_not_solved_says_so_and_keeps_its_problem():
    """Twelve iterations are not enough 2 m off with the heading wrong; what they came to is inside box and slew."""
    recorder, config = QpRecorder(), ControllerConfig(max_iterations=12, tolerance=1e-9, horizon_s=5.1)
    controller = Controller(PAPER, references.Point(north_m=0.0, east_m=0.0), config, make_solver=recorder)
    assert recorder.failed is None
    plan = controller.plan(Estimate.at_rest(north_m=2.0, heading_rad=2.0))
    assert plan.origin is PlanOrigin.SOLVED
    failed = recorder.failed
    assert failed is not None
    assert failed.solve is plan.solve
    assert plan.solve.status is SolveStatus.ITERATION_LIMIT
    assert "residual" in plan.solve.why
    assert (np.abs(np.diff(plan.thrust_N[:, :2], axis=0)) <= 30.0 + 1e-9).all()
    assert failed.faults() == []
