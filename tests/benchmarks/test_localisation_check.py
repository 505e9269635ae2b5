"""Localisation check: consistency with draws of known covariance, its judgement, and a short watched run."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.batch import Job
from benchmarks.localisation_check.consistency import (
    GridProjection,
    TrueState,
    band,
    errors,
    nees,
    quantities,
)
from benchmarks.localisation_check.judgement import judge, mean_square, p_of_mean
from benchmarks.localisation_check.probe import Squares, descend
from ltv_mpc.frames import rotation, rotation_exp
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.filter.state import Belief, Layout, grid
from ltv_mpc.localisation.sensor_config import SensorConfig
from services.tools import lockstep_run

PAPER, REALISTIC = SensorConfig.load("paper"), SensorConfig.load("realistic")
CONFIG = EstimatorConfig(deepest_m=20.0)
GRID_M = np.arange(0.0, 21.0, 2.0)
INSTANTS = 200
SHORT = 'title = "4 s of a descent"\n[run]\nduration_s = 4.0\n[plant]\ndepth_m = 5.0\n'


# --- consistency of one run -------------------------------------------------------------------------------------------


def belief_and_truth(sensors):
    """Return a belief, an error, and the truth that has it by the filter's own rule, ``Belief.apply_error``."""
    rng = np.random.default_rng(8)
    layout = Layout.of(sensors, CONFIG)
    belief = Belief.blank(layout, 0)
    belief.x[:] = rng.standard_normal(layout.size)
    belief.R, belief.mounting = rotation(0.1, -0.2, 2.0), rotation_exp(0.1 * rng.standard_normal(3))
    A = rng.standard_normal((layout.size, layout.size + 5))
    belief.P[:] = A @ A.T
    error, true = 0.3 * rng.standard_normal(layout.size), belief.copy()
    true.apply_error(error)
    x, water = true.x, rng.standard_normal((len(grid(CONFIG)), 2))
    cells = layout.north.stop - layout.north.start
    water[belief.column.first : belief.column.first + cells] = np.column_stack([x[layout.north], x[layout.east]])
    beam, near, compass = (np.zeros(4), np.zeros(4), 0.0)
    if sensors is REALISTIC:
        beam, near, compass = x[layout.beam_bias], x[layout.near_bias], float(x[layout.compass_bias][0])
    return (
        belief,
        TrueState(x[:3], x[3:6], true.R, x[9:12], x[12:15], beam, near, true.mounting, compass, water),
        error,
    )


@pytest.mark.parametrize("sensors", [PAPER, REALISTIC], ids=["paper", "realistic"])
def test_each_quantity_is_judged_by_the_errors_of_its_own_states(sensors):
    belief, truth, error = belief_and_truth(sensors)
    observed = np.zeros(len(truth.water_mps), dtype=bool)
    observed[[2, 3, 5]] = True
    belief.P[12], belief.P[:, 12] = 0.0, 0.0  # a certain state is left out
    expected = {"position": 3, "velocity": 3, "heading": 1, "tilt": 2, "gyro_bias": 3, "accelerometer_bias": 2}
    if sensors is REALISTIC:
        expected |= {"adcp_bias": 8, "compass_bias": 1, "mounting": 3}
    found = nees(belief, truth, observed)
    assert {name: dof for name, (_, dof) in found.items()} == expected | {"cells": 6}
    for name, states in quantities(belief, observed).items():
        np.testing.assert_allclose(errors(truth, belief)[states], error[states], atol=1e-12)
        i = states[states != 12]
        np.testing.assert_allclose(found[name][0], error[i] @ np.linalg.inv(belief.P[np.ix_(i, i)]) @ error[i])


