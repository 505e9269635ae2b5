"""Filter of a recorded dive: against a batch solution, against brute force, and on simulated dives."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest

from ltv_mpc.currents import WaterPrior
from ltv_mpc.localisation.pd0 import reader
from ltv_mpc.localisation.pd0.beams import BeamEnsemble, to_beams
from ltv_mpc.localisation.pd0.records import Settings
from ltv_mpc.localisation.recorded_dive.filter import Track, run
from ltv_mpc.localisation.recorded_dive.model import (
    BIAS,
    HEAVE,
    HEAVE_SD_MPS,
    VELOCITY,
    Batch,
    Model,
    beams,
    correct,
    over_ground,
)
from ltv_mpc.localisation.recorded_dive.noise import BeamNoise, beam_sd, data_sheet_sd
from ltv_mpc.localisation.recorded_dive.parameters import DiveParameters
from ltv_mpc.localisation.recorded_dive.screening import reach_m, usable
from ltv_mpc.localisation.recorded_dive.study import evaluate_track, starts, window_end
from ltv_mpc.localisation.recorded_dive.truth import MAX_GAP_S, dead_reckon
from tests.recorded.glider import Dive, World, dive

PARAMETERS = DiveParameters()
S = 1_000_000_000


def seen(made: Dive) -> list[BeamEnsemble]:
    """Return the ensembles of the file."""
    return [to_beams(e) for e in reader.parse(made.data, source="test").ensembles]


def tracked(ensembles: list[BeamEnsemble], parameters: DiveParameters = PARAMETERS, fixes: int = 10) -> Track:
    return run(ensembles, noise_of(ensembles), parameters, fixes=fixes)


def noise_of(ensembles: list[BeamEnsemble]) -> BeamNoise:
    return BeamNoise(ensembles, PARAMETERS.min_good_share)


@cache
def simulated_settings() -> Settings:
    """Return the settings of the simulated instrument."""
    return seen(dive(World(), 0, duration=5.0))[0].settings


def setting(**changed: object) -> Settings:
    """Return these settings with some changes."""
    return simulated_settings()._replace(**changed)


def window(made: Dive, start_s: float, after_s: float = 300.0) -> tuple[int, int]:
    """Return the first and the last ensemble."""
    start = int(np.searchsorted(made.t, start_s))
    return start, int(np.searchsorted(made.t, made.t[start] + after_s))


@cache
def simulated(world: World, seed: int) -> tuple[Dive, list[BeamEnsemble], BeamNoise]:
    made = dive(world, seed)
    ensembles = seen(made)
    return made, ensembles, noise_of(ensembles)


def errors(world: World, seed: int, start_s: float, parameters: DiveParameters = PARAMETERS) -> tuple[float, ...]:
    """Return the error (m), e P^-1 e, and the error of constant velocity (m), against the simulated truth."""
    made, ensembles, noise = simulated(world, seed)
    a, b = window(made, start_s)
    track = run(ensembles[a : b + 1], noise, parameters, fixes=10)
    true = made.position[b] - made.position[a]
    error, P = track.position_m[-1] - true, track.position_covariance[-1]
    held = np.mean([e.bottom_mps[:2] for e in ensembles[a : a + 10]], axis=0) * (made.t[b] - made.t[a])
    return math.hypot(*error), float(error @ np.linalg.solve(P, error)), math.hypot(*(held - true))


def small_model() -> Model:
    return Model.of(PARAMETERS, np.array([0.0, 3.0, 6.0, 9.0]), np.array([2.0, 4.0, 6.0]))


def change(model: Model, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Return F and Q, written independently from the equations."""
    p, n, cells, depths = PARAMETERS, model.size, model.cells, model.depth_m
    F, Q = np.eye(n), np.zeros((n, n))
    F[0, 2] = F[1, 3] = dt
    for a in range(2):
        at = np.ix_([a, a + 2], [a, a + 2])
        Q[at] = p.velocity_change_mps_per_rts**2 * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    F[HEAVE, HEAVE], Q[HEAVE, HEAVE] = 0.0, HEAVE_SD_MPS**2
    f = math.exp(-dt / p.bias_tau_s)
    B = np.empty((cells, cells))
    r = (2.0, 4.0, 6.0)
    for i in range(cells):
        for j in range(cells):
            near = (p.near_bias_sd_mps * math.exp(-r[i] / p.near_bias_length_m)) * (
                p.near_bias_sd_mps * math.exp(-r[j] / p.near_bias_length_m)
            )
            varying = (p.range_bias_sd_mps**2 + near) * math.exp(-abs(r[i] - r[j]) / p.range_bias_length_m)
            B[i, j] = p.beam_bias_sd_mps**2 + varying
    for beam in range(4):
        at = slice(BIAS + beam * cells, BIAS + (beam + 1) * cells)
        F[at, at] = f * np.eye(cells)
        Q[at, at] = (1 - f**2) * B
    for axis in (slice(n - 2 * len(depths), n - len(depths)), slice(n - len(depths), n)):
        distance = np.abs(np.subtract.outer(depths, depths))
        Q[axis, axis] = p.water_change_mps_per_rts**2 * dt * np.exp(-distance / p.water_correlation_length_m)
    return F, Q


