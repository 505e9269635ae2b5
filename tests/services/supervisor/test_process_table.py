"""Process table: the module of each row accepts the config that the supervisor writes for it."""

from __future__ import annotations

import importlib
from pathlib import Path

import pytest

from services.bus.options import BusOptions
from services.run import folder
from services.run.run_config import Override, RunConfig, resolve
from services.supervisor import process_table
from services.supervisor.entry_point import read_config, write_config


def made(tmp_path: Path, *settings: str) -> tuple[RunConfig, folder.RunFolder, BusOptions]:
    run_config = resolve("descent", [Override("test", settings)])
    run = folder.make("test", run_config.files, out=tmp_path / "run")
    return run_config, run, BusOptions(connect=("tls/127.0.0.1:7447",), namespace="auv/7", certs=tmp_path / "certs")


@pytest.mark.parametrize("row", process_table.PROCESSES, ids=lambda row: row.name)
def test_a_config_that_was_written_is_read_as_it_was_by_the_module_of_its_row(
    row: process_table.ProcessRow, tmp_path: Path
) -> None:
    run_config, run, own = made(tmp_path, "controller.horizon_s=7.3", "run.compute_delay_s=0.1")
    config = process_table.config_of(row.name, run_config, run, own)
    write_config(tmp_path / "config.json", config)
    module = importlib.import_module(row.module)
    assert read_config(tmp_path / "config.json", module.Config) == config
    bus = config.bus  # type: ignore[attr-defined]
    assert (bus.role, bus.namespace, bus.certs) == (row.name, "auv/7", tmp_path / "certs")
    assert (bus.listen if row.name == "router" else bus.connect) == own.connect
    assert callable(module.main)


def test_settings_and_files_are_those_of_the_run_s_folder(tmp_path: Path) -> None:
    known = tmp_path / "known.csv"
    known.write_text("depth_m,v_north_mps,u_east_mps,sd_mps,sd_common_mps\n0,0,0,0.1,0\n50,0.5,-0.25,0.001,0\n")
    of_run = made(tmp_path, "controller.horizon_s=7.3", f"estimator.water_prior={known}")
    controller, estimator = (process_table.config_of(name, *of_run) for name in ("controller", "estimator"))
    assert controller.resolved().horizon_s == 7.3  # type: ignore[attr-defined]
    prior = Path(estimator.loaded().water_prior)  # type: ignore[attr-defined]
    assert prior.parent == (tmp_path / "run" / "config").absolute()
    assert prior.read_text() == known.read_text()
