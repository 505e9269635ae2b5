"""Plot tables of a run, checked with a dive whose numbers are known."""

from __future__ import annotations

import math
from pathlib import Path

import msgspec
import numpy as np
import pytest

from ltv_mpc.messages import Array, Estimate, Health, Message, PlanOrigin
from ltv_mpc.vehicle.propulsion import propulsive_power_W
from services.recording.node_settings import vehicle_of
from services.reporting.plots import analysis
from services.reporting.plots.catalogue import PLOTS, REVIEW
from services.reporting.plots.collector import INNOVATIONS, Collector, nis_deviation
from services.reporting.plots.delays import Percentiles
from services.reporting.plots.description import Style
from services.reporting.plots.recorded import read
from services.reporting.plots.table import Columns, Table
from tests.services.recording.recordings import write
from tests.services.reporting import synthetic_run
from tests.services.reporting.synthetic_run import DRIFT_EAST_MPS, EPOCH, GROWTH_M2_PER_S, OFFSET, TARGET, S
from tests.services.runtime.test_controller_status import STATUS as CONTROLLER_STATUS
from tests.services.words import status

ARROWS = ("port", "starboard", "current")
SPEEDS = ("gnss_velocity", "adcp", "bottom_track")


@pytest.fixture
def collector() -> Collector:
    made = Collector(vehicle_of({"config/vehicle.toml": synthetic_run.VEHICLE}))
    for _, signal, _ in synthetic_run.dive():
        made.add(signal, EPOCH)
    return made


def test_each_plot_names_columns_that_there_are(collector: Collector) -> None:
    tables = collector.all_tables()
    for plot in PLOTS:
        for series in plot.series:
            columns = [series.x, series.y, *filter(None, (series.x_high, series.y_high))]
            for name in columns:
                assert any(value is not None for value in tables[series.table][name]), (plot.name, series.label, name)
            assert len({len(tables[series.table][name]) for name in columns}) == 1
            assert (series.style is Style.BAND) == bool(series.x_high or series.y_high)
        for level in plot.levels:
            assert level.value in collector.values


def columns(collector: Collector, table: str, *names: str) -> Array:
    """Return columns (N, C) of a table."""
    cells = collector.all_tables()[table]
    return np.column_stack([np.array(cells[name], dtype=float) for name in names])


def test_errors_and_the_true_track_are_drifts_since_the_start_and_so_is_their_spread(collector: Collector) -> None:
    t, north, east, spread = columns(collector, "errors", "t_s", "north_m", "east_m", "plus_2_sigma_m").T
    assert (t[0], t[-1]) == (0.0, 20.0)
    np.testing.assert_allclose(north, 0.0, atol=1e-4)
    np.testing.assert_allclose(east, DRIFT_EAST_MPS * t, atol=1e-4)
    np.testing.assert_allclose(spread, 2 * np.sqrt(GROWTH_M2_PER_S * t), atol=1e-4)
    in_sd = columns(collector, "errors", "north_sd", "east_sd")
    assert np.isnan(in_sd[0]).all()
    np.testing.assert_allclose(in_sd[1:, 1], east[1:] / np.sqrt(GROWTH_M2_PER_S * t[1:]), atol=2e-3)
    true = columns(collector, "truth", "t_s", "north_m", "east_m")
    assert tuple(true[0]) == (0.0, *OFFSET)
    assert true[-1, 1] == pytest.approx(OFFSET[0] + 2.0)


def test_of_a_reference_in_places_nothing_is_shifted_and_the_ellipse_is_that_of_the_position() -> None:
    collector = Collector()
    collector.set_files({"config/reference.toml": 'kind = "point"'})
    for _, message, _ in synthetic_run.dive():
        collector.add(message, EPOCH)
    true = columns(collector, "truth", "north_m", "east_m")
    assert tuple(true[0]) == (0.0, 0.0)
    newest = synthetic_run.estimate(20 * S)
    assert newest.covariance is not None
    away = columns(collector, "ellipse", "north_m", "east_m") - [newest.north_m, newest.east_m]
    inverse = np.linalg.inv(newest.covariance[:2, :2])
    np.testing.assert_allclose(np.einsum("ki,ij,kj->k", away, inverse, away), 4.0, rtol=1e-2)
    assert collector.since == ""


