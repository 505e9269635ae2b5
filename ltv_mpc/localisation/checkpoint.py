"""A filter's belief as a message, and back: what a process that is started anew goes on from.

Whole     the states with their covariance, and what belongs to the water beside them (``column.py``).
Left out  what forgets within seconds or says only how well it goes: snapshots to go back to, sums of innovations, the
          health's windows. A filter that goes on from a checkpoint gathers them anew.
"""

from __future__ import annotations

import zlib
from dataclasses import asdict

import msgspec
import numpy as np

from ltv_mpc.currents import WaterPrior
from ltv_mpc.localisation.adaptive.failure_signatures import FailureSignatures
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.filter.error_state_filter import ErrorStateFilter
from ltv_mpc.localisation.filter.state import Belief, Layout
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.water.column import Link, WaterColumn
from ltv_mpc.localisation.water.current_model import node_prior
from ltv_mpc.localisation.water.grid_window import conditioning_states
from ltv_mpc.messages import DroppedGridPoint, EstimatorState, to_wire


def settings_of(suite: SensorConfig, config: EstimatorConfig, prior: WaterPrior | None) -> int:
    """CRC-32 of all that decides which states there are and what they mean."""
    own = msgspec.structs.replace(config, water_prior="")  # where it was read is nobody's business, what it says is
    known = None if prior is None else asdict(prior)
    return zlib.crc32(msgspec.json.encode((suite, own, known), enc_hook=to_wire))


def checkpoint_of(filter_: ErrorStateFilter, settings: int, restarts: int) -> EstimatorState:
    """Of this instant."""
    belief = filter_.propagated_belief()
    column = belief.column
    return EstimatorState(
        t_ns=belief.t_ns,
        settings_crc=settings,
        x=belief.x,
        attitude=belief.R,
        mounting=belief.mounting,
        covariance=belief.P[np.tril_indices(belief.layout.size)],
        epoch_t_ns=belief.epoch_t_ns,
        first_grid_point=column.first,
        measured_grid_points=np.flatnonzero(column.observed),
        dropped_grid_points=tuple(_flat(node, link) for node, link in column.dropped.items()),
        walk_variance_m2ps2=column.walked,
        restarts=restarts,
    )


def belief_of(
    checkpoint: EstimatorState, suite: SensorConfig, config: EstimatorConfig, prior: WaterPrior | None
) -> Belief | None:
    """The belief that ``checkpoint`` was made of; None where it is of other settings, or of no filter."""
    layout = Layout.of(suite, config)
    n, cells = layout.size, layout.north.stop - layout.north.start
    seen, dropped, links = (
        checkpoint.measured_grid_points,
        checkpoint.dropped_grid_points,
        len(conditioning_states(layout, 0)),
    )
    whole = (
        checkpoint.settings_crc == settings_of(suite, config, prior)
        and len(checkpoint.x) == n
        and checkpoint.first_grid_point + cells <= layout.nodes
        and (len(seen) == 0 or int(seen.max()) < layout.nodes)
        and all(d.grid_point < layout.nodes and len(d.conditioning_states) == links for d in dropped)
    )
    if not whole:
        return None
    P = np.zeros((n, n))
    P[np.tril_indices(n)] = checkpoint.covariance
    P += np.tril(P, -1).T
    column = WaterColumn(
        prior=node_prior(config, prior),
        first=checkpoint.first_grid_point,
        observed=np.isin(np.arange(layout.nodes), seen),
        dropped={d.grid_point: _link(d) for d in dropped},
        walked=checkpoint.walk_variance_m2ps2,
    )
    return Belief(
        layout=layout,
        t_ns=checkpoint.t_ns,
        x=checkpoint.x.copy(),
        R=checkpoint.attitude.copy(),
        mounting=checkpoint.mounting.copy(),
        P=P,
        signatures=FailureSignatures.of(layout.size, 0),
        epoch_t_ns=checkpoint.epoch_t_ns,
        column=column,
    )


def _flat(node: int, link: Link) -> DroppedGridPoint:
    north, east = link.c.tolist()
    return DroppedGridPoint(
        grid_point=node,
        velocity_mps=(north, east),
        conditioning_states=link.then,
        regression=link.A,
        covariance=link.C,
        position_cross_covariance=link.B,
        position_covariance=link.S,
        walk_variance_m2ps2=link.walked,
    )


def _link(flat: DroppedGridPoint) -> Link:
    return Link(
        c=np.array(flat.velocity_mps),
        then=flat.conditioning_states,
        A=flat.regression,
        C=flat.covariance,
        B=flat.position_cross_covariance,
        S=flat.position_covariance,
        walked=flat.walk_variance_m2ps2,
    )
