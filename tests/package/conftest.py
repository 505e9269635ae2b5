"""The wheel of this tree, built once by the build backend, without environment and network."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.docs.pages import ROOT


@pytest.fixture(scope="session")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the wheel as `python -m build` does."""
    folder = tmp_path_factory.mktemp("dist")
    code = "import sys, hatchling.build; hatchling.build.build_wheel(sys.argv[1])"
    subprocess.run([sys.executable, "-P", "-c", code, folder], cwd=ROOT, check=True, capture_output=True)
    return next(folder.glob("*.whl"))
