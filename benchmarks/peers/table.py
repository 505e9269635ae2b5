"""Comparison as a markdown table: time beside closed-loop error, settings and machine below."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from benchmarks.peers.loop import Held
from services.tools.profile.machine_description import Machine
from services.tools.profile.machine_description import line as machine_line
from services.tools.profile.run import Spread


@dataclass(frozen=True)
class Line:
    """One tool."""

    name: str
    solves: str  # QP or NLP
    settings: str
    cycle_us: Spread  # interleaved; the three states of the caches are those of services/tools/profile/measure.py
    repeated_us: Spread
    flushed_us: Spread
    thrust_error_N: Spread
    held: dict[str, Held]  # by kind of episode


def markdown(
    lines: Sequence[Line], *, title: str, notes: Sequence[str], machine: Machine, packages: Sequence[str]
) -> str:
    """Format the table in Markdown; other times are multiples of the first line's."""
    kinds = list(lines[0].held)
    head = ["", "solves", "cycle, median (ms)", "p99 (ms)", "times the first: hot, turns, cold"]
    head += ["first thrust off, p99 (N)", *(f"{kind}: off the line (m)" for kind in kinds)]
    head += ["mean abs F (N)", "without a solution"]
    out = [f"# {title}", "", _row(head), "|" + "---|" * len(head)]
    for line in lines:
        unsolved = sum(held.unsolved for held in line.held.values())
        thrust = " / ".join(f"{line.held[kind].thrust_N:.1f}" for kind in kinds)
        out.append(
            _row(
                [
                    line.name,
                    line.solves,
                    _ms(line.cycle_us.median),
                    _ms(line.cycle_us.p99),
                    ", ".join(
                        f"{own.median / first.median:.3g}"
                        for own, first in zip(_cycle_times(line), _cycle_times(lines[0]), strict=True)
                    ),
                    f"{line.thrust_error_N.p99:.2g}" if line.solves == "QP" else "",
                    *(f"{line.held[kind].off_m:.3f}" for kind in kinds),
                    thrust,
                    str(unsolved),
                ]
            )
        )
    out += ["", *notes, "", "| | settings |", "|---|---|"]
    out += [_row([line.name, line.settings]) for line in lines]
    out += ["", "Measured on: " + machine_line(machine, packages) + f"; commit {machine['commit']}."]
    return "\n".join(out) + "\n"


def _cycle_times(line: Line) -> tuple[Spread, Spread, Spread]:
    """Return the times of a cycle repeated, interleaved and flushed."""
    return line.repeated_us, line.cycle_us, line.flushed_us


def _row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _ms(us: float) -> str:
    return f"{us / 1000:.3g}"
