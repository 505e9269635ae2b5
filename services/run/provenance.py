"""Provenance of a run: versions, commit and processor. Results of another processor may differ in the last bits.

The last bits of a product or a sine depend on the code that is selected for the processor at run time. numba selects it
for compiled functions (``numba_cpu``: its target, and a checksum of the instructions that it may use), and OpenBLAS for
numpy's products (``blas``: the name of its kernel).
"""

from __future__ import annotations

import ctypes
import platform
import zlib
from functools import cache
from importlib import metadata
from pathlib import Path

from services.run.version import combine, commit, installed

PACKAGES = (
    *("numpy", "scipy", "osqp", "daqp", "piqp", "numba", "llvmlite"),
    *("eclipse-zenoh", "msgspec", "msgpack", "mcap"),
)
KERNEL_NAMES = ("scipy_openblas_get_corename64_", "scipy_openblas_get_corename", "openblas_get_corename")


def provenance_table() -> dict[str, str]:
    """Return the table ``[made_by]`` of a run's scenario.toml."""
    checked_out = commit()
    table = {
        "ltv_mpc": combine(installed(), checked_out),
        "commit": checked_out,
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.machine()}",
        "processor": _processor(),
        "numba_cpu": _numba_cpu(),
        "blas": _blas(),
    }
    return table | {package: _version(package) for package in PACKAGES}


@cache  # it reads and parses a file for each package
def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "not installed"


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return platform.processor() or "unknown"
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or "unknown"


def _numba_cpu() -> str:
    from llvmlite import binding

    features = binding.get_host_cpu_features().flatten()
    return f"{binding.get_host_cpu_name()}, instructions {zlib.crc32(features.encode()):08x}"


def _blas() -> str:
    """Return the name of the kernel that numpy's OpenBLAS has selected; a wheel has OpenBLAS in its own folder."""
    import numpy as np

    for path in sorted(Path(np.__file__).parents[1].glob("numpy.libs/*openblas*")):
        library = ctypes.CDLL(str(path))
        for name in KERNEL_NAMES:
            if function := getattr(library, name, None):
                function.restype = ctypes.c_char_p
                return str(function().decode())
    return "unknown"
