"""Text summary of a run, from summary.json: a few lines of 80 columns, the last one is the path of its folder."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ltv_mpc.errors import one_line
from services.reporting.assessment import assessment
from services.runtime.console import WIDTH, figure

DRIFT = "since t = 0"
"""What an error of the vehicle is without the error of the fix at t = 0."""

MIN_SPEED_RATIO = 0.95
"""Ratio of reached to requested speed below which the summary names the reached speed."""


def verdict(summary: Mapping[str, Any], folder: Path, next_commands: Sequence[str] = ()) -> str:
    """Format the summary, without a line break at the end. Lock step has no rows for what only processes show."""
    in_places = summary.get("in_places")
    rows = [
        ("run", f"{summary['scenario']}, {summary['duration_s']:.1f} s {how(summary)}, seed {summary['seed']}"),
        ("horizon", f"{summary['horizon_s']:.1f} s in {summary['stages']} stages"),
        ("tracking", _error(summary["tracking_error_m"], "estimate from the reference")),
        ("true error", _error(summary["true_error_m"], f"vehicle from it, {'absolute' if in_places else DRIFT}")),
        *([("of it drift", _error(summary["true_error_drift_m"], f"vehicle from it, {DRIFT}"))] if in_places else []),
        ("localisation", _error(summary["localisation_error_m"], "estimate from the vehicle")),
        ("thrust", _thrust(summary["thrust"])),
        ("energy", _energy(summary["thrust"])),
        ("cycles", _cycles(summary)),
    ]
    if summary["mode"] != "lockstep":
        rows += [
            ("compute", _delay(summary["compute_delay_s"], summary["compute_delay_wall_s"])),
            ("end to end", _delay(summary["end_to_end_delay_s"], summary["end_to_end_delay_wall_s"])),
            ("messages", _messages(summary["messages"], summary["restarts"])),
        ]
    lines = [f"{name:<13} {text}" for name, text in rows]
    if failed := failure(summary):
        lines = [*textwrap.wrap(failed, WIDTH), *lines]
    lines.append("")
    for sentence in assessment(summary):
        lines += textwrap.wrap(sentence, WIDTH, break_on_hyphens=False)  # an option is copied whole
    if next_commands:
        lines += ["", "next:", *(f"  {command}" for command in next_commands)]
    return "\n".join([*lines, "", str(folder)])


def failure(summary: Mapping[str, Any]) -> str:
    """Return why the run of a summary did not come to its end, as a line; empty if it did."""
    why = summary.get("why")
    return one_line(f"The run failed: {why}") if why and isinstance(why, str) else ""


def how(summary: Mapping[str, Any]) -> str:
    """Describe the mode and speed of a run as far as its summary holds them (a run that was cut off has neither)."""
    if summary.get("mode") == "lockstep":
        return "in lock step"
    asked, reached = summary.get("speed"), summary.get("speed_reached")
    if asked is None:
        return "as processes"
    short = reached is not None and reached < MIN_SPEED_RATIO * asked
    return f"as processes at {f'{reached:.1f} of ' if short else ''}{asked:g} x real time"


def _error(spread: Mapping[str, float | None], meaning: str) -> str:
    mean, largest, end = (figure(spread[name], digits=".3f") for name in ("mean", "max", "final"))
    return f"mean {mean}, max {largest}, end {end} m ({meaning})"


def _thrust(thrust: Mapping[str, float | None]) -> str:
    return (
        f"mean |F| {figure(thrust['mean_abs_N'], digits='.1f')}, max {figure(thrust['max_abs_N'], digits='.1f')} N,"
        f" saturated {figure(thrust['saturated_fraction'], digits='.1f', scale=100)} %,"
        f" slew {figure(thrust['max_slew_N_per_s'], digits='.0f')} N/s"
        f" (delivered {figure(thrust.get('max_delivered_slew_N_per_s'), digits='.0f')})"
    )


def _energy(thrust: Mapping[str, float | None]) -> str:
    relative = f"{figure(thrust.get('relative_power'), digits='.1f', scale=100)} % of full lateral power"
    if (energy_J := thrust.get("propulsive_energy_J")) is None:
        return f"{relative}; no torque coefficients given"
    return f"{energy_J:.0f} J (lateral thrusters {figure(thrust.get('lateral_energy_J'), digits='.0f')} J), {relative}"


def _delay(vehicle: Mapping[str, float | None], wall: Mapping[str, float | None]) -> str:
    names = "median", "p99", "max"
    text = ", ".join(f"{name} {figure(vehicle[name], digits='.3f')}" for name in names) + " s"
    if wall["median"] is None:
        return text
    return f"{text} (wall {', '.join(figure(wall[name], digits='.1f', scale=1e3) for name in names)} ms)"


def _cycles(summary: Mapping[str, Any]) -> str:
    origins = ", ".join(f"{count} {origin}" for origin, count in summary["plan_origin"].items())
    late = summary["deadline_misses"]
    counts = [f"{late} late"] if late or summary["mode"] != "lockstep" else []  # lock step measures no time
    counts.append(f"{summary['plans_refused']} rejected")
    return f"{summary['cycles']} ({origins or 'no plan'}), {', '.join(counts)}"


def _messages(messages: Mapping[str, int], restarts: int) -> str:
    text = f"{messages['published']} published, {messages['dropped']} dropped, {messages['rejected']} rejected"
    if denied := messages.get("denied"):
        text += f", {denied} denied"
    return f"{text}; restarts: {restarts}" if restarts else text