def test_distances_are_those_to_the_target(collector: Collector) -> None:
    for table, drift in (("distance", DRIFT_EAST_MPS), ("true_distance", 0.0)):
        t, distance, depth = columns(collector, table, "t_s", "distance_m", "depth_m").T
        expected = np.hypot(OFFSET[0] + 0.1 * t - TARGET[0], OFFSET[1] + drift * t - TARGET[1])
        np.testing.assert_allclose(distance, expected, atol=1e-3)
        np.testing.assert_allclose(depth, np.maximum(0.2 * t, 0.0), atol=1e-3)


def test_a_target_that_moves_is_where_it_is_at_the_estimate_s_time() -> None:
    """The target moves with the vehicle, 1 m east of it: the distance is 1 m at any rate of plans."""
    collector = Collector()
    for t_ns in range(0, 6 * S, 100_000_000):
        collector.add(synthetic_run.estimate(t_ns), EPOCH)
        if t_ns % S == 0:
            first = synthetic_run.plan(t_ns).t_ns[0] / S
            target = (OFFSET[0] + 0.1 * first, OFFSET[1] + DRIFT_EAST_MPS * first + 1.0)
            collector.add(msgspec.structs.replace(synthetic_run.plan(t_ns, target=target), progress=first / 10), EPOCH)
    distance = columns(collector, "distance", "distance_m")
    assert len(distance) > 40
    np.testing.assert_allclose(distance[2:], 1.0, atol=2e-3)


def test_ellipse_and_profile_have_two_standard_deviations(collector: Collector) -> None:
    newest = synthetic_run.estimate(20 * S)
    away = columns(collector, "ellipse", "north_m", "east_m") - [newest.north_m, newest.east_m]
    np.testing.assert_allclose(np.sum(away**2, axis=1) / (GROWTH_M2_PER_S * 20), 4.0, rtol=1e-2)
    band = columns(collector, "profile", "north_low_mps", "east_high_mps")
    np.testing.assert_allclose(band, [[0.01, 0.0], [-0.02, 0.04], [-0.05, 0.08]], atol=1e-9)


def test_the_deadline_is_when_the_plan_takes_effect_in_wall_time(collector: Collector) -> None:
    """150 ms of the vehicle at ten times real time are 15 ms."""
    assert set(map(tuple, columns(collector, "latency", "deadline_ms", "cycle_ms"))) == {(15.0, 2.0)}


def test_percentiles_are_those_of_all_durations() -> None:
    measured = Percentiles()
    for ms in range(1, 1001):
        measured.add(float(ms))
    assert measured.at(0.5) == pytest.approx(500.0, rel=0.025)
    assert measured.at(0.99) == pytest.approx(990.0, rel=0.025)
    assert Percentiles().at(0.5) is None


def test_the_band_of_the_innovations_is_that_of_chi_squared(collector: Collector) -> None:
    """95 % of chi-squared with 20 degrees of freedom lie within 9.591 and 34.170."""
    assert nis_deviation(9.591 / 20, 20) == pytest.approx(collector.values["nis_low"], abs=0.02)
    assert nis_deviation(34.170 / 20, 20) == pytest.approx(collector.values["nis_high"], abs=0.02)
    shown = collector.tables["nis_adcp"].since(0)["deviation"]
    assert shown == pytest.approx([nis_deviation(synthetic_run.NIS, 20)] * len(shown), abs=1e-4)


