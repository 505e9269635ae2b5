"""Consistency of the filter over whole descents, against its covariance and theory; wide limits, few fixed seeds."""

from collections import Counter

import numpy as np
import pytest

from ltv_mpc.frames import rotation_log
from tests.ltv_mpc.localisation.dives import PAPER, REALISTIC, Run, S, dive, error_of, with_water


class Judged(Run):
    """Descent through the filter with normalised squared errors per degree of freedom, every 10 s."""

    def __init__(self, sensors, seed, **settings):
        super().__init__((), sensors)
        self.dive, self.nees, self.least_eigenvalue = dive(sensors, seed, **settings), {}, np.inf
        self.observed = np.zeros(71, dtype=bool)
        for start_ns in range(-10 * S, self.dive.messages[-1].t_ns, 10 * S):
            self.feed(m for m in self.dive.messages if start_ns < m.t_ns <= start_ns + 10 * S)
            self._judge(sensors)

    def _judge(self, sensors):
        belief, dive = self.estimator.filter.propagated_belief(), self.dive
        k, layout, x, P = dive.at(belief.t_ns), belief.layout, belief.x, belief.P
        np.testing.assert_array_equal(P, P.T)
        self.least_eigenvalue = min(self.least_eigenvalue, np.linalg.eigvalsh(P)[0])
        error = np.zeros(layout.size)
        error[:6] = np.concatenate([dive.position[k], dive.velocity[k]]) - x[:6]
        error[6:9] = rotation_log(dive.R[k] @ belief.R.T)
        error[9:15] = np.concatenate([dive.gyro_bias[k], dive.accelerometer_bias[k]]) - x[9:15]
        error[layout.north], error[layout.east] = dive.water[:71].T - [x[layout.north], x[layout.east]]
        self.observed[int(x[2]) + 2 : int(x[2] + 0.93 * sensors.adcp.range_m)] = True
        cells = np.flatnonzero(self.observed)
        quantities = {"position": range(3), "velocity": range(3, 6), "heading": [8], "tilt": [6, 7]}
        quantities |= {"biases": range(9, 15), "cells": [*layout.north.start + cells, *layout.east.start + cells]}
        for quantity, states in quantities.items():
            i = np.array(states)
            square = error[i] @ np.linalg.solve(P[np.ix_(i, i)], error[i]) / len(i)
            self.nees.setdefault(quantity, []).append(square)


@pytest.fixture(scope="module")
def paper():
    return [Judged(PAPER, seed) for seed in (26, 27)]


@pytest.fixture(scope="module")
def realistic():
    return [Judged(REALISTIC, seed, duration_s=60.0) for seed in range(20, 23)]


@pytest.mark.parametrize("sensors", ["paper", "realistic"])
def test_errors_match_the_covariance_which_stays_positive_definite(sensors, request):
    """Means over seeds and instants. Errors of one seed are correlated in time, so only seeds count."""
    dives = request.getfixturevalue(sensors)
    for quantity in dives[0].nees:
        mean = np.mean([np.mean(dive.nees[quantity]) for dive in dives])
        low, high = (0.85, 1.15) if quantity == "cells" else (0.3, 2.2)
        assert low < mean < high, f"{quantity}: {mean:.2f}"
    assert min(dive.least_eigenvalue for dive in dives) > 0


def test_drift_over_a_descent_of_40_m_is_near_the_linear_bound_and_follows_the_velocity_error(paper):
    """1.01 m per axis, from 5.3 mm/s at submergence (design, localisation.md), nearly 200 s of it; 4 axes: 99 %."""
    at_zero, at_end = (np.array([error_of(run.estimates[t_ns], run.dive) for run in paper]) for t_ns in (0, 200 * S))
    drift, velocity = (at_end - at_zero)[:, :2].ravel(), at_zero[:, 2:4].ravel()
    assert 0.23 * 1.01 < np.sqrt(np.mean(drift**2)) < 1.93 * 1.01
    assert 0.23 * 5.3e-3 < np.sqrt(np.mean(velocity**2)) < 1.93 * 5.3e-3
    assert 100 < velocity @ drift / (velocity @ velocity) < 260
    reported = np.sqrt([run.estimates[0].covariance[i, i] for run in paper for i in (2, 3)])
    np.testing.assert_allclose(reported, 5.3e-3, rtol=0.1)  # two axes, heading and biases, and an ADCP at once


def test_outliers_and_silent_beams_are_rejected_and_counted(realistic):
    """1 % of the beam cells by +-0.5 m/s, 25 deviations; 2 % of the beams; and 0.1 % of the good cells."""
    account = sum((Counter(run.estimator.account) for run in realistic), Counter())
    cells = account["adcp.used"] + account["adcp.gate"]
    assert 0.008 < account["adcp.gate"] / cells < 0.016
    assert 0.01 < account["adcp.no_return"] / (cells + account["adcp.no_return"]) < 0.035
    samples = [sample for run in realistic for report in run.reports.values() for sample in report.innovations]
    assert {sample.sensor for sample in samples} >= {"gnss", "adcp", "pressure", "compass"}
    z = np.array([i / sd for sample in samples for i, sd in zip(sample.innovations, sample.sd, strict=True)])
    assert 0.91 < np.mean(np.abs(z) < 2.0) < 0.99


def test_water_unlike_the_prior_still_passes_the_gate():
    """A tide of 0.25 m/s where the prior holds 0.04 m/s: the mean over all depths absorbs it."""
    of = dive(PAPER, 1, duration_s=3.0)
    run = Run(with_water(of, lambda _, depth_m: 0.25 + 0.0 * depth_m), PAPER)
    account, belief = run.estimator.account, run.estimator.filter.belief
    assert account["adcp.gate"] < 0.01 * account["adcp.used"]
    for axis, states in enumerate((belief.layout.north, belief.layout.east)):
        np.testing.assert_allclose(belief.x[states][2:25] - of.water[2:25, axis], 0.25, atol=0.03)
