"""Lock-step run as a job of a batch: a scenario and settings, which can be pickled and resolved on any worker."""

from __future__ import annotations

from typing import NamedTuple

from services.run.run_config import Override, RunConfig, resolve
from services.tools import lockstep_run
from sim.evaluation.summary import Summary


class Job(NamedTuple):
    """Run of a scenario (NAME or FILE) with settings, each KEY=VALUE."""

    scenario: str
    settings: tuple[str, ...]

    def run_config(self) -> RunConfig:
        """Resolve what the run is made of. Raises ``ConfigError``."""
        return resolve(self.scenario, [Override("batch", self.settings)])

    def summary(self) -> Summary:
        """Run it here, in lock step. Raises ``ConfigError``."""
        return lockstep_run.run(self.run_config())
