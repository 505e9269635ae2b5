"""Fields that a campaign may set, by dotted key, of the scenario, the vehicle and the reference.

controller.horizon_s            water.sd_mps            run.compute_delay_s
vehicle.surge.mass_kg           vehicle.thruster.port.max_N
reference.descent_rate_mps
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, TypeAlias

import msgspec

from ltv_mpc import config, settings_schema
from ltv_mpc.errors import ConfigError
from ltv_mpc.references import Reference
from ltv_mpc.vehicle.parameters import Vehicle
from services.run.run_config import RunConfig
from sim.scenario import Scenario

Value: TypeAlias = bool | int | float | str

VEHICLE, REFERENCE, CONTROLLER = "vehicle", "reference", "controller"


def value_of(run_config: RunConfig, key: str) -> Value | None:
    """Return the value of a run's settings at ``key``; None if its table is left out."""
    tables = {VEHICLE: run_config.vehicle, REFERENCE: run_config.reference, CONTROLLER: run_config.controller}
    plain = msgspec.to_builtins(run_config.scenario) | msgspec.to_builtins(tables)
    value: Value | None = settings_schema.flat(plain).get(key)
    return value


def of(owner: str, settings: Mapping[str, Value]) -> dict[str, Value]:
    """Select the settings of ``vehicle`` or ``reference``, by the key within its file."""
    return {key.removeprefix(f"{owner}."): value for key, value in settings.items() if key.startswith(f"{owner}.")}


def of_scenario(settings: Mapping[str, Value]) -> dict[str, Value]:
    """Select the settings of the scenario."""
    return {key: value for key, value in settings.items() if not key.startswith((f"{VEHICLE}.", f"{REFERENCE}."))}


def with_values(struct: Any, kind: Any, values: Mapping[str, Value], owner: str) -> Any:
    """Return ``struct``, of type ``kind``, with the values at dotted keys replaced. Raises ``ConfigError``."""
    table = msgspec.to_builtins(struct)
    for key, value in values.items():
        *outer, last = key.split(".")
        inner = table
        for name in outer:
            if inner.get(name) is None:
                raise ConfigError("campaign", f"{owner}.{key}", f"the scenario's {owner} has no such table")
            inner = inner[name]
        inner[last] = value
    return config.parse({k: v for k, v in table.items() if v is not None}, kind, source=f"campaign: {owner}")


def _optional_too(kind: Any, prefix: str) -> Iterator[tuple[str, settings_schema.Type]]:
    """Generate the scalar fields, also those of tables that may be left out."""
    for key, found in settings_schema.scalar_fields(kind).items():
        inner = getattr(found, "types", ())
        tables = [x for x in inner if isinstance(x, msgspec.inspect.StructType)]
        if tables:
            yield from _optional_too(tables[0].cls, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", found


KINDS: dict[str, settings_schema.Type] = {
    **{
        key: kind
        for key, kind in settings_schema.scalar_fields(Scenario).items()
        if key not in ("made_by", "title", "run.seed")
    },
    **dict(_optional_too(Vehicle, f"{VEHICLE}.")),
    **{key: kind for one in Reference.__args__ for key, kind in _optional_too(one, f"{REFERENCE}.")},
}
"""Types of the fields that a campaign may set, by key."""
