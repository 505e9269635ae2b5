"""Fault classes: effect, target, duration, size, and the reaction that is required.

Sizes are drawn from ``size``. Their meaning depends on the class: a share of the messages, seconds, or a factor; see
``sim/faults``. Durations are in vehicle seconds.
"""

from __future__ import annotations

from collections.abc import Mapping

import msgspec

from ltv_mpc.messages import (
    AdcpPing,
    Applied,
    CompassHeading,
    Estimate,
    GnssFix,
    ImuSample,
    Message,
    Plan,
    PressureDepth,
    TdcpFix,
)
from services.tools.faults.fault import Fault, Place

LOCKSTEP, PROCESSES = Place.LOCKSTEP, Place.PROCESSES

SAME_CYCLE = "the same cycle"
AFTER_THRESHOLD = "the first cycle after its threshold"
FLAGGED = "flagged, or inside 3 sigma"
IMPULSE = "10 N s of lost impulse"
DEAD = "2 s of wall time"
NAMED = "60 s"
RECOGNISED = "receipts of three plans"
SECOND_CYCLE = "the second cycle after it"

INSTRUMENTS: Mapping[str, type[Message]] = {
    "imu": ImuSample,
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
    "imu": (ImuSample,),
    "adcp": (AdcpPing,),
    "sensors": (ImuSample, AdcpPing, CompassHeading, PressureDepth, GnssFix, TdcpFix),
}

ALL = tuple(INSTRUMENTS)
WIRES = ("estimate", "plan", "applied", "imu", "adcp")
LINKS = ("estimate", "plan", "applied")
STAMPERS = (*LINKS, "sensors")
RESTARTABLE = ("estimator", "controller", "recorder")
THRUSTERS = ("port", "starboard", "both")


class FaultClass(msgspec.Struct, frozen=True):
    """Class of faults in one place (one row of the table)."""

    name: str
    place: Place
    targets: tuple[str, ...]
    duration_s: tuple[float, float]
    size: tuple[float, float]
    limit: str  # of the reaction
    may_last: bool = False  # some of them are permanent