def test_innovations_have_the_unit_of_their_sensor_and_the_band_of_the_filter() -> None:
    """A fix of a satellite has two positions and two velocities; a heading is shown in degrees."""
    collector = Collector()
    collector.add(synthetic_run.report(0), EPOCH)
    tables = {name: collector.tables[table].since(0) for name, table in INNOVATIONS.items()}
    assert tables["gnss_position"]["innovation"] == [0.1, -0.1]
    assert tables["gnss_position"]["plus_2_sd"] == pytest.approx([2.0 * math.sqrt((0.3**2 + 0.4**2) / 2)] * 2, abs=1e-4)
    assert tables["gnss_velocity"]["innovation"] == [0.02, 0.0]
    assert tables["gnss_velocity"]["minus_2_sd"] == pytest.approx([-0.02] * 2)
    assert tables["adcp"]["innovation"] == list(synthetic_run.INNOVATIONS)
    in_degrees = [math.degrees(x) for x in synthetic_run.INNOVATIONS]
    assert tables["compass"]["innovation"] == pytest.approx(in_degrees, abs=1e-4)
    assert {plot.name: plot.y.label for plot in REVIEW if plot.name in INNOVATIONS.values()} == {
        table: f"innovation ({'deg' if name == 'compass' else 'm/s' if name in SPEEDS else 'm'})"
        for name, table in INNOVATIONS.items()
    }


def test_the_energy_is_that_of_the_delivered_thrusts(collector: Collector) -> None:
    vehicle = collector.vehicle
    assert vehicle is not None
    truth, thrust_N = synthetic_run.truth(0), np.array([synthetic_run.applied(0).thrust_N])
    ahead, _, down = truth.water_velocity_mps
    power_W = propulsive_power_W(vehicle, thrust_N, np.array([ahead]), np.array([down]))
    assert power_W is not None
    energy = columns(collector, "energy", "t_s", "all_J", "lateral_J")
    assert (energy[0, 0], energy[-1, 0]) == (0.0, 20.0)
    np.testing.assert_allclose(energy[-1, 1:], [20.0 * power_W.sum(), 20.0 * power_W[0, :2].sum()], rtol=1e-3)


def test_the_vehicle_is_seen_from_above(collector: Collector) -> None:
    """It heads north, with 24 % of the thrust limit on port; at 4 m the water moves west."""
    newest = synthetic_run.estimate(20 * S)
    lines = {f"{name}_arrow": columns(collector, f"{name}_arrow", "north_m", "east_m") for name in ARROWS}
    ways = [line[1] - line[0] for line in lines.values()]  # from foot to tip
    expected = [[2.0 * 15.0 / 62.5, 0.0], [-2.0 * 15.0 / 62.5, 0.0], [0.026 * 2.0 / 0.1, -0.012 * 2.0 / 0.1]]
    np.testing.assert_allclose(ways, expected, atol=1e-3)
    assert lines["port_arrow"][0, 1] < newest.east_m < lines["starboard_arrow"][0, 1]
    assert columns(collector, "hull", "north_m")[0] == pytest.approx(newest.north_m + 1.0)


def test_events_and_changes_are_marks() -> None:
    collector = Collector()
    for signal in (
        *(
            synthetic_run.ARM,
            synthetic_run.ARMED,
            synthetic_run.EVENT,
            msgspec.structs.replace(synthetic_run.plan(0), health=Health.DEGRADED, health_why="leak"),
            synthetic_run.plan(S, origin=PlanOrigin.SHIFTED),
        ),
        *(synthetic_run.plan(2 * S, origin=PlanOrigin.SHIFTED), synthetic_run.plan(3 * S), status("plant")),
    ):
        collector.add(signal, EPOCH)
    collector.add(status("plant"), EPOCH + 1)  # it does not know the time yet
    assert [(mark.t_s, mark.node, mark.text) for mark in collector.marks.marks] == [
        (0.0, "controller", "arm accepted"),
        (5.0, "plant", synthetic_run.EVENT.text),
        (0.0, "controller", "health: degraded: leak"),
        (1.0, "controller", "health: nominal"),
        (1.0, "controller", "plan origin: shifted: OSQP: iteration limit"),
        (3.0, "controller", "plan origin: solved"),
        (3.0, "plant", "restarted"),
    ]


