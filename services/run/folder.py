"""Folder of a run. This module writes everything in it except the recording.

runs/20261121T054500Z-descent/
    scenario.toml     resolved: every value, the seed, the provenance; `ltv-mpc sim RUN/scenario.toml` runs it again
    config/*.toml     vehicle, sensors, reference, controller, estimator: the files that scenario.toml names
    config/*.csv      currents, if the water is measured; water-prior, if the estimator has one
    run.mcap          every message
    summary.json      the results
    currents.csv      the current estimated at the end, with standard deviations; not with --perfect-state
    report.html       the plots, if plotly is installed
"""

from __future__ import annotations

import contextlib
import fcntl
import itertools
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec

from ltv_mpc.config import parse_json, read_text
from ltv_mpc.currents import WaterPrior, write_profile
from ltv_mpc.errors import ConfigError

ROOT = Path("runs")
LATEST = "latest"
DELETED = "the folder was deleted during the run"
RECORDING = "run.mcap"
SUMMARY, CURRENTS, REPORT = RESULTS = "summary.json", "currents.csv", "report.html"
"""Files that are beside the recording once a run has ended."""


@dataclass(frozen=True, slots=True)
class RunFolder:
    """Existing folder of one run."""

    path: Path

    @property
    def recording(self) -> Path:
        """Path of the recording, run.mcap."""
        return self.path / RECORDING

    @property
    def scenario(self) -> Path:
        """Path of the resolved scenario, scenario.toml."""
        return self.path / "scenario.toml"

    def config(self, what: str) -> Path:
        """Return the path of a settings file: vehicle, sensors, reference, controller or estimator."""
        return self.path / "config" / f"{what}.toml"

    @property
    def deleted(self) -> bool:
        """True if the folder does not exist any more."""
        return not self.path.exists()

    def write_result(self, summary: msgspec.Struct, water: WaterPrior | None) -> None:
        """Write summary.json, and currents.csv of the estimated water, each of them completely or not at all."""
        with draft_of(self.path / SUMMARY) as draft:
            draft.write_bytes(msgspec.json.format(msgspec.json.encode(summary), indent=2) + b"\n")
        if water is not None:
            with draft_of(self.path / CURRENTS) as draft:
                write_profile(draft, water)


@contextlib.contextmanager
def draft_of(path: Path) -> Iterator[Path]:
    """Give the path of a draft that replaces ``path`` once it is written; if that fails, no draft is left."""
    draft = path.with_name(path.name + ".part")
    try:
        yield draft
        draft.replace(path)
    except BaseException:
        with contextlib.suppress(OSError):
            draft.unlink()
        raise


@contextlib.contextmanager
def reserve(
    name: str, files: Mapping[str, str], *, out: Path | None = None, force: bool = False, resume: bool = False
) -> Iterator[RunFolder]:
    """Make a folder as ``make`` does, and keep all other runs out of it within the context.

    With ``resume`` the folder ``out`` keeps its recording and its files. A folder that another run has reserved raises
    ``ConfigError``, also with ``force``.
    """
    path = _make_with_link(name) if out is None else open_folder(out, force=force or resume)
    lock = os.open(path, os.O_RDONLY)
    try:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            problem = "another run writes into this folder: wait for its end, or name another folder"
            raise ConfigError("option --out", "", problem, value=str(path)) from None
        except OSError:  # a file system without locks
            pass
        yield RunFolder(path) if resume else _prepare(path, files)
    finally:
        os.close(lock)


def make(name: str, files: Mapping[str, str], *, out: Path | None = None, force: bool = False) -> RunFolder:
    """Make the folder ``out``, or ``runs/<UTC time>-<name>`` with the link ``runs/latest``, and write settings files.

    ``files`` maps a path in the folder to a text. A folder that is not empty raises ``ConfigError`` unless ``force``
    is set, which replaces the files of a run and leaves the others.
    """
    return _prepare(_make_with_link(name) if out is None else open_folder(out, force=force), files)


def _prepare(path: Path, files: Mapping[str, str]) -> RunFolder:
    """Remove the recording and the results of an earlier run, and write the settings files."""
    try:
        # Old results would make a run that fails look complete.
        for old in (*path.glob("run*.mcap"), *(path / name for name in RESULTS)):
            old.unlink(missing_ok=True)
    except OSError as error:
        raise _refusal(path, error) from None
    write_files(path, files)
    return RunFolder(path)