def test_the_recursion_is_that_of_the_textbook() -> None:
    """x := F x, P := F P F^T + Q, and K = P H^T (H P H^T + R)^-1, five times; the gate is open."""
    model = small_model()
    rng, n = np.random.default_rng(3), model.size
    x, P = model.prior()
    expected, covariance = x.copy(), P.copy()
    for k in range(5):
        F, Q = change(model, 2.0 + k)
        model.propagate(x, P, 2.0 + k, model.parameters.velocity_change_mps_per_rts)
        H, z = rng.standard_normal((6, n)) * (rng.random((6, n)) < 0.3), rng.standard_normal(6)
        batch = Batch(H, z, rng.uniform(0.01, 0.1, 6))
        correct(x, P, batch, gate=1e9)
        expected, covariance = F @ expected, F @ covariance @ F.T + Q
        gain = covariance @ H.T @ np.linalg.inv(H @ covariance @ H.T + np.diag(batch.variance))
        expected, covariance = expected + gain @ (z - H @ expected), covariance - gain @ H @ covariance
    np.testing.assert_allclose(x, expected, atol=1e-8)
    np.testing.assert_allclose(P, covariance, atol=1e-8)


def test_a_row_is_judged_by_what_prior_and_neighbours_say_of_it() -> None:
    """Predict each row from the belief after all others, by brute force."""
    model = small_model()
    rng = np.random.default_rng(1)
    x, P = model.prior()
    H, variance = rng.standard_normal((8, model.size)) * (rng.random((8, model.size)) < 0.5), rng.uniform(1e-3, 1e-2, 8)
    S = H @ P @ H.T + np.diag(variance)
    batch = Batch(H, np.linalg.cholesky(S) @ rng.standard_normal(8), variance)
    _, nis = correct(x.copy(), P.copy(), batch, gate=1e9)
    for i in range(8):
        others = np.arange(8) != i
        y, Q = x.copy(), P.copy()
        correct(y, Q, Batch(*(part[others] for part in batch)), gate=1e9)
        h = batch.H[i]
        assert nis[i] == pytest.approx((batch.z[i] - h @ y) ** 2 / (h @ Q @ h + batch.variance[i]), rel=1e-6)


def test_outliers_are_taken_out_and_what_is_left_is_as_if_they_had_not_been_there() -> None:
    model = small_model()
    u = np.eye(4)
    H = np.zeros((12, model.size))
    H[:, VELOCITY] = np.random.default_rng(2).standard_normal((12, 2))
    batch = Batch(H, H[:, VELOCITY] @ [0.3, -0.2] + 0.001 * np.tile(u[0], 3), np.full(12, 0.01**2))
    batch.z[[2, 7, 9]] += [0.5, -0.5, 0.1]
    good = np.array([i not in (2, 7, 9) for i in range(12)])
    x, P = model.prior()
    accepted, nis = correct(x, P, batch, gate=10.83)
    assert accepted.tolist() == good.tolist()
    assert (nis > 10.83).any()
    y, Q = model.prior()
    correct(y, Q, Batch(*(part[good] for part in batch)), gate=1e9)
    np.testing.assert_allclose(x, y, atol=1e-12)
    np.testing.assert_allclose(P, Q, atol=1e-12)


