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
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path

from services.run.host_resources import core_count
from services.run.provenance import provenance_table

DISTRIBUTION = "auv-ltv-mpc"
OURS = ("ltv_mpc", "sim", "services")
ROOT = Path(__file__).resolve().parents[2]
"""Folder of this project's packages: a checkout or site-packages."""

PYTHONS = ((3, 11), (3, 14))
MIN_CORES = 2
MAX_CLOCK_STEP_S = 1e-3
MAX_OVERSLEEP_S = 5e-3
"""Largest median excess of a sleep; a step of the plant is due every 10 ms."""
LOW_SPACE_BYTES, MIN_SPACE_BYTES = 1_000_000_000, 100_000_000
"""Free space (bytes) below which there is a warning, and a problem; a recorded descent of 200 s takes 15 MB."""
MIN_FILES = 256
TOOLS = ("dev", "bench", "docs", "mutation")
"""Extras for the development of this project, which are not reported."""

MODULES = {"eclipse-zenoh": "zenoh", "tomli-w": "tomli_w", "prometheus-client": "prometheus_client"}
"""Import names that differ from the name of their distribution."""


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


def ok(check: str, found: str) -> Finding:
    """Return a finding without a problem."""
    return Finding(check, Level.OK, found)


def warning(check: str, found: str, remedy: str) -> Finding:
    """Return a finding of a run that works with reduced performance."""
    return Finding(check, Level.WARNING, found, remedy)


def problem(check: str, found: str, remedy: str) -> Finding:
    """Return a finding that makes a run fail."""
    return Finding(check, Level.PROBLEM, found, remedy)


def examine() -> list[Finding]:
    """Run every check. A check that raises is reported as a problem."""
    found = []
    for check in CHECKS:
        try:
            found.append(check())
        except Exception as error:  # any error: the other checks still run
            text = " ".join(str(error).split()) or type(error).__name__
            name = check.__name__.replace("_", " ")
            found.append(problem(name, f"cannot be checked: {text}", "make clean && make setup"))
    return found


# --- what is installed -----------------------------------------------------------------------------------------------


def python() -> Finding:
    """Check the Python version."""
    (low, high), version = PYTHONS, sys.version_info[:2]
    summary = ".".join(map(str, sys.version_info[:3]))
    if low <= version < high:
        return ok("python", f"{summary}, {sys.executable}")
    newest = f"{high[0]}.{high[1] - 1}"
    return problem("python", summary, f"install Python {low[0]}.{low[1]} to {newest}, then make clean && make setup")


def project() -> Finding:
    """Report version and commit of this project."""
    made = provenance_table()
    summary = f"{made['ltv_mpc']}, commit {made['commit'][:12]}, in {ROOT}"
    if requirements() is None:
        return warning("project", f"{summary}; its packages are not installed", f"pip install -e {ROOT}")
    return ok("project", summary)


def packages() -> Finding:
    """Check that the required packages are installed, of the right version, and can be imported."""
    there, wrong = [], []
    for name, bounds, extra in requirements() or ():
        if extra:
            continue
        version = installed(name)
        if version is None:
            wrong.append((f"{name} is missing", f"{name}{bounds}"))
        elif not within(version, bounds):
            wrong.append((f"{name} is {version}, must be {bounds}", f"{name}{bounds}"))
        elif summary := import_error(MODULES.get(name, name)):
            wrong.append((f"{name} {version} cannot be imported ({summary})", f"--force-reinstall {name}"))
        else:
            there.append(f"{name} {version}")
    if wrong:
        needed = " ".join(f'"{what}"' if " " not in what else what for _, what in wrong)
        return problem("packages", "; ".join(summary for summary, _ in wrong), f"pip install {needed}")
    return ok("packages", ", ".join(there))


def extras() -> Finding:
    """Report the optional packages; a missing one is never a problem."""
    by_extra: dict[str, list[str]] = {}
    for name, _, extra in requirements() or ():
        if extra and extra not in TOOLS:
            by_extra.setdefault(extra, [])
            if installed(name) is None:
                by_extra[extra].append(name)
    there = ", ".join(extra for extra, missing in by_extra.items() if not missing) or "none"
    lacking = [f"{extra} (pip install {' '.join(missing)})" for extra, missing in by_extra.items() if missing]
    return ok("extras", there + (f"; not installed: {', '.join(lacking)}" if lacking else ""))


