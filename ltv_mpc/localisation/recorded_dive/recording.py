"""Content of a recording, as far as it shows without any position: usable cells, beam noise, changes of velocity.

Cells   A usable cell has enough good pings, and lies above the side lobes of the sea bed and below the surface.
        The echo falls with range until it rises by 9 dB within two cells: the bottom in that beam, at range r_i.
        For a flat bottom, with u_d the down components of the beams (their sum is 4 cos(beam angle) cos(tilt) for any
        mounting):
            altitude  h = sum(u_d) / sum(1 / r_i),   cos(beam i from the vertical) = h / r_i
        Side lobes straight down return at slant range h, so beam i sees water down to the depth h cos_i; one cell less
        for the length of the pulse. The flattest beam counts for all, because earth coordinates mix the beams. A beam
        without a rise sees no bottom: its range is that of the last cell. With fewer than two rises nothing is cut.
        Looking up, the same applies to the surface.
Noise   Four beams measure three velocities. The error velocity
            e = z_ahead + z_astern - z_starboard - z_port
        does not depend on a flow that all beams share; with independent noise sd(e) = 2 sigma. For each cell, sigma is
        taken from the central 90 % of e over the dive (half their width / 1.645): the gate handles outliers beyond, and
        a bias of e is no noise. A cell with fewer than 30 samples takes sigma of the cell before it, the first cell
        that of all cells. With fewer than 30 samples in all, sigma is twice the data sheet's; so it is where e is
        constant: an error velocity that a program has filled in. No cell's sigma is below the data sheet's:
            sigma = 1.94 cm/s (1200 kHz / f) (1 m / cell) / sqrt(pings)
        (WorkHorse 1200 kHz, 1 m cells, at rest; the noise of a ping is proportional to 1 / (bandwidth x pulse length)).
        A cell with a share g of good pings has sigma / sqrt(g).
Velocity  A glider changes its velocity by centimetres per second from ensemble to ensemble, a vehicle that turns by
        metres, and between two turns hardly. So the random walk of the filter has an intensity of its own in each step.
        With u the velocity relative to the water in an ensemble, the median over its cells,
            q_k^2 = (|u_k - u_(k-1)|^2 / 2 - s_k^2 - s_(k-1)^2) / dt,   s^2 the variance of the noise of u in one axis
        The median of n cells has pi / 2 times the variance of their mean.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from ltv_mpc.localisation.pd0.beams import BeamEnsemble
from ltv_mpc.localisation.pd0.records import Settings
from ltv_mpc.messages import Array

Mask: TypeAlias = npt.NDArray[np.bool_]

RISE_COUNTS = 20.0
"""Smallest rise of a sea-bed echo: 9 dB at 0.45 dB a count. Scattering layers rise by less, a sea bed by 15 to 25."""

FIRST = 3
"""First cell searched for the sea bed. Nearer cells may ring."""


def usable(ensemble: BeamEnsemble, min_good_share: float) -> Mask:
    """Return the mask of usable cells, (4, cells).

    Parameters
    ----------
    ensemble : beam velocities, depths and echoes.
    min_good_share : smallest share of good pings.
    """
    there = np.isfinite(ensemble.velocity_mps) & (ensemble.good >= min_good_share)
    in_water = ensemble.depth_m + ensemble.below_m > 0
    reach = np.abs(ensemble.below_m) < reach_m(ensemble)
    result: Mask = there & in_water & reach
    return result


def reach_m(ensemble: BeamEnsemble) -> float:
    """Return the vertical distance without side-lobe echoes of the bottom (m); infinite if no bottom is seen.

    Parameters
    ----------
    ensemble : echoes by beam and cell.
    """
    settings = ensemble.settings
    if ensemble.echo is None or settings.cells <= FIRST + 2:
        return math.inf
    echo = ensemble.echo
    rises = echo[:, FIRST:] - echo[:, FIRST - 2 : -2] >= RISE_COUNTS
    seen = rises.any(axis=1)
    if seen.sum() < 2:
        return math.inf
    r = np.where(seen, ensemble.range_m[FIRST + np.argmax(rises, axis=1)], ensemble.range_m[-1])
    h = float(np.abs(ensemble.direction[:, 2].sum()) / np.sum(1 / r))
    return h * h / float(r.max()) - settings.cell_m


MIN_SAMPLES = 30
"""Smallest number of samples for an estimate of sigma."""

RESOLUTION_MPS = 1e-3
"""Resolution of velocities in a file (m/s)."""

NOISE_AT_SEA = 2.0
"""Noise relative to the data sheet's if it cannot be estimated: a vehicle moves while it pings."""

