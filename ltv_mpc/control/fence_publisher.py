"""Fence and obstacles as messages: reports of obstacles that arrive, and the fence in force that is published."""

from __future__ import annotations

from ltv_mpc.control.controller import Controller
from ltv_mpc.errors import ConfigError
from ltv_mpc.geofence.fence import Fence
from ltv_mpc.messages import FenceInForce, Health, Obstacles
from ltv_mpc.safety.health import NOMINAL, HealthState

OBSTACLES_PERIOD_NS, FENCE_PERIOD_NS = 1_000_000_000, 10_000_000_000
"""Times between two publications: with obstacles, and with a fence alone."""


class FencePublisher:
    """Publisher of a controller's fence and obstacles; it publishes nothing while there are none."""

    def __init__(self, controller: Controller) -> None:
        """Begin with nothing published.

        Parameters
        ----------
        controller : keeps the fence, and avoids the obstacles.
        """
        self._controller = controller
        self._fence: Fence | None = None  # published last
        self._obstacles = False  # there were some in the last publication, or one has arrived since
        self._published_ns: int | None = None
        self.health: HealthState = NOMINAL
        """Degraded if obstacles arrive that the controller cannot avoid."""

    def receive(self, obstacles: Obstacles) -> None:
        """Avoid obstacles, if the vehicle file allows it.

        Parameters
        ----------
        obstacles : reports of some or all obstacles.
        """
        try:
            self._controller.add_obstacles(obstacles)
        except ConfigError as error:
            self.health = HealthState(Health.DEGRADED, f"obstacles are not avoided: {error}")
            return
        if not self._obstacles:
            self._obstacles, self._published_ns = True, None

    def due(self, t_ns: int) -> FenceInForce | None:
        """Return the message if it is due: at a change of the fence, at the first obstacle, then from time to time.

        Parameters
        ----------
        t_ns : current time, vehicle time (ns).
        """
        fence = self._controller.fence
        period_ns = OBSTACLES_PERIOD_NS if self._obstacles else FENCE_PERIOD_NS
        recently = self._published_ns is not None and 0 <= t_ns - self._published_ns < period_ns
        if fence is self._fence and (recently or (fence is None and not self._obstacles)):
            return None
        report = self._controller.fence_in_force(t_ns)
        self._fence, self._obstacles, self._published_ns = fence, bool(report.obstacles), t_ns
        return report
