"""Tables for the review of a recorded run: error of the current over depth, histogram and spectrum of thrusts."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ltv_mpc.messages import Array
from services.reporting.plots.table import Columns, shorts

BINS = 40
SEGMENTS = 8
"""Segments of the spectrum, half overlapping (Welch 1967)."""

MIN_SAMPLES = 64


def tables(history: dict[str, Columns]) -> dict[str, Columns]:
    """Return the history with the tables of the error of the current, histogram and spectrum.

    Parameters
    ----------
    history : tables of a run, of ``Collector.all_tables``.
    """
    return history | {
        "current_error": _current_error(history.get("profile", {}), history["true_current"]),
        "histogram": _histogram(history["thrust"]),
        "spectrum": _spectrum(history["thrust"]),
    }


def _current_error(profile: Columns, true: Columns) -> Columns:
    """Return estimated minus true current at the depths of the profile where the vehicle has been."""
    order = np.argsort(true_depth := _floats(true["depth_m"]))
    if not profile or not len(order):
        return {}
    depth = _floats(profile["depth_m"])
    been = (depth >= true_depth.min()) & (depth <= true_depth.max())
    columns: Columns = {"depth_m": shorts(depth[been])}
    for axis in ("north", "east"):
        actual = np.interp(depth, true_depth[order], _floats(true[f"{axis}_mps"])[order])
        estimated = _floats(profile[f"{axis}_mps"])
        columns[f"{axis}_mps"] = shorts((estimated - actual)[been])
        for end in ("low", "high"):
            if (column := f"{axis}_{end}_mps") in profile:
                columns[column] = shorts((_floats(profile[column]) - estimated)[been])
    return columns


def _histogram(thrust: Columns) -> Columns:
    """Return the share of the time (%) in each of ``BINS`` bins of equal width."""
    forces = {side: _floats(thrust[f"{side}_N"]) for side in ("port", "starboard")}
    every = np.concatenate(list(forces.values()))
    if len(every) < MIN_SAMPLES:
        return {}
    edges = np.linspace(every.min() - 0.5, every.max() + 0.5, BINS + 1)
    columns: Columns = {"thrust_N": shorts(0.5 * (edges[:-1] + edges[1:]))}
    for side, force in forces.items():
        columns[f"{side}_percent"] = shorts(100.0 * np.histogram(force, edges)[0] / len(force))
    return columns


def _spectrum(thrust: Columns) -> Columns:
    """Return the power spectral density (N^2/Hz) of each lateral thrust, by the mean of Hann-windowed segments."""
    t = _floats(thrust["t_s"])
    if len(t) < MIN_SAMPLES or t[-1] <= t[0]:
        return {}
    step_s = float(np.median(np.diff(t)))
    uniform = t[0] + step_s * np.arange(int((t[-1] - t[0]) / step_s))
    length = min(len(uniform), max(MIN_SAMPLES // 2, 2 * len(t) // (SEGMENTS + 1)))
    window = np.hanning(length)  # scipy.signal takes a second to import
    columns: Columns = {"frequency_Hz": shorts(np.fft.rfftfreq(length, step_s)[1:])}
    for side in ("port", "starboard"):
        force = np.interp(uniform, t, _floats(thrust[f"{side}_N"]))
        parts = sliding_window_view(force, length)[:: length // 2]
        waves = np.fft.rfft(window * (parts - parts.mean(axis=1, keepdims=True)))
        power = 2.0 * step_s / np.sum(window**2) * np.mean(np.abs(waves) ** 2, axis=0)
        columns[f"{side}_N2pHz"] = shorts(np.where(power > 1e-4, power, np.nan)[1:])  # a logarithmic axis
    return columns


def _floats(cells: list[float | None]) -> Array:
    return np.array([np.nan if cell is None else cell for cell in cells], dtype=np.float64)
