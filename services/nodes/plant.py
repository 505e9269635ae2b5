"""The plant process: the simulated vehicle, and the keeper of vehicle time."""

from __future__ import annotations

from services.bus.session import BusOptions
from services.process.runner import Runner
from services.process.serve import serve
from services.process.timekeeping import KeepsTime
from services.run.situation import Situation
from sim.plant import Plant


def main(situation: Situation, bus: BusOptions, *, expects: tuple[str, ...] = ()) -> int:
    """Start the clock once all are ready, run to the scenario's end. ``expects`` are nodes besides the usual ones."""
    scenario = situation.scenario
    estimator = () if scenario.run.perfect_state else ("estimator",)
    keeps_time = KeepsTime(
        start_ns=scenario.start_ns,
        end_ns=scenario.end_ns,
        speed=scenario.run.speed,
        expects=("sensors", *estimator, "controller", *expects),
    )
    rehearse(situation)
    return serve(
        Plant.name,
        bus,
        lambda request, say: Runner(_make(situation), stop=request, say=say, keeps_time=keeps_time),
    )


def rehearse(situation: Situation) -> None:
    """Have all compiled code loaded: a few steps of a plant that is thrown away."""
    plant = _make(situation)
    for t_ns in range(0, 5 * Plant.schedule.period_ns, Plant.schedule.period_ns):
        plant.steps([(t_ns, [])])


def _make(situation: Situation) -> Plant:
    return Plant(situation.scenario, situation.vehicle, situation.water)
