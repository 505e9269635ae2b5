"""Plan of a dive: agreement with the localisation check, error budget, gains, recorded runs, and the command."""

from __future__ import annotations

import contextlib
import io
import json
import math
import pickle
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace

from benchmarks.batch import Job
from benchmarks.localisation_check.consistency import band
from benchmarks.localisation_check.probe import descend
from ltv_mpc.errors import ConfigError
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.messages import Truth
from services.cli.app import run
from services.recording.reader import Recording
from services.run.folder import RunFolder
from services.tools import lockstep_run
from services.tools.batch import executor
from services.tools.dive_plan import plan, report
from services.tools.dive_plan.plan import Dive, DivePlan
from sim.evaluation.cramer_rao_bound.model import ACCELEROMETER_BIAS, BEAM_BIAS, GYRO_BIAS, MOUNTING, ErrorModel
from tests.ltv_mpc.localisation.sensors.every_sensor import EVERY_SENSOR

DURATION_S, DEPTH_M = 10.0, 2.0
SENSORS = ("realistic", "examples/sensors/own_adcp.toml")


class Output(NamedTuple):
    """Output of the command."""

    printed: str
    folder: Path


@pytest.fixture(scope="module")
def output(tmp_path_factory: pytest.TempPathFactory) -> Output:
    folder, printed = tmp_path_factory.mktemp("plans") / "out", io.StringIO()
    options = f"--duration-s {DURATION_S:g} --depth-m {DEPTH_M:g} --fixes 1,4 --runs 1 --limit-m 0.05 --json --out"
    with contextlib.redirect_stdout(printed), pytest.MonkeyPatch.context() as patch:
        patch.setattr(executor, "core_count", lambda: 1)  # in this process, which has all compiled code
        assert run(["dive", "plan", "--sensors", "realistic", *options.split(), str(folder)]) == 0
    return Output(printed.getvalue(), folder)


@pytest.fixture(scope="module")
def planned(output: Output) -> DivePlan:
    return msgspec.json.decode(output.printed, type=DivePlan)


@pytest.mark.parametrize("sensors", SENSORS)
def test_the_drift_is_the_bound_of_the_localisation_check(sensors: str) -> None:
    flight = plan.fly(Dive(sensors, "descent", DURATION_S, DEPTH_M, 2, seed=5))
    settings = (f"sensors={sensors}", "run.seed=5", "run.surface_time_s=2", f"run.duration_s={DURATION_S}")
    record = descend(Job("descent", settings))
    assert pickle.loads(pickle.dumps((plan.fly, plan.drift, flight.case)))  # the jobs of other processes
    assert flight.drift_m[-1] == pytest.approx(math.sqrt(record.bound_drift_m2.mean()), rel=0.01)


def test_the_drift_of_simulated_dives_is_that_of_the_plan() -> None:
    """It lies in the interval of as many dives with the planned drift, on two axes each."""
    dive, dives = Dive("examples/sensors/600_khz.toml", None, 8.0, 1.6, 1, seed=1), 6
    runs = [lockstep_run.run(dive._replace(seed=seed).run_config()) for seed in range(dives)]
    ends_m = [run.localisation_error_m.final for run in runs]
    ratio = math.sqrt(np.mean(np.square(ends_m)) / 2.0) / plan.fly(dive).drift_m[-1]
    low, high = np.sqrt(np.array(band(2 * dives)) / (2 * dives))
    assert low < ratio < high


def test_the_shares_of_all_sources_add_up_to_the_variance(planned: DivePlan) -> None:
    assert sum(planned.budget.values()) == pytest.approx(1.0, abs=0.02)
    assert min(planned.budget.values()) > -5e-3
    assert planned.budget["ADCP noise"] > 0.1


def test_sensors_without_a_source_in_the_budget_are_named(planned: DivePlan) -> None:
    assert planned.not_counted == []
    assert plan.not_counted(EVERY_SENSOR) == ["bottom_track", "lbl", "usbl"]


def test_each_change_reduces_the_drift_and_more_fixes_do(planned: DivePlan) -> None:
    end_m = planned.drift_m[0][-1]
    assert len(planned.gains_m) == plan.GAINS
    assert all(drift < 1.001 * end_m for change, drift in planned.gains_m.items() if "turn" not in change)
    assert planned.gains_m["half the ADCP noise"] < 0.97 * end_m
    assert planned.gains_m["60 s longer afloat"] < planned.gains_m["one more satellite fix"] < end_m
    assert planned.drift_m[1][-1] < end_m
    assert planned.radius_95_m[0] == pytest.approx(2.4477 * end_m, rel=1e-4)
    assert planned.depth_m == pytest.approx(DEPTH_M, abs=0.5)  # it starts at rest


