"""Settings files of a run, as its recording or the messages of its processes hold them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ltv_mpc.config import loads, parse
from ltv_mpc.vehicle.parameters import Vehicle

SCENARIO, VEHICLE, REFERENCE = "scenario.toml", "config/vehicle.toml", "config/reference.toml"

HOLD = "hold"
"""Kind of a reference that begins where the vehicle is."""


def table_of(files: Mapping[str, str], name: str) -> dict[str, Any]:
    """Return a settings file as a table; an empty one if there is none, or it is not TOML."""
    try:
        return loads(files.get(name, ""))
    except (ValueError, RecursionError):
        return {}


def vehicle_name(files: Mapping[str, str]) -> str:
    """Return the name in a vehicle file; "unknown" if there is none."""
    name = table_of(files, VEHICLE).get("name")
    return name if isinstance(name, str) and name.isprintable() else "unknown"


def is_in_places(files: Mapping[str, str]) -> bool:
    """Return True if these settings files have a reference that is given in places."""
    return bool(table_of(files, REFERENCE).get("kind", HOLD) != HOLD)


def vehicle_of(files: Mapping[str, str]) -> Vehicle | None:
    """Return the vehicle of these settings files; None if there is none, or one that another version wrote."""
    try:
        return parse(loads(files[VEHICLE]), Vehicle, source=VEHICLE) if VEHICLE in files else None
    except (ValueError, RecursionError):
        return None
