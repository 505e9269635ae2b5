"""Hostile files: every reader of a file that a user names ends with an error that names the file, in bounded time."""

from __future__ import annotations

import os
import resource
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

from ltv_mpc import references
from ltv_mpc.bathymetry import Bathymetry
from ltv_mpc.control.failed_qp import NamedQp
from ltv_mpc.currents import read_prior, read_profile
from ltv_mpc.errors import ConfigError
from ltv_mpc.geofence.fence import Fence
from ltv_mpc.localisation.pd0 import reader as pd0
from ltv_mpc.references.geodesy import Origin
from ltv_mpc.vehicle.parameters import Vehicle
from services.bus.security import credentials
from services.processes import checkpoint
from services.processes.mavlink import _key
from services.recording import export, info, recover
from services.recording.records import MAGIC
from services.reporting.plots import recorded
from services.run.run_config import resolve
from services.run.summary import summarise_recording
from services.tools import autopilot_log
from services.tools.batch import results_store
from services.tools.campaign import file as campaign
from services.tools.python_run import summary_of
from tests.services.recording.recordings import chunk, foreign_keys, record

CPU_S, WALL_S, MAX_KB = 10.0, 120, 200_000


def of_folder(read: Callable[[Path], Any], name: str) -> Callable[[Path], Any]:
    """Return a reader of the file ``name`` of a folder, which is ``path`` itself under another name."""

    def reader(path: Path) -> Any:
        folder = path.parent / "folder"
        folder.mkdir(exist_ok=True)
        (folder / name).symlink_to(path.absolute())
        return read(folder)

    return reader


def certificates(folder: Path) -> None:
    for name in ("router.pem", "router.key"):
        (folder / name).write_text("")
        (folder / name).chmod(0o600)
    credentials(folder, "router")


def read_checkpoint(folder: Path) -> None:
    said: list[str] = []
    console: Any = type("Console", (), {"say": lambda _, text: said.append(text)})()
    kept = checkpoint.Checkpoint(folder, "", resume_within_s=None, console=console)
    kept.close()
    raise ConfigError("", "", said[0])


def export_recording(path: Path) -> None:
    out = path.parent / "tables"
    out.mkdir(exist_ok=True)
    export.export([path], out, "csv")


VEHICLE = Vehicle.load("paper")
TEXTS: dict[str, Callable[[Path], Any]] = {
    ".toml vehicle": lambda path: Vehicle.load(str(path)),
    ".toml scenario": lambda path: resolve(str(path)),
    ".toml campaign": campaign.load,
    ".plan reference": lambda path: references.load(str(path)),
    ".waypoints reference": lambda path: references.load(str(path)),
    ".gpx reference": lambda path: references.load(str(path)),
    ".geojson reference": lambda path: references.load(str(path)),
    ".geojson fence": lambda path: Fence.load(str(path)),
    ".plan fence": lambda path: Fence.load(str(path)),
    ".waypoints fence": lambda path: Fence.load(str(path)),
    ".csv currents": read_profile,
    ".csv prior": read_prior,
    ".csv bathymetry": lambda path: Bathymetry.load(str(path), Origin(latitude_deg=0.0, longitude_deg=0.0)),
    ".json summary": of_folder(lambda folder: summary_of(folder / "run.mcap"), "summary.json"),
    ".pd0 dive": pd0.read,
    ".qp QP": NamedQp.load,
    ".bin log": lambda path: autopilot_log.read(path, VEHICLE),
    ".tlog log": lambda path: autopilot_log.read(path, VEHICLE),
    ".jsonl results": lambda path: list(results_store.read(path)[1]),
    ".pem certificates": of_folder(certificates, "ca.pem"),
    ".key signing": _key,
    ".cp checkpoint": of_folder(read_checkpoint, checkpoint.FILE),
}
RECORDINGS: dict[str, Callable[[Path], Any]] = {
    "info": lambda path: info.read([path]),
    "report": recorded.read,
    "recover": lambda path: recover.recover([path], path.parent / "run.out"),
    "export": export_recording,
    "summary": lambda path: summarise_recording(resolve("hover"), path),
}

