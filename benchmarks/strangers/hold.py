"""Station keeping of all hulls, with estimates of a point that no file declares and in water that nobody tells of.

Each row is flown for three minutes from several starts. In the third minute

    heading     changes by at most 90 degrees, unwrapped
    force       mean |F| of a thruster is at most 1.3 times what the current needs, and 2 % of the largest thrust
    distance    the estimated point stays within max(offset, tolerance) + 0.1 m of the target

and with white noise of 0.3 m on the position and no covariance mean |F| is at most 15 % of the largest thrust. The
share of a figure is its value over its limit, and that of a row its largest one over all starts: above 1 the row fails.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from benchmarks.batch import in_order
from benchmarks.strangers import drawn
from benchmarks.strangers.flight import FOREIGN, SHIPPED, Conditions, Ours, Start, fly, load
from ltv_mpc.references import Point

TURN_DEG, NEEDED_TIMES, THRUST_SHARE, NOISE_THRUST_SHARE = 90.0, 1.3, 0.02, 0.15
MARGIN_M, TOLERANCE_M = 0.1, 0.1
BEGIN_S, END_S = 120.0, 180.0
NOISE_M = 0.3

OFFSETS_M = (0.05, 0.1, 0.15, 0.25)
DIRECTIONS = ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0))  # ahead, astern, abeam
CURRENTS_MPS = (0.0, 0.05, 0.1, 0.3)
STARTS, WORST_STARTS, WORST_ROWS = 3, 20, 20
TARGET = 0.0, 0.0


class Row(NamedTuple):
    """One row of the matrix."""

    vehicle: str
    ahead_m: float = 0.0
    starboard_m: float = 0.0
    current_mps: float = 0.0
    reports: bool = True
    noise_m: float = 0.0

    @property
    def conditions(self) -> Conditions:
        """Conditions of its flights."""
        return Conditions(
            offset_m=(self.ahead_m, self.starboard_m),
            current_mps=self.current_mps,
            reports_s=float("inf") if self.reports else 0.0,
            noise_m=self.noise_m,
        )


class Figures(NamedTuple):
    """Figures of one flight, and the largest share of a limit."""

    turned_deg: float
    force_N: float
    distance_m: float
    share: float


def matrix() -> list[Row]:
    """Return all rows."""
    vehicles = [*FOREIGN, *SHIPPED]
    points = [(0.0, 0.0), *((a * m, s * m) for m in OFFSETS_M for a, s in DIRECTIONS)]
    return [
        Row(vehicle, *point, current, reports)
        for vehicle in vehicles
        for point in points
        for current in CURRENTS_MPS
        for reports in (True, False)
    ] + [Row(vehicle, reports=reports, noise_m=NOISE_M) for vehicle in vehicles for reports in (True, False)]


def drawn_rows(hulls: int) -> list[Row]:
    """Return a row for each of so many hulls that are drawn at random; their points and currents take turns."""
    points = [(a * m, s * m) for m in OFFSETS_M for a, s in DIRECTIONS]
    return [
        Row(f"{drawn.NAME}{i}", *points[i % len(points)], CURRENTS_MPS[i // 2 % len(CURRENTS_MPS)], reports=i % 2 == 0)
        for i in range(hulls)
    ]


def judge(row: Row, seed: int) -> Figures:
    """Fly a row from one start and return its figures."""
    hull, vehicle = load(row.vehicle)
    pilot = Ours(vehicle, Point(north_m=TARGET[0], east_m=TARGET[1]))
    flight = fly(row.vehicle, pilot, row.conditions, Start.drawn(seed), duration_s=END_S)
    turned, force = flight.turned_deg(BEGIN_S, END_S), flight.mean_N(BEGIN_S, END_S)
    distance = float(flight.distance_m(TARGET, BEGIN_S, END_S).max())
    if row.noise_m:
        return Figures(turned, force, distance, force / (NOISE_THRUST_SHARE * hull.max_N))
    limit_N = NEEDED_TIMES * flight.needed_N + THRUST_SHARE * hull.max_N
    limit_m = max(abs(row.ahead_m), abs(row.starboard_m), TOLERANCE_M) + MARGIN_M
    return Figures(turned, force, distance, max(turned / TURN_DEG, force / limit_N, distance / limit_m))


def _judge(job: tuple[Row, int]) -> Figures:
    return judge(*job)


def fly_rows(rows: Sequence[Row], seeds: range, workers: int | None) -> dict[Row, list[Figures]]:
    """Fly each row from each start, on some processes."""
    flown = in_order(_judge, [(row, seed) for row in rows for seed in seeds], workers=workers)
    return {row: flown[i * len(seeds) : (i + 1) * len(seeds)] for i, row in enumerate(rows)}


def share(figures: Sequence[Figures]) -> float:
    """Return the largest share over all starts."""
    return max(one.share for one in figures)


def run(rows: Sequence[Row], *, starts: int = STARTS, workers: int | None = None) -> dict[Row, list[Figures]]:
    """Fly all rows from a few starts, and the worst ones from more."""
    found = fly_rows(rows, range(starts), workers)
    worst = sorted(found, key=lambda row: -share(found[row]))[:WORST_ROWS]
    for row, figures in fly_rows(worst, range(starts, max(starts, WORST_STARTS)), workers).items():
        found[row] += figures
    return found


HEADER = (
    "| vehicle | ahead (m) | starboard (m) | current (m/s) | reports | noise (m) | turned (deg) | mean F (N) "
    "| distance (m) | times the limit | failing starts |\n|---|---|---|---|---|---|---|---|---|---|---|"
)


def line(row: Row, figures: Sequence[Figures]) -> str:
    """Return a row of the table: the figures of its worst start."""
    worst = max(figures, key=lambda one: one.share)
    failing = sum(one.share > 1.0 for one in figures)
    return (
        f"| {row.vehicle} | {row.ahead_m:g} | {row.starboard_m:g} | {row.current_mps:g} | "
        f"{'yes' if row.reports else 'no'} | {row.noise_m:g} | {worst.turned_deg:.0f} | {worst.force_N:.2f} | "
        f"{worst.distance_m:.2f} | {worst.share:.1f} | {failing} of {len(figures)} |"
    )


def summary(found: dict[Row, list[Figures]]) -> str:
    """Return the rows that fail by vehicle, and the ten worst of all."""
    failing = {row: figures for row, figures in found.items() if share(figures) > 1.0}
    lines = [f"{len(failing)} of {len(found)} rows fail", "", "| vehicle | rows | fail |", "|---|---|---|"]
    for vehicle in dict.fromkeys(row.vehicle for row in found):
        of = [row for row in found if row.vehicle == vehicle]
        lines.append(f"| {vehicle} | {len(of)} | {sum(row in failing for row in of)} |")
    worst = sorted(found, key=lambda row: -share(found[row]))[:10]
    return "\n".join([*lines, "", "The ten worst rows", "", HEADER, *(line(row, found[row]) for row in worst)])


def report(found: dict[Row, list[Figures]]) -> str:
    """Return all failing rows, worst first, and the summary."""
    failing = sorted((row for row in found if share(found[row]) > 1.0), key=lambda row: -share(found[row]))
    return "\n".join([HEADER, *(line(row, found[row]) for row in failing), "", summary(found)])
