"""Short run in lock step, with every node and a delay, which the tests replay and damage."""

from __future__ import annotations

from pathlib import Path

import pytest

from services.run import folder
from services.run.folder import RunFolder
from services.run.run_config import Override, resolve
from services.tools import lockstep_run


@pytest.fixture(scope="package")
def locked_run(tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    """Run three seconds after one second afloat; a plan arrives 0.4 s after the start of its cycle."""
    settings = ["run.duration_s=3", "run.compute_delay_s=0.4", "run.seed=3"]
    run_config = resolve("descent", [Override("test", settings)])
    run = folder.make("descent", run_config.files, out=tmp_path_factory.mktemp("replay") / "run")
    lockstep_run.run(run_config, run)
    return run


@pytest.fixture(scope="package")
def recording(locked_run: RunFolder) -> Path:
    return locked_run.recording
