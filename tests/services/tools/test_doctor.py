"""The doctor: each thing that a run stands on, well and broken one at a time."""

from __future__ import annotations

import errno
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from ltv_mpc import jit
from services.cli.app import run
from services.supervisor import jit_cache
from services.tools import doctor
from services.tools.doctor import Found, Level

CORE = [("numpy", ">=2.0", ""), ("rosbags", ">=0.10", "ros2"), ("ruff", ">=0.14", "dev")]


@pytest.fixture
def broken(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Replace a value that the checks read."""

    def with_(name: str, value: object, of: Any = doctor) -> None:
        monkeypatch.setattr(of, name, value)

    return with_


def raises(error: Exception) -> Callable[..., Any]:
    def raised(*_: object, **__: object) -> Any:
        raise error

    return raised


def is_(found: Found, level: Level, *words: str) -> None:
    assert found[0] is level, found
    for word in words:
        assert word in " -> ".join(found[1:])
    assert (len(found) == 3) is (level is not Level.OK)


Break = Callable[[Callable[..., None]], None]

CASES: dict[str, tuple[Callable[[], Found], Break, Level, tuple[str, ...]]] = {
    "an old python": (
        doctor.python,
        lambda broken: broken("version_info", (3, 10, 9, "final", 0), sys),
        Level.PROBLEM,
        ("3.10.9", "3.11 to 3.13"),
    ),
    "a package is missing": (
        doctor.packages,
        lambda broken: (broken("requirements", lambda: CORE), broken("installed", lambda _: None))[0],
        Level.PROBLEM,
        ("numpy is missing", 'pip install "numpy>=2.0"'),
    ),
    "a package is too old": (
        doctor.packages,
        lambda broken: (broken("requirements", lambda: CORE), broken("installed", lambda _: "1.26.4"))[0],
        Level.PROBLEM,
        ("numpy is 1.26.4, must be >=2.0",),
    ),
    "a package is imported from elsewhere": (
        doctor.project,
        lambda broken: broken("folder_of", lambda name: doctor.ROOT if name != "sim" else Path("/elsewhere")),
        Level.PROBLEM,
        ("sim is taken from /elsewhere", "pip install -e"),
    ),
    "one core": (
        doctor.cores,
        lambda broken: broken("core_count", lambda: 1),
        Level.WARNING,
        ("1 cores", "--lockstep"),
    ),
    "no leave to write": (
        doctor.space,
        lambda broken: broken("TemporaryFile", raises(OSError()), doctor.tempfile),
        Level.WARNING,
        ("--out",),
    ),
    "a full disk": (
        doctor.space,
        lambda broken: broken("disk_usage", lambda _: SimpleNamespace(free=5_000_000), doctor.shutil),
        Level.PROBLEM,
        ("0.0 GB free",),
    ),
    "no loopback": (
        doctor.loopback,
        lambda broken: broken("create_server", raises(OSError(errno.EADDRNOTAVAIL, "Cannot assign")), doctor.socket),
        Level.PROBLEM,
        ("Cannot assign", "ip link set lo up"),
    ),
    "code not compiled yet": (
        doctor.compiled,
        lambda broken: (broken("CACHE_IS_PERSISTENT", True, jit), broken("is_warm", lambda: False, jit_cache))[0],
        Level.WARNING,
        ("make setup",),
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_each_thing_that_can_be_broken_is_found_with_its_remedy(case: str, broken: Callable[..., None]) -> None:
    check, break_it, level, words = CASES[case]
    break_it(broken)
    is_(check(), level, *words)


@pytest.fixture
def well(broken: Callable[..., None]) -> None:
    """Nothing that depends on how busy or full this machine is."""
    busy = (doctor.cores, doctor.space, doctor.compiled)
    broken("CHECKS", tuple((lambda: (Level.OK, "")) if check in busy else check for check in doctor.CHECKS))


@pytest.mark.usefixtures("well")
def test_here_nothing_is_a_problem(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["doctor", "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert shown["counts"]["problem"] == 0
    assert len(shown["findings"]) == len(doctor.CHECKS)


@pytest.mark.usefixtures("well")
def test_a_problem_is_exit_1_and_a_check_that_fails_is_one(
    broken: Callable[..., None], capsys: pytest.CaptureFixture[str]
) -> None:
    broken("CHECKS", (lambda: (Level.WARNING, "b", "c"),))
    assert run(["doctor"]) == 0

    def falls_over() -> Found:
        raise RuntimeError("so it is")

    broken("CHECKS", (falls_over, lambda: (Level.OK, "fine")))
    assert run(["doctor"]) == 1
    out = capsys.readouterr().out
    assert "falls_over      cannot be checked: so it is" in out
    assert "fine" in out


def test_it_speaks_of_a_missing_package_instead_of_failing_with_it() -> None:
    """The module itself needs the standard library alone."""
    code = (
        "import sys, services.tools.doctor;"
        "print(sorted({name.partition('.')[0] for name in sys.modules} & set(sys.argv[1:])))"
    )
    heavy = ("numpy", "scipy", "msgspec", "numba", "osqp", "zenoh", "mcap", "rich", "typer", "sim")
    done = subprocess.run([sys.executable, "-P", "-c", code, *heavy], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
