"""Settings of the processes aboard, as they published them beside the recorder."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Mapping
from itertools import chain
from typing import Any, TypeAlias

from ltv_mpc.config import loads, parse
from ltv_mpc.messages import NodeSettings
from ltv_mpc.vehicle.parameters import Vehicle
from services.bus.topics import BY_TYPE
from services.bus.wire import WireError
from services.recording.reader import Recording

PREFIX = f"{BY_TYPE[NodeSettings].key}/"
SCENARIO, VEHICLE, REFERENCE = "scenario.toml", "config/vehicle.toml", "config/reference.toml"

HOLD = "hold"
"""Kind of a reference that begins where the vehicle is."""


class NoSettingsError(LookupError):
    """The recording does not hold the settings of this start of a node."""


SettingsByStart: TypeAlias = dict[str, dict[int, NodeSettings]]
"""Settings by node and epoch, those of the newest start last."""


def published_settings(recordings: Iterable[Recording]) -> tuple[SettingsByStart, tuple[int, int]]:
    """Return the settings in the recordings of a run, and the vehicle times (ns) of its first and last message.

    Invalid messages are skipped.
    """
    settings: SettingsByStart = {}
    times: list[int] = []
    for stored in chain.from_iterable(recording.stored() for recording in recordings):
        times[:] = min((stored.t_ns, *times)), max((stored.t_ns, *times))
        if stored.kind is NodeSettings:
            with contextlib.suppress(WireError):
                message, header = stored.typed()
                assert isinstance(message, NodeSettings)
                settings.setdefault(stored.key.removeprefix(PREFIX), {})[header.epoch] = message
    return settings, (times[0], times[1]) if times else (0, 0)


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
