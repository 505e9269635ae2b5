"""Comparison table of several runs: figures of summary.json side by side, with differences to the first run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import msgspec


class Figure(msgspec.Struct, frozen=True):
    """Definition of a table row: ``path`` into summary.json and ``scale`` from its unit to ``unit``."""

    label: str
    unit: str
    path: tuple[str, ...]
    digits: int
    scale: float = 1.0


FIGURES = (
    Figure("simulated time", "s", ("duration_s",), 1),
    Figure("tracking error, mean", "m", ("tracking_error_m", "mean"), 3),
    Figure("tracking error, largest", "m", ("tracking_error_m", "max"), 3),
    Figure("true error, mean", "m", ("true_error_m", "mean"), 3),
    Figure("true error since t = 0, mean", "m", ("true_error_drift_m", "mean"), 3),
    Figure("true error, largest", "m", ("true_error_m", "max"), 3),
    Figure("localisation error, mean", "m", ("localisation_error_m", "mean"), 3),
    Figure("localisation error, at the end", "m", ("localisation_error_m", "final"), 3),
    Figure("lateral thrust, mean |F|", "N", ("thrust", "mean_abs_N"), 1),
    Figure("lateral thrust, largest", "N", ("thrust", "max_abs_N"), 1),
    Figure("propulsive energy", "J", ("thrust", "propulsive_energy_J"), 0),
    Figure("propulsive energy, lateral", "J", ("thrust", "lateral_energy_J"), 0),
    Figure("relative power, lateral", "%", ("thrust", "relative_power"), 2, 100.0),
    Figure("lateral thrust saturated", "%", ("thrust", "saturated_fraction"), 1, 100.0),
    Figure("vertical thrust saturated", "%", ("thrust", "vertical_saturated_fraction"), 1, 100.0),
    Figure("cycle, median", "ms", ("compute_delay_wall_s", "median"), 2, 1e3),
    Figure("cycle, p99", "ms", ("compute_delay_wall_s", "p99"), 2, 1e3),
    Figure("end to end, median", "s", ("end_to_end_delay_s", "median"), 3),
    Figure("cycles", "", ("cycles",), 0),
    Figure("plans too late", "", ("deadline_misses",), 0),
    Figure("plans rejected", "", ("plans_refused",), 0),
    Figure("messages dropped", "", ("messages", "dropped"), 0),
    Figure("messages rejected", "", ("messages", "rejected"), 0),
    Figure("messages denied", "", ("messages", "denied"), 0),
    Figure("restarts", "", ("restarts",), 0),
)


class Row(msgspec.Struct, frozen=True, kw_only=True):
    """One figure of every run (None if a run lacks it) and the difference of each later run to the first."""

    label: str
    unit: str
    digits: int
    values: tuple[float | None, ...]
    differences: tuple[float | None, ...]


def rows(summaries: Sequence[Mapping[str, Any]]) -> list[Row]:
    """Return a row for each figure that at least one run has."""
    further = dict.fromkeys(name for summary in summaries for name in summary.get("further", {}))
    named = (Figure(name, "", ("further", name), 3) for name in further)
    table = (_row(figure, summaries) for figure in (*FIGURES, *named))
    return [row for row in table if any(value is not None for value in row.values)]


def _row(figure: Figure, summaries: Sequence[Mapping[str, Any]]) -> Row:
    values = tuple(_value(figure, summary) for summary in summaries)
    first = values[0]
    return Row(
        label=figure.label,
        unit=figure.unit,
        digits=figure.digits,
        values=values,
        differences=tuple(None if first is None or value is None else value - first for value in values[1:]),
    )


def _value(figure: Figure, summary: Mapping[str, Any]) -> float | None:
    value: Any = summary
    for key in figure.path:
        value = value.get(key) if isinstance(value, Mapping) else None
    return None if not isinstance(value, int | float) else value * figure.scale


def table(names: Sequence[str], figures: Sequence[Row]) -> list[list[str]]:
    """Return the rows of the table, the head first: one column for each run, then the differences to the first."""
    head = ["figure", *names, *(f"{name} - first" for name in names[1:])]
    return [head, *map(_cells, figures)]


def _cells(row: Row) -> list[str]:
    return [
        f"{row.label} ({row.unit})" if row.unit else row.label,
        *("-" if value is None else f"{value:.{row.digits}f}" for value in row.values),
        *("-" if value is None else f"{value:+.{row.digits}f}" for value in row.differences),
    ]
