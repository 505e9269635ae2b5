"""What holds for every test: one BLAS thread, as in every process; no deadlines on shared machines; longest first."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import settings

import services  # noqa: F401  (sets the number of BLAS threads before numpy is imported)

# A first example pays for compilation, and these machines are shared.
settings.register_profile("ltv-mpc", deadline=None, derandomize=True)
settings.load_profile("ltv-mpc")

HERE = Path(__file__).parent
LONGEST = (
    "system",
    "services/launch",
    "ltv_mpc/localisation",
    "services/fleet",
    "services/measure",
    "services/nodes",
    "examples",
)
"""Folders whose files take longest, begun first: a worker that gets one of them at the end keeps all others waiting."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files stay whole and in order, but for ``LONGEST``."""

    def place(item: pytest.Item) -> int:
        folder = item.path.relative_to(HERE).parent.as_posix()
        return next((i for i, name in enumerate(LONGEST) if (folder + "/").startswith(name + "/")), len(LONGEST))

    items.sort(key=place)
