"""Reference types, and the reader of reference files, whose ``kind`` names the type."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, ClassVar, TypeAlias

import numpy as np
from msgspec import Meta

from ltv_mpc import config
from ltv_mpc.messages import Estimate, Pair, ReferenceStart
from ltv_mpc.references import mission_files
from ltv_mpc.references.base import BaseReference
from ltv_mpc.references.feasibility import descent_notes
from ltv_mpc.references.geodesy import DEGREES, METRES, Latitude, Longitude, Metres, Place, local
from ltv_mpc.references.schedule import Schedule
from ltv_mpc.references.shapes import Circle, Lawnmower, Line, Spiral, Waypoints
from ltv_mpc.references.timed import Timed, from_csv
from ltv_mpc.vehicle.parameters import Vehicle

PACKAGE = "ltv_mpc.references.files"

MAX_HOLD_DEPTH_M = 11_000.0
"""Upper bound of a reference's ``depth_m``."""


MIN_CURRENT_MPS = 0.02
"""Smallest current that has a direction: below it, a vehicle that heads into the current keeps its heading."""


class Station(BaseReference, frozen=True, kw_only=True):
    """Vertical line at which the vehicle stays, with a heading: free, fixed, or into the current at its depth.

    The heading is a part of the cost and gives way to the position. A vehicle without side thrust can only stay where
    it is if it heads into the current, or away from it.
    """

    heading_deg: Annotated[float, Meta(ge=-360, le=360)] | None = None  # true, clockwise from north; None: free
    into_current: bool = False

    def __post_init__(self) -> None:
        """Reject two headings."""
        if self.into_current and self.heading_deg is not None:
            raise ValueError("heading_deg and into_current: give one of them")

    def heading_in(self, current: Pair, before_rad: float | None) -> float | None:
        """Return the wanted heading (rad); None if it is free.

        Parameters
        ----------
        current : velocity of the water, north and east (m/s).
        before_rad : heading that was wanted before; None: none.
        """
        if self.heading_deg is not None:
            return math.radians(self.heading_deg)
        north, east = current
        if not self.into_current or not math.hypot(north, east) >= MIN_CURRENT_MPS:
            return before_rad
        return math.atan2(-east, -north)

    def position(self, anchor: ReferenceStart) -> Pair:
        """Return north and east (m).

        Parameters
        ----------
        anchor : start of the reference.
        """
        raise NotImplementedError

    def schedule(self, vehicle: Vehicle, anchor: ReferenceStart) -> Schedule:
        """Return the schedule of a target at rest, which has no length.

        Parameters
        ----------
        vehicle : parameters of the vehicle.
        anchor : start of the reference.
        """
        del vehicle
        north, east = self.position(anchor)
        column = (0.0, 0.0, north, east, math.nan if self.depth_m is None else self.depth_m)
        distance_m = math.hypot(north - anchor.north_m, east - anchor.east_m)
        return Schedule(np.array((column, column)).T.copy(), distance_m)

    def notes(self, vehicle: Vehicle) -> list[str]:
        """Return sentences about what the vehicle cannot do of this reference.

        Parameters
        ----------
        vehicle : parameters of the vehicle.
        """
        depth = [] if self.depth_m is None else descent_notes(vehicle, self.descent_rate_mps)
        return depth if self.heading_deg is None else [*depth, HEADING_NOTE.format(self.heading_deg)]


HEADING_NOTE = (
    "heading_deg = {:g} is held where the current runs along it; in a current across it the vehicle, which has no side "
    "thrust, turns to hold its position"
)


class Point(Station, frozen=True, kw_only=True, tag="point"):
    """Vertical line through a point, in metres or in degrees relative to ``origin``."""

    north_m: Metres | None = None
    east_m: Metres | None = None
    latitude_deg: Latitude | None = None
    longitude_deg: Longitude | None = None

    def __post_init__(self) -> None:
        """Reject a point without coordinates, or with both kinds."""
        super().__post_init__()
        self.position()

    def position(self, anchor: ReferenceStart | None = None) -> Pair:
        """Return north and east (m).

        Parameters
        ----------
        anchor : start of the reference, which does not matter.
        """
        del anchor
        return local(Place(**{name: getattr(self, name) for name in (*METRES, *DEGREES)}), self.origin)


class Hold(Station, frozen=True, kw_only=True, tag="hold"):
    """Vertical line through the estimated position of the vehicle at the start: "here"."""

    in_places: ClassVar[bool] = False

    @classmethod
    def at_depth_of(cls, estimate: Estimate | None) -> Hold:
        """Return the hold at the depth of an estimate; without a depth the vertical command is kept.

        Parameters
        ----------
        estimate : newest estimate, if there is one.
        """
        depth_m = None if estimate is None else estimate.depth_m
        return cls(depth_m=None if depth_m is None else min(max(depth_m, 0.0), MAX_HOLD_DEPTH_M))

    def position(self, anchor: ReferenceStart) -> Pair:
        """Return north and east (m).

        Parameters
        ----------
        anchor : start of the reference.
        """
        return anchor.north_m, anchor.east_m


Reference: TypeAlias = Point | Hold | Line | Waypoints | Lawnmower | Circle | Spiral | Timed


def load(name: str, notes: list[str] | None = None) -> Reference:
    """Return a shipped reference by name (``"descent"``, ``"square"``), or read a file by path.

    The file is TOML, or of another program (``mission_files.py``: .plan, .waypoints, .gpx, .geojson).

    A CSV file that the reference names is read too; its path is relative to the folder of the TOML file.

    Parameters
    ----------
    name : NAME or FILE.
    notes : receives a sentence about what a file of another program holds beside the path.

    Raises
    ------
    ConfigError
        If the reference does not exist or is not valid.
    """
    beside = [] if notes is None else notes
    if config.is_path(name) and (table := mission_files.read(Path(name), f"reference {name}", beside)) is not None:
        return config.parse(table, Reference, source=f"reference {name}")  # type: ignore[arg-type]
    reference: Reference = config.load(name, Reference, what="reference", package=PACKAGE)  # type: ignore[arg-type]
    if isinstance(reference, Timed) and reference.file:
        path = config.find(name, what="reference", package=PACKAGE)
        source = config.error_source(path, what="reference", name=name)
        return from_csv(reference, path.parent / reference.file, source=source)
    return reference
