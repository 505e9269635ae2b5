"""Fill the cache of compiled code before any child: five at once would each compile all of it.

It takes a minute and a half of processor time, half of that for the controller. Three processes share it: the
controller, all other nodes, and what the controller comes to last; of the little that two of them need each compiles
its own.
"""

from __future__ import annotations

import gc
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

from ltv_mpc.jit import CACHE, JIT_FUNCTIONS
from services.supervisor.parent_death import die_with_parent

MARK = "rehearsed"
"""A file in the cache's folder, which is named after the sources: where it stands, nothing is left to compile."""

EXPECTED = "expected"
"""Another: how many functions there are to compile, about."""

LOOK_S = 0.2


def is_warm() -> bool:
    """Whether a rehearsal has filled the cache before."""
    return (CACHE / MARK).exists()


def command(scenario: str) -> list[str]:
    """Return the command that compiles what a run of this scenario needs; it exits 0 when that is done."""
    return [sys.executable, "-P", "-m", "services.supervisor.jit_cache", scenario]


def fill(scenario: Path, log: Path) -> subprocess.Popen[bytes]:
    """Start ``command`` with its output in ``log``."""
    with log.open("wb") as output:
        return subprocess.Popen(
            command(str(scenario)),
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )


def share() -> float:
    """How much of it is done, about, between 0 and 1."""
    try:
        expected = int((CACHE / EXPECTED).read_text())
    except (OSError, ValueError):  # nobody has counted yet
        return 0.0
    return min(1.0, sum(1 for _ in CACHE.rglob("*.nbi")) / expected)


def warm_up(scenario: str) -> None:
    """Every node of it: all their compiled code and solvers are loaded then."""
    warm_up_controller(scenario)
    warm_up_others(scenario)


def warm_up_controller(scenario: str) -> None:
    """The controller."""
    from services.processes import controller
    from services.run.run_config import resolve

    run_config = resolve(scenario)
    controller.warm_up(run_config.vehicle, run_config.reference, run_config.scenario.controller)


def warm_up_solver(scenario: str) -> None:
    """Of the controller what a cycle comes to last."""
    from services.processes import controller
    from services.run.run_config import resolve

    run_config = resolve(scenario)
    controller.warm_up_solver(run_config.vehicle, run_config.scenario.controller)


def warm_up_others(scenario: str) -> None:
    """Plant, sensors and estimator."""
    from services.processes import estimator, plant, sensors
    from services.run.run_config import resolve

    run_config = resolve(scenario)
    plant.warm_up(run_config)
    sensors.warm_up(run_config)
    estimator.warm_up(run_config.suite, run_config.scenario.estimator)


PARTS: dict[str, Callable[[str], None]] = {
    "controller": warm_up_controller,
    "others": warm_up_others,
    "solver": warm_up_solver,
}
"""Each in a process of its own, all at once."""


def main() -> int:
    """Of the scenario that is named; then nothing is left to compile."""
    scenario, *part = sys.argv[1:]
    if part:
        name, parent = part
        die_with_parent(int(parent))
        gc.disable()  # nearly all that a compiler makes lives on: a twelfth of the time goes into looking through it
        PARTS[name](scenario)
        return 0
    children = [
        subprocess.Popen([*command(scenario), name, str(os.getpid())], stdin=subprocess.DEVNULL) for name in PARTS
    ]
    try:
        from services.processes import sensors  # noqa: F401

        # About a seventh of what is decorated belongs to other forms and references than a run's own.
        (CACHE / EXPECTED).write_text(str(len(JIT_FUNCTIONS)))
        while any(child.poll() is None for child in children):
            time.sleep(LOOK_S)
    finally:
        for child in children:
            child.kill()
            child.wait()
    failed = [child.returncode for child in children if child.returncode]
    if not failed:
        (CACHE / MARK).touch()
    return failed[0] if failed else 0


if __name__ == "__main__":
    sys.exit(main())
