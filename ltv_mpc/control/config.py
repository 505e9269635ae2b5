"""[controller]: horizon, weights and limits in one validated table; one default set of weights for all figures."""

from __future__ import annotations

import math
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from ltv_mpc import config
from ltv_mpc.control import shooting_grid
from ltv_mpc.errors import ConfigError
from ltv_mpc.messages import Array
from ltv_mpc.safety.health import Ages

STAGE_NS = 300_000_000
"""Time between the first two knots."""


class WeightSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """[controller.weights]: those that a file names. The others follow from the vehicle: ``scaling.py``."""

    position_per_m2: Annotated[float, Meta(gt=0, le=1e6)] | None = None
    terminal_position_per_m2: Annotated[float, Meta(ge=0, le=1e6)] | None = None
    terminal_velocity_s2_per_m2: Annotated[float, Meta(ge=0, le=1e9)] | None = None
    thrust: Annotated[float, Meta(ge=0, le=1e6)] | None = None
    thrust_change: Annotated[float, Meta(ge=0, le=1e6)] | None = None


class Weights(WeightSettings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The cost, all of it: see ``qp/sparse.py``. The defaults are those of the paper's vehicle, found on seeds from 100
    up, but for the last halving of the thrust weights, which looked at seeds 0 to 3 of the 20 that are reported.

    A sum over stages of position |p - ref|^2 + thrust |F / max|^2 + change |dF / max|^2, and at the end of the horizon
    terminal position |p - ref|^2 + terminal velocity |p'|^2, p' over ground. The paper's cost is the first term alone.
    """

    position_per_m2: Annotated[float, Meta(gt=0, le=1e6)] = 1.0
    terminal_position_per_m2: Annotated[float, Meta(ge=0, le=1e6)] = 40.0
    terminal_velocity_s2_per_m2: Annotated[float, Meta(ge=0, le=1e9)] = 600.0
    thrust: Annotated[float, Meta(ge=0, le=1e6)] = 3e-3
    thrust_change: Annotated[float, Meta(ge=0, le=1e6)] = 1.5e-3


class Disturbance(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What the current does that its profile does not say: ``disturbance.py``.

    ``sd_mps`` is the standard deviation of each component before anything was seen. Left out, it is 0.1 for estimates
    without a current profile, and nothing is estimated for those that have one; 0: never; else: always.
    """

    sd_mps: Annotated[float, Meta(ge=0, le=2)] | None = None
    walk_mps_per_rts: Annotated[float, Meta(ge=0, le=1)] = 0.01  # 4 cm/s over 8 m at 0.2 m/s: 9 mm/s per sqrt(s)
    noise_mps: Annotated[float, Meta(gt=0, le=1)] = 1e-3  # of the velocity over ground from estimate to estimate
    max_mps: Annotated[float, Meta(gt=0, le=5)] = 0.5  # the bias stays within, each way


class MotionLimits(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """[controller.limits]: what the motion is asked to stay within, either way; left out: anything.
    ``horizon_limits.py``.
    """

    surge_mps: Annotated[float, Meta(gt=0, le=20)] | None = None  # ahead, through the water
    yaw_rate_radps: Annotated[float, Meta(gt=0, le=20)] | None = None

    @property
    def max_abs(self) -> Array:
        """(2,) of ``limits.LIMITED``; infinite where nothing is asked."""
        asked = self.surge_mps, self.yaw_rate_radps
        return np.array([math.inf if most is None else most for most in asked])


class ControllerConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of the controller."""

    horizon_s: Annotated[float, Meta(ge=0.3, le=120)] = 5.0
    max_stages: Annotated[int, Meta(ge=2, le=400)] = (
        34  # a longer horizon is reached by stages that grow: shooting_grid.py
    )
    period_s: Annotated[float, Meta(ge=0.02, le=60)] = 0.3
    weights: WeightSettings = WeightSettings()  # what is left out follows from the vehicle
    disturbance: Disturbance = Disturbance()
    limits: MotionLimits = MotionLimits()  # of the motion, as far as it can be kept within them
    lateral: bool = True  # false: the lateral thrusters stay at zero: what happens without control
    sqp_iterations: Annotated[int, Meta(ge=1, le=6)] = 2  # QPs a cycle, each along what the one before came to
    max_iterations: Annotated[int, Meta(ge=1, le=100_000)] = 400
    tolerance: Annotated[float, Meta(gt=0, le=1e-1)] = 5e-6
    solver: str = "osqp"
    delay_quantile: Annotated[float, Meta(ge=0.5, le=1)] = 0.98
    first_delay_s: Annotated[float, Meta(ge=0, le=10)] = 0.05  # expected before anything was measured
    min_delay_s: Annotated[float, Meta(ge=0, le=10)] = 0.0  # expected whatever was measured: room on a busy machine
    ages: Ages = Ages()  # of the newest estimate, beyond which less and less is done on it

    @classmethod
    def load(cls, path: str) -> ControllerConfig:
        """A TOML file that holds the [controller] table alone. Raises ``ConfigError``."""
        settings = config.load(path, cls, what="controller settings", package="ltv_mpc.control.files")
        return validate(settings, source=f"controller settings {path}")

    @property
    def stages(self) -> int:
        """Number of stages N: ``horizon_s`` in whole stages of 0.3 s, at most ``max_stages``."""
        return min(self._reach, self.max_stages)

    @property
    def knots(self) -> Array:
        """Their knots (N+1,) in first stages of 0.3 s."""
        return shooting_grid.knots(self.stages, float(self._reach))

    @property
    def reach_s(self) -> float:
        """What the horizon comes to in whole stages."""
        return self._reach * STAGE_NS / 1e9

    @property
    def _reach(self) -> int:
        return max(1, round(self.horizon_s * 1e9 / STAGE_NS))

    @property
    def period_ns(self) -> int:
        """Time between the starts of two cycles, at least."""
        return round(self.period_s * 1e9)


class ResolvedConfig(ControllerConfig, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings for one vehicle, with every weight in its place: made by ``scaling.resolve_weights`` alone."""

    weights: Weights = Weights()


def validate(settings: ControllerConfig, *, source: str, table: tuple[str, ...] = ()) -> ControllerConfig:
    """The settings, after what no single field can tell; ``table`` is where they stand. Raises ``ConfigError``."""
    if settings.period_s > settings.horizon_s:
        problem = f"must be <= horizon_s = {settings.horizon_s:g}: a plan lasts until the next one"
        raise ConfigError(source, config.toml_key((*table, "period_s")), problem, value=settings.period_s)
    contradiction = settings.ages.problem()
    if contradiction is not None:
        name, problem = contradiction
        place = config.toml_key((*table, "ages", name))
        raise ConfigError(source, place, problem, value=getattr(settings.ages, name))
    return settings
