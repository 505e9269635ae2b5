"""Text report of the localisation of a recorded dive."""

from __future__ import annotations

from ltv_mpc.localisation.recorded_dive.study import StartResult
from services.tools.localise.dive_result import LocalisationResult, StudyRow


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
        ("error", _error_text(result.error)),
        ("study", _study_text(result.study)),
        *(("note", note) for note in result.notes),
    ]
    return "\n".join(f"{name:<11} {words}" for name, words in rows)


def _error_text(e: StartResult | None) -> str:
    if e is None:
        return "no bottom track to compare with 300 s after the start"
    where = "inside" if e.inside_3_sigma else "OUTSIDE"
    return (
        f"{e.error_m:.1f} m against bottom track after {e.after_s:.0f} s, sigma {e.sigma_m:.1f} m, {where} 3 sigma;"
        f" constant velocity {_metres(e.constant_velocity_error_m)}"
    )


def _study_text(s: StudyRow | None) -> str:
    if s is None:
        return "no start between 2 and 14 m with bottom track 300 s later"
    return (
        f"{s.starts} starts between 2 and 14 m: median {s.median_error_m:.1f} m after 300 s,"
        f" constant velocity {_metres(s.median_constant_velocity_error_m)},{_ratio(s)}"
        f" inside 3 sigma {100 * s.inside_3_sigma:.0f} %"
    )


def _metres(distance_m: float | None) -> str:
    return "unknown" if distance_m is None else f"{distance_m:.1f} m"


def _ratio(s: StudyRow) -> str:
    return "" if s.ratio is None else f" ratio {s.ratio:.2f},"
