"""Libraries of a boat computer's processes: what a process does not need is not loaded, 14 to 40 MB each."""

from __future__ import annotations

import subprocess
import sys

import pytest

ESTIMATES = """
from types import SimpleNamespace as Message
from services.edges.mavlink.navigation import Accuracy, Navigation

found, of = [], Navigation(Accuracy(), dives=False)
for ms in (0, 100, 200):
    rates = dict(roll=0.0, pitch=0.0, yaw=3.1 + 0.001 * ms, pitchspeed=0.0, yawspeed=1.0)
    found += of.attitude(Message(time_boot_ms=ms, **rates))
    found += of.position(Message(time_boot_ms=ms, **dict.fromkeys(("x", "y", "z", "vx", "vy", "vz"), 0.0)))
assert found
"""
"""numba loads scipy.linalg when the first compiled function is called."""


@pytest.mark.parametrize(
    ("process", "works", "lacks"),
    [
        ("router", "", "numba scipy.linalg"),
        ("recorder", "", "numba scipy.linalg"),
        ("mavlink", ESTIMATES, "scipy.linalg"),
    ],
)
def test_a_process_loads_no_large_library_that_it_does_not_need(process: str, works: str, lacks: str) -> None:
    pytest.importorskip("pymavlink")
    code = f"import sys, services.processes.{process}\n{works}\nprint(sorted(set({lacks.split()}) & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
