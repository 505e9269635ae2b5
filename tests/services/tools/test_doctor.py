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

CORE = [("numpy", ">=2.0")]
NOT_OURS = lambda name: doctor.ROOT if name != "sim" else Path("/elsewhere")  # noqa: E731


def raises(error: Exception) -> Callable[..., Any]:
    def raised(*_: object, **__: object) -> Any:
        raise error

    return raised


Check = Callable[[], Found]
CASES: dict[str, tuple[Check, dict[tuple[Any, str], Any], Level, tuple[str, ...]]] = {
    "an old python": (
        doctor.python, {(sys, "version_info"): (3, 10, 9, "final", 0)}, Level.PROBLEM, ("3.10.9", "3.11 to 3.13")),
    "a package is missing": (
        doctor.packages, {(doctor, "requirements"): lambda: CORE, (doctor, "installed"): lambda _: None},
        Level.PROBLEM, ("numpy is missing", 'pip install "numpy>=2.0"')),
    "a package is too old": (
        doctor.packages, {(doctor, "requirements"): lambda: CORE, (doctor, "installed"): lambda _: "1.26.4"},
        Level.PROBLEM, ("numpy is 1.26.4, must be >=2.0",)),
    "a package is imported from elsewhere": (
        doctor.project, {(doctor, "folder_of"): NOT_OURS}, Level.PROBLEM,
        ("sim is taken from /elsewhere", "pip install -e")),
    "one core": (doctor.cores, {(doctor, "core_count"): lambda: 1}, Level.WARNING, ("1 cores", "--lockstep")),
    "no leave to write": (
        doctor.space, {(doctor.tempfile, "TemporaryFile"): raises(OSError())}, Level.WARNING, ("--out",)),
    "a full disk": (
        doctor.space, {(doctor.shutil, "disk_usage"): lambda _: SimpleNamespace(free=5_000_000)}, Level.PROBLEM,
        ("0.0 GB free",)),
    "no loopback": (
        doctor.loopback, {(doctor.socket, "create_server"): raises(OSError(errno.EADDRNOTAVAIL, "Cannot assign"))},
        Level.PROBLEM, ("Cannot assign", "ip link set lo up")),
    "code not compiled yet": (
        doctor.compiled, {(jit, "CACHE_IS_PERSISTENT"): True, (jit_cache, "is_warm"): lambda: False}, Level.WARNING,
        ("make setup",)),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_each_thing_that_can_be_broken_is_found_with_its_remedy(case: str, monkeypatch: pytest.MonkeyPatch) -> None:
    check, broken, level, words = CASES[case]
    for (of, name), value in broken.items():
        monkeypatch.setattr(of, name, value)
    found = check()
    assert (found[0], len(found)) == (level, 3)
    assert all(word in " -> ".join(found[1:]) for word in words), found


@pytest.fixture
def well(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing that depends on how busy or full this machine is."""
    busy = (doctor.cores, doctor.space, doctor.compiled)
    checks = tuple((lambda: (Level.OK, "")) if check in busy else check for check in doctor.CHECKS)
    monkeypatch.setattr(doctor, "CHECKS", checks)


@pytest.mark.usefixtures("well")
def test_here_nothing_is_a_problem(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["doctor", "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert shown["counts"]["problem"] == 0
    assert len(shown["findings"]) == len(doctor.CHECKS)


def test_a_problem_is_exit_1_and_a_check_that_fails_is_one(monkeypatch, capsys) -> None:
    monkeypatch.setattr(doctor, "CHECKS", (lambda: (Level.WARNING, "b", "c"),))
    assert run(["doctor"]) == 0
    monkeypatch.setattr(doctor, "CHECKS", (raises(RuntimeError("so it is")), lambda: (Level.OK, "fine")))
    assert run(["doctor"]) == 1
    out = capsys.readouterr().out
    assert "raised          cannot be checked: so it is" in out
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
