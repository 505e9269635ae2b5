"""summary.json: what one run came to. A figure that has no data is null.

Positions are horizontal. Delays are in vehicle seconds (wall time times speed); beside them, in names that end in
``_wall_s``, in wall seconds, null in lock step, where no time is measured.
"""

from __future__ import annotations

import msgspec


class Spread(msgspec.Struct, frozen=True, kw_only=True):
    """Of an error over time (m)."""

    mean: float | None
    max: float | None
    final: float | None


class Quantiles(msgspec.Struct, frozen=True, kw_only=True):
    """Of something that happens once a cycle."""

    median: float | None
    p99: float | None
    max: float | None


class Thrust(msgspec.Struct, frozen=True, kw_only=True):
    """The commands to the two lateral thrusters."""

    saturated_fraction: float | None  # of the time, either of them at its minimum or maximum
    max_abs_N: float | None
    mean_abs_N: float | None  # over time and both
    travel_N: float | None  # sum of |dF| over both: what wears them
    max_slew_N_per_s: float | None  # largest |dF/dt|


class Messages(msgspec.Struct, frozen=True, kw_only=True):
    """On all keys of the run."""

    published: int
    dropped: int  # published, but not in the recording: gaps of the sequences
    rejected: int  # turned away at a node's door


class Summary(msgspec.Struct, frozen=True, kw_only=True):
    """One run. Errors are drift since t = 0, but for the absolute one."""

    scenario: str
    mode: str  # "services" or "lockstep"
    seed: int
    speed: float | None  # times real time that was asked for; null in lock step
    speed_reached: float | None  # what the machine did of it, pauses included
    duration_s: float  # how far it came after t = 0
    cycles: int  # of the controller
    tracking_error_m: Spread  # estimate to reference: the controller's part
    true_error_m: Spread  # truth to reference
    localisation_error_m: Spread  # estimate to truth: the estimator's part
    localisation_error_absolute_m: Spread  # with the error at t = 0 in it
    thrust: Thrust
    compute_delay_s: Quantiles  # from the start of a cycle to its plan's publication
    compute_delay_wall_s: Quantiles
    end_to_end_delay_s: Quantiles  # from an estimate's validity time to the instant the plan made of it takes effect
    end_to_end_delay_wall_s: Quantiles
    stages_us: dict[str, Quantiles]  # wall time of each stage of a cycle, where it was measured
    deadline_misses: int  # plans that reached the plant after their start time
    plans_refused: int  # by the actuators: outside box or slew, or out of order
    qp_status: dict[str, int]
    plan_origin: dict[str, int]
    restarts: int
    messages: Messages
    stages: int  # N of the horizon
    horizon_s: float  # what they reach
