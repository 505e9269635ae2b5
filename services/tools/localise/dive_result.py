"""Result of the localisation of a recorded dive: localise.json, and the output of ``--json``."""

from __future__ import annotations

import msgspec

from ltv_mpc.localisation.pd0.reader import Loss
from ltv_mpc.localisation.recorded_dive.bottom_track import StartResult, Uniformity
from ltv_mpc.localisation.recorded_dive.parameters import DiveParameters


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
    """Result of the command. ``error`` and ``study`` are None if the file holds no truth for them."""

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
