"""What a user may import, and what that brings along."""

from __future__ import annotations

import subprocess
import sys

import ltv_mpc

NAMES = {
    "Bathymetry",
    "Controller",
    "ControllerConfig",
    "CurrentProfile",
    "Estimate",
    "Fence",
    "Limit",
    "Motion",
    "Obstacle",
    "Obstacles",
    "Plan",
    "PlanOrigin",
    "SolveStatus",
    "Term",
    "Vehicle",
    "advance",
    "build_qp",
    "references",
    "solve_qp",
}


def test_the_public_names_are_these_and_each_is_there():
    assert set(ltv_mpc.__all__) == NAMES
    for name in NAMES:
        assert getattr(ltv_mpc, name) is not None


def test_the_library_imports_neither_the_simulation_nor_the_services_nor_a_network():
    code = (
        "import ltv_mpc, sys\n"
        "for name in ltv_mpc.__all__: getattr(ltv_mpc, name)\n"
        "bad = {m.partition('.')[0] for m in sys.modules} & {'sim', 'services', 'zenoh', 'msgpack'}\n"
        "assert not bad, bad"
    )
    done = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
