"""Contents of the wheel, from the build backend without environment and network. `make package` installs a real one."""

from __future__ import annotations

import email
import subprocess
import sys
import tomllib
import zipfile
from email.message import Message
from pathlib import Path

import pytest

from services.run import provenance as versions
from services.tools import doctor
from tests.docs.pages import ROOT

PACKAGES = ("ltv_mpc", "sim", "services")
EXTRAS = {
    *("viz", "secure", "ros2", "mavlink", "gpx", "parquet", "campaign"),
    *("bench", "docs", "mutation", "dev", "notebook"),
}
CORE_LACKS = (
    *("plotly", "matplotlib", "pyarrow", "distributed", "cryptography"),
    *("rosbags", "starlette", "sphinx", "pytest"),
)


def wheel(root: Path, folder: Path) -> zipfile.ZipFile:
    """Build the wheel of the tree at ``root`` as `python -m build` does."""
    code = "import sys, hatchling.build; print(hatchling.build.build_wheel(sys.argv[1]))"
    done = subprocess.run(
        [sys.executable, "-P", "-c", code, folder], cwd=root, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return zipfile.ZipFile(folder / done.stdout.split()[-1])


@pytest.fixture(scope="module")
def ours(tmp_path_factory: pytest.TempPathFactory) -> zipfile.ZipFile:
    return wheel(ROOT, tmp_path_factory.mktemp("dist"))


def metadata(of: zipfile.ZipFile) -> Message:
    (name,) = (name for name in of.namelist() if name.endswith(".dist-info/METADATA"))
    return email.message_from_bytes(of.read(name))


def files(root: Path) -> set[str]:
    """Return the files of the three packages in the tree."""
    return {
        path.relative_to(root).as_posix()
        for package in PACKAGES
        for path in (root / package).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }


def test_it_holds_the_three_packages_whole_and_nothing_else(ours: zipfile.ZipFile) -> None:
    """Vehicles, sensors, references, scenarios, pages and styles are files of the packages."""
    code = {name for name in ours.namelist() if ".dist-info/" not in name}
    assert code == files(ROOT)
    for data in ("vehicle/files/paper.toml", "vehicle/template.toml", "references/files/hover.toml"):
        assert f"ltv_mpc/{data}" in code
    assert {"sim/scenarios/descent.toml", "services/reporting/static/report.html"} <= code


def test_type_checkers_are_told_that_all_three_packages_have_types(ours: zipfile.ZipFile) -> None:
    assert {f"{package}/py.typed" for package in PACKAGES} <= set(ours.namelist())


def test_the_core_is_lean_and_the_extras_are_those_that_are_promised(ours: zipfile.ZipFile) -> None:
    found = metadata(ours)
    core = [line for line in found.get_all("Requires-Dist", ()) if "extra ==" not in line]
    assert len(core) == len(tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"])
    for name in CORE_LACKS:
        assert not any(line.startswith(name) for line in core), name
    assert set(found.get_all("Provides-Extra", ())) == EXTRAS
    page = (ROOT / "docs" / "install.md").read_text()
    assert {name for name in EXTRAS if f"`{name}`" in page} == EXTRAS


def test_its_name_is_nobody_else_s_and_its_command_is_there(ours: zipfile.ZipFile) -> None:
    found = metadata(ours)
    assert found["Name"] == doctor.DISTRIBUTION
    assert found["Requires-Python"] == "<3.14,>=3.11"
    (entries,) = (name for name in ours.namelist() if name.endswith("entry_points.txt"))
    assert "ltv-mpc = services.cli.app:main" in ours.read(entries).decode()
    assert any(name.endswith("licenses/LICENSE") for name in ours.namelist())


@pytest.mark.parametrize(
    ("installed", "commit", "said"),
    [
        ("0.2.0", "unknown", "0.2.0"),
        ("0.2.1.dev5+g1a2b3c4d5", "unknown", "0.2.1.dev5+g1a2b3c4d5"),
        ("0.2.0", "ffffffffffffffff", "0.2.0+gfffffffff"),
        ("0.2.1.dev5+g1a2b3c4d5.d20260101", "ffffffffffffffff", "0.2.1.dev+gfffffffff"),
        ("0.2.1.dev5", "ffffffffffffffff and changes", "0.2.1.dev+gfffffffff.changed"),
        ("0.2.0rc1", "ffffffffffffffff", "0.2.0rc1+gfffffffff"),
        ("unknown", "ffffffffffffffff", "unknown"),
    ],
)
def test_a_checkout_reports_its_current_commit_not_the_installed_one(installed: str, commit: str, said: str) -> None:
    assert versions.combine(installed, commit) == said


def test_command_run_and_doctor_say_the_same_version(capsys: pytest.CaptureFixture[str]) -> None:
    from services.cli.app import run
    from services.run.provenance import provenance_table

    assert run(["--version"]) == 0
    said = capsys.readouterr().out.split()[-1]
    assert said == versions.version() == provenance_table()["ltv_mpc"]
    assert doctor.project()[1].startswith(f"{said}, commit ")
