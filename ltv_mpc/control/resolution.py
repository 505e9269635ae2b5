"""Resolution of the controller's settings for one vehicle: what they leave out follows from the vehicle.

The only place that decides a default horizon or a default weight. The weights come first (``scaling.py``), with the
slowness with which the vehicle keeps its margins at normal effort; the horizon is then the shortest one that suits the
vehicle and is stable with these weights. `ltv-mpc vehicle check` proposes them.
"""

from __future__ import annotations

import math
from functools import lru_cache

import msgspec

from ltv_mpc.config import parse, toml_key
from ltv_mpc.control.config import STAGE_NS, Bow, ControllerConfig, ResolvedConfig, Weights
from ltv_mpc.control.margins import FULL_SHARE, SHARES, Loop
from ltv_mpc.control.scaling import bounded, characteristic_scales, default_weights
from ltv_mpc.errors import ConfigError
from ltv_mpc.vehicle.parameters import Vehicle
from ltv_mpc.vehicle.performance import performance

MIN_HORIZON_S, MAX_HORIZON_S = 3.0, 60.0
"""Bounds of the proposed horizon."""

MIN_TIME_SCALES = 1.9
"""Shortest horizon over the time scale T. At half of the points of the map in docs/horizon.md the error with this
horizon is within 1 % of that with the best one, at nine of ten points within 12 %. Longer ones gain at most 4 points.
"""

STABLE_SHARES = (0.1, 0.2, 0.35, 0.5)
"""Currents over the top speed in which the loop of a proposed horizon is stable."""

SLOWNESSES = tuple(1.2**i for i in range(6))
"""Slownesses that are tried (``scaling.default_weights``), up to 2.5. A slower loop bears more gain, dead time and lag,
but a wrong mass or drag moves the vehicle farther. With a longer horizon it does not catch a hull that is unstable in a
strong current: docs/robustness.md.
"""

ORDINARY_SHARE = 0.2
"""Current over the top speed up to which a vehicle is slowed that cannot keep its margins up to ``FULL_SHARE``."""

LENGTHENING = 1.05
"""Factor by which a horizon is lengthened until its closed loop is stable."""

WEAK_ASTERN_RATIO = 0.7
"""Top speed astern over top speed ahead below which a vehicle counts as weak astern."""


@lru_cache(maxsize=64)
def proposed_slowness(vehicle: Vehicle) -> float:
    """Return the least slowness that keeps the margins up to ``FULL_SHARE``, or ``ORDINARY_SHARE``, or as far as any.

    Parameters
    ----------
    vehicle : its own weights are examined, with the horizon that is proposed for them.
    """
    kept = {}
    for slowness in SLOWNESSES:
        weights = default_weights(vehicle, slowness=slowness)
        horizon_s = proposed_horizon_s(vehicle, weights)
        kept[slowness] = kept_share(vehicle, ResolvedConfig(weights=weights, horizon_s=horizon_s), FULL_SHARE)
        if kept[slowness] >= FULL_SHARE:
            return slowness
    enough = min(ORDINARY_SHARE, max(kept.values()))
    return next(slowness for slowness, share in kept.items() if share >= enough)


def kept_share(vehicle: Vehicle, config: ResolvedConfig, end: float = math.inf) -> float:
    """Return the strongest current, over the top speed, up to which the loop keeps its margins.

    Parameters
    ----------
    vehicle : vehicle to be controlled.
    config : settings of the controller.
    end : no stronger current is examined.

    Returns
    -------
    One of ``margins.SHARES``; minus infinity if the margins are not kept in still water.
    """
    kept = -math.inf
    for share in SHARES:
        loop = Loop(vehicle, config, share)
        if share > end or not loop.keeps(loop.goal):
            break
        kept = share
    return kept


