"""Square at 1 m/s, ended by the mission policy: the operator is lost and the craft holds its position; then a leak."""

from __future__ import annotations

import numpy as np

from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.messages import MissionAction
from ltv_mpc.safety.mission_policy import MissionSettings
from tests.foreign_plant.flight import SQUARE, Figure, Flight
from tests.foreign_plant.plant import STEP_S

TIMEOUT_S, SETTLED_S = 10.0, 15.0
MISSION = MissionSettings(operator_timeout_s=TIMEOUT_S, on_operator_loss=MissionAction.HOLD, leak=True)


class WithLeakDetector(Flight):
    """Flight of a craft that publishes ``leak`` with each estimate."""

    leaking = False

    def estimates(self, t_ns: int):
        """Return the estimate and the state of the leak detector."""
        return [*super().estimates(t_ns), ("leak", self.sender, {"detected": self.leaking})]


def run() -> list[Figure]:
    """Return the distance from the place where the hold began, and thrust and time after the leak."""
    flight = WithLeakDetector(config=ControllerConfig(mission=MISSION))
    flight.fly(0.6)  # the detector is heard before the craft is armed
    flight.command(action="arm")
    flight.fly(8.0)
    flight.command(action="follow", reference_toml=SQUARE.read_text())
    flight.fly(TIMEOUT_S + 1.0)
    place = np.array(flight.plans[-1].reference_m)
    flight.fly(SETTLED_S)
    held_m = np.linalg.norm(flight.fly(20.0) - place, axis=1)
    flight.leaking = True
    begin = len(flight.plans)
    flight.fly(3.0)
    plans = flight.plans[begin:]
    surfacing = [plan for plan in plans if plan.why == "surface: leak detected"]
    late_s = 3.0 if not surfacing else (surfacing[0].cycle_t_ns - plans[0].cycle_t_ns) * 1e-9
    thrust_N = max(map(abs, flight.actuators.command_N))
    return [
        Figure("distance from the place of the hold", float(held_m.max()), 0.3, "m"),
        Figure("time to the failsafe after a leak", late_s, 0.3 + STEP_S, "s"),
        Figure("thrust 3 s after the leak", thrust_N, 1e-6, "N"),
    ]
