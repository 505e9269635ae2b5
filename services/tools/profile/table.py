"""Text table of a latency profile: cycles, their stages, and the machine."""

from __future__ import annotations

from collections.abc import Sequence

from services.runtime.console import columns, fold
from services.tools.profile import machine_description
from services.tools.profile.measure import STAGES
from services.tools.profile.run import Profile, Row

CYCLES = ("solver", "horizon", "hot", "turns", "cold", "p99", "max", *("of riccati: hot", "turns", "cold", "p99"),
          *("iterations", "p99"), *("off (N)", "p99", "max"), "status")  # fmt: skip


def text(profile: Profile) -> str:
    """Format the tables: times in microseconds, errors in newtons."""
    kinds = ", ".join(f"{count} {kind}" for kind, count in profile.problems.items())
    return "\n".join(
        [
            "cycle (us): medians, and p99 and max of turns",
            *columns([CYCLES, *map(_cycle, profile.rows)], numbers=True),
            "",
            "stages of a cycle in turns (us): medians",
            *columns([("solver", "horizon", *STAGES), *map(_stages, profile.rows)], numbers=True),
            "",
            *map(
                fold,
                (
                    f"cycles at each horizon: {kinds}; solvers interleaved, in a new random order each cycle",
                    "hot: the same cycle repeated at once; turns: after the other candidates; cold: after a flush of"
                    " caches",
                    "a service sees cold: between two of its cycles other processes use the caches",
                    "off: of the first free thrust from the exact solution of the same QP; of riccati: whole cycle"
                    " over that of riccati, in the same column",
                    machine_description.line(profile.machine),
                ),
            ),
        ]
    )


def _cycle(row: Row) -> Sequence[str]:
    hot, turns, cold, i, off = row.repeated_us, row.cycle_us, row.flushed_us, row.iterations, row.thrust_error_N
    times = (hot.median, turns.median, cold.median, turns.p99, turns.max)
    ratios = (*(of["median"] for of in (row.repeated_ratio, row.ratio, row.flushed_ratio)), row.ratio["p99"])
    return [
        *_names(row),
        *(f"{time:.0f}" for time in times),
        *(f"{ratio:.2f}" for ratio in ratios),
        *(f"{count:.0f}" for count in (i.median, i.p99)),
        *(f"{error:.1e}" if 0 < error < 1e-3 else f"{error:.3f}" for error in (off.median, off.p99, off.max)),
        ", ".join(f"{name} {count}" for name, count in row.status.items()),
    ]


def _stages(row: Row) -> Sequence[str]:
    return [*_names(row), *(f"{row.stage_us[stage].median:.1f}" for stage in STAGES)]


def _names(row: Row) -> tuple[str, str]:
    return row.solver, f"{row.stages} stages, {row.horizon_s:.1f} s"
