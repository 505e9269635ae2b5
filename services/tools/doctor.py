"""Machine check: one check for each requirement of a run, with the remedy for each problem.

At its top this file imports the standard library alone: a package that is missing or broken is a finding, no traceback.
"""

from __future__ import annotations

import enum
import importlib
import os
import re
import shutil
import socket
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path

from services.run.host_resources import core_count
from services.run.provenance import provenance_table

DISTRIBUTION = "auv-ltv-mpc"
ROOT = Path(__file__).resolve().parents[2]
"""Folder of this project's packages: a checkout or site-packages."""

PYTHONS = ((3, 11), (3, 14))
MIN_CORES = 2
LOW_SPACE_BYTES, MIN_SPACE_BYTES = 1_000_000_000, 100_000_000
"""Free space (bytes) below which there is a warning, and a problem; a recorded descent of 200 s takes 15 MB."""


class Level(enum.StrEnum):
    """Severity of a finding."""

    OK = "ok"
    WARNING = "warning"  # it works, worse than it could
    PROBLEM = "problem"  # a run will fail


@dataclass(frozen=True)
class Finding:
    """Result of one check: what was checked, what was found, and the remedy if there is a problem."""

    check: str
    level: Level
    found: str
    remedy: str = ""


def examine() -> list[Finding]:
    """Run every check. A check that raises is reported as a problem."""
    found = []
    for check in CHECKS:
        try:
            found.append(Finding(check.__name__, *check()))
        except Exception as error:  # any error: the other checks still run
            text = " ".join(str(error).split()) or type(error).__name__
            found.append(
                Finding(check.__name__, Level.PROBLEM, f"cannot be checked: {text}", "make clean && make setup")
            )
    return found


Found = tuple[Level, str] | tuple[Level, str, str]
"""Level, what was found, and the remedy if there is a problem."""


def python() -> Found:
    """Check the Python version."""
    (low, high), version = PYTHONS, ".".join(map(str, sys.version_info[:3]))
    if low <= sys.version_info[:2] < high:
        return Level.OK, f"{version}, {sys.executable}"
    newest = f"{high[0]}.{high[1] - 1}"
    return Level.PROBLEM, version, f"install Python {low[0]}.{low[1]} to {newest}, then make clean && make setup"


def project() -> Found:
    """Report the version of this project, and check that its packages are imported from it, not others of their names.

    ``sim`` and ``services`` are names that other packages and folders have, too.
    """
    made = provenance_table()
    summary = f"{made['ltv_mpc']}, commit {made['commit'][:12]}, in {ROOT}"
    elsewhere = {name: folder for name in ("ltv_mpc", "sim", "services") if (folder := folder_of(name)) != ROOT}
    if elsewhere:
        taken = "; ".join(f"{name} is taken from {folder or 'nowhere'}" for name, folder in elsewhere.items())
        return Level.PROBLEM, taken, f"rename that folder or start in another one, then pip install -e {ROOT}"
    if not requirements():
        return Level.WARNING, f"{summary}; its packages are not installed", f"pip install -e {ROOT}"
    return Level.OK, summary


def packages() -> Found:
    """Check that the required packages are installed, of the right version, and can be imported."""
    there, wrong, needed = [], [], []
    for name, bounds in requirements():
        version = installed(name)
        if version is not None and within(version, bounds):
            module = {"eclipse-zenoh": "zenoh"}.get(name, name.replace("-", "_"))
            try:
                importlib.import_module(module)
                there.append(f"{name} {version}")
            except Exception as error:  # a broken extension may raise any error
                wrong.append(f"{name} {version} cannot be imported ({' '.join(str(error).split())[:120]})")
                needed.append(f"--force-reinstall {name}")
        else:
            wrong.append(f"{name} is {'missing' if version is None else f'{version}, must be {bounds}'}")
            needed.append(f'"{name}{bounds}"')
    return (
        (Level.PROBLEM, "; ".join(wrong), f"pip install {' '.join(needed)}") if wrong else (Level.OK, ", ".join(there))
    )


