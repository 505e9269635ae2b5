"""A run in Python: the messages of lock step or of a folder as arrays by name, with units."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from ltv_mpc import Run, simulate, solve_qp
from ltv_mpc.errors import ConfigError
from ltv_mpc.messages import Estimate, SolveStatus
from services.reporting.plots import recorded
from services.reporting.run_summary_text import verdict
from services.tools.python_run import Table
from tests.ltv_mpc.control.ocp.test_extension import TotalThrust

SHORT = {"seed": 3, "duration_s": 3.0}


@pytest.fixture(scope="module")
def run() -> Run:
    return simulate("paper-5s", qps=True, **SHORT)


def test_a_run_that_is_simulated_is_the_one_that_is_recorded_and_read(run: Run, tmp_path: Path) -> None:
    read = simulate("paper-5s", out=tmp_path / "run", **SHORT)
    assert read.summary == json.loads((tmp_path / "run" / "summary.json").read_text())
    assert read.summary["tracking_error_m"] == run.summary["tracking_error_m"]
    for key in ("world/truth", "estimate", "plan", "applied", "sensor/imu", "localisation"):
        assert set(read[key]) == set(run[key])
        for name, column in run[key].items():
            if column.dtype != object:
                np.testing.assert_array_equal(read[key][name], column, err_msg=f"{key} {name}")


@pytest.mark.parametrize(
    ("reference", "absolute"),
    [
        ('kind = "point"\nnorth_m = 5.0\neast_m = 0.0', True),
        ('kind = "hold"', False),
    ],
)
def test_the_error_of_the_vehicle_is_absolute_for_places_and_drift_for_here(reference, absolute, tmp_path) -> None:
    (tmp_path / "there.toml").write_text(reference)
    settings = {"reference": tmp_path / "there.toml", "duration_s": 8.0, "surface_time_s": 1.0, "seed": 5}
    run = simulate("hover", out=tmp_path / "run", **settings)
    truth, estimate, target = run["world/truth"], run["estimate"], run["plan"]["reference_m"][-1]
    p, e = truth["position_m"][:, :2], np.column_stack([estimate["north_m"], estimate["east_m"]])
    fix = e[np.searchsorted(estimate["t_ns"], 0)] - p[np.searchsorted(truth["t_ns"], 0)]
    assert np.hypot(*fix) > 1.0
    errors = {name: run.summary[f"true_error{name}_m"]["final"] for name in ("", "_drift")}
    away = p[-1] - np.array(target, dtype=float)
    assert errors["_drift"] == pytest.approx(np.hypot(*(away + fix)), abs=0.2)
    assert errors[""] == pytest.approx(np.hypot(*(away if absolute else away + fix)), abs=0.2)
    assert run.summary["in_places"] == absolute
    drawn = recorded.read(tmp_path / "run" / "run.mcap").tables["true_distance"]["distance_m"][-1]
    assert drawn == pytest.approx(errors[""], abs=0.2)
    text = verdict(run.summary, tmp_path)
    assert ("vehicle from it, absolute" in text) == absolute
    assert "vehicle from it, since t = 0" in text


def test_arrays_have_an_index_over_messages_and_names_have_units(run: Run) -> None:
    estimate = run["estimate"]
    many = len(run.messages["estimate"])
    assert estimate["north_m"].shape == estimate["t_s"].shape == (many,)
    assert estimate["covariance"].shape == (many, 6, 6)
    assert estimate["current.north_mps"].shape == estimate["current.sd_mps"].shape
    assert (estimate.units["t_s"], estimate.units["current.sd_mps"]) == ("s", "m/s")
    np.testing.assert_array_equal(estimate["t_s"], estimate["t_ns"] * 1e-9)
    assert run["sensor/imu"]["angular_rate_radps"].shape == (len(run["sensor/imu"]["t_ns"]), 3)
    for mistaken in (lambda: run["estimat"], lambda: estimate["norht_m"]):
        with pytest.raises(KeyError, match="did you mean"):
            mistaken()


def test_what_is_missing_is_nan_and_what_differs_in_size_stays_apart() -> None:
    with_depth = Estimate.at_rest(north_m=1.0, depth_m=5.0)
    table = Table([Estimate.at_rest(north_m=1.0), with_depth])
    np.testing.assert_array_equal(table["depth_m"], [np.nan, 5.0])
    assert np.isnan(table["covariance"]).all()


def test_each_plan_has_its_qp_with_the_names_of_its_rows(run: Run) -> None:
    assert len(run.qps) == len(run["plan"]["origin"])
    solved = [(qp, origin) for qp, origin in zip(run.qps, run["plan"]["origin"], strict=True) if origin == "solved"]
    assert len(solved) >= 3
    for qp, _ in solved:
        assert qp is not None
        assert qp.qp.A.shape == (len(qp.rows), len(qp.qp.q))
        assert solve_qp(qp.qp, "piqp").solve.status is SolveStatus.SOLVED
    first, second = (qp.qp.q for qp, _ in solved[-2:] if qp is not None)
    assert not np.array_equal(first, second)
    assert "slew of port in stage 1" in {row.name for qp, _ in solved if qp is not None for row in qp.rows}


def test_a_limit_of_one_s_own_bounds_the_plans() -> None:
    start = {"north_m": 5.0, "heading_rad": 3.0}
    settings = SHORT | {"plant": start, "reference": "hover", "perfect_state": True, "horizon_s": 3.0}
    free, bounded = (simulate("paper-5s", terms=terms, **settings) for terms in ((), (TotalThrust(),)))
    most = [np.abs(one["plan"]["thrust_N"][3:, 3:, :2].sum(axis=2)).max() for one in (free, bounded)]
    assert most[0] > 30.0
    assert most[1] < 21.0


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"horizon": 4.0}, 'argument horizon: "horizon": unknown key'),
        ({"horizon_s": -4.0}, "argument horizon_s: .*horizon_s = -4.0: must be >= 0.3"),
        ({"period_s": 4.0}, "argument period_s: is one of .*water.surface_waves.period_s"),
        ({"water": {"sd": 4.0}}, 'argument water.sd: "water.sd": unknown key'),
        ({"out": "x", "qps": True}, "argument out: cannot act together"),
    ],
)
def test_a_change_that_cannot_be_is_refused_by_its_name(changes: dict[str, object], says: str) -> None:
    with pytest.raises(ConfigError, match=says):
        simulate("paper-5s", **changes)  # type: ignore[arg-type]


def test_a_table_becomes_a_data_frame_with_a_column_for_each_number(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    pandas = ModuleType("pandas")
    pandas.DataFrame = dict  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "pandas", pandas)
    frame = run["applied"].to_pandas()
    np.testing.assert_array_equal(frame["thrust_N_1"], run["applied"]["thrust_N"][:, 1])
    assert {column.ndim for column in dict(frame).values()} == {1}
