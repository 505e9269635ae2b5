"""Plan of a dive as text and as a picture, and the drift of a recorded run to lay over it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ltv_mpc.errors import ConfigError
from ltv_mpc.messages import Array, Estimate, Truth
from services.recording.acceptance import accepted
from services.recording.reader import StoredMessage
from services.reporting.plots import palette
from services.runtime.console import counted
from services.tools.dive_plan.plan import POINTS, DivePlan, RecordedDrift

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SECOND_NS = 1_000_000_000

SHOWN_SHARE = 5e-4
"""Smallest share of the error budget that is shown."""

DASHES = ("-", "--", "-.", ":")


def recorded_drift(messages: Iterable[StoredMessage]) -> RecordedDrift:
    """Return the drift of a recorded run at whole seconds. Raises ``ConfigError`` if it has no estimates after t = 0.

    With the truth of a simulation it is the error; otherwise it is sigma by the filter's own covariance P of the
    position,  sqrt((tr P(t) - tr P(0)) / 2).
    """
    truth: dict[int, Array] = {}
    estimate: dict[int, Array] = {}
    variance: dict[int, float] = {}
    for content, _, _ in accepted(messages, (Truth, Estimate)):
        match content:
            case Truth(t_ns=t_ns) if t_ns >= 0 and t_ns % SECOND_NS == 0:
                truth[t_ns] = np.array(content.position_m[:2])
            case Estimate(t_ns=t_ns) if t_ns >= 0 and t_ns % SECOND_NS == 0:
                estimate[t_ns] = np.array([content.north_m, content.east_m])
                if content.covariance is not None:
                    P = np.array(content.covariance).reshape(6, 6)
                    variance[t_ns] = 0.5 * float(P[0, 0] + P[1, 1])
    for kind, times in (("true", truth.keys() & estimate.keys()), ("reported", variance.keys())):
        if len(times) > 1:
            first, *after = sorted(times)
            if kind == "true":
                start = estimate[first] - truth[first]
                errors = [float(np.sqrt(np.mean((estimate[t] - truth[t] - start) ** 2))) for t in after]
            else:
                errors = [math.sqrt(max(variance[t] - variance[first], 0.0)) for t in after]
            return RecordedDrift(t_s=[t * 1e-9 for t in after], drift_m=errors, kind=kind)
    problem = "has no two estimates with a covariance or a truth at whole seconds from t = 0 on"
    raise ConfigError("option --against", "", problem)


def text(of: DivePlan) -> str:
    """Format the plan as tables."""
    names = _names(of)
    shown = [POINTS * k // 4 - 1 for k in range(1, 5)]
    lines = [
        f"dive of {of.duration_s:.0f} s to {of.depth_m:.0f} m, sensors {of.sensors}, "
        f"{counted(of.runs, 'simulated dive')}",
        "expected drift since submergence, standard deviation of one horizontal axis (m)",
        "  ".join([f"{'':12}", *(f"{of.t_s[k]:>6.0f} s" for k in shown), f"{'95 % within':>12}"])
        + (f"  {of.limit_m:g} m reached" if of.limit_m is not None else ""),
    ]
    for name, drifts, radius, when in zip(names, of.drift_m, of.radius_95_m, of.limit_reached_s, strict=True):
        row = "  ".join([f"{name:12}", *(f"{drifts[k]:>8.2f}" for k in shown), f"{radius:>10.2f} m"])
        reached = "" if of.limit_m is None else "  not in the dive" if when is None else f"  after {when:.0f} s"
        lines.append(row + reached)
    end, first = of.drift_m[0][-1], names[0]
    lines += ["", f"error budget at {of.duration_s:.0f} s with {first}: share of the variance"]
    lines += [f"{name:36} {100 * share:5.1f} %" for name, share in of.budget.items() if share >= SHOWN_SHARE]
    lines += ["", f"drift at {of.duration_s:.0f} s with {first} ({end:.2f} m) after one change"]
    lines += [f"{name:36} {drift:5.2f} m  {100 * (drift / end - 1):+4.0f} %" for name, drift in of.gains_m.items()]
    if of.against is not None:
        label = {"true": "error of the run", "reported": "drift that the filter of the run reports"}[of.against.kind]
        lines += ["", f"{label} at {of.against.t_s[-1]:.0f} s: {of.against.drift_m[-1]:.2f} m an axis"]
    if of.not_counted:
        lines.append(f"not counted: {', '.join(of.not_counted)}; with them the drift is smaller")
    return "\n".join(lines + [f"note: {note}" for note in of.notes])


def draw(of: DivePlan, out: Path) -> None:
    """Write the picture: drift over time, error budget, and drift after each change."""
    from matplotlib.figure import Figure

    from services.reporting import sheet

    with sheet.style(page=True):
        figure = Figure(figsize=(sheet.PAGE_IN, 7.4), layout="constrained")
        over_time, budget, gains = figure.subplots(3, 1, height_ratios=(1.3, 1.3, 0.8))
        for name, line, colour, dash in zip(_names(of), of.drift_m, cycle(palette.RUNS), cycle(DASHES), strict=False):
            over_time.plot([0.0, *of.t_s], [0.0, *line], label=name, color=colour, linestyle=dash)
        if of.limit_m is not None:
            over_time.axhline(of.limit_m, color=palette.LIMIT, linestyle=":", label=f"limit {of.limit_m:g} m")
        if of.against is not None:
            over_time.plot(of.against.t_s, of.against.drift_m, color=palette.TRUTH, label=f"run, {of.against.kind}")
        over_time.set(xlabel="time (s)", ylabel="standard deviation (m)")
        sheet.legend_above(over_time, "Drift since submergence, one axis")
        shares = {name: share for name, share in of.budget.items() if share >= SHOWN_SHARE}
        _bars(budget, {name: 100.0 * share for name, share in shares.items()}, "%.0f")
        budget.set_title(f"Error budget with {_names(of)[0]}")
        budget.set_xlabel("share of the variance at the end (%)")
        _bars(gains, {"as planned": of.drift_m[0][-1], **of.gains_m}, "%.2f")
        gains.set_title("Drift after one change")
        gains.set_xlabel("standard deviation at the end (m)")
        figure.suptitle(f"{of.duration_s:.0f} s to {of.depth_m:.0f} m, sensors {of.sensors}")
        sheet.write(figure, [out])


def _bars(panel: Axes, values: Mapping[str, float], label: str) -> None:
    drawn = panel.barh(list(values), list(values.values()), color=palette.OTHER, height=0.6)
    panel.bar_label(drawn, fmt=label, padding=3)
    panel.invert_yaxis()
    panel.margins(x=0.1)
    panel.grid(visible=False, axis="y")


def _names(of: DivePlan) -> list[str]:
    return [counted(n, "fix", "fixes") for n in of.fixes]