def names() -> Finding:
    """Check that ``ltv_mpc``, ``sim`` and ``services`` are imported from this project, not from packages of the same
    name.
    """
    owners = {name: sorted(set(owners_of(name)) - {DISTRIBUTION}) for name in OURS}
    taken = {name: others for name, others in owners.items() if others}
    if taken:
        summary = "; ".join(f"{name} also belongs to {', '.join(others)}" for name, others in taken.items())
        others = sorted({other for found in taken.values() for other in found})
        return problem("names", summary, f"pip uninstall {' '.join(others)}")
    elsewhere = {name: folder for name in OURS if (folder := folder_of(name)) != ROOT}
    if elsewhere:
        summary = "; ".join(f"{name} is taken from {folder or 'nowhere'}" for name, folder in elsewhere.items())
        return problem("names", summary, f"rename that folder or start in another one, then pip install -e {ROOT}")
    return ok("names", f"{', '.join(OURS)} are imported from this project")


# --- the machine ----------------------------------------------------------------------------------------------------


def cores() -> Finding:
    """Check the number of cores and their load."""
    count, busy = core_count(), os.getloadavg()[0]
    summary = f"{count} cores, load {busy:.2f}"
    if count < MIN_CORES:
        return warning("cores", summary, "a run at real time (--speed 1) or --lockstep needs less")
    if busy > count:
        return warning(
            "cores", summary, "load is above the number of cores, so measured times are too long: end other programs"
        )
    return ok("cores", summary)


def clock() -> Finding:
    """Check the resolution of the monotonic clock and the delay of a sleep of 1 ms."""
    resolution_s, late_s = time.get_clock_info("monotonic").resolution, oversleep_s()
    summary = f"resolution {resolution_s * 1e9:.0f} ns, a sleep of 1 ms is {late_s * 1e3:.2f} ms longer"
    if resolution_s > MAX_CLOCK_STEP_S:
        return problem("clock", summary, "another clock source: /sys/devices/system/clocksource/clocksource0")
    if late_s > MAX_OVERSLEEP_S:
        return warning("clock", summary, "steps come every 10 ms: end other programs, or run at a lower --speed")
    return ok("clock", summary)


def open_files() -> Finding:
    """Check how many files a process may have open."""
    import resource

    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    if 0 <= soft < MIN_FILES:
        return warning("open files", f"at most {soft} a process", f"ulimit -n {4 * MIN_FILES}")
    return ok("open files", f"at most {soft} a process")


def space() -> Finding:
    """Check the free space of the current folder and that it can be written."""
    here, free = Path.cwd(), shutil.disk_usage(Path.cwd()).free
    summary = f"{free / 1e9:.1f} GB free in {here}"
    if not writable(here):
        return warning("space", f"{here} cannot be written", "start in another folder, or give each run an --out DIR")
    if free < MIN_SPACE_BYTES:
        return problem("space", summary, "free disk space, or start in a folder on another disk")
    if free < LOW_SPACE_BYTES:
        return warning("space", summary, "a recorded descent takes 15 MB: remove old folders below runs/")
    return ok("space", summary)


def temporary() -> Finding:
    """Check that there is a folder for temporary files."""
    try:
        folder = Path(tempfile.gettempdir())
    except FileNotFoundError:
        return problem("temporary files", "no writable folder", "set TMPDIR to a writable folder")
    return ok("temporary files", str(folder))


def loopback() -> Finding:
    """Check that processes can reach each other over 127.0.0.1."""
    try:
        echoed = echo()
    except OSError as error:
        remedy = "bring the loopback interface up (ip link set lo up), or allow it in the firewall or sandbox"
        return problem("loopback", f"127.0.0.1 cannot be used: {error.strerror or error}", remedy)
    router = "a router listens" if router_answers() else "no router listens"
    return ok("loopback", f"{echoed} bytes there and back; {router} at 127.0.0.1:7447, the default router address")


# --- what a run computes with ---------------------------------------------------------------------------------------


def solver() -> Finding:
    """Solve a QP of two variables whose solution is known with OSQP.

    min x'x/2 - x1 - x2, 0 <= x <= 0.5: x = (0.5, 0.5).
    """
    x = solution()
    if not all(abs(xi - 0.5) <= 1e-3 for xi in x):
        remedy = "pip install --force-reinstall osqp; until then --set controller.solver=riccati"
        return problem("solver", f"osqp gives {x} for (0.5, 0.5)", remedy)
    return ok("solver", "osqp solves a QP")


def compiled() -> Finding:
    """Check the cache of compiled code."""
    from ltv_mpc.jit import CACHE, CACHE_IS_PERSISTENT
    from services.supervisor.jit_cache import is_warm

    if not CACHE_IS_PERSISTENT:
        remedy = "make ~/.cache writable, or set XDG_CACHE_HOME to a folder that is: until then each run compiles again"
        return warning("compiled code", f"no writable cache folder; temporary folder {CACHE}", remedy)
    if not is_warm():
        return warning(
            "compiled code",
            f"not compiled yet: {CACHE}",
            "the first run compiles for about a minute, or run make setup",
        )
    return ok("compiled code", f"ready in {CACHE}")


