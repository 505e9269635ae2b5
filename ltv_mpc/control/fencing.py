"""Fence and obstacles of a controller: what is in force."""

from __future__ import annotations

from ltv_mpc.errors import ConfigError
from ltv_mpc.geofence.fence import Fence
from ltv_mpc.geofence.obstacles import ObstacleTable
from ltv_mpc.messages import FenceInForce, Obstacles, ZoneInForce
from ltv_mpc.vehicle.parameters import Vehicle


class Fencing:
    """Fence and obstacles of one vehicle."""

    def __init__(self, vehicle: Vehicle) -> None:
        """Begin without a fence and without obstacles.

        Parameters
        ----------
        vehicle : its file needs [hull] for a fence or an obstacle.
        """
        self._vehicle = vehicle
        self.fence: Fence | None = None
        """Fence in force."""
        self.obstacles = ObstacleTable()
        """Obstacles that are known."""

    @property
    def hull_m(self) -> float:
        """Radius of the circle around the hull (m). Raises ``ConfigError`` if it is not known."""
        hull = self._vehicle.hull
        if hull is None:
            raise ConfigError(
                f"vehicle {self._vehicle.name}", "[hull]", "is missing: a fence needs length_m and beam_m"
            )
        return hull.radius_m

    def set_fence(self, fence: Fence | None) -> None:
        """Keep another fence; None: none. Raises ``ConfigError`` if the hull is not known."""
        if fence is not None:
            _ = self.hull_m
        self.fence = fence

    def add_obstacles(self, obstacles: Obstacles) -> None:
        """Take reports of obstacles. Raises ``ConfigError`` if the hull is not known."""
        _ = self.hull_m
        self.obstacles.add(obstacles)

    def in_force(self, t_ns: int) -> FenceInForce:
        """Return what is in force as a message.

        Parameters
        ----------
        t_ns : time of the message, vehicle time (ns).
        """
        zones = () if self.fence is None else self.fence.zones()
        hull = self._vehicle.hull
        return FenceInForce(
            t_ns=t_ns,
            hull_radius_m=0.0 if hull is None else hull.radius_m,
            zones=tuple(
                ZoneInForce(
                    label=zone.label,
                    keep_in=zone.keep_in,
                    vertices_m=zone.vertices,
                    radius_m=zone.radius_m,
                    margin_m=zone.margin_m,
                )
                for zone in zones
            ),
            obstacles=self.obstacles.reports,
        )