KINDS = (
    #    name                   place      targets                       duration   size           limit
    FaultClass("sensor_off",          LOCKSTEP,  ALL,                          (3, 15),  (1, 1), AFTER_THRESHOLD, True),
    FaultClass("sensor_stuck",        LOCKSTEP,  ALL,                          (2, 12),   (1, 1),        FLAGGED),
    FaultClass("sensor_garbage",      LOCKSTEP,  ALL,                          (1, 10),   (0.1, 1),      FLAGGED),
    FaultClass("sensor_wrong",        LOCKSTEP,  ALL,                          (2, 12),   (0.5, 3),      FLAGGED),
    FaultClass("sensor_slow",         LOCKSTEP,  ALL,                          (3, 15),   (3, 10),       FLAGGED),
    FaultClass("sensor_delayed",      LOCKSTEP,  ALL,                          (3, 15),   (0.05, 2),     FLAGGED),
    FaultClass("sensor_intermittent", LOCKSTEP,  ALL,                          (3, 15),   (0.2, 2),      FLAGGED),
    FaultClass("message_loss",        LOCKSTEP,  WIRES,                        (1, 8),    (0.2, 1),    AFTER_THRESHOLD),
    FaultClass("message_delay",       LOCKSTEP,  WIRES,                        (1, 8),    (0.05, 2),   AFTER_THRESHOLD),
    FaultClass("message_reorder",     LOCKSTEP,  WIRES,                        (1, 8),    (0.1, 0.8),    SAME_CYCLE),
    FaultClass("message_duplicate",   LOCKSTEP,  WIRES,                        (1, 8),    (0.1, 1),      SAME_CYCLE),
    FaultClass("message_corruption",  LOCKSTEP,  WIRES,                        (1, 8),    (0.05, 1),     SAME_CYCLE),
    FaultClass("message_stale",       LOCKSTEP,  ("estimate", "plan"),         (1, 8),    (1, 1),      AFTER_THRESHOLD),
    FaultClass("not_a_number",        LOCKSTEP,  WIRES,                        (1, 8),    (0.05, 1),     SAME_CYCLE),
    FaultClass("clock_jump",          LOCKSTEP,  STAMPERS,                     (1, 8),  (-3600, 3600), AFTER_THRESHOLD),
    FaultClass("solver_failure",      LOCKSTEP,  ("fails", "lies", "raises"),  (0.3, 3),  (1, 1),        SAME_CYCLE),
    FaultClass("solver_overrun",      LOCKSTEP,  ("controller",),              (2, 8),    (0.35, 1.5), AFTER_THRESHOLD),
    FaultClass("thruster_loss",       LOCKSTEP,  THRUSTERS,                    (10, 40),  (0.3, 1),      IMPULSE, True),
    FaultClass("second_commander",    LOCKSTEP,  ("plant",),                   (0.5, 5),  (0.2, 1),      SAME_CYCLE),
    FaultClass("external_force",      LOCKSTEP,  ("vehicle",),                 (1, 8),    (20, 200),     FLAGGED),
    FaultClass("second_source",       LOCKSTEP,  ("estimate",),                (1, 15),   (3, 30),       SAME_CYCLE),
    FaultClass("estimate_dropout",    LOCKSTEP,  ("estimate",),                (1, 30),   (1, 1),      AFTER_THRESHOLD),
    FaultClass("clock_step",          LOCKSTEP,  ("vehicle",),                 (3, 15), (-3600, 3600), RECOGNISED),
    FaultClass("reference_point",     LOCKSTEP,  ("ahead", "starboard"),       (60, 90),  (0.5, 0.5),     NAMED),
    FaultClass("controller_restart",  LOCKSTEP,  ("controller",),              (1, 5),    (1, 1),        SECOND_CYCLE),
    FaultClass("message_loss",        PROCESSES, LINKS,                        (1, 6),    (0.2, 1),    AFTER_THRESHOLD),
    FaultClass("message_delay",       PROCESSES, LINKS,                        (1, 6),    (0.05, 1),   AFTER_THRESHOLD),
    FaultClass("message_reorder",     PROCESSES, LINKS,                        (1, 6),    (0.1, 0.8),    SAME_CYCLE),
    FaultClass("message_duplicate",   PROCESSES, LINKS,                        (1, 6),    (0.1, 1),      SAME_CYCLE),
    FaultClass("message_corruption",  PROCESSES, LINKS,                        (1, 6),    (0.05, 1),     SAME_CYCLE),
    FaultClass("process_crash",       PROCESSES, RESTARTABLE,                  (0, 0),    (1, 1),        DEAD),
    FaultClass("process_hang",        PROCESSES, RESTARTABLE,                  (0, 0),    (1, 1),        DEAD),
    FaultClass("process_slow",        PROCESSES, RESTARTABLE,                  (2, 8),    (0.3, 0.9),  AFTER_THRESHOLD),
    FaultClass("disk_full",           PROCESSES, ("recorder",),                (0, 0),    (1, 1),        DEAD),
    FaultClass("router_killed",       PROCESSES, ("router",),                  (0, 0),    (1, 1),        DEAD),
)  # fmt: skip
"""All classes; those of messages have a row in each place."""

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
    ("sensor_off", "compass"): AIDED_M,
    ("sensor_off", "pressure"): AIDED_M,
    ("sensor_off", "gnss"): AIDED_M,
    ("sensor_off", "tdcp"): AIDED_M,
    ("thruster_loss", "port"): ADRIFT_M,
    ("thruster_loss", "starboard"): ADRIFT_M,
    ("thruster_loss", "both"): ADRIFT_M,
    ("second_source", "estimate"): AIDED_M,
    ("estimate_dropout", "estimate"): DROPOUT_M,
    ("clock_step", "vehicle"): AIDED_M,
    ("reference_point", "ahead"): AIDED_M,
    ("reference_point", "starboard"): AIDED_M,
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
