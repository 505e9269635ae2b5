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


def made(tmp_path: Path, *given: str) -> tuple[RunConfig, folder.RunFolder, BusOptions]:
    run_config = resolve("descent", [Override("test", given)])
    run = folder.make("test", run_config.files, out=tmp_path / "run")
    return run_config, run, BusOptions(connect=("tls/127.0.0.1:7447",), namespace="auv/7", certs=tmp_path / "certs")


@pytest.mark.parametrize("row", process_table.PROCESSES, ids=lambda row: row.name)
def test_a_config_that_was_written_is_read_as_it_was_by_the_module_of_its_row(row, tmp_path) -> None:
    run_config, run, own = made(tmp_path, "controller.horizon_s=7.3", "run.compute_delay_s=0.1")
    config = process_table.config_of(row.name, run_config, run, own)
    write_config(tmp_path / "config.json", config)
    module = importlib.import_module(row.module)
    assert read_config(tmp_path / "config.json", module.Config) == config
    bus = config.bus  # type: ignore[attr-defined]
    assert (bus.role, bus.namespace, bus.certs) == (row.name, "auv/7", tmp_path / "certs")
    assert (bus.listen if row.name == "router" else bus.connect) == own.connect
    assert callable(module.main)
