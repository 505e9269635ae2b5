"""Cache of compiled numba kernels, filled before any process starts: otherwise each process would compile them all.

Compiling takes more than a minute of processor time, two thirds of that for the controller. Three processes share the
work: the kernels of the QP, which are the longest chain of functions that need each other; the rest of the controller;
and all other nodes. On two cores the first of them has a core for itself, and none waits long for another one. Measured
times are in docs/notes/compile-time.md.
"""

from __future__ import annotations

import contextlib
import gc
import hashlib
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import msgspec

import ltv_mpc
import sim
from ltv_mpc.jit import CACHE, share_compilation
from services.run.run_config import RunConfig, resolve
from services.supervisor.parent_death import die_with_parent

NOTE = "compiling, once after a change of the sources: a minute or two"
"""Line that announces a compilation."""

MARK = "rehearsed"
"""File in the cache folder; its name goes on with a hash of the sources, of which everything is compiled."""

MACHINE_CODE_BYTES = 15_500_000
"""Approximate size of all machine code. Its share grows as evenly as the time; that of the functions does not."""

POLL_S = 0.2
"""Time between two looks at the share."""


def is_warm() -> bool:
    """Return True if everything is compiled."""
    return mark().exists()


def mark() -> Path:
    """Return the file that says that these sources are compiled."""
    digest = hashlib.sha256()
    for package in (ltv_mpc, sim):
        for path in sorted(Path(package.__path__[0]).rglob("*.py")):
            digest.update(path.read_bytes())
    return CACHE / f"{MARK}-{digest.hexdigest()[:16]}"


def command(scenario: str, *part: str) -> list[str]:
    """Return the command that compiles what a run of this scenario needs, or a part of it, and then exits with 0.

    It ends with this process.
    """
    return [sys.executable, "-P", "-m", "services.supervisor.jit_cache", str(os.getpid()), scenario, *part]


def fill(scenario: Path, log: Path | None, wait: Callable[[float], None]) -> int:
    """Run ``command`` with its output in ``log``, and return its exit code.

    ``wait`` is called again and again with the share that is compiled, approximately. An exception of it ends the
    compilation. A terminal's Ctrl-C reaches this process alone.
    """
    with contextlib.nullcontext() if log is None else log.open("wb") as output:
        process = subprocess.Popen(
            command(str(scenario)),
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            process_group=0,
        )
    before = stored_bytes()
    try:
        while process.poll() is None:
            wait(share(before))
    finally:
        process.kill()  # its own children end with it
        code = process.wait()
    return code


def share(before: int) -> float:
    """Return the share that is compiled, approximately, 0 to 1; ``before``: ``stored_bytes`` at the beginning."""
    return min(1.0, (stored_bytes() - before) / MACHINE_CODE_BYTES)


def stored_bytes() -> int:
    """Return the size of the machine code in the cache, also that of other versions of the sources."""
    return sum(path.stat().st_size for path in CACHE.glob("*/*.nbc"))


PARTS = {"solver": 0, "controller": 3, "others": 5}
"""Niceness of the parts that are compiled at the same time, each by a process of its own.

The solver's is the longest, and the controller waits for it; the others depend on none.
"""


def warm_up(run_config: RunConfig, part: str = "") -> None:
    """Run the nodes of a scenario briefly: all that its processes need, or one part of what is compiled for them.

    With the controller's part goes the proposal of a horizon, which the next run may need.
    """
    from ltv_mpc.control.resolution import settled
    from services.processes import controller, estimator, plant, sensors

    vehicle, scenario = run_config.vehicle, run_config.scenario
    if part == "solver":
        controller.warm_up_solver(vehicle, run_config.controller)
    if part == "controller":
        settled(msgspec.structs.replace(scenario.controller, horizon_s=None), vehicle)
    if part in ("", "controller"):
        controller.warm_up(vehicle, run_config.reference, run_config.controller)
    if part in ("", "others"):
        plant.warm_up(run_config)
        sensors.warm_up(run_config)
        estimator.warm_up(run_config.sensor_config, scenario.estimator)


def main(arguments: Sequence[str]) -> int:
    """Compile what a run of the named scenario needs, or a part. Return 0 if all of it is compiled."""
    parent, scenario, *part = arguments
    die_with_parent(int(parent))
    if part:
        os.nice(PARTS[part[0]])
        share_compilation()
        gc.disable()  # a compiler frees next to nothing: collection would take a twelfth of the time
        warm_up(resolve(scenario), *part)
        return 0
    children = [subprocess.Popen(command(scenario, name), stdin=subprocess.DEVNULL) for name in PARTS]
    failed = [code for child in children if (code := child.wait())]
    if not failed:
        mark().touch()
    return failed[0] if failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