def test_a_limit_is_reached_between_two_instants() -> None:
    assert plan.reached_s([10.0, 20.0], [1.0, 3.0], 2.0) == 15.0
    assert plan.reached_s([10.0, 20.0], [1.0, 3.0], 0.5) == 5.0
    assert plan.reached_s([10.0, 20.0], [1.0, 3.0], 4.0) is None


def test_a_calibration_leaves_what_noise_and_drift_of_a_bias_leave() -> None:
    """Constants by averaging; Gauss-Markov biases by integration of the scalar Riccati equation."""
    sensors, seconds = SensorConfig.load("realistic"), 600.0
    sensors = replace(sensors, imu=replace(sensors.imu, gyro_bias_tau_s=300.0))
    J = np.diag(ErrorModel(sensors, EstimatorConfig(), calibration_s=seconds).prior())
    for states, sd, r, tau in (
        (GYRO_BIAS, sensors.imu.gyro_bias_sd_radps, sensors.imu.angle_random_walk_rad_per_rts, 300.0),
        (
            ACCELEROMETER_BIAS,
            sensors.imu.accelerometer_bias_sd_mps2,
            sensors.imu.velocity_random_walk_mps_per_rts,
            sensors.imu.accelerometer_bias_tau_s,
        ),
    ):
        information, steps = sd**-2, 100_000
        for _ in range(steps):
            information += seconds / steps * (2.0 * information * (1.0 - sd**2 * information) / tau + r**-2)
        assert J[states] == pytest.approx(information, rel=2e-3)
    left = sensors.adcp.beam_noise_sd_mps**2 * sensors.adcp.period_ns * 1e-9 / seconds
    assert J[BEAM_BIAS] == pytest.approx(1.0 / sensors.adcp.beam_bias_sd_mps**2 + 1.0 / left)
    assert (J[MOUNTING] > 1.0 / sensors.adcp.mounting_known_to_rad**2).all()


def test_a_path_ends_the_dive_where_it_is_complete(tmp_path: Path) -> None:
    path = tmp_path / "leg.toml"
    path.write_text(
        'kind = "line"\nstart_s = 0.0\nspeed_mps = 0.4\ndepth_m = 1.0\n'
        "start = {north_m = 0.0, east_m = 0.0}\nend = {north_m = 3.0, east_m = 0.0}\n"
    )
    # from where the estimate is at t = 0, metres off, to the line, and along it
    flight = plan.fly(Dive("paper", str(path), None, DEPTH_M, 1, seed=0))
    assert 8.0 < flight.case.at_s[-1] < 200.0


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    folder = tmp_path_factory.mktemp("runs") / "recorded"
    assert run(["sim", "descent", "--lockstep", "--duration-s", "4", "--out", str(folder)]) == 0
    return RunFolder(folder)


def test_the_drift_of_a_recorded_run_is_its_localisation_error(recorded: RunFolder) -> None:
    found = report.recorded_drift(Recording(recorded.recording))
    final = json.loads((recorded.path / "summary.json").read_text())["localisation_error_m"]["final"]
    assert (found.kind, found.t_s) == ("true", [1.0, 2.0, 3.0, 4.0])
    assert found.drift_m[-1] == pytest.approx(final / math.sqrt(2.0), rel=1e-6)


def test_without_a_truth_the_filter_s_own_sigma_is_laid_over_the_plan(recorded: RunFolder) -> None:
    messages = [message for message in Recording(recorded.recording) if message.kind is not Truth]
    found = report.recorded_drift(messages)
    assert (found.kind, found.t_s) == ("reported", [1.0, 2.0, 3.0, 4.0])
    assert all(drift >= 0.0 for drift in found.drift_m)
    with pytest.raises(ConfigError, match="--against"):
        report.recorded_drift([])


def test_the_command_prints_json_and_writes_its_folder(output: Output) -> None:
    printed = json.loads(output.printed)
    assert (printed["sensors"], printed["fixes"], printed["runs"], printed["limit_m"]) == ("realistic", [1, 4], 1, 0.05)
    assert json.loads((output.folder / "dive-plan.json").read_text()) == printed
    assert "Drift after one change" in (output.folder / "dive-plan.html").read_text(encoding="utf-8")
