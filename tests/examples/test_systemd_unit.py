"""Units of systemd: systemd accepts them, and their commands and options are known to the program."""

from __future__ import annotations

import configparser
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from typer.core import TyperGroup
from typer.main import get_command

from services.cli.app import app

FOLDER = Path(__file__).parents[2] / "examples" / "systemd"
UNIT = FOLDER / "ltv-mpc-controller.service"
UNITS = sorted(FOLDER.glob("*.service"))
PAGE = FOLDER.parents[1] / "docs" / "boat.md"
SANDBOX = (
    *("ProtectHome", "PrivateTmp", "NoNewPrivileges", "CapabilityBoundingSet", "RestrictAddressFamilies"),
    *("RestrictNamespaces", "SystemCallFilter", "ProtectKernelTunables", "ProtectControlGroups"),
    "ProtectKernelModules",
    *("ProtectKernelLogs", "ProtectClock", "PrivateDevices", "RestrictSUIDSGID", "SystemCallArchitectures"),
)
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


@pytest.mark.parametrize("unit", UNITS, ids=lambda unit: unit.stem)
def test_systemd_has_nothing_to_say_about_it(unit: Path, tmp_path: Path) -> None:
    assert verified(unit.read_text(), tmp_path) == ""


def service_of(unit: Path) -> dict[str, str]:
    parser = configparser.ConfigParser(interpolation=None, strict=False)
    parser.optionxform = str  # type: ignore[assignment,method-assign]
    parser.read(unit)
    return dict(parser["Service"])


def options() -> dict[str, str]:
    """Return the lines of the options file, as if none were a comment."""
    text = (FOLDER / "options.env").read_text()
    return dict(re.findall(r"^#?([A-Z0-9_]+)=(.*)$", text, re.MULTILINE))


def parameters(unit: Path, given: dict[str, str]) -> dict[str, Any]:
    """Return the parameters of a unit's command, with these variables in its environment."""
    words = [
        part
        for word in service_of(unit)["ExecStart"].split()
        for part in (given.get(word[1:], "").split() if word.startswith("$") else [word])
    ]
    program, command, *arguments = words
    assert program == PROGRAM
    group = get_command(app)
    assert isinstance(group, TyperGroup)
    return group.commands[command].make_context(command, arguments).params


@pytest.mark.parametrize("unit", UNITS, ids=lambda unit: unit.stem)
def test_its_command_exists_with_the_options_of_the_file_and_without(unit: Path) -> None:
    assert parameters(unit, {})["certs"] is None
    assert parameters(unit, options())["certs"] == Path("/etc/ltv-mpc/certs")


@pytest.mark.parametrize("unit", UNITS, ids=lambda unit: unit.stem)
def test_it_may_write_only_where_systemd_lets_it(unit: Path) -> None:
    assert set(SANDBOX) <= set(service_of(unit))
    assert service_of(unit)["ProtectSystem"] == "strict"
    if shutil.which("systemd-analyze") is not None:
        command = ["systemd-analyze", "security", "--offline=true", "--threshold=30", str(unit)]  # 3.0
        answer = subprocess.run(command, capture_output=True, text=True, check=False)
        assert answer.returncode == 0, answer.stdout[-300:]


def test_every_option_of_the_file_is_used_by_a_unit() -> None:
    used = {word[1:] for unit in UNITS for word in service_of(unit)["ExecStart"].split() if word.startswith("$")}
    assert set(options()) == used


def test_the_files_that_the_units_name_are_those_that_the_page_copies() -> None:
    named = {path for unit in UNITS for path in re.findall(r"/etc/ltv-mpc/(\w+\.\w+)", unit.read_text())}
    page = PAGE.read_text()
    assert {name for name in named if name in page} == named
    assert {unit.stem for unit in UNITS if f"examples/systemd/{unit.name}" in page} == {unit.stem for unit in UNITS}


def test_the_controller_resumes_armed_from_the_folder_that_systemd_keeps() -> None:
    given = parameters(UNIT, options())
    assert (given["vehicle"], given["reference"]) == ("/etc/ltv-mpc/vehicle.toml", "/etc/ltv-mpc/mission.toml")
    assert (given["settings"], given["fence"]) == (Path("/etc/ltv-mpc/controller.toml"), "/etc/ltv-mpc/fence.toml")
    assert (given["state"], given["resume_armed"]) == (Path("%S") / service_of(UNIT)["StateDirectory"], True)
