"""Assessment of a run: what its figures mean, one sentence each, for the terminal and for the report."""

from __future__ import annotations

import math
from collections.abc import Mapping
from enum import Enum
from typing import Any

from ltv_mpc.messages import Health

LESS_TRACKING_ERROR = "--set controller.effort=high"
"""Option of a further run, if tracking is the larger part of the error and the thrusters have room for it."""

WITHOUT_DRIFT = "--perfect-state"
"""Option of a further run without drift of the estimate."""

GOOD_M = 0.05
"""Mean error (m) below which a run gets no advice: a fortieth of the length of the shipped vehicle."""

OFTEN = 0.1
"""Share of the cycles above which plans that are late, or a health that is not nominal, are the cause."""

OFTEN_SATURATED = 0.1
"""Share of the time at a thrust limit above which that limit is explained, as a bound of the tracking error."""

AT_ITS_LARGEST = 0.95
"""Ratio of the last error to the largest one above which the vehicle was not held at the reference."""


def assessment(summary: Mapping[str, Any]) -> list[str]:
    """Return one sentence each on the error and what bounds it, fence, thrust, health, delay, and what was lost.

    A figure that the summary lacks, such as the truth of a real vehicle, gives no sentence.
    """
    sentences = [*_error(summary), _fence(summary), _lateral_thrust(summary), _vertical_thrust(summary)]
    sentences += [_health(summary), *_delay(summary), _losses(summary)]
    return [sentence for sentence in dict.fromkeys(sentences) if sentence]


def next_option(summary: Mapping[str, Any]) -> str | None:
    """Return the option that the sentences about the error propose and the run did not have; None if there is none."""
    match _cause(summary):
        case _Cause.TRACKING:
            return LESS_TRACKING_ERROR
        case _Cause.SHORT_HORIZON:
            return f"--horizon-s {summary['proposed_horizon_s']:g}"
        case _Cause.TRACKING_WITH_HIGH_EFFORT:
            return f"--horizon-s {2 * summary['horizon_s']:.0f}"
        case _Cause.DRIFT:
            return WITHOUT_DRIFT
    return None


class _Cause(Enum):
    """Larger part of the error of the vehicle, with the sentence that says what reduces it."""

    GOOD = ""
    DRIFT = (
        "Better sensors or more fixes reduce the drift, more thrust does not; "
        f"`{WITHOUT_DRIFT}` shows the same run without drift."
    )
    SATURATION = "The thrust limits bound it: a slower reference, a weaker current or stronger thrusters reduce it."
    SHORT_HORIZON = (
        "A plan that ends before a turn does cannot see what the turn is for, and drives in circles or astern."
    )
    LATE = (
        "Plans that come too late leave the vehicle on old ones: a lower `--speed` or a shorter cycle gives them time."
    )
    HEALTH = "What degrades the health comes first."
    NO_THRUST = "The lateral thrusts were zero, so the water carried the vehicle."
    TRACKING = f"`{LESS_TRACKING_ERROR}` reduces the tracking error, for more thrust."
    TRACKING_WITH_HIGH_EFFORT = "A longer horizon may reduce the tracking error."


def _cause(summary: Mapping[str, Any]) -> _Cause | None:
    """Return the larger part of the error, the controller's or the estimator's; None if the truth is not known."""
    tracking, true, localisation = _errors_m(summary)
    if tracking is None or true is None or localisation is None:
        return None
    if true < GOOD_M:
        return _Cause.GOOD
    cycles = max(summary.get("cycles", 0), 1)
    if localisation > tracking:
        return _Cause.DRIFT
    if _figure(summary, "thrust", "mean_abs_N") == 0.0:
        return _Cause.NO_THRUST
    if _not_nominal(summary) > OFTEN * cycles:
        return _Cause.HEALTH
    if summary.get("deadline_misses", 0) > OFTEN * cycles:
        return _Cause.LATE
    if _short_horizon(summary):
        return _Cause.SHORT_HORIZON
    if (_figure(summary, "thrust", "saturated_fraction") or 0.0) > OFTEN_SATURATED:
        return _Cause.SATURATION
    return _Cause.TRACKING_WITH_HIGH_EFFORT if summary.get("effort") == "high" else _Cause.TRACKING


def _error(summary: Mapping[str, Any]) -> list[str]:
    """Name the error, the part that is larger, and what reduces it."""
    (tracking, true, localisation), cause = _errors_m(summary), _cause(summary)
    if tracking is None:
        return []
    if cause is None:
        good = f", which is good: less than {GOOD_M:g} m" if tracking < GOOD_M else ""
        return [f"The estimate was {tracking:.3f} m from the reference on average{good}."]
    average = f"The vehicle was {true:.3f} m from the reference on average"
    perfect = ""
    if summary.get("perfect_state"):
        perfect = f"All of this is tracking, because `{WITHOUT_DRIFT}` gave the true state to the controller."
    if cause is _Cause.GOOD:
        return [f"{average}, which is good: less than {GOOD_M:g} m.", perfect]
    if cause is _Cause.DRIFT:
        parts = f"Drift of the estimate is the larger part, {localisation:.3f} m; tracking is {tracking:.3f} m."
    else:
        parts = (
            perfect
            or f"Tracking is the larger part, {tracking:.3f} m; the drift of the estimate is {localisation:.3f} m."
        )
    why = _health(summary) if cause is _Cause.HEALTH else ""
    return [_short_horizon(summary), f"{average}.", parts, why, _not_held(summary, cause), cause.value]


