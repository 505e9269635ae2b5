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
from ltv_mpc.localisation.adaptive.failure_signatures import Signatures
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.filter.error_state_filter import Filter
from ltv_mpc.localisation.filter.state import Belief, Layout
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.water.column import Column, Link
from ltv_mpc.localisation.water.current_model import node_prior
from ltv_mpc.localisation.water.grid_window import given
from ltv_mpc.messages import DroppedNode, EstimatorState, to_wire


def settings_of(suite: SensorConfig, config: EstimatorConfig, prior: WaterPrior | None) -> int:
    """CRC-32 of all that decides which states there are and what they mean."""
    own = msgspec.structs.replace(config, water_prior="")  # where it was read is nobody's business, what it says is
    known = None if prior is None else asdict(prior)
    return zlib.crc32(msgspec.json.encode((suite, own, known), enc_hook=to_wire))


def checkpoint_of(filter_: Filter, settings: int, restarts: int) -> EstimatorState:
    """Of this instant."""
    belief = filter_.settled()
    column = belief.column
    return EstimatorState(
        t_ns=belief.t_ns,
        settings=settings,
        x=belief.x,
        attitude=belief.R,
        mounting=belief.mounting,
        covariance=belief.P[np.tril_indices(belief.layout.size)],
        epoch_t_ns=belief.epoch_t_ns,
        first_node=column.first,
        seen_nodes=np.flatnonzero(column.seen),
        dropped=tuple(_flat(node, link) for node, link in column.dropped.items()),
        walked=column.walked,
        restarts=restarts,
    )


def belief_of(
    checkpoint: EstimatorState, suite: SensorConfig, config: EstimatorConfig, prior: WaterPrior | None
) -> Belief | None:
    """The belief that ``checkpoint`` was made of; None where it is of other settings, or of no filter."""
    layout = Layout.of(suite, config)
    n, cells = layout.size, layout.north.stop - layout.north.start
    seen, dropped, links = checkpoint.seen_nodes, checkpoint.dropped, len(given(layout, 0))
    whole = (
        checkpoint.settings == settings_of(suite, config, prior)
        and len(checkpoint.x) == n
        and checkpoint.first_node + cells <= layout.nodes
        and (len(seen) == 0 or int(seen.max()) < layout.nodes)
        and all(d.node < layout.nodes and len(d.given) == links for d in dropped)
    )
    if not whole:
        return None
    P = np.zeros((n, n))
    P[np.tril_indices(n)] = checkpoint.covariance
    P += np.tril(P, -1).T
    column = Column(
        prior=node_prior(config, prior),
        first=checkpoint.first_node,
        seen=np.isin(np.arange(layout.nodes), seen),
        dropped={d.node: _link(d) for d in dropped},
        walked=checkpoint.walked,
    )
    return Belief(
        layout=layout,
        t_ns=checkpoint.t_ns,
        x=checkpoint.x.copy(),
        R=checkpoint.attitude.copy(),
        mounting=checkpoint.mounting.copy(),
        P=P,
        astray=Signatures.of(layout.size, 0),
        epoch_t_ns=checkpoint.epoch_t_ns,
        column=column,
    )


def _flat(node: int, link: Link) -> DroppedNode:
    north, east = link.c.tolist()
    return DroppedNode(
        node=node,
        velocity_mps=(north, east),
        given=link.then,
        regression=link.A,
        covariance=link.C,
        with_position=link.B,
        position=link.S,
        walked=link.walked,
    )


def _link(flat: DroppedNode) -> Link:
    return Link(
        c=np.array(flat.velocity_mps),
        then=flat.given,
        A=flat.regression,
        C=flat.covariance,
        B=flat.with_position,
        S=flat.position,
        walked=flat.walked,
    )
