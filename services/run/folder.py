"""A run's folder, and the only writer of what is in it but the recording itself.

runs/20261121T054500Z-descent/
    scenario.toml     resolved: every value, the seed, what made it; `ltv-mpc sim RUN/scenario.toml` runs it again
    config/*.toml     vehicle, sensors, reference, controller, estimator: the files it names
    config/*.csv      currents, of a measured water; water-prior, where the estimator was given one
    run.mcap          every message
    summary.json      what it came to
    currents.csv      the current as it was estimated at the end, with standard deviations; not with --perfect-state
"""

from __future__ import annotations

import contextlib
import itertools
import os
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import msgspec

from ltv_mpc.currents import WaterPrior, write_profile
from ltv_mpc.errors import ConfigError
from sim.grading.summary import Summary

ROOT = Path("runs")
LATEST = "latest"


@dataclass(frozen=True, slots=True)
class RunFolder:
    """An existing folder of one run."""

    path: Path

    @property
    def recording(self) -> Path:
        """run.mcap."""
        return self.path / "run.mcap"

    @property
    def summary(self) -> Path:
        """summary.json."""
        return self.path / "summary.json"

    @property
    def currents(self) -> Path:
        """currents.csv."""
        return self.path / "currents.csv"

    @property
    def scenario(self) -> Path:
        """scenario.toml."""
        return self.path / "scenario.toml"

    def config(self, what: str) -> Path:
        """One of the settings files: ``vehicle``, ``sensors``, ``reference``, ``controller``, ``estimator``."""
        return self.path / "config" / f"{what}.toml"

    def write_result(self, summary: Summary, water: WaterPrior | None) -> None:
        """summary.json, and currents.csv of the water as it was estimated; each whole or not at all."""
        draft = self.summary.with_suffix(".json.part")
        draft.write_bytes(msgspec.json.format(msgspec.json.encode(summary), indent=2) + b"\n")
        draft.replace(self.summary)
        if water is not None:
            draft = self.currents.with_suffix(".csv.part")
            write_profile(draft, water)
            draft.replace(self.currents)


def make(name: str, files: Mapping[str, str], *, out: Path | None = None, force: bool = False) -> RunFolder:
    """The folder ``out``, or ``runs/<UTC time>-<name>`` with the link ``runs/latest`` to it, with its settings files.

    ``files``: path in the folder -> text. A folder that is not empty is refused (``ConfigError``) unless ``force``,
    which replaces what a run writes and leaves the rest.
    """
    folder = RunFolder(_default(name) if out is None else _given(out, force=force))
    for path, text in files.items():
        target = folder.path / path
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(text, encoding="utf-8")
    return folder


def made_for(scenario: Path, out: Path) -> RunFolder | None:
    """The folder ``out`` where a launcher has made it for a run of its ``scenario`` and nothing is recorded yet."""
    folder = RunFolder(out)
    same = folder.scenario.absolute() == scenario.absolute()
    return folder if same and not folder.recording.exists() else None


def _default(name: str) -> Path:
    stem = f"{datetime.now(UTC):%Y%m%dT%H%M%SZ}-{name}"
    tries = (ROOT / (stem if count == 1 else f"{stem}-{count}") for count in itertools.count(1))
    path = next(path for path in tries if _made(path))
    with contextlib.suppress(OSError):  # the link is a convenience: not every file system has links
        draft = ROOT / f".{LATEST}-{os.getpid()}"
        draft.symlink_to(path.name)
        draft.replace(ROOT / LATEST)
    return path


def _made(path: Path) -> bool:
    """Whether ``path`` was made here and now: several runs may start within one second."""
    try:
        path.mkdir(parents=True)
    except FileExistsError:
        return False
    except OSError as error:
        raise _refusal(path, error) from None
    return True


def _given(path: Path, *, force: bool) -> Path:
    try:
        path.mkdir(parents=True, exist_ok=True)
        if any(path.iterdir()) and not force:
            raise ConfigError(
                "option --out", "", "a folder that is not empty: name another, or add --force", value=str(path)
            )
        # else a run that fails would seem to have ended
        for old in (*path.glob("run*.mcap"), path / "summary.json", path / "currents.csv"):
            old.unlink(missing_ok=True)
    except OSError as error:
        raise _refusal(path, error) from None
    return path


def _refusal(path: Path, error: OSError) -> ConfigError:
    return ConfigError(
        "option --out", "", f"a folder that can be written is needed ({error.strerror})", value=str(path)
    )
