"""Pre-arm checks: what must hold before the controller takes the thrusters, each with its name and what to do.

    estimate       an estimate has arrived, and it is up to date
    covariance     the standard deviation of its position, if it has one, is at most ``max_position_sd_m``
    reference      its start is at most ``max_start_m`` away
    plan           a trial plan from this estimate is solved: estimate plausible, reference valid, solver ready
    depth          the estimate has a depth if the reference has one
    actuators      if they report: they report now, and they follow the plans
    inputs         each state of the inputs that degrades the health, by its name
    mission        each present cause of the mission policy, by its name: battery, leak, mission time

A weak thruster, a wrong vehicle file, a missing depth and actuators that do not follow the plans are warnings. What
cannot be known does not block: actuators that never reported (a warning), an unknown covariance, a reference that has
not started yet. There is a clock when a command arrives: without one its process rejects it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple

from ltv_mpc.control.controller import Controller
from ltv_mpc.control.mode import LATERAL_OFF, NO_DEPTH, NOT_STARTED
from ltv_mpc.messages import Applied, Estimate, Health, InputReport, PlanOrigin
from ltv_mpc.safety.health import NOMINAL, HealthState
from ltv_mpc.safety.mission_policy import Cause

REMEDIES: Mapping[str, str] = {
    "estimate": "check the publisher of `estimate`",
    "covariance": "wait for a better position, or raise [controller.mission] max_position_sd_m",
    "reference": "check its origin and the estimate's, or raise [controller.mission] max_start_m",
    "plan": "check estimate, reference and solver",
    "depth": "check the publisher of `estimate`, or follow a reference without depth",
    "actuators": "check the publisher of `applied` and its link",
    "commands": "return the thrusters to the controller",
    "plans": "compare the vehicle file with the limits of the actuators",
    "source": "stop the publisher that does not belong there",
    "thrusters": "inspect the propeller",
    "vehicle file": "correct it: `ltv-mpc vehicle identify`",
    "obstacles": "add [hull] to the vehicle file, or stop the publisher of `obstacles`",
    "clock": "wait for 10 s, and check the publisher's clock",
    "mission time": "send `follow` for a new mission",
    "battery": "charge or replace it",
    "battery input": "check the publisher of `battery`",
    "leak": "search the leak",
    "leak input": "check the publisher of `leak`",
}
"""What to do, by the name of the check."""


WARNINGS = "thrusters", "commands", "vehicle file"
"""Checks that only warn: the plans are computed for the thrust that a weak thruster delivers and for the vehicle that
the controller has learned, and another driver of the thrusters can return them after the controller is armed.
"""


class Failure(NamedTuple):
    """Pre-arm check that failed, or that could not be made."""

    check: str
    problem: str
    blocks: bool = True  # False: a warning only

    @property
    def text(self) -> str:
        """Name, problem and what to do."""
        return f"{self.check}: {self.problem}: {REMEDIES.get(self.check, 'see controller/status')}"


def failures(
    trial: Controller,
    *,
    estimate: Estimate | None,
    applied: Applied | None,
    reports: Mapping[str, InputReport],
    states: Mapping[str, HealthState],
    causes: Iterable[Cause],
) -> list[Failure]:
    """Return the checks that fail.

    Parameters
    ----------
    trial : new controller of the same vehicle, reference and settings; it plans one cycle.
    estimate, applied : the newest messages.
    reports : state of the inputs, by key.
    states : health by each input, by name.
    causes : present causes of the mission policy.
    """
    failures = [Failure(cause.name, cause.why) for cause in causes]
    failures += [
        Failure(name, state.why, blocks=name not in WARNINGS) for name, state in states.items() if state is not NOMINAL
    ]
    if applied is None:
        failures.append(Failure("actuators", "no report yet, so plans count as followed", blocks=False))
    elif applied.health is not Health.NOMINAL:
        failures.append(Failure("actuators", f"they do not follow the plans (health {applied.health.value})"))
    return [*_failures_of_estimate(trial, estimate, reports["estimate"]), *failures]


def _failures_of_estimate(trial: Controller, estimate: Estimate | None, report: InputReport) -> Iterator[Failure]:
    if estimate is None or report.age_ns is None:
        yield Failure("estimate", "none has arrived")
        return
    if not (report.alive and report.valid):
        yield Failure("estimate", f"the newest is {report.age_ns * 1e-9:.1f} s old")
    settings, P = trial.config.mission, estimate.covariance
    if P is not None:
        sd_m = math.sqrt(max(float(P[0, 0]), float(P[1, 1]), 0.0))
        if sd_m > settings.max_position_sd_m:
            problem = f"the standard deviation of the position is {sd_m:.3g} m, above {settings.max_position_sd_m:g} m"
            yield Failure("covariance", problem)
    plan = trial.plan(estimate)
    if plan.origin is not PlanOrigin.SOLVED and plan.why not in (NOT_STARTED, LATERAL_OFF):
        yield Failure("plan", plan.why)
    if plan.health_why == NO_DEPTH:
        yield Failure("depth", "the reference has one but the estimates have none", blocks=False)
    distance_m = trial.follower.start_distance_m
    if distance_m is not None and distance_m > settings.max_start_m:
        yield Failure("reference", f"its start is {distance_m:.0f} m away, more than {settings.max_start_m:g} m")
