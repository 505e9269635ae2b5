"""Fault classes: effect, target, duration and size, and the bound on what a loss may do.

Sizes are drawn from ``size``. Their meaning depends on the class: a share of the messages, seconds, or a factor; see
``effects.py``. Durations are in vehicle seconds. ``reactions.py`` has the reactions that are required.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping

import msgspec

from ltv_mpc.messages import (
    AdcpPing,
    Applied,
    CompassHeading,
    Estimate,
    GnssFix,
    ImuSamples,
    LocalisationReport,
    Message,
    Plan,
    PressureDepth,
    TdcpFix,
    Truth,
)


class Place(enum.StrEnum):
    """Place of injection: in a lock-step run or in a run of processes."""

    LOCKSTEP = "lockstep"
    PROCESSES = "processes"


class Fault(msgspec.Struct, frozen=True, kw_only=True):
    """Fault to inject. Times are vehicle times (s); the meaning of ``size`` depends on the class."""

    kind: str  # its class
    target: str
    start_s: float
    end_s: float
    size: float
    seed: int
    permanent: bool = False  # it lasts until the run's end, and no recovery is required

    @property
    def start_ns(self) -> int:
        """Return the start (ns)."""
        return round(self.start_s * 1e9)

    @property
    def end_ns(self) -> int:
        """Return the end (ns)."""
        return round(self.end_s * 1e9)


LOCKSTEP, PROCESSES = Place.LOCKSTEP, Place.PROCESSES

INSTRUMENTS: Mapping[str, type[Message]] = {
    "imu": ImuSamples,
    "adcp": AdcpPing,
    "compass": CompassHeading,
    "pressure": PressureDepth,
    "gnss": GnssFix,
    "tdcp": TdcpFix,
}
AFLOAT = ("gnss", "tdcp")
"""Sensors that work, and so can fail, before the descent only."""

MESSAGES: Mapping[str, tuple[type[Message], ...]] = {
    "estimate": (Estimate,),
    "plan": (Plan,),
    "applied": (Applied,),
    "imu": (ImuSamples,),
    "adcp": (AdcpPing,),
    "truth": (Truth,),
    "report": (LocalisationReport,),
    "sensors": (ImuSamples, AdcpPing, CompassHeading, PressureDepth, GnssFix, TdcpFix),
}

ALL = tuple(INSTRUMENTS)
WIRES = ("estimate", "plan", "applied", "imu", "adcp")
LINKS = ("estimate", "plan", "applied")
STAMPERS = (*LINKS, "sensors")
OWN_KEYS = (*WIRES, "truth", "report")
RESTARTABLE = ("estimator", "controller", "recorder")
THRUSTERS = ("port", "starboard", "both")


class FaultClass(msgspec.Struct, frozen=True):
    """Class of faults in one place (one row of the table)."""

    name: str
    place: Place
    targets: tuple[str, ...]
    duration_s: tuple[float, float]
    size: tuple[float, float]
    may_last: bool = False  # some of them are permanent


KINDS = (
    #    name                   place      targets                       duration   size
    FaultClass("sensor_off",          LOCKSTEP,  ALL,                          (3, 15),  (1, 1), True),
    FaultClass("sensor_stuck",        LOCKSTEP,  ALL,                          (2, 12),   (1, 1)),
    FaultClass("sensor_garbage",      LOCKSTEP,  ALL,                          (1, 10),   (0.1, 1)),
    FaultClass("sensor_wrong",        LOCKSTEP,  ALL,                          (2, 12),   (0.5, 3)),
    FaultClass("sensor_slow",         LOCKSTEP,  ALL,                          (3, 15),   (3, 10)),
    FaultClass("sensor_delayed",      LOCKSTEP,  ALL,                          (3, 15),   (0.05, 2)),
    FaultClass("sensor_intermittent", LOCKSTEP,  ALL,                          (3, 15),   (0.2, 2)),
    FaultClass("message_loss",        LOCKSTEP,  WIRES,                        (1, 8),    (0.2, 1)),
    FaultClass("message_delay",       LOCKSTEP,  WIRES,                        (1, 8),    (0.05, 2)),
    FaultClass("message_reorder",     LOCKSTEP,  WIRES,                        (1, 8),    (0.1, 0.8)),
    FaultClass("message_duplicate",   LOCKSTEP,  WIRES,                        (1, 8),    (0.1, 1)),
    FaultClass("message_corruption",  LOCKSTEP,  WIRES,                        (1, 8),    (0.05, 1)),
    FaultClass("message_stale",       LOCKSTEP,  ("estimate", "plan"),         (1, 8),    (1, 1)),
    FaultClass("not_a_number",        LOCKSTEP,  WIRES,                        (1, 8),    (0.05, 1)),
    FaultClass("clock_jump",          LOCKSTEP,  STAMPERS,                     (1, 8),  (-3600, 3600)),
    FaultClass("solver_failure",      LOCKSTEP,  ("fails", "lies", "raises"),  (0.3, 3),  (1, 1)),
    FaultClass("solver_overrun",      LOCKSTEP,  ("controller",),              (2, 8),    (0.35, 1.5)),
    FaultClass("thruster_loss",       LOCKSTEP,  THRUSTERS,                    (10, 40),  (0.3, 1), True),
    FaultClass("second_commander",    LOCKSTEP,  ("plant",),                   (0.5, 5),  (0.2, 1)),
    FaultClass("external_force",      LOCKSTEP,  ("vehicle",),                 (1, 8),    (20, 200)),
    FaultClass("second_source",       LOCKSTEP,  ("estimate",),                (1, 15),   (3, 30)),
    FaultClass("estimate_dropout",    LOCKSTEP,  ("estimate",),                (1, 30),   (1, 1)),
    FaultClass("clock_step",          LOCKSTEP,  ("vehicle",),                 (3, 15), (-3600, 3600)),
    FaultClass("reference_point",     LOCKSTEP,  ("ahead", "starboard"),       (60, 90),  (0.5, 0.5)),
    FaultClass("controller_restart",  LOCKSTEP,  ("controller",),              (1, 5),    (1, 1)),
    FaultClass("own_keys",            LOCKSTEP,  OWN_KEYS,                     (2, 10),   (0.2, 1)),
    FaultClass("stranger_datagrams",  LOCKSTEP,  ("open", "signed"),           (2, 10),   (10, 60)),
    FaultClass("message_loss",        PROCESSES, LINKS,                        (1, 6),    (0.2, 1)),
    FaultClass("message_delay",       PROCESSES, LINKS,                        (1, 6),    (0.05, 1)),
    FaultClass("message_reorder",     PROCESSES, LINKS,                        (1, 6),    (0.1, 0.8)),
    FaultClass("message_duplicate",   PROCESSES, LINKS,                        (1, 6),    (0.1, 1)),
    FaultClass("message_corruption",  PROCESSES, LINKS,                        (1, 6),    (0.05, 1)),
    FaultClass("process_crash",       PROCESSES, RESTARTABLE,                  (0, 0),    (1, 1)),
    FaultClass("process_hang",        PROCESSES, RESTARTABLE,                  (0, 0),    (1, 1)),
    FaultClass("process_slow",        PROCESSES, RESTARTABLE,                  (2, 8),    (0.3, 0.9)),
    FaultClass("disk_full",           PROCESSES, ("recorder",),                (0, 0),    (1, 1)),
    FaultClass("router_killed",       PROCESSES, ("router",),                  (0, 0),    (1, 1)),
    FaultClass("helper_stopped",      PROCESSES, ("forkserver", "cleanup"),    (1, 5),    (1, 1)),
    FaultClass("flood",               PROCESSES, ("unknown", "event"),         (2, 8),  (100, 3000)),
)  # fmt: skip
"""All classes; those of messages have a row in each place."""

ENDING = ("process_crash", "process_hang", "router_killed", "disk_full")
"""Classes after which a process must work again."""

ATTACKS = (*ENDING, "process_slow", "helper_stopped", "flood")
"""Classes of what is done to the processes of a run, or to its recorder."""

DATAGRAMS = "stranger_datagrams"
"""Class of what a stranger sends to the edge to MAVLink, in a flight of its own."""

ADRIFT_M = 15.0
"""Drift of a vehicle without control: 75 s in water of 0.2 m/s."""

INERTIAL_M = 25.0
"""3 sigma of an IMU without aiding for 75 s, with level and biases estimated with the current profiler before."""

AIDED_M = 2.0
"""With the current profiler: 3 sigma of a velocity of 5 mm/s over two minutes."""

DROPOUT_M = 6.0
"""Drift in water of 0.2 m/s for 30 s without estimates."""

BOUNDS_M: Mapping[tuple[str, str], float] = {
    ("sensor_off", "imu"): ADRIFT_M,
    ("sensor_off", "adcp"): INERTIAL_M,
    **{("sensor_off", name): AIDED_M for name in INSTRUMENTS if name not in ("imu", "adcp")},
    **{("thruster_loss", name): ADRIFT_M for name in THRUSTERS},
    **{("reference_point", name): AIDED_M for name in ("ahead", "starboard")},
    ("second_source", "estimate"): AIDED_M,
    ("estimate_dropout", "estimate"): DROPOUT_M,
    ("clock_step", "vehicle"): AIDED_M,
    ("controller_restart", "controller"): AIDED_M,
}
"""Largest change of the true horizontal error (m) by class and target, during the fault and the minute after it; a
permanent fault counts for 75 s.
"""

NAMES = tuple(dict.fromkeys(kind.name for kind in KINDS))


def of(name: str, place: Place) -> FaultClass:
    """Return the row of a class in a place."""
    return next(kind for kind in KINDS if kind.name == name and kind.place is place)


def bound_m(fault: Fault) -> float | None:
    """Return the bound of the true error's growth (m); None if the class has none, and for thrust lost for a while."""
    if fault.kind == "thruster_loss" and not fault.permanent:
        return None
    return BOUNDS_M.get((fault.kind, fault.target))