MB = 1_000_000
CONTENTS = {
    "zeros": bytes(175_000),
    "not UTF-8": b"\xff\xfe" * 1000,
    "a NUL": b"a = 1\0\n",
    "deep JSON": b'{"a":' * 100_000,
    "deep list": b"[" * 100_000,
    "deep TOML": b"a = " + b"[" * 100_000,
    "long lines": b"depth_m,v_north_mps,u_east_mps\n" + b"1," * 70_000 + b'"' + b"x" * 200_000 + b'",1\n',
    "too large": b"#" * ((1 << 20) + 1),
}
EVERY = [(name, reader) for name in CONTENTS for reader in TEXTS]
BOMBS_OF = {
    ".toml vehicle": {
        "a dotted key": b".".join([b"a"] * 100_000) + b" = 1",
        "dotted keys": b"".join(b"a.b%d.c.d.e.f.g.h.i = 1\n" % k for k in range(35_000)),
        "inline tables": b"a = " + b"{b = " * 50_000,
        "a long key": b"k" * MB + b" = 1",
        "many keys": b"".join(b"key%d = 1\n" % k for k in range(60_000)),
        "a large number": b"a = " + b"9" * 5000,
    },
    ".csv currents": {"a long header": b"depth_m," * 120_000, "quotes": b'"' * MB, "lines": b"\n" * (MB // 4) + b"x"},
    ".geojson fence": {"a long key": b'{"' + b"k" * MB + b'": 1}'},
    ".json summary": {"a large number": b'{"x": 1' + b"0" * 400 + b"}", "a wrong type": b'{"health": []}'},
}
CONTENTS |= {f"{reader}: {name}": content for reader, of in BOMBS_OF.items() for name, content in of.items()}
EVERY += [(f"{reader}: {name}", reader) for reader, of in BOMBS_OF.items() for name in of]


@contextmanager
def bounded(cpu_s: float = CPU_S) -> Iterator[None]:
    """Fail after ``cpu_s`` of processor time or a wait, and if the memory grows by more than ``MAX_KB``."""

    def stop(*_: object) -> None:
        raise AssertionError("takes too long")

    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    handlers = [signal.signal(number, stop) for number in (signal.SIGPROF, signal.SIGALRM)]
    signal.setitimer(signal.ITIMER_PROF, cpu_s)
    signal.alarm(WALL_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.alarm(0)
        for number, handler in zip((signal.SIGPROF, signal.SIGALRM), handlers, strict=True):
            signal.signal(number, handler)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < MAX_KB


def refused(read: Callable[[Path], Any], path: Path, says: str = ".") -> None:
    with bounded(), pytest.raises(ConfigError, match=says) as error:
        read(path)
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 2000 + len(str(path))


@pytest.mark.parametrize(("name", "reader"), EVERY)
def test_a_hostile_text_is_an_error_of_one_line(name, reader, tmp_path) -> None:
    path = tmp_path / f"hostile{reader.split()[0]}"
    path.write_bytes(CONTENTS[name])
    refused(TEXTS[reader], path)


NO_FILES = {"fifo": "is not a regular file", "device": "is not a regular file", "folder": "is a folder|no recording"}
NO_FILES |= dict.fromkeys(("NUL in the name", "long name"), "cannot be read")


@pytest.mark.parametrize("reader", [*TEXTS, *(f".mcap {name}" for name in RECORDINGS)])
@pytest.mark.parametrize("kind", NO_FILES)
def test_what_is_no_regular_file_is_an_error_and_not_waited_for(kind, reader, tmp_path) -> None:
    suffix, name = reader.split()
    path = tmp_path / f"hostile{suffix}"
    match kind:
        case "fifo":
            os.mkfifo(path)
        case "device":
            path.symlink_to("/dev/zero")
        case "folder":
            path.mkdir()
        case "NUL in the name":
            path = tmp_path / f"a\0b{suffix}"
        case _:
            path = tmp_path / f"{'n' * 5000}{suffix}"
    if kind in ("NUL in the name", "long name") and reader in (".json summary", ".pem certificates", ".cp checkpoint"):
        pytest.skip("names a folder")
    refused(TEXTS.get(reader) or RECORDINGS[name], path, NO_FILES[kind])


EMPTY_MESSAGE = record(5, bytes(22))


def bomb(path: Path, data: bytes) -> Path:
    one = chunk(data)
    path.write_bytes(MAGIC + one * max(1, BOMB_BYTES // len(one)))
    return path


BOMB_BYTES = 175_000 // 4  # the time grows linearly
BOMBS = {
    "zeros": bytes(1 << 27),
    "empty records": record(0x81, b"") * (1 << 20),
    "empty messages": EMPTY_MESSAGE * (1 << 18),
    "a channel and its messages": record(4, b"\0\0\0\0" + b"\5\0\0\0plant" + b"\4\0\0\0json" + bytes(4))
    + EMPTY_MESSAGE * (1 << 18),
    "small chunks of zeros": bytes(1 << 14),
}


@pytest.mark.parametrize("reader", RECORDINGS)
@pytest.mark.parametrize("name", BOMBS)
def test_a_recording_that_unpacks_to_much_more_is_read_in_bounded_time(name, reader, tmp_path) -> None:
    with bounded(CPU_S / 4), suppress(ConfigError):
        RECORDINGS[reader](bomb(tmp_path / "run.mcap", BOMBS[name]))


HEADER = b'"epoch":1,"sequence":0'
MESSAGES = [
    *(b"", b"null", b"[]", b"1", b"{}", b"{" + HEADER + b"}"),
    *(b'{"epoch":[],"sequence":{}}', b'{"epoch":-1,"sequence":1e99}'),
    b"{" + HEADER + b',"a":' + b"[" * 100_000,
    *(b"{" + HEADER + b',"a":' + b'{"a":' * n + b"1" + b"}" * n + b"}" for n in (100, 900, 3000)),
    b"{" + HEADER + b',"t_ns":"x","node":5,"kind":[],"text":{},"files":1,"steps":"","rejected":null,"samples":{}}',
    b"{" + HEADER + b',"t_ns":' + b"9" * 400 + b',"samples":[1,[],{"t_ns":"x"}],"north_m":"' + b"n" * 1000 + b'"}',
    b"{" + HEADER + b',"t_ns":1' + b"".join(b',"f%d":%d' % (k, k) for k in range(3000)) + b"}",
    b"\xff" * 100,
]


@pytest.mark.parametrize("reader", RECORDINGS)
def test_wrong_types_in_a_recording_are_skipped(reader, tmp_path) -> None:
    keys = ("plan", "estimate", "applied", "world/truth", "clock", "sensor/imu", "controller/status", "x", "a\0b")
    keys += tuple(
        f"{key}/{node}" for key in ("status", "event", "rejected", "settings", "record") for node in ("x", "\0")
    )
    metadata = {
        "start_ns": "x" * 100,
        "mode": "\0",
        "scenario.toml": "a = " + "[" * 50_000,
        "config/vehicle.toml": "[" * 50_000,
    }
    path = foreign_keys(tmp_path / "run.mcap", keys, *MESSAGES, **metadata)
    with bounded():
        RECORDINGS[reader](path)
