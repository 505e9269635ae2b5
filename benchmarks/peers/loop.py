"""Peer in the place of the controller's solver: in the profile, and in a closed loop."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.peers.peer import Peer
from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.control.node import ControllerNode
from ltv_mpc.control.problem_data import Constants
from ltv_mpc.control.resolution import settled
from ltv_mpc.messages import Estimate, Pair, Plan, PlanOrigin, SolveStatus
from ltv_mpc.node import ReceivedMessage
from ltv_mpc.vehicle.parameters import Vehicle
from services.tools.profile.measure import Candidate
from services.tools.profile.problems import Episode


def candidate_of(peer: type[Peer]) -> Candidate:
    """Return a peer as a candidate."""

    def make_solver(vehicle: Vehicle, config: ControllerConfig) -> Peer:
        resolved = settled(config, vehicle)
        constants = Constants.of(vehicle, resolved.weights, resolved.knots, resolved.limits.state_bounds)
        return peer(resolved, constants, vehicle)

    return Candidate(peer.name, make_solver)


class Loop(ControllerNode):
    """A node that controls, and notes how far off the line the vehicle is."""

    def __init__(self, candidate: Candidate, episode: Episode) -> None:
        super().__init__(episode.vehicle, episode.reference, episode.config, make_solver=candidate.make_solver)
        self.off_m: list[float] = []
        self.cycles = 0
        self.unsolved = 0
        self._target: Pair | None = None

    def receive(self, arrival: ReceivedMessage) -> None:
        """One message, and what it says of the loop once there is a plan."""
        super().receive(arrival)
        estimate = arrival.message
        if isinstance(estimate, Estimate) and self._target is not None:
            north, east = self._target
            self.off_m.append(float(np.hypot(estimate.north_m - north, estimate.east_m - east)))

    def cycle(self, estimate: Estimate, t_ns: int) -> Plan:
        """One plan."""
        plan = super().cycle(estimate, t_ns)
        if plan.solve.status is not SolveStatus.NOT_RUN:
            self._target = plan.reference_m
            self.cycles += 1
            self.unsolved += plan.origin is not PlanOrigin.SOLVED
        return plan


@dataclass(frozen=True)
class Held:
    """Result of a closed loop."""

    off_m: float  # mean distance from the line
    unsolved: int  # cycles without a solution


def closed(candidate: Candidate, episode: Episode) -> Held:
    """Run the whole episode in closed loop under the candidate's own plans."""
    loop = Loop(candidate, episode)
    episode.feed(loop, lambda: loop.cycles > episode.cycles)
    return Held(float(np.mean(loop.off_m)), loop.unsolved)
