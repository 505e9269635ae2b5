"""Scenarios of the foreign craft: one module each, whose ``run()`` returns figures with their limits."""

from __future__ import annotations

from importlib import import_module
from pkgutil import iter_modules

from tests.foreign_plant.flight import Figure

NAMES = tuple(sorted(module.name for module in iter_modules(__path__)))


def run(name: str) -> list[Figure]:
    """Run a scenario and return its figures."""
    figures: list[Figure] = import_module(f"{__name__}.{name}").run()
    return figures
