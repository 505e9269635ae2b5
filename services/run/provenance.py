"""Provenance of a run: versions, commit and processor. Results of another processor may differ in the last bits.

The last bits of a product or a sine depend on the code that is selected for the processor at run time. numba selects it
for compiled functions (``numba_cpu``: its target, and a checksum of the instructions that it may use), and OpenBLAS for
numpy's products (``blas``: the name of its kernel).

The version of the running code is one text for `ltv-mpc --version`, a run's files and the doctor. A wheel has the
version of its git tag. An editable checkout has the version of the day of its installation, while its code changes: of
that version only the release is still valid, and the commit that is checked out now is appended.
"""

from __future__ import annotations

import ctypes
import platform
import re
import subprocess
import zlib
from functools import cache
from importlib import metadata
from pathlib import Path

import ltv_mpc

ROOT = Path(__file__).resolve().parents[2]

UNKNOWN = "unknown"


def version() -> str:
    """Return the version: ``0.2.0``, for a checkout ``0.2.0+g1a2b3c4d5``, and ``.changed`` if its files differ."""
    return combine(ltv_mpc.__version__, commit())


def combine(installed: str, commit: str) -> str:
    """Combine a distribution's version with the commit that is checked out, if there is one."""
    if UNKNOWN in (commit, installed):
        return installed
    release = re.sub(r"(?<=\.dev)\d+", "", installed.partition("+")[0])
    name, _, changes = commit.partition(" ")
    return f"{release}+g{name[:9]}{'.changed' if changes else ''}"


def commit() -> str:
    """Return the commit, with ``and changes`` if files differ from it; "unknown" outside a checkout."""
    if not (ROOT / ".git").exists():
        return UNKNOWN
    try:
        head, changed = (_git(*words) for words in (("rev-parse", "HEAD"), ("status", "--porcelain", "-uno")))
    except (OSError, subprocess.SubprocessError):
        return UNKNOWN
    return head + (" and changes" if changed else "")


def _git(*words: str) -> str:
    done = subprocess.run(["git", "-C", str(ROOT), *words], capture_output=True, text=True, timeout=5, check=True)
    return done.stdout.strip()


PACKAGES = (
    *("numpy", "scipy", "osqp", "daqp", "piqp", "numba", "llvmlite"),
    *("eclipse-zenoh", "msgspec", "msgpack", "mcap"),
)
KERNEL_NAMES = ("scipy_openblas_get_corename64_", "scipy_openblas_get_corename", "openblas_get_corename")


def provenance_table() -> dict[str, str]:
    """Return the table ``[made_by]`` of a run's scenario.toml."""
    checked_out = commit()
    table = {
        "ltv_mpc": combine(ltv_mpc.__version__, checked_out),
        "commit": checked_out,
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.machine()}",
        "processor": _processor(),
        "numba_cpu": _numba_cpu(),
        "blas": _blas(),
    }
    return table | {package: package_version(package) for package in PACKAGES}


@cache  # it reads and parses a file for each package
def package_version(package: str) -> str:
    """Return the version of an installed distribution."""
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
