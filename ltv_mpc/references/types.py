"""Reference types, and the reader of reference files, whose ``kind`` names the type."""

from __future__ import annotations

from typing import TypeAlias

from ltv_mpc import config
from ltv_mpc.messages import Estimate, Pair, ReferenceStart
from ltv_mpc.references.base import BaseReference
from ltv_mpc.references.feasibility import descent_notes
from ltv_mpc.references.geodesy import Latitude, Longitude, Metres, Place, local
from ltv_mpc.references.shapes import Circle, Lawnmower, Line, Spiral, Waypoints
from ltv_mpc.references.timed import Timed, from_csv
from ltv_mpc.vehicle.parameters import Vehicle

PACKAGE = "ltv_mpc.references.files"

MAX_HOLD_DEPTH_M = 11_000.0
"""Upper bound of a reference's ``depth_m``."""


class Point(BaseReference, frozen=True, kw_only=True, tag="point"):
    """Vertical line through a point, in metres or in degrees relative to ``origin``."""

    north_m: Metres | None = None
    east_m: Metres | None = None
    latitude_deg: Latitude | None = None
    longitude_deg: Longitude | None = None

    def __post_init__(self) -> None:
        """Reject a point without coordinates, or with both kinds."""
        self._place()

    def position(self, anchor: ReferenceStart) -> Pair:
        """Return north and east (m).

        Parameters
        ----------
        anchor : start of the reference.
        """
        del anchor
        return self._place()

    def notes(self, vehicle: Vehicle) -> list[str]:
        """Return sentences about what the vehicle cannot do of this reference.

        Parameters
        ----------
        vehicle : parameters of the vehicle.
        """
        return _of_depth(self, vehicle)

    def _place(self) -> Pair:
        place = Place(
            north_m=self.north_m,
            east_m=self.east_m,
            latitude_deg=self.latitude_deg,
            longitude_deg=self.longitude_deg,
        )
        return local(place, self.origin)


class Hold(BaseReference, frozen=True, kw_only=True, tag="hold"):
    """Vertical line through the estimated position of the vehicle at the start: "here"."""

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

    def notes(self, vehicle: Vehicle) -> list[str]:
        """Return sentences about what the vehicle cannot do of this reference.

        Parameters
        ----------
        vehicle : parameters of the vehicle.
        """
        return _of_depth(self, vehicle)


def _of_depth(reference: BaseReference, vehicle: Vehicle) -> list[str]:
    return [] if reference.depth_m is None else descent_notes(vehicle, reference.descent_rate_mps)


Reference: TypeAlias = Point | Hold | Line | Waypoints | Lawnmower | Circle | Spiral | Timed


def load(name: str) -> Reference:
    """Return a shipped reference by name (``"descent"``, ``"square"``), or read a TOML file by path.

    A CSV file that the reference names is read too; its path is relative to the folder of the TOML file.

    Raises
    ------
    ConfigError
        If the reference does not exist or is not valid.
    """
    reference: Reference = config.load(name, Reference, what="reference", package=PACKAGE)  # type: ignore[arg-type]
    if isinstance(reference, Timed) and reference.file:
        path = config.find(name, what="reference", package=PACKAGE)
        return from_csv(
            reference, path.parent / reference.file, source=config.error_source(path, what="reference", name=name)
        )
    return reference