def test_a_table_stays_small_and_keeps_its_peaks() -> None:
    table = Table(("t", "x"), limit=50, peak="x")
    for t in range(10_000):
        table.add(t, 100.0 if t in (777, 5_000) else 1.0)
    columns = table.since(0)
    assert 50 <= len(table) < 100
    assert [t for t, x in zip(columns["t"], columns["x"], strict=True) if x == 100.0] == [777, 5_000]
    assert columns["t"] == sorted(columns["t"], key=float)  # type: ignore[arg-type]
    assert table.generation > 0


def test_a_recording_gives_what_the_signals_give(tmp_path: Path, collector: Collector) -> None:
    picture = read(synthetic_run.record(tmp_path / "run.mcap"))
    assert not picture.cut
    assert picture.values == collector.values
    assert picture.tables["latency"] == collector.tables["latency"].since(0)
    for name in ("ellipse", "profile", "horizon", "ahead"):
        assert picture.tables[name] == collector.all_tables()[name], name
    assert picture.marks == tuple(collector.marks.marks)


def test_estimates_of_a_source_that_is_not_in_use_are_not_drawn(tmp_path: Path) -> None:
    used = 5
    in_use = msgspec.structs.replace(CONTROLLER_STATUS, source="default", source_epoch=used)
    messages: list[tuple[str, Message, int, int, int]] = [("controller", in_use, 1, 0, 0)]
    for k in range(20):
        for epoch, north_m in ((6, 50.0), (used, 1.0)):
            t_ns = k * S + (epoch == used) * S // 2
            estimate = msgspec.structs.replace(Estimate.at_rest(north_m=north_m, depth_m=0.0), t_ns=t_ns)
            messages.append(("estimator", estimate, epoch, k, t_ns))
    assert read(write(tmp_path / "run.mcap", messages)).tables["track"]["north_m"] == [1.0] * 20


def test_the_review_of_a_run_is_that_of_its_tables() -> None:
    """A thrust of 10 N at 0.5 Hz has its peak there, and a density whose integral is its variance of 50 N^2."""
    t = np.arange(0.0, 200.0, 0.2)
    wave = 10.0 * np.sin(2.0 * np.pi * 0.5 * t)
    history: dict[str, Columns] = {
        "thrust": {"t_s": t.tolist(), "port_N": wave.tolist(), "starboard_N": np.full(len(t), 5.0).tolist()},
        "profile": {"depth_m": [0.5, 2.5, 9.5]}
        | {name: [0.1, 0.2, 0.3] for name in ("north_mps", "east_mps")}
        | {name: [0.0, 0.15, 0.2] for name in ("north_low_mps", "east_low_mps")},
        "true_current": {"depth_m": [4.0, 0.0], "north_mps": [0.4, 0.0], "east_mps": [0.2, 0.2]},
    }
    tables = analysis.tables(history)
    error = tables["current_error"]  # at the two depths where the vehicle has been
    assert (error["depth_m"], error["north_mps"], error["east_mps"]) == ([0.5, 2.5], [0.05, -0.05], [-0.1, 0.0])
    assert error["north_low_mps"] == [-0.1, -0.05]
    assert sum(tables["histogram"]["port_percent"]) == pytest.approx(100.0, abs=0.01)
    spectrum = tables["spectrum"]
    frequency, power = (np.array(spectrum[name], dtype=float) for name in ("frequency_Hz", "port_N2pHz"))
    assert frequency[np.nanargmax(power)] == pytest.approx(0.5, abs=0.03)
    assert np.nansum(power) * (frequency[1] - frequency[0]) == pytest.approx(50.0, rel=0.05)