def calm_ensemble(rng: np.random.Generator, **more: object) -> BeamEnsemble:
    """Return an ensemble with directions and depths, without measurements."""
    u = rng.standard_normal((4, 3))
    u /= np.linalg.norm(u, axis=1)[:, None]
    values = {
        "t_ns": 0,
        "settings": setting(),
        "depth_m": 20.0,
        "direction": u,
        "velocity_mps": np.zeros((4, 5)),
        "below_m": rng.uniform(-8, 8, (4, 5)),
        "good": np.full((4, 5), 0.5),
        "echo": None,
        "range_m": 2.0 * np.arange(1, 6),
        "bottom_mps": np.full(3, np.nan),
    }
    return BeamEnsemble(**{**values, **more})


def test_a_row_is_the_beam_through_water_that_is_linear_in_depth() -> None:
    """In a linear profile the triangular weights have no effect: z = u . (c(d) - v) - u_d w + beta."""
    rng = np.random.default_rng(4)
    ensemble = calm_ensemble(rng)
    model = Model.of(PARAMETERS, np.linspace(5, 35, 11), ensemble.range_m)
    x = rng.standard_normal(model.size)
    slope, offset = np.array([0.03, -0.02]), np.array([0.1, 0.4])
    x[model.north], x[model.east] = (offset[a] + slope[a] * model.depth_m for a in range(2))
    mask = rng.random((4, 5)) < 0.7
    batch = beams(model, ensemble, mask, np.linspace(0.01, 0.02, 5))
    expected, variance = [], []
    for i in range(4):
        for j in range(5):
            if mask[i, j]:
                u = ensemble.direction[i]
                c = offset + slope * (20.0 + ensemble.below_m[i, j])
                bias = x[model.biases][i * model.cells + j]
                expected.append(u[:2] @ (c - x[VELOCITY]) - u[2] * x[HEAVE] + bias)
                variance.append(1.3 * np.linspace(0.01, 0.02, 5)[j] ** 2 / 0.5)
    np.testing.assert_allclose(batch.H @ x, expected, atol=1e-12)
    np.testing.assert_allclose(batch.variance, variance)
    ground = over_ground(model, ensemble)
    np.testing.assert_allclose(ground.H @ x, x[VELOCITY])


def test_a_cell_is_the_mean_over_twice_its_length_not_the_water_at_its_middle() -> None:
    """At a kink c = g |z|: exactly g length / 3 by the triangle's integral, g length / 4 by its three points."""
    ensemble = calm_ensemble(np.random.default_rng(4), below_m=np.zeros((4, 5)), settings=setting(cell_m=4.0))
    model = Model.of(PARAMETERS, np.linspace(5, 35, 31), ensemble.range_m)
    x = np.zeros(model.size)
    x[model.north] = 0.1 * np.abs(model.depth_m - 20.0)
    batch = beams(model, ensemble, np.ones((4, 5), dtype=bool), np.full(5, 0.01))
    np.testing.assert_allclose(batch.H @ x, np.repeat(ensemble.direction[:, 0], 5) * 0.1 * 4.0 / 4)


def test_noise_is_found_under_bias_and_outliers_and_not_below_the_data_sheet() -> None:
    rng = np.random.default_rng(5)
    settings = setting(cells=5)
    sheet = data_sheet_sd(settings)
    assert sheet == pytest.approx(0.0194 / math.sqrt(10))  # 600 kHz and 2 m: as 1200 kHz and 1 m

    def recorded(count: int) -> list[BeamEnsemble]:
        made = []
        for k in range(count):
            z = 0.02 * rng.standard_normal((4, 5)) + np.array([0.03, 0, 0, -0.01])[:, None]
            z[rng.random((4, 5)) < 0.01] += 0.6
            z[:, 3] *= 0.01
            if k > 20:
                z[1, 4] = np.nan
            made.append(calm_ensemble(rng, velocity_mps=z, good=np.ones((4, 5)), settings=settings))
        return made

    sd = beam_sd(recorded(1000), 0.5)
    np.testing.assert_allclose(sd[:3], 0.02, rtol=0.2)
    assert sd[3] == sheet  # quieter than it can be
    assert sd[4] == sd[3]  # too few samples: the cell before
    few = beam_sd(recorded(20), 0.5)
    np.testing.assert_allclose(few, 0.02, rtol=0.5)  # all cells together
    assert (few == few[0]).all()
    assert (beam_sd(recorded(2), 0.5) == 2 * sheet).all()


