"""Plot of a recorded dive: horizontal track, error over time with its standard deviation, current over depth."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes

from ltv_mpc.localisation.recorded_dive.filter import Track
from ltv_mpc.messages import Array

mpl.use("Agg")
import matplotlib.pyplot as plt

ESTIMATE, CONSTANT, EAST = "#0072B2", "#E69F00", "#D55E00"
"""Colours of Okabe and Ito, distinct for colour-blind readers and in grey; bottom track is black."""


class PlotData(Protocol):
    """Data of the plot."""

    @property
    def track(self) -> Track:
        """Track of the filter."""

    @property
    def truth_m(self) -> Array:
        """Positions from bottom track, (N, 2), NaN if unknown."""

    @property
    def constant_velocity_mps(self) -> Array | None:
        """Mean velocity of the fixes, (2,)."""


def draw(data: PlotData, out: Path) -> None:
    """Write the plot."""
    plt.rcParams.update({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False})
    figure = plt.figure(figsize=(9.0, 4.6), layout="constrained")
    grid = figure.add_gridspec(2, 2, width_ratios=(1.0, 1.2))
    _above(figure.add_subplot(grid[:, 0]), data)
    _error(figure.add_subplot(grid[0, 1]), data)
    _water(figure.add_subplot(grid[1, 1]), data.track)
    figure.savefig(out, dpi=160)
    plt.close(figure)


def _above(panel: Axes, data: PlotData) -> None:
    track, truth, constant = data.track, data.truth_m, data.constant_velocity_mps
    panel.plot(truth[:, 1], truth[:, 0], color="black", linewidth=1.1, label="bottom track")
    panel.plot(track.position_m[:, 1], track.position_m[:, 0], color=ESTIMATE, linewidth=1.4, label="filter")
    if constant is not None:
        path = constant * track.t_s[:, None]
        panel.plot(path[:, 1], path[:, 0], color=CONSTANT, linewidth=1.0, linestyle="--", label="constant velocity")
    # {p + 3 L [cos a, sin a]} with P = L L^T
    spread, axes = np.linalg.eigh(track.position_covariance[-1])
    angle = np.linspace(0, 2 * np.pi, 90)
    ring = (
        track.position_m[-1] + 3 * (np.stack([np.cos(angle), np.sin(angle)], axis=1) * np.sqrt(spread.clip(0))) @ axes.T
    )
    panel.plot(ring[:, 1], ring[:, 0], color=ESTIMATE, linewidth=0.8, linestyle=":", label="3 sigma at the end")
    panel.plot(0, 0, "k+", markersize=9)
    panel.set(xlabel="east (m)", ylabel="north (m)", title="horizontal track")
    panel.set_aspect("equal", adjustable="datalim")
    panel.legend(frameon=False, loc="best")


def _error(panel: Axes, data: PlotData) -> None:
    track = data.track
    sigma = np.sqrt(np.linalg.eigvalsh(track.position_covariance)[:, -1].clip(0))
    panel.fill_between(track.t_s, 0, 3 * sigma, color=ESTIMATE, alpha=0.2, linewidth=0, label="3 sigma")
    error = np.hypot(*(track.position_m - data.truth_m).T)
    panel.plot(track.t_s, error, color=ESTIMATE, linewidth=1.3, label="filter from bottom track")
    if data.constant_velocity_mps is not None:
        constant = np.hypot(*(data.constant_velocity_mps * track.t_s[:, None] - data.truth_m).T)
        panel.plot(track.t_s, constant, color=CONSTANT, linewidth=1.0, linestyle="--", label="constant velocity")
    panel.set(xlabel="time (s)", ylabel="distance (m)", title="position error against bottom track")
    panel.set_ylim(bottom=0)
    panel.legend(frameon=False, loc="upper left")


def _water(panel: Axes, track: Track) -> None:
    water = track.water
    for name, velocity, colour in (("north", water.north_mps, ESTIMATE), ("east", water.east_mps, EAST)):
        panel.fill_betweenx(
            water.depth_m, velocity - water.sd_mps, velocity + water.sd_mps, color=colour, alpha=0.2, linewidth=0
        )
        style = "-" if name == "north" else "--"
        panel.plot(velocity, water.depth_m, color=colour, linewidth=1.2, linestyle=style, label=f"{name}, with 1 sigma")
    panel.invert_yaxis()
    panel.set(xlabel="current (m/s)", ylabel="depth (m)", title="current at the end")
    panel.legend(frameon=False, loc="best")
