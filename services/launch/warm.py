"""Fill the cache of compiled code in one process, before any child: five at once would each compile all of it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from ltv_mpc.compiled import CACHE

MARK = "rehearsed"
"""A file in the cache's folder, which is named after the sources: where it stands, nothing is left to compile."""


def is_warm() -> bool:
    """Whether a rehearsal has filled the cache before."""
    return (CACHE / MARK).exists()


def fill(scenario: Path, log: Path) -> subprocess.Popen[bytes]:
    """Start a process that compiles what a run of this scenario needs; it exits 0 when that is done."""
    command = [sys.executable, "-P", "-m", "services.launch.warm", str(scenario)]
    with log.open("wb") as output:
        return subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT, start_new_session=True
        )


def rehearse(scenario: str) -> None:
    """Every node of it: all their compiled code and solvers are loaded then."""
    from services.nodes import controller, estimator, plant, sensors
    from services.run.situation import resolve

    situation = resolve(scenario)
    plant.rehearse(situation)
    sensors.rehearse(situation)
    estimator.rehearse(situation.suite, situation.scenario.estimator)
    controller.rehearse(situation.vehicle, situation.reference, situation.scenario.controller)


def main() -> None:
    """Of the scenario that is named; then nothing is left to compile."""
    rehearse(sys.argv[1])
    (CACHE / MARK).touch()


if __name__ == "__main__":
    main()