def write_files(folder: Path, files: Mapping[str, str]) -> None:
    """Write texts into files by their paths in a folder, with the folders that they need."""
    for relative, text in files.items():
        target = folder / relative
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(text, encoding="utf-8")


def find(text: str) -> Path:
    """Return the recording of RUN: a run's folder, its run.mcap, or ``latest`` for the newest folder below runs/.

    ``find(text).parent`` is the run's folder, unless run.mcap was moved out of it. Raises ``ConfigError`` if there is
    no such recording, and for an empty file: the recorder has not written anything yet.
    """
    source = f"RUN {text}"
    path = _newest() if text == LATEST else Path(text)
    if path is None:
        raise ConfigError(source, "", f"no run below {ROOT.absolute()}: name the folder of a run")
    try:
        if path.is_dir():
            path = path / RECORDING
        size = path.stat().st_size if path.is_file() else None
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        raise ConfigError(source, "", f"cannot be read: {getattr(error, 'strerror', None) or error}") from None
    if size == 0:
        raise ConfigError(f"recording {path}", "", "no recording: 0 bytes")
    if size is not None:
        return path
    if path.name == RECORDING and path.parent.is_dir():
        others = sorted(one.name for one in path.parent.glob("*") if one.suffix in (".mcap", ".db3"))
        wanted = "name the folder of a recorded run"
        if others:
            wanted = f"it has {', '.join(others[:3])}; name an .mcap file, of a .db3 `ros2 bag convert` makes one"
        raise ConfigError(source, "", f"there is no {RECORDING} in this folder: {wanted}")
    raise ConfigError(source, "", f"no such folder or file: a run's folder, its {RECORDING}, or {LATEST}")


def read_summary(recording: Path) -> dict[str, Any]:
    """Return the contents of summary.json beside a recording; empty if there is none.

    Raises ``ConfigError`` if it cannot be read: its figures are not replaced by others in silence.
    """
    path = recording.with_name(SUMMARY)
    return parse_json(read_text(path, what="summary"), f"summary {path}") if path.exists() else {}


def _newest() -> Path | None:
    """Return the folder of the newest run.

    A simulation counts from its start, by its scenario.toml, which is written once. A recording beside a vehicle has
    none and counts by its last message.
    """
    folders = [path for path in ROOT.glob("*") if not path.is_symlink()]
    dated = [[path / name for name in ("scenario.toml", RECORDING) if (path / name).is_file()] for path in folders]
    marks = [files[0] for files in dated if files]
    return max(marks, key=lambda path: path.stat().st_mtime_ns).parent if marks else None


def make_default(name: str) -> Path:
    """Make the folder ``runs/<UTC time>-<name>`` and return its path."""
    stem = f"{datetime.now(UTC):%Y%m%dT%H%M%SZ}-{name}"
    tries = (ROOT / (stem if count == 1 else f"{stem}-{count}") for count in itertools.count(1))
    return next(path for path in tries if _try_make(path))


def _make_with_link(name: str) -> Path:
    path = make_default(name)
    with contextlib.suppress(OSError):  # the link is a convenience: not every file system has links
        draft = ROOT / f".{LATEST}-{os.getpid()}"
        draft.symlink_to(path.name)
        draft.replace(ROOT / LATEST)
    return path


def _try_make(path: Path) -> bool:
    """Make a folder; return False if it exists: several runs may start within one second."""
    try:
        path.mkdir(parents=True)
    except FileExistsError:
        return False
    except (OSError, ValueError) as error:
        raise _refusal(path, error) from None
    return True


def open_folder(path: Path, *, force: bool) -> Path:
    """Make the folder ``path`` if it does not exist, and return it.

    A folder that is not empty raises ``ConfigError`` unless ``force`` is set, which leaves everything in it.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        if any(path.iterdir()) and not force:
            problem = "is not empty: name another folder, or add --force"
            raise ConfigError("option --out", "", problem, value=str(path))
    except ConfigError:
        raise
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        raise _refusal(path, error) from None
    return path


def _refusal(path: Path, error: OSError | ValueError) -> ConfigError:
    return ConfigError(
        "option --out", "", f"cannot be written ({getattr(error, 'strerror', None) or error})", value=str(path)
    )
