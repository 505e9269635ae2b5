"""Vehicles with other values than those of their files."""

from __future__ import annotations

from typing import Any

import msgspec


def changed(of: Any, values: dict[str, Any]) -> Any:
    """Return a vehicle, or a part of one, with other values, by their keys in a vehicle file: ``surge.mass_kg``."""
    for key, value in values.items():
        name, _, rest = key.partition(".")
        of = msgspec.structs.replace(of, **{name: changed(getattr(of, name), {rest: value}) if rest else value})
    return of
