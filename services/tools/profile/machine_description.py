"""Machine description: processor, cores, load and versions, without which measured times cannot be compared."""

from __future__ import annotations

import os
from collections.abc import Iterable

from services.run.provenance import package_version, provenance_table

Machine = dict[str, str | int | list[float]]

SOLVERS = ("daqp", "piqp", "qpsolvers")
"""What a profile uses beyond the packages that a run names."""


def machine(load_before: list[float], packages: Iterable[str] = SOLVERS) -> Machine:
    """Describe this machine; ``load_before`` is the result of ``load`` before the measurement."""
    return {
        **provenance_table(),
        **{package: package_version(package) for package in packages},
        "cores": os.cpu_count() or 1,
        "load_before": load_before,
        "load_after": load(),
    }


def load() -> list[float]:
    """Return the mean number of running and waiting processes over 1, 5 and 15 minutes."""
    return [round(mean, 2) for mean in os.getloadavg()]


def line(of: Machine, packages: Iterable[str] = ("numpy", "numba", "osqp", "piqp")) -> str:
    """Format the machine description as one line of text."""
    versions = ", ".join(f"{name} {of[name]}" for name in ("python", *packages))
    loads = f"{_one(of['load_before'])} to {_one(of['load_after'])}"
    return f"{of['processor']}, {of['cores']} cores, load {loads}; {versions}"


def _one(load: object) -> str:
    return f"{load[0]:g}" if isinstance(load, list) else str(load)
