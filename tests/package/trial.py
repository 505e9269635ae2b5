"""`make package`: the wheel, built as it would be published and tried where nothing else is.

For each Python of 3.11 to 3.13 that this machine has: an empty environment, the wheel without any extra, and in a
folder of its own what a first user does. Then what the lean core lacks has to be asked for by the name of its extra.
The built files stay in dist/, the environments go.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from zipfile import ZipFile

from rich.console import Console

from tests.docs.pages import ROOT, blocks

MINORS = (11, 12, 13)
PACKAGES = ("ltv_mpc", "sim", "services")
DIST = ROOT / "dist"
LIMIT_S = 1800.0
"""For one command: the first run in an environment compiles, on a slow machine for minutes."""

USER = """
from ltv_mpc import Controller, Estimate, Vehicle, references

vehicle = Vehicle.load("paper")
plan = Controller(vehicle, references.Point(north_m=0.0, east_m=0.0)).plan(Estimate.at_rest(north_m=2.0))
reveal_type(vehicle.dry_mass_kg)
reveal_type(plan.thrust_at(0))
vehicle.mass
"""
"""What a user's type checker is asked: two types that it must know, and one mistake that it must see."""

NO_REPORT = "no report.html: plotly is not installed: pip install plotly (extra viz)"

WANTED = (
    (("log", "export", "run", "--format", "parquet"), 2, "extra parquet"),
    (("certs", "new", "certs"), 2, "extra secure"),
    (("ros2",), 2, "extra ros2"),
    (("mavlink",), 2, "extra mavlink"),
    (("campaign", "campaign.toml"), 2, "extra campaign"),
    (("report", "run"), 1, "extra viz"),
    (("dashboard",), 1, "extra viz"),
)
"""Commands that the lean core cannot do, their exit codes, and what they ask for."""


class Failed(Exception):
    """Failure of a trial, with its description."""


@dataclass(frozen=True)
class Environment:
    """Empty environment with the wheel installed, and a working folder."""

    python: Path
    folder: Path

    @property
    def program(self) -> Path:
        """Path of the installed ltv-mpc."""
        return self.python.with_name("ltv-mpc")

    def run(self, *words: str | Path, code: int = 0) -> subprocess.CompletedProcess[str]:
        """Run a command in the working folder, outside of this checkout. Raises ``Failed`` for another exit code."""
        own = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "VIRTUAL_ENV"))}
        line = [str(word) for word in words]
        done = subprocess.run(
            line, cwd=self.folder, env=own, timeout=LIMIT_S, check=False, capture_output=True, text=True
        )
        if done.returncode != code:
            ends = f"{done.stdout[-1500:]}\n{done.stderr[-1500:]}"
            raise Failed(f"{' '.join(line)}: exit code {done.returncode}, not {code}\n{ends}")
        return done


# --- what is tried ---------------------------------------------------------------------------------------------------


def version(env: Environment, wheel: Path) -> str:
    """Check that wheel, command, run and doctor report the same version."""
    said = env.run(env.program, "--version").stdout.split()[-1]
    if said != wheel.name.split("-")[1]:
        raise Failed(f"--version says {said} of {wheel.name}")
    return said


def help_(env: Environment, _wheel: Path) -> str:
    """Check the help of every command."""
    if "Start here" not in env.run(env.program, "--help").stdout:
        raise Failed("help has no panels")
    return "prints its panels"


def data(env: Environment, wheel: Path) -> str:
    """Check that every file of the packages is installed, and that the code is imported from the installation."""
    site = env.run(env.python, "-c", "import ltv_mpc, pathlib; print(pathlib.Path(ltv_mpc.__file__).parents[1])")
    there = Path(site.stdout.strip())
    if there.is_relative_to(ROOT):
        raise Failed(f"ltv_mpc is taken from {there}")
    names = [name for name in ZipFile(wheel).namelist() if name.startswith(PACKAGES)]
    missing = [name for name in names if not (there / name).is_file()]
    if missing:
        raise Failed(f"not installed: {', '.join(missing)}")
    return f"{len(names)} files"


def lockstep(env: Environment, wheel: Path) -> str:
    """Run five seconds of the descent in lock step; the run reports in one line that it wrote no report."""
    began = time.monotonic()
    done = env.run(env.program, "sim", "--lockstep", "--duration-s", "5", "--json", "--out", "run")
    took_s = time.monotonic() - began
    summary = json.loads(done.stdout)
    if summary["duration_s"] < 5.0 or NO_REPORT not in done.stderr:
        raise Failed(f"{summary}\n{done.stderr}")
    if f'ltv_mpc = "{wheel.name.split("-")[1]}"' not in (env.folder / "run" / "scenario.toml").read_text():
        raise Failed("scenario.toml names another version")
    return f"{summary['cycles']} cycles, {took_s:.0f} s with compiling"


def replay(env: Environment, _wheel: Path) -> str:
    """Replay the same run."""
    verdict = json.loads(env.run(env.program, "replay", "run", "--json").stdout)
    return f"{verdict['steps_identical']} of {verdict['steps_run']} steps identical"


def processes(env: Environment, _wheel: Path) -> str:
    """Run the same as processes over Zenoh, at low speed because other programs share the machine."""
    env.run(env.program, "sim", "--speed", "2", "--duration-s", "5", "--out", "processes")
    return "5 s over Zenoh"


def loop(env: Environment, _wheel: Path) -> str:
    """Run the loop of the README."""
    (code,) = (block.text for block in blocks("README.md") if block.language == "python")
    end = "import math\nassert plan.origin == 'solved' and math.hypot(estimate.north_m, estimate.east_m) < 0.1\n"
    (env.folder / "loop.py").write_text(code + end)
    env.run(env.python, "loop.py")
    return "comes to its point"


