"""Reference trajectories: points, paths, tracks with times, "here"; ``load`` reads one from a file."""

from ltv_mpc.references.geodesy import Origin, Place
from ltv_mpc.references.shapes import Circle, Lawnmower, Line, Spiral, Waypoint, Waypoints
from ltv_mpc.references.timed import Timed
from ltv_mpc.references.types import Hold, Point, Reference, load

__all__ = [
    "Circle",
    "Hold",
    "Lawnmower",
    "Line",
    "Origin",
    "Place",
    "Point",
    "Reference",
    "Spiral",
    "Timed",
    "Waypoint",
    "Waypoints",
    "load",
]
