"""Vehicles with other values than those of their files."""

from __future__ import annotations

from typing import Any

import msgspec

from ltv_mpc.vehicle.parameters import Coefficients


def changed(of: Any, values: dict[str, Any]) -> Any:
    """Return a vehicle, or a part of one, with other values, by their keys in a vehicle file: ``surge.mass_kg``."""
    for key, value in values.items():
        name, _, rest = key.partition(".")
        of = msgspec.structs.replace(of, **{name: changed(getattr(of, name), {rest: value}) if rest else value})
    return of


def off_by(p: Coefficients, *, mass: float = 1.0, drag: float = 1.0) -> Coefficients:
    """Return coefficients with factors on all masses and on all damping."""
    factors = dict.fromkeys(("linear", "quadratic"), drag) | dict.fromkeys(("mass", "inertia", "dry"), mass)
    return p._replace(
        **{name: factors[kind] * getattr(p, name) for name in p._fields if (kind := name.partition("_")[0]) in factors}
    )