@lru_cache(maxsize=64)
def proposed_horizon_s(vehicle: Vehicle, weights: Weights) -> float:
    """Return the horizon for a vehicle: 1.9 T, at least the time to turn and to stop, and long enough to be stable.

    A plan that covers both the turn and the stop can reach a point and stay there. The turn is by 90 deg; it is by 180
    deg if the vehicle is much slower astern than ahead, so that a plan covers the turn away from stern-to. A vehicle
    with little sway damping needs a longer horizon than that, or it oscillates about its station (margins.py).

    Parameters
    ----------
    vehicle : gives the time scale T and the closed loop.
    weights : weights of the cost in use; the closed loop depends on them.

    Returns
    -------
    Horizon (s), a whole number of stages.
    """
    can, both = performance(vehicle), 0.0
    if can.turn_90deg_s is not None:
        both = can.turn_90deg_s + (can.stopping_time_s or 0.0)
        ahead, astern = can.top_speed_ahead_mps, can.top_speed_astern_mps
        if ahead is not None and astern is not None and astern < WEAK_ASTERN_RATIO * ahead:
            rates = can.turning_rate_starboard_radps, can.turning_rate_port_radps
            both += 0.5 * math.pi / min(abs(rate) for rate in rates if rate)
    horizon_s = _whole(max(MIN_TIME_SCALES * characteristic_scales(vehicle).time_s, both))
    while horizon_s < MAX_HORIZON_S:
        config = ResolvedConfig(weights=weights, horizon_s=horizon_s)
        if all(Loop(vehicle, config, share).keeps() for share in STABLE_SHARES):
            break
        horizon_s = _whole(LENGTHENING * horizon_s)
    return horizon_s


def _whole(horizon_s: float) -> float:
    """Round a horizon up to whole stages, within its bounds."""
    stage = STAGE_NS * 1e-9
    return round(math.ceil(min(max(horizon_s, MIN_HORIZON_S), MAX_HORIZON_S) / stage - 1e-9) * stage, 1)


def settled(
    config: ControllerConfig, vehicle: Vehicle, *, source: str = "controller settings", table: tuple[str, ...] = ()
) -> ResolvedConfig:
    """Return the settings with the horizon and every weight set.

    Parameters
    ----------
    config : settings; those that are resolved already stay the same.
    vehicle : gives the weights and the horizon that the settings leave out.
    source : file or option that an error names.
    table : names of the tables that hold the settings in that file.

    Returns
    -------
    The same settings, with a horizon, all weights, and which end goes first on a path.

    Raises
    ------
    ConfigError : a value is out of its bounds, or the period is longer than the horizon.
    """
    if isinstance(config, ResolvedConfig):
        return config
    parse(msgspec.to_builtins(config), ControllerConfig, source=source)  # settings made in Python are not checked yet
    given = {name: value for name, value in msgspec.structs.asdict(config.weights).items() if value is not None}
    own = default_weights(vehicle, config.effort, proposed_slowness(vehicle))
    weights = bounded(msgspec.structs.replace(own, **given), vehicle)
    horizon_s = proposed_horizon_s(vehicle, weights) if config.horizon_s is None else config.horizon_s
    if config.period_s > horizon_s:
        proposed = ", which `ltv-mpc vehicle check` proposes" if config.horizon_s is None else ""
        problem = f"must be <= horizon_s = {horizon_s:g}{proposed}: a plan lasts until the next one"
        raise ConfigError(source, toml_key((*table, "period_s")), problem, value=config.period_s)
    limits = config.limits
    if limits.bow is None:
        limits = msgspec.structs.replace(limits, bow=default_bow(vehicle))
    resolved = ("weights", "horizon_s", "limits")
    rest = {name: getattr(config, name) for name in config.__struct_fields__ if name not in resolved}
    return ResolvedConfig(**rest, weights=weights, horizon_s=horizon_s, limits=limits)


def default_bow(vehicle: Vehicle) -> Bow:
    """Return which end goes first on a path if the settings do not say it.

    Parameters
    ----------
    vehicle : a vehicle whose two lateral thrusters push less astern than ahead goes bow first.
    """
    ahead_N, astern_N = vehicle.pushes_N
    return "first" if astern_N < ahead_N else "either"