def test_the_reach_is_that_of_the_flattest_beam_less_a_cell() -> None:
    """Level, beams at 60 deg of elevation: bottom at 16 m in each is 16 cos 30 below, side lobes reach cos 30 of it."""
    k = math.cos(math.radians(30))
    u = np.array([[0.5, 0, k], [-0.5, 0, k], [0, 0.5, k], [0, -0.5, k]])
    echo = np.full((4, 12), 60.0)
    echo[:, 8:] = 90.0
    level = calm_ensemble(
        np.random.default_rng(0), direction=u, echo=echo, range_m=2.0 * np.arange(12), settings=setting(cells=12)
    )
    assert reach_m(level) == pytest.approx(16 * k * k - 2.0)
    echo[1, :] = 60.0  # sees no bottom to 22 m
    h = 4 * k / (3 / 16 + 1 / 22)
    assert reach_m(level) == pytest.approx(h * h / 22 - 2.0)
    silent = level._replace(echo=np.full((4, 12), 60.0))
    assert reach_m(silent) == reach_m(level._replace(echo=None)) == math.inf


def test_bad_cells_are_left_out() -> None:
    ensemble = calm_ensemble(np.random.default_rng(0), depth_m=3.0, below_m=np.full((4, 5), 2.0))
    ensemble.velocity_mps[0, 0] = np.nan
    ensemble.good[1, 1] = 0.4
    ensemble.below_m[2, 2] = -3.5  # above the surface
    left_out = ~usable(ensemble, 0.5)
    assert sorted(zip(*np.nonzero(left_out), strict=True)) == [(0, 0), (1, 1), (2, 2)]


def grounded(t_s: list[float], velocity: list[tuple[float, float] | None]) -> list[BeamEnsemble]:
    rng = np.random.default_rng(0)
    missing = (math.nan, math.nan)
    return [
        calm_ensemble(rng, t_ns=round(t * S), bottom_mps=np.array([*(v or missing), 0.1]))
        for t, v in zip(t_s, velocity, strict=True)
    ]


