"""Settings of all tests: one BLAS thread as in each process, no deadlines on shared machines, longest folders first."""

from __future__ import annotations

import gc
import signal
from pathlib import Path

import pytest
from hypothesis import settings

import services  # noqa: F401  (sets the number of BLAS threads before numpy is imported)

# isort: split
import ltv_mpc.jit  # noqa: F401  (a command would load compiled functions as plain Python)

# A first example pays for compilation, and these machines are shared.
settings.register_profile("ltv-mpc", deadline=None, derandomize=True, max_examples=30)
settings.load_profile("ltv-mpc")

# Under ``nohup`` the processes that tests start would ignore a hang-up, as they should for a user.
signal.signal(signal.SIGHUP, signal.SIG_DFL)

gc.set_threshold(50_000, 20, 100)  # thousands of tests and trees of syntax are no garbage to look for

HERE = Path(__file__).parent


@pytest.fixture
def without_report(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let ``sim`` name its report and write none: to read the recording of a minute takes as long as to make it."""

    def named(recording: Path, _: object) -> str:
        return f"report: {recording.with_name('report.html')}"

    monkeypatch.setattr("services.cli.runs.after_run", named)


LONGEST = (
    *("browser", "services/supervisor", "foreign_plant", "docs", "services/tools", "strangers", "system"),
    *("benchmarks", "examples", "services/edges", "services/replay", "services/dashboard", "services/runtime"),
    *("ltv_mpc/control", "ltv_mpc/safety", "ltv_mpc/localisation", "ltv_mpc/vehicle", "ltv_mpc/references"),
)
"""Folders whose files take longest. They start first: a long file that starts last keeps all other workers waiting."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Sort the tests so that the folders of ``LONGEST`` come first; files stay whole and in their order."""

    def rank(item: pytest.Item) -> int:
        folder = item.path.relative_to(HERE).parent.as_posix()
        return next((i for i, name in enumerate(LONGEST) if (folder + "/").startswith(name + "/")), len(LONGEST))

    items.sort(key=rank)
