"""Units of systemd for controller and router: systemd accepts them, and their commands are known to the program."""

from __future__ import annotations

import configparser
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from typer.core import TyperGroup
from typer.main import get_command

from services.cli.app import app

UNIT = Path(__file__).parents[2] / "examples" / "systemd" / "ltv-mpc-controller.service"
ROUTER = UNIT.with_name("ltv-mpc-router.service")
PROGRAM = "/opt/ltv-mpc/bin/ltv-mpc"


def verified(text: str, folder: Path) -> str:
    """Return what ``systemd-analyze verify`` says of a unit whose program is one that exists here."""
    if shutil.which("systemd-analyze") is None:
        pytest.skip("systemd-analyze is not installed: the unit is not checked")
    unit = folder / UNIT.name
    unit.write_text(text.replace(PROGRAM, sys.executable))
    command = ["systemd-analyze", "verify", "--man=no", str(unit)]
    answer = subprocess.run(command, capture_output=True, text=True, check=False)
    return f"{answer.stdout}{answer.stderr}" or f"exit code {answer.returncode}" * bool(answer.returncode)


@pytest.mark.parametrize("unit", [UNIT, ROUTER])
def test_systemd_has_nothing_to_say_about_it(unit: Path, tmp_path: Path) -> None:
    assert verified(unit.read_text(), tmp_path) == ""


def test_systemd_notices_a_misspelt_setting(tmp_path: Path) -> None:
    assert "WatchdogSecs" in verified(UNIT.read_text().replace("WatchdogSec=", "WatchdogSecs="), tmp_path)


def test_its_command_resumes_armed_from_the_folder_that_systemd_keeps() -> None:
    parser = configparser.ConfigParser(interpolation=None)
    parser.read(UNIT)
    service = parser["Service"]
    program, command, *words = service["ExecStart"].split()
    assert program == PROGRAM
    group = get_command(app)
    assert isinstance(group, TyperGroup)
    given = group.commands[command].make_context(command, words).params
    assert (given["vehicle"], given["reference"]) == ("/etc/ltv-mpc/vehicle.toml", "/etc/ltv-mpc/mission.toml")
    assert (given["state"], given["resume_armed"]) == (Path("%S") / service["StateDirectory"], True)


def test_each_setting_has_its_reason_on_the_page_of_hosts() -> None:
    page = (UNIT.parents[2] / "docs" / "hosts.md").read_text()
    for name in re.findall(r"^(\w+)=", UNIT.read_text().partition("[Service]")[2], re.MULTILINE):
        if name not in ("ExecStart", "StateDirectory", "Environment", "DynamicUser", "WantedBy"):
            assert f"`{name}" in page, name