def test_truth_is_bottom_track_added_up_and_gaps_are_bridged_linearly() -> None:
    # v = 0.1 t north, at rest east: t^2 / 20; the fix at 6 s is missing
    t = [0.0, 2.0, 6.0, 10.0]
    ground = dead_reckon(grounded(t, [(0.1 * x, 0.0) if x != 6.0 else None for x in t]))
    np.testing.assert_allclose(ground.displacement(0, 3), [5.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(ground.displacement(1, 2), [(36 - 4) / 20, 0.0], atol=1e-12)


def test_there_is_no_truth_outside_bottom_track_nor_across_a_long_gap() -> None:
    long = MAX_GAP_S + 1
    t = [0.0, 5.0, 10.0, 15.0, 10 + long, 15 + long, 20 + long]
    ground = dead_reckon(grounded(t, [None, (1, 0), (1, 0), None, (1, 0), (1, 0), None]))
    assert ground.displacement(0, 1) is None
    assert ground.displacement(1, 3) is None
    assert ground.displacement(2, 4) is None
    assert ground.displacement(5, 6) is None
    np.testing.assert_allclose(ground.displacement(1, 2), [5.0, 0.0])
    np.testing.assert_allclose(ground.displacement(4, 5), [5.0, 0.0])
    assert dead_reckon(grounded([0.0, 5.0], [None, None])).displacement(0, 1) is None


def test_starts_are_every_second_ensemble_between_two_and_fourteen_metres() -> None:
    rng = np.random.default_rng(0)
    depths = [0.0, 1.9, 2.0, 5.0, 8.0, 11.0, 14.0, 14.1, 3.0]
    assert starts([calm_ensemble(rng, depth_m=z) for z in depths]) == [2, 4, 6]


@pytest.mark.parametrize(("metres", "inside"), [(5.9, True), (6.1, False)])
def test_a_trial_is_graded_at_its_end_by_three_sigma_about_the_mean_of_its_fixes(metres: float, inside: bool) -> None:
    """Truth: 0.1 m/s north for 310 s; the fixes say 0.1 and 0.3. The filter is ``metres`` too far east, sigma 2 m."""
    t = [10.0 * k for k in range(40)]
    made = grounded(t, [(0.3 if k == 6 else 0.1, 0.0) for k in range(40)])
    ground = dead_reckon(made)
    assert window_end(ground, 5) == 35
    assert window_end(ground, 10) is None
    true = ground.displacement(5, 35)
    np.testing.assert_allclose(true, [30.0 + 2.0, 0.0], atol=1e-9)
    N = 31
    track = Track(
        t_ns=tuple(e.t_ns for e in made[5:36]),
        position_m=np.linspace(0, 1, N)[:, None] * (true + np.array([0.0, metres])),
        position_covariance=np.tile(np.diag([1.0, 4.0]), (N, 1, 1)),
        velocity_mps=np.zeros((N, 2)),
        fixes=2,
        cells_used=0,
        cells_screened=0,
        cells_rejected=0,
        nis=1.0,
        water=WaterPrior(depth_m=t, north_mps=t, east_mps=t, sd_mps=t, sd_common_mps=0.0),
    )
    trial = evaluate_track(made, ground, track, start=5, end=35, offered_fixes=2)
    assert trial.error_m == pytest.approx(metres)
    assert trial.sigma_m == pytest.approx(2.0)
    assert trial.inside_3_sigma == inside
    assert trial.after_s == pytest.approx(300.0)
    assert trial.constant_velocity_error_m == pytest.approx(0.2 * 300 - 32)
    assert evaluate_track(made, ground, track, start=5, end=35, offered_fixes=0).constant_velocity_error_m is None


def test_bottom_track_after_the_fixes_is_truth_and_never_reaches_the_filter() -> None:
    ensembles = seen(dive(World(), 1, duration=120.0))
    beam_noise = noise_of(ensembles)
    track = run(ensembles, beam_noise, PARAMETERS, fixes=10)
    blind = [e if k < 10 else e._replace(bottom_mps=np.full(3, np.nan)) for k, e in enumerate(ensembles)]
    other = tracked(blind)
    np.testing.assert_array_equal(track.position_m, other.position_m)
    np.testing.assert_array_equal(track.position_covariance, other.position_covariance)
    assert track.fixes == 10
    changed = [e if k != 9 else e._replace(bottom_mps=e.bottom_mps + 0.02) for k, e in enumerate(ensembles)]
    assert (run(changed, beam_noise, PARAMETERS, fixes=10).position_m[-1] != track.position_m[-1]).any()


def test_without_bottom_track_there_is_a_track_that_says_how_little_it_knows() -> None:
    made = dive(World(), 2, duration=60.0)
    track = tracked(seen(made), fixes=0)
    assert track.fixes == 0
    assert np.isfinite(track.position_m).all()
    # nothing says how fast the water moves: its prior is the velocity's
    sd = np.sqrt(track.position_covariance[-1].diagonal())
    np.testing.assert_allclose(sd, PARAMETERS.water_mean_sd_mps * made.t[-1], rtol=0.1)


def test_the_covariance_stays_symmetric_and_definite_and_the_water_has_a_share_in_common() -> None:
    track = tracked(seen(dive(World(water_change=0.0, outliers=0.0), 4)))
    P = track.position_covariance
    np.testing.assert_allclose(P, P.transpose(0, 2, 1), rtol=1e-9)
    assert (np.linalg.eigvalsh(P[1:]) > 0).all()
    assert (np.diff(P[:, 0, 0] + P[:, 1, 1]) > -0.5).all()
    water = track.water
    assert 0 <= water.sd_common_mps <= water.sd_mps.min() > 0
    assert np.diff(water.depth_m).min() > 0


def test_on_synthetic_dives_half_the_errors_are_below_six_metres_and_consistent() -> None:
    """Sea and instrument have the errors of the parameters' sources; no number here was fitted."""
    found = np.array([errors(World(), seed, start_s) for seed in range(4) for start_s in (27.0, 60.0, 110.0)])
    error, normalised, held = found.T
    assert np.median(error) <= 6.0
    assert np.median(error) <= 0.6 * np.median(held)
    assert (normalised <= 9.0).mean() >= 0.95
    # and not so wide that nothing could be outside: chi-square of two degrees of freedom has a mean of 2
    assert normalised.mean() > 0.4


@pytest.mark.parametrize(
    "world",
    [
        World(towards_zero=0.05, towards_zero_sd=0.08),
        World(mounting_deg=11.0, near_cells=3),
        World(water_change=0.002),
        World(wave_amplitude=0.03),
    ],
    ids=["ringing", "mounted askew", "quick water", "internal wave"],
)
def test_in_other_seas_three_sigma_holds_and_constant_velocity_is_beaten(world: World) -> None:
    error, normalised, held = np.transpose([errors(world, seed, start_s) for seed in range(2) for start_s in (27, 70)])
    assert (normalised <= 9.0).all()
    assert np.median(error) < 0.6 * np.median(held)