def cores() -> Found:
    """Check the number of cores and their load."""
    count, busy = core_count(), os.getloadavg()[0]
    summary = f"{count} cores, load {busy:.2f}"
    if count < MIN_CORES:
        return Level.WARNING, summary, "a run at real time (--speed 1) or --lockstep needs less"
    if busy > count:
        return Level.WARNING, summary, "load is above the number of cores, so steps come late: end other programs"
    return Level.OK, summary


def space() -> Found:
    """Check the free space of the current folder and that it can be written."""
    here, free = Path.cwd(), shutil.disk_usage(Path.cwd()).free
    summary = f"{free / 1e9:.1f} GB free in {here}"
    try:
        with tempfile.TemporaryFile(dir=here):
            pass
    except OSError:
        return Level.WARNING, f"{here} cannot be written", "start in another folder, or give each run an --out DIR"
    if free < MIN_SPACE_BYTES:
        return Level.PROBLEM, summary, "free disk space, or start in a folder on another disk"
    if free < LOW_SPACE_BYTES:
        return Level.WARNING, summary, "a recorded descent takes 15 MB: remove old folders below runs/"
    return Level.OK, summary


def loopback() -> Found:
    """Check that processes can reach each other over 127.0.0.1."""
    try:
        with socket.create_server(("127.0.0.1", 0)) as server:
            socket.create_connection(server.getsockname(), timeout=2.0).close()
    except OSError as error:
        remedy = "bring the loopback interface up (ip link set lo up), or allow it in the firewall or sandbox"
        return Level.PROBLEM, f"127.0.0.1 cannot be used: {error.strerror or error}", remedy
    return Level.OK, "127.0.0.1 can be used"


def compiled() -> Found:
    """Check the cache of compiled code."""
    from ltv_mpc.jit import CACHE, CACHE_IS_PERSISTENT
    from services.supervisor.jit_cache import is_warm

    if not CACHE_IS_PERSISTENT:
        remedy = "make ~/.cache writable, or set XDG_CACHE_HOME to a folder that is: until then each run compiles again"
        return Level.WARNING, f"no writable cache folder; temporary folder {CACHE}", remedy
    if not is_warm():
        remedy = "the first run compiles for about a minute, or run make setup"
        return Level.WARNING, f"not compiled yet: {CACHE}", remedy
    return Level.OK, f"ready in {CACHE}"


CHECKS: tuple[Callable[[], Found], ...] = (python, project, packages, cores, space, loopback, compiled)
"""Checks in the order in which they are printed; those on which others depend come first."""


def requirements() -> list[tuple[str, str]]:
    """List name and bounds of each distribution that every run needs; empty if this project is not installed."""
    pattern = re.compile(r"([\w.-]+)(?:\[[^]]*])?\s*\(?([^;)]*)\)?\s*")  # those of extras have a condition
    try:
        found = [pattern.fullmatch(text) for text in metadata.requires(DISTRIBUTION) or ()]
    except metadata.PackageNotFoundError:
        return []
    return [(one[1], one[2].replace(" ", "")) for one in found if one is not None]


def installed(name: str) -> str | None:
    """Return the version of a distribution; None if it is not installed."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def within(version: str, bounds: str) -> bool:
    """Return True if version ``1.1.3`` meets ``<1.2,>=1.1``; an unknown comparison is ignored."""
    asked = re.findall(r"(>=|<)([\d.]+)", bounds)
    return all((_numbers(version) >= _numbers(bound)) is (relation == ">=") for relation, bound in asked)


def _numbers(version: str) -> list[int]:
    released = re.match(r"[\d.]*", version)[0]  # type: ignore[index]
    return [*map(int, re.findall(r"\d+", released)), 0, 0, 0, 0][:4]  # 1.0 is 1


def folder_of(package: str) -> Path | None:
    """Return the folder from which ``import`` takes a top-level package."""
    spec = find_spec(package)
    places = list(spec.submodule_search_locations or ()) if spec is not None else []
    return Path(places[0]).resolve().parent if places else None
