"""Text table of a latency profile: cycles, their stages, and the machine."""

from __future__ import annotations

from collections.abc import Sequence

from services.runtime.console import fold
from services.tools.profile import machine_description
from services.tools.profile.measure import STAGES
from services.tools.profile.run import Profile, Row

NAMES = f"{'horizon':<18} {'solver':<17}"


def text(profile: Profile) -> str:
    """Format the tables: times in microseconds, errors in newtons."""
    kinds = ", ".join(f"{count} {kind}" for kind, count in profile.problems.items())
    return "\n".join(
        [
            *_cycles(profile.rows),
            "",
            *_stages(profile.rows),
            "",
            *map(
                fold,
                (
                    f"cycles at each horizon: {kinds}; solvers interleaved, in a new random order each cycle",
                    "hot: the same cycle repeated at once; turns: after the other candidates; cold: after a flush of"
                    " caches",
                    "a service sees cold: between two of its cycles other processes use the caches",
                    "off: of the first free thrust from the exact solution of the same QP; of PIQP: whole cycle over"
                    " that of PIQP native, by its own interface, in the same column",
                    machine_description.line(profile.machine),
                ),
            ),
        ]
    )


def _cycles(rows: Sequence[Row]) -> list[str]:
    times = f"{'hot':>7} {'turns':>7} {'cold':>7} {'p99':>7} {'max':>6}"
    ratios = f"{'hot':>5} {'turns':>5} {'cold':>5} {'p99':>5}"
    lines = [
        f"{'':<36} {'cycle (us): medians, of turns':^38}  {'of PIQP':^23}  {'iterations':^11}  {'thrust off (N)':^23}",
        f"{NAMES} {times}  {ratios}  {'median':>6} {'p99':>4}  {'median':>7} {'p99':>7} {'max':>7}  status",
    ]
    for row in rows:
        hot, turns, cold, i, e = row.repeated_us, row.cycle_us, row.flushed_us, row.iterations, row.thrust_error_N
        lines.append(
            f"{_names(row)} {hot.median:>7.0f} {turns.median:>7.0f} {cold.median:>7.0f} {turns.p99:>7.0f}"
            f" {turns.max:>6.0f}  {row.repeated_ratio.median:>5.2f} {row.ratio.median:>5.2f}"
            f" {row.flushed_ratio.median:>5.2f} {row.ratio.p99:>5.2f}  {i.median:>6.0f} {i.p99:>4.0f}"
            f"  {_newton(e.median)} {_newton(e.p99)} {_newton(e.max)}"
            f"  {', '.join(f'{name} {count}' for name, count in row.status.items())}"
        )
    return lines


def _stages(rows: Sequence[Row]) -> list[str]:
    heads = " ".join(f"{stage:>9}" for stage in STAGES)
    lines = [f"{'':<36} stages of a cycle interleaved, medians (us)", f"{NAMES} {heads}"]
    lines += [f"{_names(row)} " + " ".join(f"{row.stage_us[stage].median:>9.1f}" for stage in STAGES) for row in rows]
    return lines


def _names(row: Row) -> str:
    horizon = f"{row.stages} stages, {row.horizon_s:.1f} s"
    return f"{horizon:<18} {row.solver:<17}"


def _newton(error: float) -> str:
    return f"{error:>7.1e}" if 0 < error < 1e-3 else f"{error:>7.3f}"
