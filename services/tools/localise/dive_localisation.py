"""Localisation of a recorded dive: one track, and a study over many starting points.

The dive runs from the first ensemble, or from the first at or below ``--start-depth-m``, to the end of the file, to
another instrument, or to a gap of more than two minutes. An instrument may change its cells and pings within a dive.
Beam noise is estimated from all ensembles of each setup. The starts of the study lie in the first dive of the file,
independent of where the track starts.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from ltv_mpc.currents import write_profile
from ltv_mpc.errors import ConfigError
from ltv_mpc.localisation.pd0 import reader
from ltv_mpc.localisation.pd0.beams import BeamEnsemble, to_beams
from ltv_mpc.localisation.pd0.reader import Loss, Recording
from ltv_mpc.localisation.pd0.records import Ensemble, Settings
from ltv_mpc.localisation.recorded_dive.filter import Track, run
from ltv_mpc.localisation.recorded_dive.noise import BeamNoise
from ltv_mpc.localisation.recorded_dive.parameters import DiveParameters
from ltv_mpc.localisation.recorded_dive.study import (
    StartResult,
    constant_velocity,
    evaluate_track,
    run_start,
    starts,
    window_end,
)
from ltv_mpc.localisation.recorded_dive.truth import BottomTrackPath, dead_reckon
from ltv_mpc.localisation.recorded_dive.uniformity import Uniformity, uniformity
from ltv_mpc.messages import Array

MAX_STARTS = 60
MOST_NIS, LEAST_INSIDE = 3.0, 0.9
"""Largest NIS, and smallest share of starts inside 3 sigma, of a filter that is consistent."""

COLUMNS = (
    *("t_ns", "t_s", "depth_m", "north_m", "east_m", "sigma_m", "velocity_north_mps", "velocity_east_mps"),
    *("bottom_north_m", "bottom_east_m"),
)
"""Columns of track.csv. Positions are relative to the first ensemble; those of bottom track are the truth."""


class InstrumentRow(msgspec.Struct, frozen=True, kw_only=True):
    """Instrument settings in the file, and the estimated noise."""

    frequency_kHz: int
    beam_angle_deg: float
    looks: str
    coordinates: str
    bins_mapped: bool
    cells: int
    cell_m: float
    first_cell_m: float
    pings: int
    beam_sd_mps: float  # median over the cells


class TrackRow(msgspec.Struct, frozen=True, kw_only=True):
    """Track from the selected start."""

    start_ensemble: int
    start_depth_m: float
    ensembles: int
    duration_s: float
    fixes: int
    end_north_m: float
    end_east_m: float
    end_sigma_m: float  # along the worst axis
    cells_used: int
    cells_screened: int
    cells_rejected: int
    nis: float


class StudyRow(msgspec.Struct, frozen=True, kw_only=True):
    """Statistics over all starts for which a true track exists."""

    starts: int
    median_error_m: float
    median_constant_velocity_error_m: float | None  # None without a fix
    ratio: float | None
    inside_3_sigma: float  # share
    each: tuple[StartResult, ...]


class LocalisationResult(msgspec.Struct, frozen=True, kw_only=True):
    """Content of localise.json, and the output of ``--json``.

    ``error`` and ``study`` are None if the file holds no truth for them.
    """

    file: str
    bytes: int
    ensembles: int
    lost_bytes: int
    lost_places: int
    losses: tuple[Loss, ...]
    surface_fixes: int
    instrument: InstrumentRow
    track: TrackRow
    water: Uniformity | None  # None: too little bottom track
    error: StartResult | None
    study: StudyRow | None
    notes: tuple[str, ...]
    parameters: DiveParameters


@dataclass(frozen=True, slots=True)
class Outcome:
    """Result of the localisation with the data of its plots and tables."""

    result: LocalisationResult
    ensembles: Sequence[BeamEnsemble]  # of the track
    track: Track
    truth_m: Array  # (N, 2), from bottom track, NaN if unknown
    constant_velocity_mps: Array | None


def localise(
    path: Path,
    fixes: int = 10,
    start_depth_m: float | None = None,
    head: str | None = None,
    *,
    parameters: DiveParameters | None = None,
    progress: Callable[[float], None] = lambda _share: None,
) -> Outcome:
    """Read a PD0 file, run the filter and compare it with bottom track.

    ``progress`` receives the share done. Raises ``ConfigError``.
    """
    parameters = parameters or DiveParameters()
    recording = reader.read(path)
    ensembles, heads = _of_head(recording, head)
    first = _first(ensembles, start_depth_m, recording.source)
    end, why = dive_end(ensembles, first, parameters.longest_gap_s)
    settings = ensembles[first].settings
    seen = [to_beams(e) for e in ensembles]
    dive = seen[first:end]
    water = uniformity(dive, parameters)
    if water is not None and not water.uniform:
        parameters = msgspec.structs.replace(parameters, water_change_mps_per_rtm=water.change_mps_per_rtm)
    noise = BeamNoise(dive, parameters.min_good_share)
    track = run(dive, noise, parameters, fixes=fixes)
    ground = dead_reckon(dive)
    after = window_end(ground, 0)
    error = None if after is None else evaluate_track(dive, ground, track, start=0, end=after, offered_fixes=fixes)
    many = _study(ensembles, seen, parameters, fixes, progress)
    result = LocalisationResult(
        file=str(path),
        bytes=recording.size,
        ensembles=len(ensembles),
        lost_bytes=recording.lost_bytes,
        lost_places=recording.lost_places,
        losses=recording.losses,
        surface_fixes=fixes,
        instrument=_instrument(settings, noise),
        track=_track(track, dive, ensembles[first].number),
        water=water,
        error=error,
        study=many,
        notes=(*heads, *_notes(settings, dive, track, many, why)),
        parameters=parameters,
    )
    return Outcome(result, dive, track, _truth(ground), constant_velocity(dive[:fixes]))


def dive_end(ensembles: Sequence[Ensemble], first: int, longest_gap_s: float) -> tuple[int, str]:
    """Return the end (exclusive) of the dive that starts at ``first``, and the reason; "" at the end of the file."""
    for k in range(first + 1, len(ensembles)):
        gap = 1e-9 * (ensembles[k].t_ns - ensembles[k - 1].t_ns)
        if gap > longest_gap_s:
            return k, f"the dive ends at ensemble {ensembles[k - 1].number}: a gap of {gap:.0f} s follows"
        if not ensembles[k].settings.same_instrument(ensembles[first].settings):
            return k, f"the dive ends at ensemble {ensembles[k - 1].number}: another instrument follows"
    return len(ensembles), ""


def write(outcome: Outcome, folder: Path) -> None:
    """Write track.csv, currents.csv and localise.html; raises ``NoPlotly`` instead of the last."""
    (folder / "track.csv").write_text(_table(outcome), encoding="utf-8")
    write_profile(folder / "currents.csv", outcome.track.water)
    from services.tools.localise import plot

    plot.write(outcome, folder / "localise.html")


def _of_head(recording: Recording, head: str | None) -> tuple[Sequence[Ensemble], list[str]]:
    """Return the ensembles of one head, and a note if there are two: without a choice the one with more ensembles."""
    heads = {way: [e for e in recording.ensembles if e.settings.upward == (way == "up")] for way in ("down", "up")}
    chosen = head or max(heads, key=lambda way: len(heads[way]))
    if not heads.get(chosen):
        problem = f"must be one that looks, of {recording.source}: {', '.join(way for way in heads if heads[way])}"
        raise ConfigError("option --head", "", problem, value=chosen)
    other = "down" if chosen == "up" else "up"
    if not heads[other]:
        return heads[chosen], []
    note = f"two heads: {len(heads[chosen])} ensembles look {chosen} and are used, {len(heads[other])} look {other}"
    return heads[chosen], [f"{note} (--head {other})"]


def _first(ensembles: Sequence[Ensemble], start_depth_m: float | None, source: str) -> int:
    deepest = max(e.depth_m for e in ensembles)
    if start_depth_m is None or deepest >= start_depth_m:
        return next(k for k, e in enumerate(ensembles) if start_depth_m is None or e.depth_m >= start_depth_m)
    problem = f"no ensemble of {source} is that deep: the deepest is at {deepest:.1f} m"
    raise ConfigError("option --start-depth-m", "", problem, value=start_depth_m)


def _instrument(settings: Settings, noise: BeamNoise) -> InstrumentRow:
    same = ("frequency_kHz", "bins_mapped", "cells", "cell_m", "first_cell_m", "pings")
    return InstrumentRow(
        **{name: getattr(settings, name) for name in same},
        beam_angle_deg=round(math.degrees(settings.beam_angle_rad), 6),
        looks="up" if settings.upward else "down",
        coordinates=settings.coordinates.name.lower(),
        beam_sd_mps=float(np.median(noise.sd_mps(settings))),
    )


def _track(track: Track, dive: Sequence[BeamEnsemble], number: int) -> TrackRow:
    north, east = track.position_m[-1].tolist()
    same = ("fixes", "cells_used", "cells_screened", "cells_rejected", "nis")
    return TrackRow(
        **{name: getattr(track, name) for name in same},
        start_ensemble=number,
        start_depth_m=dive[0].depth_m,
        ensembles=len(dive),
        duration_s=float(track.t_s[-1]),
        end_north_m=north,
        end_east_m=east,
        end_sigma_m=float(np.sqrt(np.linalg.eigvalsh(track.position_covariance[-1])[-1])),
    )


def _study(
    ensembles: Sequence[Ensemble],
    seen: Sequence[BeamEnsemble],
    parameters: DiveParameters,
    fixes: int,
    progress: Callable[[float], None],
) -> StudyRow | None:
    end, _ = dive_end(ensembles, 0, parameters.longest_gap_s)
    dive = seen[:end]
    ground = dead_reckon(dive)
    noise = BeamNoise(dive, parameters.min_good_share)
    rows = []
    first = starts(dive)[:MAX_STARTS]
    for done, start in enumerate(first):
        progress(done / len(first))
        found = run_start(dive, ground, noise, parameters, start=start, offered_fixes=fixes)
        rows += [] if found is None else [found]
    if not rows:
        return None
    median = float(np.median([row.error_m for row in rows]))
    errors = [x for row in rows if (x := row.constant_velocity_error_m) is not None]
    constant = float(np.median(errors)) if errors else None
    return StudyRow(
        starts=len(rows),
        median_error_m=median,
        median_constant_velocity_error_m=constant,
        ratio=median / constant if constant else None,
        inside_3_sigma=sum(row.inside_3_sigma for row in rows) / len(rows),
        each=tuple(rows),
    )


def _notes(
    settings: Settings, dive: Sequence[BeamEnsemble], track: Track, many: StudyRow | None, why: str
) -> list[str]:
    inside, wrong = 1.0 if many is None else many.inside_3_sigma, "the filter is NOT consistent, its sigma is too small"
    setups, turned = len({e.settings.setup for e in dive}), settings.heading_alignment_rad or settings.heading_bias_rad
    tracks_bottom = any(np.isfinite(e.bottom_mps[:2]).all() for e in dive)
    notes = {
        why: why != "",
        f"the instrument changes its cells or pings: {setups} setups; the first is shown": setups > 1,
        "no fix by bottom track: the initial velocity, and so the track, is unknown": track.fixes == 0,
        "no bottom track in the dive: nothing to compare the track with": not tracks_bottom,
        "heading alignment or bias (EA, EB) is set: not applied, north is the north of the file's headings": turned,
        "no water cell could be used: the track follows the fixes only": track.cells_used == 0,
        f"{wrong}: NIS {track.nis:.1f} where 1 is expected": track.nis > MOST_NIS,
        f"{wrong}: {100 * inside:.0f} % of the starts are inside 3 sigma, where 99 % are expected": inside
        < LEAST_INSIDE,
    }
    return [note for note, holds in notes.items() if holds]


def _truth(ground: BottomTrackPath) -> Array:
    """Return bottom track's position at every ensemble, relative to the first."""
    nowhere = np.full(2, np.nan)
    return np.array([nowhere if (x := ground.displacement(0, k)) is None else x for k in range(len(ground.t_s))])


def _table(outcome: Outcome) -> str:
    """Format track.csv; a cell is empty where bottom track is not available."""
    track, depth_m = outcome.track, [ensemble.depth_m for ensemble in outcome.ensembles]
    sigma_m = np.sqrt(np.linalg.eigvalsh(track.position_covariance)[:, -1].clip(0))
    columns = (track.t_s, depth_m, track.position_m, sigma_m, track.velocity_mps, outcome.truth_m)
    lines = [",".join(COLUMNS)]
    for ensemble, numbers in zip(outcome.ensembles, np.column_stack(columns), strict=True):
        lines.append(",".join([str(ensemble.t_ns), *("" if math.isnan(x) else f"{x:.4f}" for x in numbers)]))
    return "\n".join(lines) + "\n"
