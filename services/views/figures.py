"""The README's picture, from recordings of real runs: tracks from above, error over time, thrusts with their limits.

    python -m services.views.figures OUT.png RUN RUN ...

Each RUN is a run's folder. The last one is shown in the lower panels.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import numpy as np

from ltv_mpc.signals import Applied, Array, Estimate, Plan, Truth
from ltv_mpc.vehicle.parameters import Vehicle
from services.recording.reader import Recording

mpl.use("Agg")
import matplotlib.pyplot as plt

COLOURS = ("#999999", "#E69F00", "#0072B2", "#009E73")
"""Okabe and Ito: told apart by the colour-blind, and in grey."""


@dataclass(frozen=True)
class Series:
    """What the picture needs of one run, t > 0; columns as named."""

    label: str
    truth: Array  # t (s), north, east (m) from where it was at t = 0
    estimate: Array  # t (s), distance from the reference (m), its sigma (m), distance of the truth from the line (m)
    command: Array  # t (s), port, starboard (N)
    limits: tuple[float, float]


def read(folder: Path) -> Series:
    """The series of a run."""
    truth, estimates, commands = [], [], []
    reference: tuple[float, float] | None = None
    horizon_s, lateral = 0.0, False
    for message in Recording(folder / "run.mcap"):
        if message.kind not in (Truth, Estimate, Plan, Applied):
            continue
        signal, _ = message.typed()
        match signal:
            case Plan():
                reference = reference or signal.reference_m
                horizon_s, lateral = (signal.t_ns[-1] - signal.t_ns[0]) * 1e-9, lateral or signal.origin == "solved"
            case Truth() if signal.t_ns >= 0 and signal.t_ns % 100_000_000 == 0:
                truth.append((signal.t_ns * 1e-9, *signal.position_m[:2]))
            case Estimate() if signal.t_ns >= 0:
                spread = 0.0 if signal.covariance is None else np.linalg.eigvalsh(signal.covariance[:2, :2])[-1]
                estimates.append((signal.t_ns * 1e-9, signal.north_m, signal.east_m, np.sqrt(max(spread, 0.0))))
            case Applied() if signal.t_ns >= 0:
                commands.append((signal.t_ns * 1e-9, *signal.command_N[:2]))
    where, belief, command = np.array(truth), np.array(estimates), np.array(commands)
    where[:, 1:] -= where[0, 1:]
    north, east = reference or (belief[0, 1], belief[0, 2])
    error = np.hypot(belief[:, 1] - north, belief[:, 2] - east)
    true = np.interp(belief[:, 0], where[:, 0], np.hypot(where[:, 1], where[:, 2]))
    port = Vehicle.load(str(folder / "config" / "vehicle.toml")).thruster.port
    label = f"horizon {horizon_s:.1f} s" if lateral else "no control"
    return Series(
        label, where, np.column_stack([belief[:, 0], error, belief[:, 3], true]), command, (port.min_N, port.max_N)
    )


def draw(runs: list[Series], out: Path) -> None:
    """Three panels, readable at the width of a page."""
    plt.rcParams.update({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False})
    figure = plt.figure(figsize=(9.0, 4.6), layout="constrained")
    grid = figure.add_gridspec(2, 2, width_ratios=(1.0, 1.35))
    above = figure.add_subplot(grid[:, 0])
    for run, colour in zip(runs, COLOURS, strict=False):
        above.plot(run.truth[:, 2], run.truth[:, 1], color=colour, linewidth=1.3, label=run.label)
        above.plot(*run.truth[-1, [2, 1]], "o", color=colour, markersize=4)
    above.plot(0, 0, "k+", markersize=9, label="line to hold")
    above.set(xlabel="east (m)", ylabel="north (m)", title="true track from above", aspect="equal")
    above.set_aspect("equal", adjustable="datalim")
    above.legend(frameon=False, loc="best")
    last, colour = runs[-1], COLOURS[min(len(runs), len(COLOURS)) - 1]
    t, error, sigma, true = last.estimate.T
    over_time = figure.add_subplot(grid[0, 1])
    # sigma of the drift since t = 0: the error of the last fix is common to both ends
    drift = np.sqrt((sigma**2 - sigma[0] ** 2).clip(0))
    over_time.fill_between(t, 0, 2 * drift, color=colour, alpha=0.2, linewidth=0)
    over_time.fill_between(t, 0, error, color=colour, alpha=0.9, linewidth=0, label="estimate from the line")
    over_time.plot(t, true, color="black", linewidth=1.1, label="truth from the line")
    over_time.plot([], [], color=colour, alpha=0.3, linewidth=6, label="2 sigma of the filter, since t = 0")
    over_time.set(ylabel="distance (m)", title=f"{last.label}: error", xlim=(0, t[-1]))
    over_time.set_ylim(bottom=0)
    over_time.legend(frameon=False, loc="upper right")
    thrust = figure.add_subplot(grid[1, 1], sharex=over_time)
    for column, name, shade in ((1, "port", "#D55E00"), (2, "starboard", "#56B4E9")):
        thrust.plot(last.command[:, 0], last.command[:, column], color=shade, linewidth=0.9, label=name)
    for limit in last.limits:
        thrust.axhline(limit, color="black", linewidth=0.8, linestyle=":")
    thrust.set(xlabel="time (s)", ylabel="thrust (N)", title="commands, with their limits")
    thrust.set_ylim(1.1 * last.limits[0], 1.45 * last.limits[1])
    thrust.legend(frameon=False, loc="upper right", ncols=2)
    figure.savefig(out, dpi=160)
    plt.close(figure)


def main() -> None:
    """OUT.png, then the runs' folders."""
    out, *folders = map(Path, sys.argv[1:])
    draw([read(folder) for folder in folders], out)


if __name__ == "__main__":
    main()
