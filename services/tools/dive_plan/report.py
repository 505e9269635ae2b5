"""Plan of a dive as text and as plots, and the drift of a recorded run to lay over it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from itertools import cycle
from pathlib import Path

import numpy as np

from ltv_mpc.errors import ConfigError
from ltv_mpc.messages import Array, Estimate, Truth
from services.recording.acceptance import accepted
from services.recording.reader import StoredMessage
from services.reporting import report
from services.reporting.plots import palette
from services.reporting.plots.description import Axis, Level, Plot, Series, Style
from services.reporting.plots.table import Columns
from services.runtime.console import columns, counted
from services.tools.dive_plan.plan import POINTS, DivePlan, RecordedDrift

SECOND_NS = 1_000_000_000

AT_THE_END = "Expected drift; budget and changes at the end of the dive"
"""Heading of the plots."""

SHOWN_SHARE = 5e-4
"""Smallest share of the error budget that is shown."""


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
    end, at_the_end = of.drift_m[0][-1], f"{of.duration_s:.0f} s with {_names(of)[0]}"
    shares = [(name, f"{100 * share:.1f} %") for name, share in of.budget.items() if share >= SHOWN_SHARE]
    gains = [(name, f"{drift:.2f} m", f"{100 * (drift / end - 1):+.0f} %") for name, drift in of.gains_m.items()]
    lines = [
        f"dive of {of.duration_s:.0f} s to {of.depth_m:.0f} m, sensors {of.sensors}, "
        f"{counted(of.runs, 'simulated dive')}",
        "expected drift since submergence, standard deviation of one horizontal axis (m)",
        *columns(list(_drifts(of)), numbers=True),
        *("", f"error budget at {at_the_end}: share of the variance", *columns(shares, numbers=True)),
        *("", f"drift at {at_the_end} ({end:.2f} m) after one change", *columns(gains, numbers=True)),
    ]
    if of.against is not None:
        label = {"true": "error of the run", "reported": "drift that the filter of the run reports"}[of.against.kind]
        lines += ["", f"{label} at {of.against.t_s[-1]:.0f} s: {of.against.drift_m[-1]:.2f} m an axis"]
    if of.not_counted:
        lines.append(f"not counted: {', '.join(of.not_counted)}; with them the drift is smaller")
    return "\n".join(lines + [f"note: {note}" for note in of.notes])


def _drifts(of: DivePlan) -> Iterator[tuple[str, ...]]:
    """Yield the rows of the drift over time, the head first."""
    shown, limit_m = [POINTS * k // 4 - 1 for k in range(1, 5)], of.limit_m
    limited = () if limit_m is None else (f"{limit_m:g} m reached",)
    yield "", *(f"{of.t_s[k]:.0f} s" for k in shown), "95 % within", *limited
    for name, drifts, radius, when in zip(_names(of), of.drift_m, of.radius_95_m, of.limit_reached_s, strict=True):
        reached = "not in the dive" if when is None else f"after {when:.0f} s"
        yield name, *(f"{drifts[k]:.2f}" for k in shown), f"{radius:.2f} m", *(limited and (reached,))


def write(of: DivePlan, out: Path) -> None:
    """Write the plots: drift over time, error budget, and drift after each change. Raises ``NoPlotly``."""
    title = f"{of.duration_s:.0f} s to {of.depth_m:.0f} m, sensors {of.sensors}"
    names = _names(of)
    shares = {name: 100.0 * share for name, share in of.budget.items() if share >= SHOWN_SHARE}
    gains = {"as planned": of.drift_m[0][-1], **of.gains_m}
    run = Series(f"run, {of.against.kind if of.against else ''}", "run", "t_s", "drift_m", palette.TRUTH)
    colours = zip(names, cycle(palette.RUNS), strict=False)
    plots = (
        Plot(
            name="drift",
            title="Drift since submergence, one axis",
            y=Axis("standard deviation (m)"),
            group=AT_THE_END,
            series=(*(Series(name, name, "t_s", "drift_m", colour) for name, colour in colours), run),
            levels=(Level("limit", "limit_m", palette.LIMIT),),
        ),
        _by_row("budget", f"Error budget with {names[0]}", "share of the variance (%)", shares),
        _by_row("gains", "Drift after one change", "standard deviation (m)", gains),
    )
    tables: dict[str, Columns] = {
        name: {"t_s": [0.0, *of.t_s], "drift_m": [0.0, *drifts]} for name, drifts in zip(names, of.drift_m, strict=True)
    }
    for name, values in (("budget", shares), ("gains", gains)):
        tables[name] = {"value": list(values.values()), "row": [float(i) for i in range(len(values))]}
    tables["run"] = {} if of.against is None else {"t_s": [*of.against.t_s], "drift_m": [*of.against.drift_m]}
    report.write_plots(out, title, plots, tables, values={} if of.limit_m is None else {"limit_m": of.limit_m})


def _by_row(name: str, title: str, label: str, values: Mapping[str, float]) -> Plot:
    """Return the plot of one value for each row."""
    series = (Series("", name, "value", "row", palette.OTHER, Style.DOT),)
    rows = Axis("", downwards=True, rows=tuple(values))
    return Plot(name=name, title=title, x=Axis(label), y=rows, group=AT_THE_END, series=series)


def _names(of: DivePlan) -> list[str]:
    return [counted(n, "fix", "fixes") for n in of.fixes]