def doctor(env: Environment, _wheel: Path) -> str:
    """Check that the doctor finds no problem and names every missing extra."""
    found = json.loads(env.run(env.program, "doctor", "--json").stdout)
    (extras,) = (finding["found"] for finding in found["findings"] if finding["check"] == "extras")
    for extra in ("viz", "campaign", "ros2"):
        if f"{extra} (pip install" not in extras:
            raise Failed(f"doctor does not miss {extra}: {extras}")
    return f"{found['counts']['problem']} problems"


def lean(env: Environment, _wheel: Path) -> str:
    """Check that the core names the extra of each missing package."""
    shutil.copy(ROOT / "examples" / "campaigns" / "horizon.toml", env.folder / "campaign.toml")
    for words, code, asked in WANTED:
        done = env.run(env.program, *words, code=code)
        if asked not in done.stderr or "Traceback" in done.stderr:
            raise Failed(f"ltv-mpc {' '.join(words)} does not ask for {asked}: {done.stderr[-1500:]}")
    return f"{len(WANTED)} commands ask for their extra"


def types(env: Environment, _wheel: Path) -> str:
    """Check that a strict type checker finds the types of the installed wheel."""
    (env.folder / "user.py").write_text(USER)
    checker = (sys.executable, "-P", "-m", "mypy", "--strict", "--python-executable", env.python)
    done = env.run(*checker, "--cache-dir", os.devnull, "user.py", code=1)
    for wanted in ('"float"', "ndarray[", '"Vehicle" has no attribute "mass"', "Found 1 error"):
        if wanted not in done.stdout:
            raise Failed(f"mypy does not say {wanted}:\n{done.stdout[-2000:]}")
    return "float, ndarray, one mistake seen"


TRIALS: tuple[Callable[[Environment, Path], str], ...] = (
    *(version, help_, data, lockstep, replay, loop, doctor, lean, types, processes),
)


# --- where -----------------------------------------------------------------------------------------------------------


def pythons() -> dict[int, Path | None]:
    """Return the interpreter of each minor version, on the path or below pyenv's root; None if it is missing."""
    root = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    found: dict[int, Path | None] = {}
    for minor in MINORS:
        name = f"python3.{minor}"
        places = [Path(place) / name for place in os.get_exec_path()] + sorted(root.glob(f"3.{minor}.*/bin/{name}"))
        found[minor] = next((place for place in places if _works(place, minor)), None)
    return found


def _works(python: Path, minor: int) -> bool:
    """Return True if an interpreter exists, has the version of its name and can create environments."""
    test = f"import sys, venv, ensurepip; sys.exit(sys.version_info[:2] != (3, {minor}))"
    try:
        return subprocess.run([python, "-c", test], capture_output=True, check=False).returncode == 0
    except OSError:
        return False


def packaged() -> list[str]:
    """Return the files of the three packages that git does not ignore."""
    git = ("git", "-C", ROOT, "ls-files", "--cached", "--others", "--exclude-standard", *PACKAGES)
    names = subprocess.run(git, capture_output=True, text=True, check=True).stdout.splitlines()
    return [name for name in names if (ROOT / name).is_file()]


def built() -> Path:
    """Build the wheel from the source distribution, as `python -m build` does."""
    shutil.rmtree(DIST, ignore_errors=True)
    done = subprocess.run(
        [sys.executable, "-P", "-m", "build", "--outdir", DIST, ROOT], capture_output=True, text=True, check=False
    )
    if done.returncode:
        sys.exit(f"python -m build:\n{done.stdout[-3000:]}\n{done.stderr[-3000:]}")
    (wheel,) = DIST.glob("*.whl")
    if missing := set(packaged()) - set(ZipFile(wheel).namelist()):
        sys.exit(f"not in {wheel}: {', '.join(sorted(missing))}")
    return wheel


def tried(python: Path, wheel: Path) -> Iterator[tuple[str, str | Failed]]:
    """Yield the name and result of each trial, in a new environment."""
    with tempfile.TemporaryDirectory(prefix="ltv-mpc-package-") as place:
        folder = Path(place)
        subprocess.run([python, "-m", "venv", folder / "venv"], check=True)
        env = Environment(folder / "venv" / "bin" / "python", folder / "work")
        env.folder.mkdir()
        try:
            env.run(env.python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", wheel)
        except Failed as failed:
            yield "install", failed
            return
        for trial in TRIALS:
            try:
                yield trial.__name__.strip("_"), trial(env, wheel)
            except (Failed, ValueError, OSError, subprocess.TimeoutExpired) as error:
                yield trial.__name__.strip("_"), error if isinstance(error, Failed) else Failed(repr(error))


def main(arguments: Sequence[str]) -> int:
    """Run the trials; exit code 1 if one fails or no Python was found. ``arguments`` selects of 11, 12, 13."""
    console = Console()
    wheel = built()
    console.print(f"{wheel.relative_to(ROOT)}, {wheel.stat().st_size / 1e3:.0f} kB")
    wrong = tries = 0
    for minor, python in pythons().items():
        if arguments and str(minor) not in arguments:
            continue
        if python is None:
            console.print(f"Python 3.{minor}: not found on this machine, not tried")
            continue
        console.print(f"Python 3.{minor}: {python}")
        for name, result in tried(python, wheel):
            tries += 1
            wrong += isinstance(result, Failed)
            console.print(f"  {name:<10} {'FAILED ' if isinstance(result, Failed) else ''}{result}", markup=False)
    return int(wrong > 0 or tries == 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
