"""Tables of docs/paper.md, which are stored in figures.json and written into the page at their marks."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import msgspec

from benchmarks.page_tables import Table
from benchmarks.paper.settings import COMPUTING_S, RECORDED
from benchmarks.paper.sheets import NONE
from benchmarks.paper.timing import Timed
from sim.evaluation.summary import Summary

# --- what stands in them ---------------------------------------------------------------------------------------------


def descents(summaries: Mapping[str, Summary]) -> Table:
    """Tabulate the recorded runs of the figures."""
    return Table(
        name="descents",
        head=(
            *("one descent, full loop", "horizon (s)", "delay (s)", "tracking (m)", "localisation (m)"),
            *("true error (m)", "mean abs F (N)", "saturated (%)"),
        ),
        digits=(0, 1, 2, 3, 3, 3, 1, 1),
        rows=tuple(
            (
                name,
                *_setting(key, summaries[key]),
                summaries[key].tracking_error_m.mean,
                summaries[key].localisation_error_m.mean,
                summaries[key].true_error_m.mean,
                *_effort(summaries[key]),
            )
            for key, name, *_ in RECORDED
        ),
    )


def timing(timed: Timed) -> Table:
    """Tabulate the paper's computing times and this controller's on this machine."""
    return Table(
        name="timing",
        head=(
            f"{timed.machine['cores']} cores, {_load(timed)}",
            "the paper, 2012 (ms)",
            "median (ms)",
            "p99 (ms)",
            "largest (ms)",
            "cycles",
        ),
        digits=(0, 0, 3, 3, 3, 0),
        rows=tuple(
            (
                f"{cycle.horizon_s:g} s: {cycle.samples.stages} stages, {cycle.reach_s:.1f} s",
                COMPUTING_S[cycle.horizon_s] * 1e3,
                cycle.cycle_us.median / 1e3,
                cycle.cycle_us.p99 / 1e3,
                cycle.cycle_us.max / 1e3,
                float(len(cycle.samples.cycle_us)),
            )
            for cycle in timed.cycles
        ),
    )


def _load(timed: Timed) -> str:
    """Return the load of the machine before and after the measurement (mean of one minute)."""
    loads = [timed.machine[when] for when in ("load_before", "load_after")]
    return "load " + " to ".join(f"{load[0]:.1f}" for load in loads if isinstance(load, list))


def _setting(key: str, summary: Summary) -> tuple[float | None, float | None]:
    """Return horizon and delay; None for both without control."""
    return (None, None) if key == NONE else (summary.horizon_s, summary.compute_delay_s.median)


def _effort(summary: Summary) -> tuple[float | None, float]:
    """Return mean |F| (N), and the share of the time at a limit in per cent."""
    return summary.thrust.mean_abs_N, 100.0 * (summary.thrust.saturated_fraction or 0.0)


# --- where they stand ------------------------------------------------------------------------------------------------


class Figures(msgspec.Struct, frozen=True, kw_only=True):
    """Content of figures.json."""

    made_with: str  # options that change numbers
    machine: str  # on which the times were measured
    tables: tuple[Table, ...]

    def write(self, path: Path) -> None:
        """Write the tables as JSON."""
        path.write_bytes(msgspec.json.format(msgspec.json.encode(self), indent=1) + b"\n")

    @classmethod
    def load(cls, path: Path) -> Figures:
        """Read the tables from JSON."""
        return msgspec.json.decode(path.read_bytes(), type=cls)
