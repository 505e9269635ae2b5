"""Where a time was measured: processor, cores, load and versions. Without these a time means nothing elsewhere."""

from __future__ import annotations

import os
from collections.abc import Iterable
from importlib import metadata

from services.run.provenance import made_by

Machine = dict[str, str | int | list[float]]

SOLVERS = ("daqp", "piqp", "qpsolvers")
"""What a profile uses beyond the packages that a run names."""


def machine(load_before: list[float], packages: Iterable[str] = SOLVERS) -> Machine:
    """As of now; ``load_before`` is what ``load`` said before anything was measured."""
    return {
        **made_by(),
        **{package: version(package) for package in packages},
        "cores": os.cpu_count() or 1,
        "load_before": load_before,
        "load_after": load(),
    }


def load() -> list[float]:
    """Means of the number of processes that run or wait to, over 1, 5 and 15 minutes."""
    return [round(mean, 2) for mean in os.getloadavg()]


def version(package: str) -> str:
    """Of an installed distribution."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "not installed"


def line(of: Machine, packages: Iterable[str] = ("numpy", "numba", "osqp", "piqp")) -> str:
    """For a person."""
    versions = ", ".join(f"{name} {of[name]}" for name in ("python", *packages))
    loads = f"{_one(of['load_before'])} to {_one(of['load_after'])}"
    return f"{of['processor']}, {of['cores']} cores, load {loads}; {versions}"


def _one(load: object) -> str:
    return f"{load[0]:g}" if isinstance(load, list) else str(load)
