"""Schema of summary.json, the result of one run. A figure without data is null.

Positions are horizontal. Delays are in vehicle seconds (wall time times speed). Names that end in ``_wall_s`` are in
wall seconds; they are null in lock step, where no time is measured.
"""

from __future__ import annotations

import msgspec

from sim.evaluation.further import Further


class Spread(msgspec.Struct, frozen=True, kw_only=True):
    """Statistics of an error over time (m)."""

    mean: float | None
    max: float | None
    final: float | None


class Quantiles(msgspec.Struct, frozen=True, kw_only=True):
    """Quantiles of a quantity that is measured once a cycle."""

    median: float | None
    p99: float | None
    max: float | None


class Thrust(msgspec.Struct, frozen=True, kw_only=True):
    """Statistics of the commands to the thrusters, of the lateral ones where none is named, and the energy of all.

    The vehicle file's ``slew_N_per_s`` limits the commands; the simulated propellers deliver with a slew of their own.
    """

    saturated_fraction: float | None = None  # share of the time with either at its minimum or maximum
    max_abs_N: float | None = None  # largest of both thrusters
    mean_abs_N: float | None = None  # mean over time and both thrusters
    travel_N: float | None = None  # sum of |dF| over both thrusters, a measure of wear
    max_slew_N_per_s: float | None = None  # largest |dF/dt|
    max_delivered_slew_N_per_s: float | None = None  # the same of the delivered thrust, from one truth to the next
    propulsive_energy_J: float | None = None  # at the shafts of all propellers; null without torque coefficients
    lateral_energy_J: float | None = None  # its part of the two lateral thrusters
    relative_power: float | None = None  # mean of the lateral |F|^1.5 over that at full thrust, 0 to 1
    vertical_saturated_fraction: float | None = None  # as saturated_fraction; null without a vertical thruster


class ZoneFigures(msgspec.Struct, frozen=True, kw_only=True):
    """Distance of the true hull from one zone of the fence, from t = 0 on."""

    zone: str  # table and number in the fence file, and its name
    least_clearance_m: float  # negative: the hull was in the zone
    in_margin_s: float
    inside_s: float


class Messages(msgspec.Struct, frozen=True, kw_only=True):
    """Message counts over all keys of the run."""

    published: int
    dropped: int  # published, but missing in the recording: gaps in the sequence numbers
    rejected: int  # rejected by the validation of a process
    denied: int = 0  # attempts that the router denied: no role allows them, or the certificate is not valid


class Summary(msgspec.Struct, frozen=True, kw_only=True):
    """Summary of one run. Drift since t = 0 does not contain the error of the fix at t = 0."""

    scenario: str  # its name
    mode: str  # "services" or "lockstep"
    completed: bool  # the run came to its end, and all its processes with it
    why: str  # why it did not; empty if it did
    seed: int  # of all random draws
    speed: float | None  # requested speed relative to real time; null in lock step
    speed_reached: float | None  # speed reached, pauses included
    duration_s: float  # vehicle time reached after t = 0
    cycles: int  # number of controller cycles
    tracking_error_m: Spread  # estimate to reference: the controller's part
    true_error_m: Spread  # truth to reference: absolute for a reference in places, otherwise drift since t = 0
    true_error_drift_m: Spread  # the same as drift since t = 0
    in_places: bool  # the reference is given in places; false: it begins where the vehicle is
    localisation_error_m: Spread  # estimate to truth, drift since t = 0: the estimator's part
    localisation_error_absolute_m: Spread  # including the error at t = 0
    further: Further
    thrust: Thrust
    fence: tuple[ZoneFigures, ...]  # zones of all fences that were in force
    arrived_s: float | None  # vehicle time of the first arrival at the end of a reference; null: none
    fence_exceeded: int  # number of plans that lack more than 1 cm of a required clearance at one knot or more
    compute_delay_s: Quantiles  # from the start of a cycle to its plan's publication
    compute_delay_wall_s: Quantiles  # the same in wall time; null in lock step
    end_to_end_delay_s: Quantiles  # from an estimate's validity time to the effect of its plan
    end_to_end_delay_wall_s: Quantiles  # the same in wall time; null in lock step
    deadline_misses: int  # plans that reached the plant after their start time
    plans_refused: int  # rejected by the actuators: thrust limit, slew limit or out of order
    qp_status: dict[str, int]  # number of plans by the status of their QP
    plan_origin: dict[str, int]  # number of plans by where their lateral thrusts come from
    health: dict[str, int]  # number of plans by the controller's health and its reason
    restarts: int  # of processes
    messages: Messages
    stages: int  # N of the horizon
    horizon_s: float  # length of the horizon
    proposed_horizon_s: float  # what `vehicle check` proposes for the vehicle
    effort: str  # low, normal or high: the weights of thrust
    perfect_state: bool = False  # the controller was given the true state
