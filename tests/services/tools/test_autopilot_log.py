"""Logs of ArduPilot: the vehicle that made them is found, from DataFlash and from telemetry."""

from __future__ import annotations

import json
import math
import struct
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

pytest.importorskip("pymavlink", reason="not installed: pip install pymavlink (extra mavlink)")

from ltv_mpc import Vehicle
from ltv_mpc.config import to_toml
from ltv_mpc.vehicle.dynamics import rates
from ltv_mpc.vehicle.identification import identify
from ltv_mpc.vehicle.shooting_fit import Motion
from services.cli.app import run
from services.tools import autopilot_log
from tests.foreign_plant.mavlink_flight import EXAMPLE
from tests.ltv_mpc.vehicles import changed
from tests.services.edges.mavlink.items import codec

BOAT = Vehicle.load("bluerobotics-boat")
STEP_S, SECONDS, PERIOD = 0.02, 50.0, 5
HEADER = b"\xa3\x95"
FORMATS = {
    "PARM": (10, "QNff", "TimeUS,Name,Value,Default"),
    "ARM": (11, "QBIBB", "TimeUS,ArmState,ArmChecks,Forced,Method"),
    "IMU": (12, "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
    "XKF1": (13, "QBccCfffffff", "TimeUS,C,Roll,Pitch,Yaw,VN,VE,VD,dPD,PN,PE,PD"),
    "RCOU": (14, "QHHHH", "TimeUS,C1,C2,C3,C4"),
}
LETTERS = {"Q": "Q", "B": "B", "I": "I", "f": "f", "c": "h", "C": "H", "H": "H", "N": "16s"}


class Sample(NamedTuple):
    """Motion and outputs at one instant."""

    t_us: int
    state: tuple[float, ...]  # n, e, u, v, psi, r
    pwm: tuple[int, int]


@cache
def drive(seconds: float = SECONDS) -> tuple[Sample, ...]:
    """Return a drive with thrusts that change every 4 s; the motors follow the PWM with lag and slew of the file."""
    rng, thrusters, p = np.random.default_rng(3), BOAT.thrusters[:2], BOAT.coefficients()
    x, F, wanted, samples = np.zeros(6), np.zeros(2), np.zeros(2), []
    for k in range(round(seconds / STEP_S)):
        if k % 200 == 0:
            wanted = rng.uniform(-0.5, 0.9, 2) * 40.0
        pwm = tuple(round(float(np.interp(wanted[i], thrusters[i].pwm_N, thrusters[i].pwm_us))) for i in range(2))
        command = np.array([np.interp(pwm[i], thrusters[i].pwm_us, thrusters[i].pwm_N) for i in range(2)])
        if k % PERIOD == 0:
            samples.append(Sample(1_000_000 + round(k * STEP_S * 1e6), tuple(x.tolist()), (pwm[0], pwm[1])))
        F += (command - F) * (1.0 - math.exp(-STEP_S / thrusters[0].lag_s))
        k1 = np.array(rates(x[2], x[3], x[4], x[5], F[0], F[1], 0.0, 0.0, 0.0, 0.0, p))
        y = x + 0.5 * STEP_S * k1
        x = x + STEP_S * np.array(rates(y[2], y[3], y[4], y[5], F[0], F[1], 0.0, 0.0, 0.0, 0.0, p))
    return tuple(samples)


def over_ground(x: tuple[float, ...]) -> tuple[float, float]:
    return x[2] * math.cos(x[4]) - x[3] * math.sin(x[4]), x[2] * math.sin(x[4]) + x[3] * math.cos(x[4])


def data_flash(path: Path, functions: dict[str, float], events: dict[int, int]) -> None:
    """Write a log; ``events`` are the new states of arming by the number of the sample."""

    def row(name: str, *values: Any) -> bytes:
        number, letters, _ = FORMATS[name]
        return HEADER + bytes([number]) + struct.pack("<" + "".join(LETTERS[one] for one in letters), *values)

    data = bytearray()
    for name, (number, letters, columns) in {
        "FMT": (128, "BBnNZ", "Type,Length,Name,Format,Columns"),
        **FORMATS,
    }.items():
        size = 89 if name == "FMT" else 3 + struct.calcsize("<" + "".join(LETTERS[one] for one in letters))
        row_of = struct.pack("<BB4s16s64s", number, size, name.encode(), letters.encode(), columns.encode())
        data += HEADER + b"\x80" + row_of
    for name, value in functions.items():
        data += row("PARM", 0, name.encode(), value, 0.0)
    for k, (t_us, x, pwm) in enumerate(drive()):
        if k in events:
            data += row("ARM", t_us, events[k], 0, 0, 0)
        north, east = over_ground(x)
        data += row("IMU", t_us, 0, 0.0, 0.0, x[5], 0.0, 0.0, -9.8)
        data += row(
            "XKF1", t_us, 0, 0, 0, round(math.degrees(x[4]) % 360.0 * 100), north, east, 0.0, 0.0, x[0], x[1], 0.0
        )
        data += row("RCOU", t_us, pwm[1], 1500, pwm[0], 1500)
    path.write_bytes(data)


def telemetry(path: Path, started_us: int, restarts: bool, seconds: float = SECONDS) -> None:
    """Write a log that begins so long after the start of the autopilot, which ``restarts`` in the middle."""
    make, other, data = codec(), codec(2), bytearray()

    def add(t_us: int, message: Any, by: Any = make) -> None:
        nonlocal data
        data += struct.pack(">Q", 1_700_000_000_000_000 + t_us) + by.encode(message)

    samples, middle = drive(seconds), len(drive(seconds)) // 2
    for k, (drive_us, x, pwm) in enumerate(samples):
        t_us = samples[k - middle].t_us if restarts and k >= middle else started_us + drive_us
        north, east = over_ground(x)
        add(t_us, other.make.attitude_encode(t_us // 1000, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0), other)
        if k % 10 == 0:
            add(t_us, make.make.heartbeat_encode(10, 3, 128 if k >= 20 else 0, 0, 4))
        add(t_us, make.make.attitude_encode(t_us // 1000, 0.0, 0.0, math.remainder(x[4], 2 * math.pi), 0.0, 0.0, x[5]))
        add(t_us, make.make.local_position_ned_encode(t_us // 1000, x[0], x[1], 0.0, north, east, 0.0))
        add(t_us, make.make.servo_output_raw_encode(t_us % 2**32, 0, pwm[0], 1500, pwm[1], 1500, 0, 0, 0, 0))
    path.write_bytes(data)


FUNCTIONS = {"SERVO1_FUNCTION": 74.0, "SERVO3_FUNCTION": 73.0}
KINDS = {
    "armed later.BIN": lambda path: data_flash(path, FUNCTIONS, {20: 1}),
    "armed before, as by LOG_DISARMED = 0.bin": lambda path: data_flash(path, FUNCTIONS, {len(drive()) - 20: 0}),
    "without arming.bin": lambda path: data_flash(path, FUNCTIONS, {}),
    "outputs whose stamps begin again.tlog": lambda path: telemetry(path, 2**32 - 30_000_000, False),
    "an hour and a half after the start.tlog": lambda path: telemetry(path, 5_400_000_000, False),
    "restarted.tlog": lambda path: telemetry(path, 1_000_000_000, True),
}


@pytest.mark.parametrize("kind", KINDS)
def test_a_log_has_the_motion_of_the_drive_its_thrusts_and_when_it_was_armed(kind: str, tmp_path: Path) -> None:
    log, count = tmp_path / kind, len(drive())
    KINDS[kind](log)
    found = autopilot_log.read(log, BOAT)
    states = np.array([one.state for one in drive()])
    rows = [int(np.argmin(np.hypot(*(states[:, :2] - (of.north_m, of.east_m)).T))) for of in found.estimates]
    assert len(rows) >= count - 4
    assert np.diff(rows).min() >= 1
    velocities = [(one.velocity_north_mps, one.velocity_east_mps, one.yaw_rate_radps) for one in found.estimates]
    np.testing.assert_allclose(velocities, [(*over_ground(states[row]), states[row, 5]) for row in rows], atol=1e-5)
    for output, (t_us, _, pwm) in zip(range(count), drive(), strict=True):
        thrusts = [np.interp(us, of.pwm_us, of.pwm_N) for us, of in zip(pwm, BOAT.thrusters[:2], strict=True)]
        np.testing.assert_allclose(found.command_N[output], thrusts)
        if not kind.startswith("restarted"):
            assert found.t_ns[output] - found.t_ns[0] == (t_us - drive()[0].t_us) * 1000
    armed = np.arange(count) < count - 20 if kind.startswith("armed before") else np.arange(count) >= 20
    assert found.armed.tolist() == (armed | kind.startswith("without")).tolist()
    assert any("no ARM in the log" in note for note in found.notes) is kind.startswith("without")
    assert any("SERVOn_FUNCTION" in note for note in found.notes) is kind.endswith("tlog")


def test_the_vehicle_that_made_a_log_is_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log, wrong = tmp_path / "restarted.tlog", tmp_path / "wrong.toml"
    telemetry(log, 1_000_000_000, restarts=True, seconds=150.0)
    true = {"surge.mass_kg": BOAT.surge.mass_kg, "sway.mass_kg": BOAT.sway.mass_kg}
    too_much = {key: 1.4 * value for key, value in (true | {"yaw.inertia_kgm2": BOAT.yaw.inertia_kgm2}).items()}
    wrong.write_text(to_toml(changed(BOAT, too_much)))
    assert run(["vehicle", "identify", str(log), "--vehicle", str(wrong), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["input"] == "pwm"
    assert report["left_out_s"] == pytest.approx(2.0, abs=0.5)  # disarmed
    found = {one["name"]: one for one in report["coefficients"]}
    for name, value in zip(("mass_surge", "mass_sway"), true.values(), strict=True):
        assert found[name]["excited"]
        assert found[name]["value"] == pytest.approx(value, rel=0.05)
    assert max(report["residual_sd"][:2]) < 0.007  # an initial state that stays behind in a local minimum leaves 0.01


def test_a_log_that_cannot_be_used_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "boat.bin"
    data_flash(log, {"SERVO1_FUNCTION": 26.0}, {20: 1})
    for arguments, says in (
        ([str(log), "--vehicle", "bluerobotics-boat"], "SERVOn_FUNCTION: must have (73, 74)"),
        ([str(log), "--vehicle", "paper"], "SERVOn_FUNCTION"),
        ([str(log)], "option --vehicle: is needed"),
        ([str(tmp_path / "none.tlog"), "--vehicle", "paper"], "none.tlog: no such file"),
    ):
        assert run(["vehicle", "identify", *arguments]) == 2
        error = capsys.readouterr().err
        assert says in error
        assert "Traceback" not in error
    data_flash(log, FUNCTIONS, {20: 1})
    assert run(["vehicle", "identify", str(log), "--vehicle", "paper"]) == 2
    assert "[thruster.port] pwm_us: is missing" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["damaged.bin", "damaged.tlog"])
def test_damage_costs_itself_alone(name: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """One output a thousand years ahead ended in a traceback, and one value that is none cost the log."""
    log = tmp_path / name
    (telemetry(log, 0, False) if name.endswith("tlog") else data_flash(log, FUNCTIONS, {20: 1}))
    data = bytearray(log.read_bytes())
    if name.endswith("tlog"):
        data[len(data) // 2] ^= 1
    else:
        stamp = struct.pack("<Q", drive()[400].t_us)
        xkf1, rcou = (data.index(HEADER + bytes([number]) + stamp) for number in (13, 14))
        data[xkf1 + 18 : xkf1 + 22] = struct.pack("<f", math.nan)  # VN
        data[rcou + 3 : rcou + 11] = struct.pack("<Q", 2**50)
        data[rcou - 1_000 : rcou - 1_000] = bytes(19)
        data += HEADER + bytes([14]) + struct.pack("<QHHHH", 2**63, 1500, 1500, 1500, 1500)
    log.write_bytes(data)
    found = autopilot_log.read(log, BOAT)
    assert len(found.estimates) >= len(drive()) - 6
    assert found.t_ns.max() < 2e11
    assert found.notes[-1].startswith("the log is damaged in")
    assert not any(capfd.readouterr())


def test_the_simulated_autopilot_has_the_boat_of_its_vehicle_file() -> None:
    """Without the Munk moment, (M_x - M_y) u v, the yaw of its boat was that of no vehicle."""
    boat, rng, rows, wanted = EXAMPLE.Boat(), np.random.default_rng(5), [], (0.0, 0.0)
    for k in range(9000):
        wanted = wanted if k % 200 else tuple(rng.uniform(-20.0, 40.0, 2))
        if k % PERIOD == 0:
            rows.append((k * STEP_S, boat.surge, boat.sway, boat.rate, boat.heading, *wanted))
        boat.step(wanted)
    t, u, v, r, heading, port, starboard = np.array(rows).T
    still, velocity, command = np.zeros((len(t), 2)), np.column_stack((u, v, r)), np.column_stack((port, starboard))
    motion = Motion(t, velocity, np.unwrap(heading), still, command, np.full(3, 1e-3))
    found = {one.name: one for one in identify(BOAT, motion, "thrust", "arm").coefficients}
    for name in ("mass_surge", "mass_sway", "inertia_yaw", "quadratic_surge", "quadratic_sway", "quadratic_yaw"):
        assert found[name].excited
        assert found[name].value == pytest.approx(found[name].file, rel=0.06)
