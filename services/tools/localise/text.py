"""Text report of the localisation of a recorded dive."""

from __future__ import annotations

from functools import partial

from ltv_mpc.localisation.recorded_dive.study import MAX_START_DEPTH_M, MIN_START_DEPTH_M, WINDOW_S, StartResult
from ltv_mpc.localisation.recorded_dive.uniformity import Uniformity
from services.runtime.console import figure
from services.tools.localise.dive_localisation import LocalisationResult, StudyRow

_metres = partial(figure, unit="m", digits=".1f", none="unknown")
_STARTS = f"between {MIN_START_DEPTH_M:g} and {MAX_START_DEPTH_M:g} m"


def text(result: LocalisationResult) -> str:
    """Format the result as text."""
    i, t = result.instrument, result.track
    lost = f"{result.lost_bytes} bytes lost in {result.lost_places} places" if result.lost_places else "no byte lost"
    rows = [
        ("file", f"{result.file}: {result.ensembles} ensembles, {lost}"),
        *(("", f"byte {x.offset}: {x.length} bytes: {x.why}") for x in result.losses[:3]),
        (
            "instrument",
            f"{i.frequency_kHz} kHz, {i.beam_angle_deg:g} deg beams looking {i.looks}, {i.coordinates} coordinates,"
            f" {i.cells} x {i.cell_m:g} m, {i.pings} pings, noise of a beam {100 * i.beam_sd_mps:.1f} cm/s",
        ),
        (
            "track",
            f"{t.ensembles} ensembles, {t.duration_s:.0f} s from {t.start_depth_m:.1f} m, {t.fixes} fixes;"
            f" ends {t.end_north_m:.1f} m north, {t.end_east_m:.1f} m east, sigma {t.end_sigma_m:.1f} m",
        ),
        ("cells", f"{t.cells_used} used, {t.cells_screened} screened, {t.cells_rejected} rejected; NIS {t.nis:.2f}"),
        ("water", _water_text(result.water)),
        ("error", _error_text(result.error)),
        ("study", _study_text(result.study)),
        *(("note", note) for note in result.notes),
    ]
    return "\n".join(f"{name:<11} {words}" for name, words in rows)


def _water_text(w: Uniformity | None) -> str:
    if w is None:
        return "too little bottom track to tell whether it is horizontally uniform"
    change = f"changes by {100 * w.change_mps:.0f} cm/s along {w.run_m:.0f} m"
    if w.uniform:
        return f"horizontally uniform as assumed: {change}"
    return f"NOT horizontally uniform: {change}; sigma is widened for it"


def _error_text(e: StartResult | None) -> str:
    if e is None:
        return f"no bottom track to compare with {WINDOW_S:g} s after the start"
    where = "inside" if e.inside_3_sigma else "OUTSIDE"
    return (
        f"{e.error_m:.1f} m against bottom track after {e.after_s:.0f} s, sigma {e.sigma_m:.1f} m, {where} 3 sigma;"
        f" constant velocity {_metres(e.constant_velocity_error_m)}"
    )


def _study_text(s: StudyRow | None) -> str:
    if s is None:
        return f"no start {_STARTS} with bottom track {WINDOW_S:g} s later"
    ratio = "" if s.ratio is None else f" ratio {s.ratio:.2f},"
    return (
        f"{s.starts} starts {_STARTS}: median {s.median_error_m:.1f} m after {WINDOW_S:g} s,"
        f" constant velocity {_metres(s.median_constant_velocity_error_m)},{ratio}"
        f" inside 3 sigma {100 * s.inside_3_sigma:.0f} %"
    )