_OPPOSED = np.array([1.0, 1.0, -1.0, -1.0])


def data_sheet_sd(settings: Settings) -> float:
    """Return sigma of one beam and ensemble by the data sheet (m/s), all pings good."""
    return 0.0194 * (1200 / settings.frequency_kHz) / settings.cell_m / float(np.sqrt(settings.pings))


class BeamNoise:
    """Beam noise of a recording, for each setup of its instrument."""

    def __init__(self, ensembles: Sequence[BeamEnsemble], min_good_share: float) -> None:
        """Estimate the noise from the error velocity.

        Parameters
        ----------
        ensembles : the recording.
        min_good_share : smallest share of good pings of a cell in use.
        """
        by_setup: dict[Settings, list[BeamEnsemble]] = {}
        for ensemble in ensembles:
            by_setup.setdefault(ensemble.settings.setup, []).append(ensemble)
        self._sd_mps = {setup: beam_sd(of, min_good_share) for setup, of in by_setup.items()}

    def sd_mps(self, settings: Settings) -> Array:
        """Return sigma of one beam for each cell (m/s), (cells,).

        Parameters
        ----------
        settings : of an ensemble of the recording.
        """
        return self._sd_mps[settings.setup]


def beam_sd(ensembles: Sequence[BeamEnsemble], min_good_share: float) -> Array:
    """Estimate sigma of one beam for each cell (m/s), (cells,).

    Parameters
    ----------
    ensembles : ensembles of one setup.
    min_good_share : smallest share of good pings of a cell in use.
    """
    settings = ensembles[0].settings
    sheet = data_sheet_sd(settings)
    spare = np.array([_OPPOSED @ x.velocity_mps for x in ensembles])
    spare[np.array([x.good[0] < min_good_share for x in ensembles])] = np.nan
    cells = [column[np.isfinite(column)] for column in spare.T]
    centred = [e - np.median(e) for e in cells if len(e)]
    everywhere = _sd(np.concatenate(centred)) if centred else None
    before = NOISE_AT_SEA * sheet if everywhere is None else everywhere
    sd = np.empty(settings.cells)
    for j, e in enumerate(cells):
        found = _sd(e)
        before = before if found is None else found
        sd[j] = max(before, sheet)
    return sd


def _sd(e: Array) -> float | None:
    """Return sigma of one beam from samples of e, or None if there are too few."""
    if len(e) < MIN_SAMPLES or np.ptp(e) < RESOLUTION_MPS:
        return None
    return float(np.quantile(np.abs(e - np.median(e)), 0.9)) / 1.645 / 2


def velocity_changes(
    ensembles: Sequence[BeamEnsemble], masks: Sequence[Mask], noise: BeamNoise, least_mps_per_rts: float
) -> Array:
    """Return the intensity (N,) of the velocity's random walk (m/s per square root of s) in the step to each ensemble.

    Parameters
    ----------
    ensembles : the dive.
    masks : usable cells (4, cells) of each ensemble.
    noise : beam noise of the recording.
    least_mps_per_rts : smallest intensity.
    """
    changes = np.full(len(ensembles), least_mps_per_rts)
    before: tuple[int, Array, float] | None = None
    for k, (ensemble, mask) in enumerate(zip(ensembles, masks, strict=True)):
        cells = mask.all(axis=0)
        if not cells.any():
            continue
        inverse = np.linalg.pinv(ensemble.direction)[:2]
        through_water = np.median(inverse @ ensemble.velocity_mps[:, cells], axis=1)
        of_beam = float(np.mean(noise.sd_mps(ensemble.settings)[cells] ** 2))
        variance = 0.5 * math.pi * of_beam * 0.5 * float((inverse**2).sum()) / int(cells.sum())
        if before is not None:
            last, velocity, noise_before = before
            dt = 1e-9 * (ensemble.t_ns - ensembles[last].t_ns)
            square = float(((through_water - velocity) ** 2).sum()) / 2.0 - variance - noise_before
            changes[last + 1 : k + 1] = np.maximum(changes[last + 1 : k + 1], math.sqrt(max(square, 0.0) / dt))
        before = k, through_water, variance
    return changes