CHECKS: tuple[Callable[[], Finding], ...] = (
    *(python, project, packages, extras, names),
    *(cores, clock, open_files, space, temporary, loopback),
    *(solver, compiled),
)
"""Checks in the order in which they are printed; those on which others depend come first."""


# --- what the checks look at ----------------------------------------------------------------------------------------


def requirements() -> list[tuple[str, str, str]] | None:
    """List name, bounds and extra of each required distribution; None if this project is not installed."""
    try:
        texts = metadata.requires(DISTRIBUTION) or []
    except metadata.PackageNotFoundError:
        return None
    return [parsed for text in texts if (parsed := requirement(text)) is not None]


def requirement(text: str) -> tuple[str, str, str] | None:
    """Parse ``osqp<1.2,>=1.1; extra == "x"`` into name, bounds, extra."""
    found = re.fullmatch(r"""([\w.-]+)(?:\[[^]]*])?\s*\(?([^;)]*)\)?\s*(?:;.*extra == ['"]([\w-]+)['"].*)?""", text)
    return None if found is None else (found[1], found[2].replace(" ", ""), found[3] or "")


def installed(name: str) -> str | None:
    """Return the version of a distribution; None if it is not installed."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def within(version: str, bounds: str) -> bool:
    """Return True if version ``1.1.3`` meets ``<1.2,>=1.1``; an unknown comparison is ignored."""
    holds = {">=": lambda a, b: a >= b, "<": lambda a, b: a < b, ">": lambda a, b: a > b, "<=": lambda a, b: a <= b}
    for bound in filter(None, bounds.split(",")):
        found = re.fullmatch(r"(>=|<=|<|>)([\d.]+)", bound)
        if found is not None and not holds[found[1]](_numbers(version), _numbers(found[2])):
            return False
    return True


def _numbers(version: str) -> list[int]:
    numbers = [int(part) for part in re.match(r"[\d.]*", version)[0].split(".") if part]  # type: ignore[index]
    while numbers and not numbers[-1]:  # 1.0 is 1
        numbers.pop()
    return numbers


def import_error(module: str) -> str:
    """Return why a module cannot be imported; empty if it can."""
    try:
        importlib.import_module(module)
    except Exception as error:  # a broken extension may raise any error
        return " ".join(str(error).split())[:120] or type(error).__name__
    return ""


def owners_of(package: str) -> Iterable[str]:
    """Return the distributions that claim a top-level package."""
    return _distributions().get(package, ())


@cache
def _distributions() -> Mapping[str, list[str]]:
    return metadata.packages_distributions()  # reads the list of every installed file


def folder_of(package: str) -> Path | None:
    """Return the folder from which ``import`` takes a top-level package."""
    spec = find_spec(package)
    places = list(spec.submodule_search_locations or ()) if spec is not None else []
    return Path(places[0]).resolve().parent if places else None


def oversleep_s() -> float:
    """Return the median excess duration of a sleep of 1 ms (s)."""
    return statistics.median(_oversleeps())


def _oversleeps(count: int = 15) -> Iterator[float]:
    for _ in range(count):
        began = time.perf_counter()
        time.sleep(1e-3)
        yield time.perf_counter() - began - 1e-3


def writable(folder: Path) -> bool:
    """Return True if a file can be created in the folder."""
    try:
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def echo() -> int:
    """Send bytes over a loopback connection and return how many arrived. Raises ``OSError``."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(2.0)
        with socket.create_connection(server.getsockname(), timeout=2.0) as client:
            client.sendall(b"ltv-mpc")
            near, _ = server.accept()
            with near:
                near.settimeout(2.0)
                return len(near.recv(100))


def router_answers() -> bool:
    """Return True if a process listens at the default address of a router."""
    try:
        socket.create_connection(("127.0.0.1", 7447), timeout=0.5).close()
    except OSError:
        return False
    return True


def solution() -> tuple[float, ...]:
    """Return OSQP's x of the QP of ``solver``."""
    import numpy as np
    from scipy.sparse import csc_array, eye_array

    from ltv_mpc.control.qp import QP
    from ltv_mpc.control.solvers.qpsolvers_backend import solve_qp

    unit = csc_array(eye_array(2))
    qp = QP(unit, np.array([-1.0, -1.0]), unit, np.zeros(2), np.full(2, 0.5))
    return tuple(float(x) for x in solve_qp(qp).x)
