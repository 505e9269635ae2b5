"""Resolution of the controller's settings for one vehicle: what they leave out follows from the vehicle.

The only place that decides a default horizon or a default weight. The weights come first (``scaling.py``), with the
slowness with which the vehicle keeps its margins at normal effort; the horizon is then the shortest one that suits the
vehicle and is stable with these weights (``horizon_selection.py``).
"""

from __future__ import annotations

import msgspec

from ltv_mpc.config import parse, toml_key
from ltv_mpc.control.config import Bow, ControllerConfig, ResolvedConfig
from ltv_mpc.control.horizon_selection import proposed_horizon_s, proposed_slowness
from ltv_mpc.control.scaling import bounded, default_weights
from ltv_mpc.errors import ConfigError
from ltv_mpc.vehicle.parameters import Vehicle


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
