"""Beam noise of a recording, estimated from its error velocity: four beams measure three velocities.

    e = z_ahead + z_astern - z_starboard - z_port

does not depend on a flow that all beams share; with independent noise sd(e) = 2 sigma. For each cell, sigma is taken
from the central 90 % of e over the dive (half their width / 1.645): the gate handles outliers beyond, and a bias of e
is no noise. A cell with fewer than 30 samples takes sigma of the cell before it, the first cell that of all cells.
With fewer than 30 samples in all, sigma is twice the data sheet's; so it is where 90 % of e are constant: an error
velocity that a program has filled in. No cell's sigma is below the data sheet's:
    sigma = 1.94 cm/s (1200 kHz / f) (1 m / cell) / sqrt(pings)
(WorkHorse 1200 kHz, 1 m cells, at rest; the noise of a ping is proportional to 1 / (bandwidth x pulse length)).
A cell with a share g of good pings has sigma / sqrt(g).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ltv_mpc.localisation.pd0.beams import BeamEnsemble
from ltv_mpc.localisation.pd0.records import Settings
from ltv_mpc.messages import Array

MIN_SAMPLES = 30
"""Smallest number of samples for an estimate of sigma."""

SAME_MPS = 1e-5
"""Difference below which velocities of a file are the same (m/s): a hundredth of its resolution."""

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
    """Return sigma of one beam from samples of e, or None if there are too few that differ."""
    width = float(np.quantile(np.abs(e - np.median(e)), 0.9)) if len(e) >= MIN_SAMPLES else 0.0
    return width / 1.645 / 2 if width >= SAME_MPS else None
