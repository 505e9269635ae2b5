"""Assessment of a run: what its figures mean, one sentence each, for the terminal and for the report."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
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
"""Share of cycles, or of the time in a margin or at a thrust limit, above which that is the cause of the error."""

AT_ITS_LARGEST = 0.95
"""Ratio of the last error to the largest one above which the vehicle was not held at the reference."""

ALWAYS_CHANGING, RESTLESS = 0.7, 0.3
"""Mean rate of the lateral commands over their largest, from which the slew limit bounds the error, or noise moves the
thrusters: 0.06 to 0.1 in shipped scenarios, 0.3 to 0.55 with noisy sensors, 0.9 with a slew limit of a tenth.
"""

LONG_DELAY = 0.05
"""Delay over the proposed horizon above which it is the cause: 0.7 s doubles the error of the shipped vehicle."""


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
        case _Cause.DRIFT | _Cause.NOISE:
            return WITHOUT_DRIFT
        case _Cause.DELAY if summary.get("mode") == "lockstep":  # else the delay is measured
            return "--set run.compute_delay_s=0"
    return None


class _Cause(Enum):
    """Cause of the error of the vehicle, with the sentence that says what reduces it."""

    GOOD = ""
    NOISE = (
        f"Noise of the estimate, or waves, keep the thrusters moving: `{WITHOUT_DRIFT}` shows the run without noise."
    )
    DRIFT = f"Better sensors or more fixes reduce it, more thrust does not; `{WITHOUT_DRIFT}` shows it without."
    NO_THRUST = "The lateral thrusts were zero, so the water carried the vehicle."
    DROPOUT = "The estimates dropped out, and the vehicle followed its prediction: estimator and sensors come first."
    OTHER_SOURCE = "Another source of thrust, or none, drove the thrusters: end it, or switch them on."
    WEAK = "The thrusters are weak: clear or mend them, or correct the thrusts in the vehicle file."
    WRONG_FILE = "The vehicle file is wrong: `ltv-mpc vehicle identify` finds values that explain the motion."
    HEALTH = "What degrades the health comes first."
    LATE = "Plans that come too late leave the vehicle on old ones: a lower `--speed` gives them more time."
    SHORT_HORIZON = (
        "A plan that ends before a turn does cannot see what the turn is for: it drives in circles or astern."
    )
    SLEW = (
        "The slew limit bounds it: a larger `slew_N_per_s` of the vehicle file reduces it, if the thrusters allow it."
    )
    DELAY = "The delay bounds it: a faster computer, fewer stages or a smaller `run.compute_delay_s` reduces it."
    FENCE = "The fence bounds it: a start or reference outside of its zones and margins reduces it."
    SATURATION = "The thrust limits bound it: a slower reference, a weaker current or stronger thrusters reduce it."
    TRACKING_WITH_HIGH_EFFORT = "A longer horizon may reduce the tracking error."
    TRACKING = f"`{LESS_TRACKING_ERROR}` reduces the tracking error, for more thrust."


OF_HEALTH = _Cause.DROPOUT, _Cause.OTHER_SOURCE, _Cause.WEAK, _Cause.WRONG_FILE, _Cause.HEALTH
"""Causes that the reason of the health names."""


def _cause(summary: Mapping[str, Any]) -> _Cause | None:
    """Return the first cause whose condition holds; None if the truth is not known."""
    tracking, true, localisation = _errors_m(summary)
    if math.isnan(tracking + true + localisation):
        return None
    cycles, duration_s = max(summary.get("cycles", 0), 1), max(summary.get("duration_s", 0.0), 1.0)
    health = _health(summary, OFTEN)
    travel_N, largest_N_per_s = (_figure(summary, "thrust", name) for name in ("travel_N", "max_slew_N_per_s"))
    changing = travel_N / max(2.0 * duration_s * largest_N_per_s, 1e-9)
    delay_s, held = _figure(summary, "end_to_end_delay_s", "median"), not _not_held(summary)
    in_fence_s = sum(zone["inside_s"] + zone["in_margin_s"] for zone in summary.get("fence", ()))
    conditions = {
        _Cause.GOOD: true < GOOD_M,
        _Cause.NOISE: RESTLESS < changing < ALWAYS_CHANGING and not summary.get("perfect_state"),
        _Cause.DRIFT: localisation > tracking,
        _Cause.NO_THRUST: _figure(summary, "thrust", "mean_abs_N") == 0.0,
        _Cause.DROPOUT: "no new estimates" in health,
        _Cause.OTHER_SOURCE: "somebody else" in health,
        _Cause.WEAK: "thruster weak" in health or "thrust differs" in health,
        _Cause.WRONG_FILE: "vehicle file" in health,
        _Cause.HEALTH: bool(health),
        _Cause.LATE: summary.get("deadline_misses", 0) - 1 > OFTEN * cycles,  # the delay of the first is not known
        _Cause.SHORT_HORIZON: bool(_short_horizon(summary)),
        _Cause.SLEW: changing >= ALWAYS_CHANGING,
        _Cause.DELAY: held and delay_s > LONG_DELAY * summary.get("proposed_horizon_s", math.inf),
        _Cause.FENCE: held and in_fence_s > OFTEN * duration_s,
        _Cause.SATURATION: _figure(summary, "thrust", "saturated_fraction") > OFTEN,
        _Cause.TRACKING_WITH_HIGH_EFFORT: summary.get("effort") == "high",
    }
    return next((cause for cause, holds in conditions.items() if holds), _Cause.TRACKING)


def _error(summary: Mapping[str, Any]) -> list[str]:
    """Name the error, the part that is larger, and what reduces it."""
    (tracking, true, localisation), cause = _errors_m(summary), _cause(summary)
    if math.isnan(tracking):
        return []
    if cause is None:
        good = f", which is good: less than {GOOD_M:g} m" if tracking < GOOD_M else ""
        return [f"The estimate was {tracking:.3f} m from the reference on average{good}."]
    what = "error" if summary.get("in_places") else "drift"
    average, perfect = f"The vehicle was {true:.3f} m from the reference on average", summary.get("perfect_state")
    parts = f"Tracking is the larger part, {tracking:.3f} m; the {what} of the estimate is {localisation:.3f} m."
    if perfect:
        parts = f"All of this is tracking, because `{WITHOUT_DRIFT}` gave the true state to the controller."
    elif localisation > tracking:
        larger = f"{what.capitalize()} of the estimate is the larger part, {localisation:.3f} m"
        parts = f"{larger}; tracking is {tracking:.3f} m."
    if cause is _Cause.GOOD:
        return [f"{average}, which is good: less than {GOOD_M:g} m.", parts if perfect else ""]
    why = _health(summary) if cause in OF_HEALTH else ""
    held = _not_held(summary) if cause is _Cause.SATURATION else ""
    return [_short_horizon(summary), f"{average}.", parts, why, held, cause.value]


def _short_horizon(summary: Mapping[str, Any]) -> str:
    """Say so if the horizon is shorter than the one that is proposed; empty without lateral control."""
    horizon_s, proposed_s = summary.get("horizon_s", math.inf), summary.get("proposed_horizon_s", 0.0)
    if horizon_s >= proposed_s or _figure(summary, "thrust", "mean_abs_N") == 0.0:
        return ""
    return f"The horizon of {horizon_s:.1f} s is shorter than a turn and a stop: {proposed_s:.1f} s is proposed."


def _not_held(summary: Mapping[str, Any]) -> str:
    """Say so if thrusters at their limits could not hold the vehicle at the reference."""
    largest, last = (_figure(summary, "true_error_m", name) for name in ("max", "final"))
    if not (_figure(summary, "thrust", "saturated_fraction") > OFTEN and last >= AT_ITS_LARGEST * largest):
        return ""
    return f"The distance ended at {last:.3f} m, about its largest: the thrust was not sufficient to hold the vehicle."


def _errors_m(summary: Mapping[str, Any]) -> Iterator[float]:
    """Yield the mean errors of tracking, of the vehicle and of the estimate (m); the second has the others in it."""
    localisation = "localisation_error_absolute_m" if summary.get("in_places") else "localisation_error_m"
    return (_figure(summary, error, "mean") for error in ("tracking_error_m", "true_error_m", localisation))


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
    if math.isnan(saturated) or _figure(summary, "thrust", "mean_abs_N") == 0.0:
        return ""
    if saturated == 0.0:
        return "No lateral thruster reached its limit."
    return f"A lateral thruster was at its limit for {100 * saturated:.1f} % of the time."


def _vertical_thrust(summary: Mapping[str, Any]) -> str:
    """Tell how long the vertical thruster was at its limit, and what asks for so much thrust."""
    saturated = _figure(summary, "thrust", "vertical_saturated_fraction")
    if not saturated > 0.0:
        return ""
    sentence = f"The vertical thruster was at its limit for {100 * saturated:.1f} % of the time"
    if saturated <= OFTEN:
        return f"{sentence}."
    return (
        f"{sentence}, because the vertical speed of the reference and the buoyancy need all of its thrust: "
        "a smaller `descent_rate_mps` or ballast leaves a reserve."
    )


def _health(summary: Mapping[str, Any], share: float = 0.0) -> str:
    """Count the cycles whose health was not nominal, if more than a share, and name the most frequent reason."""
    counts = {text: count for text, count in summary.get("health", {}).items() if text != Health.NOMINAL.value}
    total, cycles = sum(counts.values()), summary.get("cycles", 0)
    if total <= share * cycles:
        return ""
    reason = max(counts, key=lambda text: counts[text]).rstrip("?")
    return f"The controller's health was not nominal in {total} of {cycles} cycles, most often {reason}."


def _delay(summary: Mapping[str, Any]) -> list[str]:
    """Tell the delay from estimate to effect, and how many plans came after their start."""
    delay_s = _figure(summary, "end_to_end_delay_s", "median")
    if math.isnan(delay_s):
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


def _figure(summary: Mapping[str, Any], group: str, name: str) -> float:
    """Return a figure, or NaN where a summary that was cut off lacks it: no condition on it holds."""
    value: float | None = summary.get(group, {}).get(name)
    return math.nan if value is None else value
