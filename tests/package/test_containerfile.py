"""Image for a boat computer: the steps of its Containerfile in a bare Debian root, and the wheels for arm64.

They fetch packages, for minutes, so `make package` runs them (``BARE_DEBIAN=1``) and `make test` does not.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.docs.pages import ROOT, blocks

CONTAINERFILE = ROOT / "examples" / "container" / "Containerfile"
EXTRAS = "mavlink,ros2,viz,secure"
PYTHONS = ("3.11", "3.12", "3.13")
NEWEST_FIRST = ("manylinux_2_28", "manylinux_2_17")
fetches = pytest.mark.skipif("BARE_DEBIAN" not in os.environ, reason="fetches packages; `make package` runs it")
bare = pytest.mark.skipif(
    shutil.which("debootstrap") is None or os.geteuid() != 0,
    reason="no bare Debian root: apt-get install debootstrap, and run as root",
)


def steps() -> list[tuple[str, str]]:
    """Return the instructions of the Containerfile and what stands behind them."""
    lines = re.sub(r"\s*\\\n\s*", " ", CONTAINERFILE.read_text()).splitlines()
    pairs = (line.split(maxsplit=1) for line in lines if line and not line.startswith("#"))
    return [(instruction, rest) for instruction, rest in pairs]


def pip(*words: str | Path) -> None:
    done = subprocess.run([sys.executable, "-m", "pip", *words], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]


def platforms(processor: str) -> list[str]:
    return [word for one in NEWEST_FIRST for word in ("--platform", f"{one}_{processor}")]


class BareDebian:
    """Root of Debian with what each installation has, in which the steps of a Containerfile are run."""

    def __init__(self, root: Path, suite: str) -> None:
        self.root, self.user, self.folder, self.entry = root, "root", "/", [""]
        made = subprocess.run(["debootstrap", "--variant=minbase", suite, root], capture_output=True, check=False)
        assert made.returncode == 0, made.stdout[-2000:]
        shutil.copy("/etc/resolv.conf", root / "etc")

    def run(self, *command: str) -> str:
        """Run a command as the present user in the present folder; return its output."""
        inside = 'cd "$0" && HOME=$(getent passwd "$(id -u)" | cut -d: -f6) exec "$@"'
        mounts = ("unshare", "--mount", "--pid", "--fork", f"--mount-proc={self.root}/proc")
        root = ("env", "-i", "PATH=/usr/sbin:/usr/bin:/sbin:/bin", "chroot", f"--userspec={self.user}", str(self.root))
        called = (*mounts, *root, "/bin/sh", "-c", inside, self.folder, *command)
        done = subprocess.run(called, capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"{command}: {done.returncode}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}"
        return done.stdout + done.stderr

    def do(self, instruction: str, rest: str, context: Path) -> None:
        """Do what an instruction says, with the files of a folder."""
        match instruction:
            case "RUN":
                self.run("/bin/sh", "-c", rest)
            case "COPY":
                *names, to = rest.split()
                target = self.root / to.lstrip("/")
                if to.endswith("/"):
                    target.mkdir(parents=True, exist_ok=True)
                for name in names:
                    copy = shutil.copytree if (context / name).is_dir() else shutil.copy
                    copy(context / name, target)
            case "USER":
                self.user = rest
            case "WORKDIR":
                self.folder = rest
            case "ENTRYPOINT":
                self.entry = json.loads(rest)
            case "VOLUME":
                assert (self.root / rest.lstrip("/")).is_dir()
            case _:
                raise AssertionError(f"unknown instruction {instruction}")


@fetches
@bare
@pytest.mark.timeout(1800)
def test_the_steps_of_the_containerfile_install_it_in_a_bare_debian(wheel: Path, tmp_path: Path) -> None:
    context = tmp_path / "context"
    wanted = (*platforms("x86_64"), "--only-binary=:all:", "--python-version", "3.11")
    pip("download", "--quiet", "-d", context / "wheels", *wanted, f"{wheel}[mavlink]")
    shutil.copy(ROOT / "ltv_mpc" / "vehicle" / "files" / "bluerobotics-boat.toml", context / "vehicle.toml")
    (mission,) = (one.text for one in blocks("docs/boat.md") if one.text.startswith("# mission.toml"))
    (context / "mission.toml").write_text(mission)
    (first, image), *rest = steps()
    assert first == "FROM"
    debian = BareDebian(tmp_path / "root", image.rpartition(":")[2].removesuffix("-slim"))
    for instruction, of in rest:
        debian.do(instruction, of, context)
    command = debian.entry
    assert debian.run(*command, "--version").split()[-1] == wheel.name.split("-")[1]
    files = ("/etc/ltv-mpc/vehicle.toml", "--reference", "/etc/ltv-mpc/mission.toml")
    assert "bluerobotics-boat" in debian.run(*command, "vehicle", "check", *files)
    assert "--autopilot" in debian.run(*command, "mavlink", "--help")
    router = ("timeout", "--preserve-status", "20", *command, "router")
    assert "ready at tcp/127.0.0.1:7447" in debian.run(*router)


@fetches
@pytest.mark.parametrize("python", PYTHONS)
def test_all_wheels_exist_for_arm64(python: str, wheel: Path, tmp_path: Path) -> None:
    """As the page about the boat computer says; pip chooses them, and downloads none."""
    wanted = ("--only-binary=:all:", "--python-version", python, "--target", tmp_path, "--ignore-installed")
    pip("install", "--quiet", "--dry-run", *wanted, *platforms("aarch64"), f"{wheel}[{EXTRAS}]")


def test_the_page_names_what_the_containerfile_copies() -> None:
    page = (ROOT / "docs" / "boat.md").read_text()
    names = [name for instruction, rest in steps() if instruction == "COPY" for name in rest.split()[:-1]]
    assert names == ["wheels", "vehicle.toml", "mission.toml"]
    assert "(../examples/container/Containerfile)" in page
    for name in names:
        assert name in page
