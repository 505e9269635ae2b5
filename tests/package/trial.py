"""`make package`: the wheel, built as it would be published and tried where nothing else is.

For each Python of 3.11 to 3.13 on the path: an empty environment, the wheel without any extra, and in a folder of its
own what a first user does. Then what the lean core lacks has to be asked for by the name of its extra. The built files
stay in dist/, the environments go.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from zipfile import ZipFile

from tests.docs.pages import ROOT, blocks

MINORS = ("11", "12", "13")
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
    ("log export run --format parquet", 2, "extra parquet"),
    ("certs new certs", 2, "extra secure"),
    ("ros2", 2, "extra ros2"),
    ("mavlink", 2, "extra mavlink"),
    ("campaign campaign.toml", 2, "extra campaign"),
    ("report run", 1, "extra viz"),
    ("dashboard", 1, "extra viz"),
)
"""Commands that the lean core cannot do, their exit codes, and what they ask for."""


def call(*words: str | Path, code: int = 0, cwd: Path = ROOT) -> subprocess.CompletedProcess[str]:
    """Run a command outside of this checkout's environment; another exit code is an ``AssertionError``."""
    own = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "VIRTUAL_ENV"))}
    done = subprocess.run(words, cwd=cwd, env=own, timeout=LIMIT_S, check=False, capture_output=True, text=True)
    ends = f"{done.stdout[-1500:]}\n{done.stderr[-1500:]}"
    assert done.returncode == code, f"{' '.join(map(str, words))}: exit code {done.returncode}, not {code}\n{ends}"
    return done


class Trial:
    """Empty environment with the wheel installed, a working folder, and what is tried there in this order."""

    def __init__(self, python: str, wheel: Path, folder: Path) -> None:
        self.wheel, self.folder = wheel, folder
        call(python, "-m", "venv", folder / "venv")
        self.python = folder / "venv" / "bin" / "python"
        self.version = wheel.name.split("-")[1]
        call(self.python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", wheel)

    def run(self, line: str, code: int = 0) -> subprocess.CompletedProcess[str]:
        """Run the installed command in the working folder."""
        return call(self.python.with_name("ltv-mpc"), *line.split(), code=code, cwd=self.folder)

    def all_files_are_installed_and_used(self) -> None:
        program = "import ltv_mpc, pathlib; print(pathlib.Path(ltv_mpc.__file__).parents[1])"
        site = Path(call(self.python, "-c", program, cwd=self.folder).stdout.strip())
        assert not site.is_relative_to(ROOT)
        names = [name for name in ZipFile(self.wheel).namelist() if name.startswith(PACKAGES)]
        assert [name for name in names if not (site / name).is_file()] == []

    def commands_say_their_version_and_panels(self) -> None:
        assert self.run("--version").stdout.split()[-1] == self.version
        assert "Start here" in self.run("--help").stdout
        found = json.loads(self.run("doctor --json").stdout)
        (extras,) = (finding["found"] for finding in found["findings"] if finding["check"] == "extras")
        assert all(f"{extra} (pip install" in extras for extra in ("viz", "campaign", "ros2")), extras

    def a_run_in_lock_step_and_its_replay(self) -> None:
        done = self.run("sim --lockstep --duration-s 5 --json --out run")
        assert json.loads(done.stdout)["duration_s"] >= 5.0
        assert NO_REPORT in done.stderr
        assert f'ltv_mpc = "{self.version}"' in (self.folder / "run" / "scenario.toml").read_text()
        self.run("replay run --json")

    def a_run_as_processes(self) -> None:
        self.run("sim --speed 2 --duration-s 5 --out processes")  # other programs share the machine

    def the_loop_of_the_readme(self) -> None:
        (code,) = (block.text for block in blocks("README.md") if block.language == "python")
        end = "import math\nassert plan.origin == 'solved' and math.hypot(estimate.north_m, estimate.east_m) < 0.1\n"
        call(self.python, "-c", code + end, cwd=self.folder)

    def what_is_missing_is_asked_for(self) -> None:
        shutil.copy(ROOT / "examples" / "campaigns" / "horizon.toml", self.folder / "campaign.toml")
        for line, code, asked in WANTED:
            errors = self.run(line, code=code).stderr
            assert asked in errors, errors
            assert "Traceback" not in errors, errors

    def a_strict_type_checker_finds_the_types(self) -> None:
        (self.folder / "user.py").write_text(USER)
        checker = (sys.executable, "-P", "-m", "mypy", "--strict", "--python-executable", self.python)
        said = call(*checker, "--cache-dir", os.devnull, "user.py", code=1, cwd=self.folder).stdout
        for wanted in ('"float"', "ndarray[", '"Vehicle" has no attribute "mass"', "Found 1 error"):
            assert wanted in said, said


TRIALS = [one for name, one in vars(Trial).items() if not name.startswith("_") and name != "run"]


def main(minors: list[str]) -> int:
    """Build the wheel and run the trials; exit code 1 if one fails or no Python was found."""
    shutil.rmtree(DIST, ignore_errors=True)
    call(sys.executable, "-P", "-m", "build", "--outdir", DIST, ROOT)
    (wheel,) = DIST.glob("*.whl")
    tracked = call("git", "ls-files", "--cached", "--others", "--exclude-standard", *PACKAGES).stdout.splitlines()
    assert {name for name in tracked if (ROOT / name).is_file()} <= set(ZipFile(wheel).namelist())
    results = []
    for minor in minors or MINORS:
        python = shutil.which(f"python3.{minor}") or ""
        needed = (python, "-c", "import venv, ensurepip")
        if not python or subprocess.run(needed, capture_output=True, check=False).returncode:
            print(f"Python 3.{minor}: not found, not tried")  # noqa: T201
            continue
        with tempfile.TemporaryDirectory(prefix="ltv-mpc-package-") as folder:
            tried = Trial(python, wheel, Path(folder))
            for trial in TRIALS:
                began = time.monotonic()
                try:
                    trial(tried)
                    failed = ""
                except Exception as error:
                    failed = f"FAILED {error!r}"
                print(f"3.{minor} {trial.__name__}: {failed or f'{time.monotonic() - began:.0f} s'}")  # noqa: T201
                results.append(failed)
    return int(any(results) or not results)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
