"""Mission and fence of an autopilot as reference and fence files, by the rules for files of other programs."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple, cast

import msgspec

from ltv_mpc import config
from ltv_mpc.config import to_toml
from ltv_mpc.geofence.fence import Fence
from ltv_mpc.geofence.fence_files import MARGIN_M, zones_of
from ltv_mpc.messages import Action, Command, Pair
from ltv_mpc.references import Origin, Reference
from ltv_mpc.references.geodesy import local
from ltv_mpc.references.mission_items import Item, ItemRefused, Stop, reference_table, refusals, stops_of
from ltv_mpc.validation import rejection_reason
from services.edges.mavlink.download import ListRefused


class Mission(NamedTuple):
    """Mission as a reference, and its stops in the order in which the vehicle comes to them."""

    toml: str  # contents of a reference file
    stops: Sequence[Stop]
    places: Sequence[Pair]  # of the stops, north and east (m)
    along_m: Sequence[float]  # distance of each stop from the begin
    unreached: Sequence[int]  # items with a place behind the one at which it ends

    @property
    def texts(self) -> list[str]:
        """Place, speed and wait of each item, and which are not reached."""
        texts = []
        for number, place, speed_mps in self.stops:
            at = [f"{value:.7g}" for value in (place.latitude_deg, place.longitude_deg) if value is not None]
            at += [f"{value:.1f} m" for value in (place.north_m, place.east_m, place.depth_m) if value is not None]
            wait = f", waits {place.wait_s:g} s" if place.wait_s else ""
            texts += [f"{number}: {', '.join(at)} at {speed_mps:g} m/s{wait}"] if number else []
        behind = [f"not reached, behind item {self.stops[-1].number}: {', '.join(map(str, self.unreached))}"]
        return [*texts[:-1], f"{texts[-1]}, then holds", *(behind if self.unreached else [])] if texts else []


def mission_of(
    messages: Iterable[Any], origin: Origin, speed_mps: float, here: Pair, *, dives: bool, first: int = 1
) -> Mission | None:
    """Return the mission of a list from item ``first`` on; None if it has none. Item 0 is the home of ArduPilot.

    ``speed_mps`` holds until the mission sets another one; ``here`` is where the vehicle is, north and east (m). Raises
    ``ListRefused`` with number and name of an item that cannot be driven.
    """
    items = [_item(message) for message in messages]
    try:
        for refusal in refusals(items, dives=dives):
            raise refusal
        stops = stops_of(items, origin, speed_mps, here, dives=dives, first=first)
        if not stops:
            return None
        table = reference_table(stops, origin, here)
        reference = config.parse(table, cast(Any, Reference), source="mission")
    except ItemRefused as error:
        raise ListRefused(f"mission: {error}") from None
    except ValueError as error:
        raise ListRefused(str(error)) from None
    text = to_toml(reference)
    if (reason := rejection_reason(Command(command_id=0, action=Action.FOLLOW, reference_toml=text))) is not None:
        raise ListRefused(f"mission: {reason}")
    places = [local(stop.place, origin) for stop in stops]
    ways = [math.dist(a, b) for a, b in itertools.pairwise([here if len(stops) == 1 else places[0], *places])]
    unreached = {item.number for item in items[first:] if item.has_place} - {stop.number for stop in stops}
    return Mission(text, stops, places, list(itertools.accumulate(ways)), sorted(unreached))


def fence_of(messages: Iterable[Any], origin: Origin) -> str:
    """Return the fence file of a list; empty if it has no zone. Raises ``ListRefused`` with the number of an item."""
    try:
        zones = zones_of(map(_item, messages), "fence")
        if not zones:
            return ""
        table = {"margin_m": MARGIN_M, "origin": msgspec.to_builtins(origin), **zones}
        text = to_toml(config.parse(table, Fence, source="fence"))
    except ValueError as error:
        raise ListRefused(str(error)) from None
    if (reason := rejection_reason(Command(command_id=0, action=Action.FENCE, fence_toml=text))) is not None:
        raise ListRefused(f"fence: {reason}")
    return text


def _item(message: Any) -> Item:
    """Return the item of a MISSION_ITEM_INT."""
    parameters = message.param1, message.param2, message.param3, message.param4
    latitude, longitude = round(message.x * 1e-7, 7), round(message.y * 1e-7, 7)
    return Item(message.seq, message.command, message.frame, parameters, latitude, longitude, message.z)
