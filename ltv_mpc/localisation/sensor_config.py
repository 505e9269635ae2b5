"""The sensors file: which sensors a vehicle has, how often they measure and how well.

Simulation and estimator read the same file: the simulation draws biases with the standard deviations that the filter
starts from. The settings of a sensor are in its file in ``sensors/``, and terms that they share in
``sensors/settings.py``.
"""

from __future__ import annotations

from typing import Annotated, Any

from msgspec import Meta

from ltv_mpc import config
from ltv_mpc.errors import ConfigError
from ltv_mpc.localisation.sensors import SensorTables

_PACKAGE = "ltv_mpc.localisation.files"


class SensorConfig(SensorTables, frozen=True, kw_only=True):
    """All sensors of a vehicle."""

    name: str
    description: str
    latitude_rad: Annotated[float, Meta(ge=-1.5708, le=1.5708)]

    @classmethod
    def load(cls, name: str) -> SensorConfig:
        """Read a sensors file.

        A file may name a shipped file as its ``base``: its own keys then replace those of the base, table by table.

        Parameters
        ----------
        name : of a shipped file (``"paper"``, ``"realistic"``), or path of a TOML file.

        Raises
        ------
        ConfigError : if the file cannot be read, or does not fit.
        """
        path = config.find(name, what="sensors", package=_PACKAGE)
        table = config.read_toml(path, what="sensors")
        source = config.error_source(path, what="sensors", name=name)
        if "base" in table:
            table = _merged_with_base(table, source)
        return config.parse(table, cls, source=source)


def _merged_with_base(own: dict[str, Any], source: str) -> dict[str, Any]:
    """Return the keys of the base, replaced by those of the file."""
    base = own.pop("base")
    if not isinstance(base, str) or config.is_path(base):
        raise ConfigError(source, "base", "must be the name of a shipped sensors file", value=base)
    try:
        below = config.find(base, what="base", package=_PACKAGE)
    except ConfigError as error:
        raise ConfigError(source, "base", error.problem, value=base) from None
    merged = config.read_toml(below, what="sensors")
    for key, value in own.items():
        table = merged.get(key)
        merged[key] = {**table, **value} if isinstance(table, dict) and isinstance(value, dict) else value
    return merged
