"""Plot of a recorded dive: horizontal track, error over time with its standard deviation, current over depth."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ltv_mpc.localisation.recorded_dive.filter import Track
from ltv_mpc.messages import Array
from services.reporting import sheet
from services.reporting.plots import palette


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
    with sheet.style(page=True):
        figure = Figure(figsize=(9.0, 5.0), layout="constrained")
        grid = figure.add_gridspec(2, 2, width_ratios=(1.0, 1.2))
        _above(figure.add_subplot(grid[:, 0]), data)
        _error(figure.add_subplot(grid[0, 1]), data)
        _water(figure.add_subplot(grid[1, 1]), data.track)
        sheet.write(figure, [out])


def _above(panel: Axes, data: PlotData) -> None:
    track, truth, constant = data.track, data.truth_m, data.constant_velocity_mps
    panel.plot(truth[:, 1], truth[:, 0], color=palette.TRUTH, label="bottom track")
    panel.plot(track.position_m[:, 1], track.position_m[:, 0], color=palette.ESTIMATE, label="filter")
    if constant is not None:
        path = constant * track.t_s[:, None]
        panel.plot(
            path[:, 1], path[:, 0], color=palette.OTHER, linewidth=1.0, linestyle="--", label="constant velocity"
        )
    # {p + 3 L [cos a, sin a]} with P = L L^T
    spread, axes = np.linalg.eigh(track.position_covariance[-1])
    angle = np.linspace(0, 2 * np.pi, 90)
    ring = (
        track.position_m[-1] + 3 * (np.stack([np.cos(angle), np.sin(angle)], axis=1) * np.sqrt(spread.clip(0))) @ axes.T
    )
    panel.plot(
        ring[:, 1],
        ring[:, 0],
        color=palette.ESTIMATE,
        linewidth=0.8,
        linestyle=":",
        label="3 sigma of the filter at the end",
    )
    panel.plot(0, 0, "+", color=palette.TRUTH, markersize=9)
    panel.set(xlabel="east (m)", ylabel="north (m)")
    panel.set_aspect("equal", adjustable="datalim")
    sheet.legend_above(panel, "horizontal track")


def _error(panel: Axes, data: PlotData) -> None:
    track = data.track
    sigma = np.sqrt(np.linalg.eigvalsh(track.position_covariance)[:, -1].clip(0))
    label = "3 sigma of the filter"
    panel.fill_between(track.t_s, 0, 3 * sigma, color=palette.ESTIMATE, alpha=0.2, linewidth=0, label=label)
    error = np.hypot(*(track.position_m - data.truth_m).T)
    panel.plot(track.t_s, error, color=palette.ESTIMATE, label="filter from bottom track")
    if data.constant_velocity_mps is not None:
        constant = np.hypot(*(data.constant_velocity_mps * track.t_s[:, None] - data.truth_m).T)
        panel.plot(track.t_s, constant, color=palette.OTHER, linewidth=1.0, linestyle="--", label="constant velocity")
    panel.set(xlabel="time (s)", ylabel="distance (m)")
    panel.set_ylim(bottom=0)
    sheet.legend_above(panel, "position error against bottom track")


def _water(panel: Axes, track: Track) -> None:
    water = track.water
    for name, velocity, colour in (("north", water.north_mps, palette.NORTH), ("east", water.east_mps, palette.EAST)):
        panel.fill_betweenx(
            water.depth_m, velocity - water.sd_mps, velocity + water.sd_mps, color=colour, alpha=0.2, linewidth=0
        )
        style = "-" if name == "north" else "--"
        panel.plot(velocity, water.depth_m, color=colour, linestyle=style, label=f"{name}, with 1 sigma")
    panel.invert_yaxis()
    panel.set(xlabel="current (m/s)", ylabel="depth (m)")
    sheet.legend_above(panel, "current at the end")
