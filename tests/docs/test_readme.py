"""What README promises is run."""

from __future__ import annotations

import math
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text()


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", README, flags=re.M | re.S)


def test_the_loop_works_as_printed_and_brings_the_vehicle_to_its_point():
    (code,) = blocks("python")
    names: dict[str, object] = {}
    exec(code, names)
    estimate = names["estimate"]
    assert math.hypot(estimate.north_m, estimate.east_m) < 0.1  # type: ignore[attr-defined]
    assert names["plan"].origin == "solved"  # type: ignore[attr-defined]


def test_the_loop_works_with_a_vehicle_file_of_one_s_own(tmp_path):
    (code,) = blocks("python")
    own = (ROOT / "ltv_mpc" / "vehicle" / "files" / "paper.toml").read_text()
    for theirs, mine in (('name = "paper"', 'name = "mine"'), ("_kgpm = 500.0", "_kgpm = 400.0")):
        assert theirs in own
        own = own.replace(theirs, mine)
    (tmp_path / "my_auv.toml").write_text(own)
    names: dict[str, object] = {}
    exec(code.replace('Vehicle.load("paper")', f'Vehicle.load("{tmp_path}/my_auv.toml")'), names)
    assert names["vehicle"].surge.quadratic_damping_kgpm == 400.0  # type: ignore[attr-defined]
    estimate = names["estimate"]
    assert math.hypot(estimate.north_m, estimate.east_m) < 0.1  # type: ignore[attr-defined]


def test_every_make_target_that_it_names_exists():
    targets = set(re.findall(r"`make ([a-z]+)`", README)) | {
        words[1] for block in blocks("") for line in block.splitlines() if (words := line.split())[:1] == ["make"]
    }
    makefile = (ROOT / "Makefile").read_text()
    assert {"sim", "test"} <= targets
    for target in targets:
        assert re.search(rf"^{target}:", makefile, flags=re.M), target


COMMANDS = sorted(set(re.findall(r"`ltv-mpc ([^`]+)`", README)))


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_that_it_names_has_these_options(command):
    """Names and options exist; what needs a file or a host is not run."""
    words = shlex.split(command)
    done = subprocess.run(
        [sys.executable, "-P", "-m", "services.cli", words[0], "--help"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    for option in (word for word in words if word.startswith("--")):
        assert option in done.stdout