def _short_horizon(summary: Mapping[str, Any]) -> str:
    """Say so if the horizon is shorter than the one that is proposed; empty without lateral control."""
    horizon_s, proposed_s = summary.get("horizon_s", math.inf), summary.get("proposed_horizon_s", 0.0)
    if horizon_s >= proposed_s or _figure(summary, "thrust", "mean_abs_N") == 0.0:
        return ""
    return f"The horizon of {horizon_s:.1f} s is shorter than a turn and a stop: {proposed_s:.1f} s is proposed."


def _not_held(summary: Mapping[str, Any], cause: _Cause) -> str:
    """Say so if thrusters at their limits could not hold the vehicle at the reference."""
    largest, last = (_figure(summary, "true_error_m", name) for name in ("max", "final"))
    if cause is not _Cause.SATURATION or largest is None or last is None or last < AT_ITS_LARGEST * largest:
        return ""
    return f"The distance ended at {last:.3f} m, about its largest: the thrust was not sufficient to hold the vehicle."


def _errors_m(summary: Mapping[str, Any]) -> tuple[float | None, float | None, float | None]:
    """Return the mean errors of tracking, of the vehicle and of the estimate (m)."""
    tracking, true, localisation = (
        _figure(summary, f"{error}_error_m", "mean") for error in ("tracking", "true", "localisation")
    )
    return tracking, true, localisation


def _fence(summary: Mapping[str, Any]) -> str:
    """Name the nearest zone of the fence, and the time that the hull spent in zones and margins."""
    zones = summary.get("fence")
    if not zones:
        return ""
    nearest = min(zones, key=lambda zone: zone["least_clearance_m"])
    inside_s, in_margin_s = (sum(zone[name] for zone in zones) for name in ("inside_s", "in_margin_s"))
    entered = f"it was in a margin for {in_margin_s:.1f} s, and in a zone for {inside_s:.1f} s"
    least = f"The hull came within {nearest['least_clearance_m']:.2f} m of {nearest['zone']}"
    return f"{least}; {entered}." if in_margin_s else f"{least}, and kept out of every margin."


def _lateral_thrust(summary: Mapping[str, Any]) -> str:
    saturated = _figure(summary, "thrust", "saturated_fraction")
    if saturated is None or _figure(summary, "thrust", "mean_abs_N") == 0.0:
        return ""
    if saturated == 0.0:
        return "No lateral thruster reached its limit."
    return f"A lateral thruster was at its limit for {100 * saturated:.1f} % of the time."


def _vertical_thrust(summary: Mapping[str, Any]) -> str:
    """Tell how long the vertical thruster was at its limit, and what asks for so much thrust."""
    saturated = _figure(summary, "thrust", "vertical_saturated_fraction")
    if not saturated:
        return ""
    sentence = f"The vertical thruster was at its limit for {100 * saturated:.1f} % of the time"
    if saturated <= OFTEN_SATURATED:
        return f"{sentence}."
    return (
        f"{sentence}, because the vertical speed of the reference and the buoyancy need all of its thrust: "
        "a smaller `descent_rate_mps` or ballast leaves a reserve."
    )


def _health(summary: Mapping[str, Any]) -> str:
    """Count the cycles in which the controller's health was not nominal, and name the most frequent reason."""
    counts = {text: count for text, count in summary.get("health", {}).items() if text != Health.NOMINAL.value}
    if not counts:
        return ""
    most_frequent = max(counts, key=lambda text: counts[text])
    return (
        f"The controller's health was not nominal in {_not_nominal(summary)} of {summary['cycles']} cycles, "
        f"most often {most_frequent}."
    )


def _not_nominal(summary: Mapping[str, Any]) -> int:
    """Return the number of cycles in which the controller's health was not nominal."""
    return sum(count for text, count in summary.get("health", {}).items() if text != Health.NOMINAL.value)


def _delay(summary: Mapping[str, Any]) -> list[str]:
    """Tell the delay from estimate to effect, and how many plans came after their start."""
    delay_s = _figure(summary, "end_to_end_delay_s", "median")
    if delay_s is None:
        return []
    late, measured = summary["deadline_misses"], summary.get("mode") != "lockstep"
    effect = f"A plan took effect {delay_s:.2f} s after its estimate, and was made for that time." if measured else ""
    if late:
        more = ": a lower `--speed` gives them more time" if measured else ""
        return [effect, f"{late} of {summary['cycles']} plans came too late{more}."]
    return [effect, "No plan came too late." if measured else ""]


def _losses(summary: Mapping[str, Any]) -> str:
    messages = summary.get("messages")
    if summary.get("mode") == "lockstep" or messages is None:
        return ""
    counts = {
        "dropped messages": messages["dropped"],
        "rejected messages": messages["rejected"],
        "denied messages": messages.get("denied", 0),
        "restarts of processes": summary["restarts"],
    }
    bad = ", ".join(f"{what}: {count}" for what, count in counts.items() if count)
    return f"Not all went well: {bad}. The report lists the events." if bad else "No message was lost."


def _figure(summary: Mapping[str, Any], group: str, name: str) -> float | None:
    """Return a figure, or None where a summary that was cut off lacks it."""
    value: float | None = summary.get(group, {}).get(name)
    return value
