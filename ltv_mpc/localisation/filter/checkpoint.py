"""Checkpoint: a filter's belief as a message, and back. A restarted process continues from it.

Included      the states with their covariance
Not included  data that lose their meaning within seconds or only rate the filter: snapshots, sums of innovations, the
              windows of the health monitor. A filter that continues from a checkpoint collects them again.
"""

from __future__ import annotations

import zlib

import msgspec
import numpy as np

from ltv_mpc.array_encoding import to_wire
from ltv_mpc.currents import WaterPrior
from ltv_mpc.localisation.adaptive.failure_signatures import FailureSignatures
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.filter.error_state_filter import ErrorStateFilter
from ltv_mpc.localisation.filter.state import Belief, Layout
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.messages import EstimatorState


def settings_of(sensor_config: SensorConfig, config: EstimatorConfig, prior: WaterPrior | None) -> int:
    """Return the CRC-32 of all settings that decide which states exist and what they mean.

    Parameters
    ----------
    sensor_config : settings of the sensors.
    config : settings of the filter.
    prior : water known from an earlier dive; None: that of ``config``.
    """
    own = msgspec.structs.replace(config, water_prior="")  # the profile itself counts, not its path
    return zlib.crc32(msgspec.json.encode((sensor_config, own, prior), enc_hook=to_wire))


def checkpoint_of(filter_: ErrorStateFilter, settings: int, restarts: int) -> EstimatorState:
    """Return the checkpoint of a filter.

    Parameters
    ----------
    filter_ : filter; it is not changed.
    settings : result of ``settings_of``.
    restarts : number of reinitialisations so far.
    """
    belief = filter_.propagated_belief()
    return EstimatorState(
        t_ns=belief.t_ns,
        settings_crc=settings,
        x=belief.x,
        attitude=belief.R,
        mounting=belief.mounting,
        covariance=belief.P[np.tril_indices(belief.layout.size)],
        epoch_t_ns=belief.epoch_t_ns,
        restarts=restarts,
    )


def belief_of(
    checkpoint: EstimatorState, sensor_config: SensorConfig, config: EstimatorConfig, prior: WaterPrior | None
) -> Belief | None:
    """Return the belief of a checkpoint; None if its settings differ or its sizes do not fit.

    Parameters
    ----------
    checkpoint : message of an earlier process.
    sensor_config, config, prior : settings as in ``settings_of``.
    """
    layout = Layout.of(sensor_config, config)
    n = layout.size
    if checkpoint.settings_crc != settings_of(sensor_config, config, prior) or len(checkpoint.x) != n:
        return None
    P = np.zeros((n, n))
    P[np.tril_indices(n)] = checkpoint.covariance
    P += np.tril(P, -1).T
    return Belief(
        layout=layout,
        t_ns=checkpoint.t_ns,
        x=checkpoint.x.copy(),
        R=checkpoint.attitude.copy(),
        mounting=checkpoint.mounting.copy(),
        P=P,
        signatures=FailureSignatures.of(layout.size, 0),
        epoch_t_ns=checkpoint.epoch_t_ns,
    )
