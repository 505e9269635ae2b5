"""Settings of the controller, ``[controller]``: horizon, weights, limits, solver, delay, ages."""

from __future__ import annotations

import math
from typing import Annotated, Literal, TypeAlias

import msgspec
import numpy as np
from msgspec import Meta

from ltv_mpc import config
from ltv_mpc.control import shooting_grid
from ltv_mpc.messages import Array, SourceName, Times
from ltv_mpc.node import DEFAULT_SOURCE
from ltv_mpc.safety.health import Ages
from ltv_mpc.safety.mission_policy import MissionSettings

STAGE_NS = 300_000_000
"""Time between the first two knots (ns)."""


Effort: TypeAlias = Literal["low", "normal", "high"]
"""Thrust that a controller spends on a small error: three points of the curve in docs/notes/pareto.md."""


Bow: TypeAlias = Literal["first", "either"]
"""Which end goes first on a path: the bow, or the one that costs less."""


HEADING_PER_RAD2 = 0.1
"""Default weight of the heading: 1 rad costs as much as 0.32 m off, for the paper's vehicle. It needs no scaling,
because an angle has no unit of length or time.
"""


class WeightSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Weights of the cost, [controller.weights]. A weight that is not set follows from the vehicle: ``scaling.py``."""

    position_per_m2: Annotated[float, Meta(gt=0, le=1e6)] | None = None
    terminal_position_per_m2: Annotated[float, Meta(ge=0, le=1e6)] | None = None
    terminal_velocity_s2_per_m2: Annotated[float, Meta(ge=0, le=1e9)] | None = None
    thrust: Annotated[float, Meta(ge=0, le=1e6)] | None = None
    thrust_change: Annotated[float, Meta(ge=0, le=1e6)] | None = None
    heading_per_rad2: Annotated[float, Meta(ge=0, le=1e6)] | None = None  # at a point that has a heading


class Weights(WeightSettings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """All weights of the cost; the defaults are those of the paper's vehicle.

    The cost is half of a sum (``ocp/terms.py``). Each stage adds position |p - ref|^2 + thrust |U / F|^2 + change |dU /
    F|^2, with U the commands and F the largest thrusts. The end of the horizon adds terminal position |p - ref|^2 +
    terminal velocity |p' - ref'|^2, where p' is the velocity over ground. The paper's cost is the first term alone. The
    weights of thrust and of its change are a point of the curve of error against power (docs/notes/pareto.md).

    At a point that has a heading each stage also adds heading |psi - psi_ref|^2; 0 stands for ``HEADING_PER_RAD2``.
    """

    position_per_m2: Annotated[float, Meta(gt=0, le=1e6)] = 1.0
    terminal_position_per_m2: Annotated[float, Meta(ge=0, le=1e6)] = 40.0
    terminal_velocity_s2_per_m2: Annotated[float, Meta(ge=0, le=1e9)] = 600.0
    thrust: Annotated[float, Meta(ge=0, le=1e6)] = 3e-2
    thrust_change: Annotated[float, Meta(ge=0, le=1e6)] = 1.5e-2
    heading_per_rad2: Annotated[float, Meta(ge=0, le=1e6)] = 0.0

    def at_heading(self, wanted: bool) -> Weights:
        """Return the weights for a reference with or without a heading.

        Parameters
        ----------
        wanted : False: the heading is free, so its weight is 0.
        """
        heading = (self.heading_per_rad2 or HEADING_PER_RAD2) if wanted else 0.0
        return msgspec.structs.replace(self, heading_per_rad2=heading)


class Disturbance(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Estimation of the current's bias, of the lever arm and of the vehicle's model: ``disturbance.py``.

    ``sd_mps`` is the prior standard deviation of each component of the bias. If it is not set, it is 0.15 for estimates
    without a current profile, and the bias of a profile is small and slow until it is significant. 0: never estimate a
    bias; above 0: the same with and without a profile.
    """

    sd_mps: Annotated[float, Meta(ge=0, le=2)] | None = None
    walk_mps_per_rts: Annotated[float, Meta(ge=0, le=1)] = 0.003  # of the bias, with time
    walk_mps_per_rtm: Annotated[float, Meta(ge=0, le=1)] = 0.02  # of the bias, with depth: 4 cm/s over 8 m
    noise_mps: Annotated[float, Meta(gt=0, le=1)] | None = None  # of the velocity; None: 0.15 % of the top speed
    max_mps: Annotated[float, Meta(gt=0, le=20)] | None = None  # bound of each component of the bias; None: top speed
    model_sd: Annotated[float, Meta(ge=0, le=1)] = 0.2  # prior, relative, of masses and drag; 0: the file's for ever
    lever_arm_sd_m: Annotated[float, Meta(ge=0, le=10)] = 0.2  # prior of an undeclared lever arm; 0: there is none


