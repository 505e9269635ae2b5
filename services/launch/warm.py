"""Fill the cache of compiled code before any child: five at once would each compile all of it.

It takes a minute or two of processor time, more than half of it for the controller; so that is done by one process, all
else by another, and of the little that both need each compiles its own.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from ltv_mpc.compiled import CACHE
from services.launch.orphans import die_with_parent

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
    rehearse_controller(scenario)
    rehearse_others(scenario)


def rehearse_controller(scenario: str) -> None:
    """The controller."""
    from services.nodes import controller
    from services.run.situation import resolve

    situation = resolve(scenario)
    controller.rehearse(situation.vehicle, situation.reference, situation.scenario.controller)


def rehearse_others(scenario: str) -> None:
    """Plant, sensors and estimator."""
    from services.nodes import estimator, plant, sensors
    from services.run.situation import resolve

    situation = resolve(scenario)
    plant.rehearse(situation)
    sensors.rehearse(situation)
    estimator.rehearse(situation.suite, situation.scenario.estimator)


def main() -> int:
    """Of the scenario that is named; then nothing is left to compile."""
    scenario, *parent = sys.argv[1:]
    if parent:
        die_with_parent(int(parent[0]))
        rehearse_controller(scenario)
        return 0
    command = [sys.executable, "-P", "-m", "services.launch.warm", scenario, str(os.getpid())]
    with subprocess.Popen(command, stdin=subprocess.DEVNULL) as other:
        rehearse_others(scenario)
    if other.returncode == 0:
        (CACHE / MARK).touch()
    return other.returncode


if __name__ == "__main__":
    sys.exit(main())