def test_the_projection_of_water_is_its_best_fit_by_lines_between_grid_points():
    rng = np.random.default_rng(2)
    bend_m, fine_m = np.array([-3.0, 0.7, 5.5, 6.1, 6.9, 13.0, 19.9, 25.0]), np.linspace(0.0, 20.0, 20_001)
    values = rng.standard_normal(len(bend_m))
    projection = GridProjection(GRID_M, bend_m)
    best = projection.fit(np.interp(projection.depth_m, bend_m, values)[:, None])[:, 0]

    def mean_square(c):
        return np.trapezoid((np.interp(fine_m, GRID_M, c) - np.interp(fine_m, bend_m, values)) ** 2, fine_m)

    for k in range(len(GRID_M)):
        for d in (-1e-3, 1e-3):
            assert mean_square(best + d * (np.arange(len(GRID_M)) == k)) > mean_square(best)
    even = GridProjection(GRID_M, GRID_M[::2])  # water that bends at grid points alone
    np.testing.assert_allclose(
        even.fit(np.interp(even.depth_m, GRID_M, GRID_M**2)[:, None])[:, 0], GRID_M**2, atol=1e-10
    )


# --- judgement of several runs ----------------------------------------------------------------------------------------


def runs_of(
    rng: np.random.Generator, runs: int, *, constant: bool, factor: float = 1.0, dof: int = 3, instants: int = INSTANTS
) -> list[Squares]:
    """Return runs whose squares are one draw repeated, or one draw per instant."""
    t, n = np.arange(instants) * 1_000_000_000, np.full(instants, dof)
    drawn = factor * rng.chisquare(dof, (runs, 1 if constant else instants))
    return [Squares(t, one, n) for one in np.broadcast_to(drawn, (runs, instants))]


@pytest.mark.parametrize(("runs", "constant"), [(5, True), (40, False)])
def test_consistent_squares_are_rejected_as_rarely_as_the_level_says(runs: int, constant: bool) -> None:
    """Ten means are judged together: at 1 % of 100 checks 1 is rejected in the mean.

    With 200 instants the means of independent draws would nearly all be within the tolerance, and never be rejected.
    """
    rng = np.random.default_rng([7, runs, constant])
    rejected = 0
    for _ in range(100):
        means = [mean_square(runs_of(rng, runs, constant=constant, dof=1, instants=20)) for _ in range(10)]
        rejected += any(one.rejected for one in judge([("", mean.value, "", p_of_mean(mean)) for mean in means]))
    assert rejected <= 5


@pytest.mark.parametrize("factor", [1.3**2, 1.3**-2])
def test_a_noise_that_is_off_by_thirty_per_cent_is_rejected(factor: float) -> None:
    """Twenty runs of white squares, beside 18 other hypotheses."""
    mean = mean_square(runs_of(np.random.default_rng(8), 20, constant=False, factor=factor))
    assert judge([("", mean.value, "", p_of_mean(mean)), *[("", 1.0, "", 1.0)] * 18])[0].rejected


# --- a watched run ----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def scenario(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("short") / "short.toml"
    path.write_text(SHORT)
    return str(path)


def test_a_watched_run_is_the_same_run_and_its_drift_is_that_of_the_grader(scenario: str) -> None:
    job = Job(scenario, ("sensors=realistic", "run.seed=5"))
    watched = descend(job)
    summary = lockstep_run.run(job.run_config())
    assert summary.localisation_error_m.final == pytest.approx(float(np.hypot(*watched.drift_m)), rel=1e-12)
    assert watched.missed == 0
    assert watched.min_eigenvalue > 0
    assert watched.asymmetry == 0
    # two codes that share nothing but the sensors file
    np.testing.assert_allclose(watched.velocity_reported_m2ps2, watched.bound_velocity_m2ps2, rtol=0.1)
    for name in ("position", "velocity", "heading", "tilt", "adcp_bias", "compass_bias", "mounting", "cells"):
        assert watched.nees[name].t_ns.tolist() == [k * 1_000_000_000 for k in range(5)], name
    assert (np.diff(watched.nees["cells"].dof) >= 0).all()  # what has been seen stays seen
    assert 2 * 14 <= watched.nees["cells"].dof[0] <= watched.nees["cells"].dof[-1] <= 2 * 20
    for name, of in watched.nees.items():
        assert of.square[-1] < band(of.dof[-1], 0.9999)[1], name
    pings = watched.nis["adcp"]
    assert np.diff(pings.t_ns).max() == 333_333_333
    assert 0.8 < pings.square.sum() / pings.dof.sum() < 1.2  # one outlier of 25 deviations left in would be 600