class MotionLimits(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Limits of the motion, [controller.limits]; not set: no limit.

    Those of surge and yaw rate are soft (``ocp/limits.py``), that of the cross-track distance, too
    (``ocp/fence.py``). Those of depth bound the vertical thrust, but not in
    failsafe and not by hand (``depth_limits.py``). The limits of thrust and slew rate are in the vehicle file.
    """

    bow: Bow | None = None  # on a path; not set: "first" for a vehicle that is weaker astern
    min_surge_mps: Annotated[float, Meta(ge=-20, le=0)] | None = None  # through the water; 0: never astern
    max_surge_mps: Annotated[float, Meta(gt=0, le=20)] | None = None
    min_yaw_rate_radps: Annotated[float, Meta(ge=-20, lt=0)] | None = None  # to port
    max_yaw_rate_radps: Annotated[float, Meta(gt=0, le=20)] | None = None  # to starboard
    max_cross_track_m: Annotated[float, Meta(gt=0, le=10_000)] | None = None  # from a path, to either side
    min_depth_m: Annotated[float, Meta(ge=0, le=11_000)] | None = None
    max_depth_m: Annotated[float, Meta(gt=0, le=11_000)] | None = None
    min_altitude_m: Annotated[float, Meta(gt=0, le=11_000)] | None = None  # above the bottom, seen or sounded

    def __post_init__(self) -> None:
        """Reject depth limits without a depth between them."""
        if self.min_depth_m is not None and self.max_depth_m is not None and self.min_depth_m >= self.max_depth_m:
            raise ValueError(f"min_depth_m = {self.min_depth_m:g}: must be < max_depth_m = {self.max_depth_m:g}")

    @classmethod
    def symmetric(cls, *, surge_mps: float | None = None, yaw_rate_radps: float | None = None) -> MotionLimits:
        """Return limits of the same size in both directions.

        Parameters
        ----------
        surge_mps : largest surge speed through the water, ahead and astern (m/s); None: no limit.
        yaw_rate_radps : largest yaw rate to either side (rad/s); None: no limit.
        """
        return cls(
            min_surge_mps=None if surge_mps is None else -surge_mps,
            max_surge_mps=surge_mps,
            min_yaw_rate_radps=None if yaw_rate_radps is None else -yaw_rate_radps,
            max_yaw_rate_radps=yaw_rate_radps,
        )

    def on(self, *, path: bool) -> MotionLimits:
        """Return the limits on a path, where the bow may have to go first, or at a point.

        Parameters
        ----------
        path : True on a path.
        """
        if path and self.bow == "first" and (self.min_surge_mps is None or self.min_surge_mps < 0.0):
            return msgspec.structs.replace(self, min_surge_mps=0.0)
        return self

    @property
    def path_speed_mps(self) -> float:
        """Largest speed through the water on a path, ahead or astern (m/s); infinite without a limit."""
        limits = self.on(path=True)
        ahead, astern = limits.state_bounds[1, 0], -limits.state_bounds[0, 0]
        return float(max(ahead, astern))

    @property
    def state_bounds(self) -> Array:
        """Lower and upper limits (2, 2) of the states ``problem_data.LIMITED_STATES``; infinite where none is set."""
        low = [-math.inf if limit is None else limit for limit in (self.min_surge_mps, self.min_yaw_rate_radps)]
        high = [math.inf if limit is None else limit for limit in (self.max_surge_mps, self.max_yaw_rate_radps)]
        return np.array([low, high])


class ControllerConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of the controller."""

    horizon_s: Annotated[float, Meta(ge=0.3, le=120)] | None = None  # None: what `ltv-mpc vehicle check` proposes
    effort: Effort = "normal"  # which default weights of thrust: scaling.py
    max_stages: Annotated[int, Meta(ge=2, le=400)] = 34  # a longer horizon has growing stages: shooting_grid.py
    period_s: Annotated[float, Meta(ge=0.02, le=60)] = 0.3
    weights: WeightSettings = WeightSettings()  # a weight that is not set follows from the vehicle
    disturbance: Disturbance = Disturbance()
    limits: MotionLimits = MotionLimits()  # soft limits of the motion
    position_tolerance_m: Annotated[float, Meta(ge=0, le=1000)] = 0.0  # at a point: distance that costs nothing
    lateral: bool = True  # false: no lateral control, both lateral thrusters stay at zero
    sqp_iterations: Annotated[int, Meta(ge=1, le=6)] = (
        2  # QPs per cycle, each linearised along the solution of the one before
    )
    max_iterations: Annotated[int, Meta(ge=1, le=100_000)] = 400
    tolerance: Annotated[float, Meta(gt=0, le=1e-1)] = 5e-6
    solver: str = "osqp"
    sources: Annotated[tuple[SourceName, ...], Meta(max_length=16)] = (
        DEFAULT_SOURCE,
    )  # names of the sources of estimates, the preferred one first; "default": the plain key
    delay_quantile: Annotated[float, Meta(ge=0.5, le=1)] = 0.98  # of the measured delays: delay.py
    first_delay_s: Annotated[float, Meta(ge=0, le=10)] = 0.05  # expected delay before any measurement
    min_delay_s: Annotated[float, Meta(ge=0, le=10)] = 0.0  # smallest expected delay: margin on a busy machine
    ages: Ages = Ages()  # of the newest estimate, at which health degrades
    mission: MissionSettings = MissionSettings()  # ends of a mission, and bounds of the pre-arm checks

    @classmethod
    def load(cls, path: str) -> ControllerConfig:
        """Read a TOML file that holds the [controller] table alone. Raises ``ConfigError``.

        Parameters
        ----------
        path : of the file, with a suffix or a slash.
        """
        return config.load(path, cls, what="controller settings", package=None)

    @property
    def period_ns(self) -> int:
        """Smallest time between the starts of two cycles (ns)."""
        return round(self.period_s * 1e9)


class ResolvedConfig(ControllerConfig, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings for one vehicle, with the horizon and every weight set: ``resolution.settled`` makes them."""

    horizon_s: Annotated[float, Meta(ge=0.3, le=120)]
    weights: Weights

    @property
    def stages(self) -> int:
        """Number of stages N: the horizon in whole stages of 0.3 s, at most ``max_stages``."""
        return min(self._reach, self.max_stages)

    @property
    def knots(self) -> Array:
        """Knots (N+1,) of the horizon, in units of the first stage (0.3 s)."""
        return shooting_grid.knots(self.stages, float(self._reach))

    @property
    def knots_ns(self) -> Times:
        """The same in ns."""
        return np.round(self.knots * STAGE_NS).astype(np.int64)

    @property
    def reach_s(self) -> float:
        """Length of the horizon in whole stages of 0.3 s (s)."""
        return self._reach * STAGE_NS / 1e9

    @property
    def _reach(self) -> int:
        return max(1, round(self.horizon_s * 1e9 / STAGE_NS))
