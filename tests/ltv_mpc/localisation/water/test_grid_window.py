"""Moving window of the depth grid against a filter that keeps every depth, and the links of dropped depths."""

import dataclasses

import msgspec
import numpy as np
import pytest

from ltv_mpc.localisation.adaptive.failure_signatures import FailureSignatures
from ltv_mpc.localisation.filter.error_state_filter import ErrorStateFilter
from ltv_mpc.localisation.filter.state import Belief, Layout, reach_m
from ltv_mpc.localisation.water.current_model import add_random_walk, node_prior, write_prior
from ltv_mpc.localisation.water.grid_window import conditioning_states, link_covariance, move_window
from ltv_mpc.messages import AdcpPing
from tests.ltv_mpc.localisation.dives import CONFIG, PAPER, REALISTIC, Run, dive
from tests.ltv_mpc.localisation.sensors.every_sensor import with_settings

WHOLE = msgspec.structs.replace(CONFIG, adapts_to_water=False)
WINDOW = msgspec.structs.replace(WHOLE, kept_m=0.0)


SUITE = with_settings(REALISTIC, adcp={"range_m": 7.0})
LEVEL = msgspec.structs.replace(SUITE.adcp, lever_arm_m=(0.0, 0.0, 0.0))
LAYOUT = Layout.of(SUITE, WINDOW)
CELLS = LAYOUT.north.stop - LAYOUT.north.start


def sink(belief, depth_m):
    """Move the window as the filter does before a correction."""
    belief.x[2] = depth_m
    move_window(belief, *reach_m(SUITE.adcp), WINDOW.cell_m)


def states_of(belief, nodes):
    """Return the state indices of north, then east, of grid points."""
    slots = np.asarray(nodes) - belief.column.first
    return np.concatenate([belief.layout.north.start + slots, belief.layout.east.start + slots])


def test_signatures_move_with_the_window():
    """A signature moves like a difference of two estimates, because the window is linear."""
    rng = np.random.default_rng(5)
    belief = Belief.blank(LAYOUT, 0)
    write_prior(belief, WINDOW)
    other = belief.copy()
    belief.signatures = FailureSignatures.of(LAYOUT.size, 1)
    belief.signatures.error[:, 0] = rng.standard_normal(LAYOUT.size)
    belief.signatures.error[2] = 0.0  # at one depth
    other.x += belief.signatures.error[:, 0]
    for depth_m in (9.0, 20.0, 31.0):
        sink(belief, depth_m)
        sink(other, depth_m)
        np.testing.assert_allclose(belief.signatures.error[:, 0], other.x - belief.x, atol=1e-12)
    assert belief.column.first > 0


def test_a_filter_that_drops_depths_equals_one_that_keeps_them():
    """9 m down at 0.2 m/s with beams of 5 m: the same vehicle and the same water, to 1e-9, at every estimate."""
    sensors = with_settings(REALISTIC, adcp={"range_m": 5.0})
    keeps, forgets = (Run(dive(sensors, 4, duration_s=45.0).messages, sensors, config) for config in (WHOLE, WINDOW))
    assert list(keeps.estimates) == list(forgets.estimates)
    for a, b in zip(keeps.estimates.values(), forgets.estimates.values(), strict=True):
        for field in ("north_m", "east_m", "depth_m", "heading_rad", "velocity_north_mps", "velocity_east_mps"):
            assert getattr(a, field) == pytest.approx(getattr(b, field), abs=1e-9)
        np.testing.assert_allclose(b.covariance, a.covariance, rtol=1e-9, atol=1e-12)
        shared = slice(*np.searchsorted(a.current.depth_m, [b.current.depth_m[0], b.current.depth_m[-1] + 0.5]))
        np.testing.assert_allclose(b.current.north_mps, a.current.north_mps[shared], atol=1e-9)
        np.testing.assert_allclose(b.current.sd_mps, a.current.sd_mps[shared], atol=1e-9)
    assert keeps.estimator.account == forgets.estimator.account
    whole, window = keeps.estimator.filter.belief, forgets.estimator.filter.belief
    assert window.column.first > 0, "or nothing was forgotten"
    assert window.layout.size < whole.layout.size / 2
    np.testing.assert_array_equal(window.P, window.P.T)
    np.testing.assert_array_equal(window.column.observed, whole.column.observed)


def test_no_depth_of_70_m_is_dropped_with_the_shipped_settings_and_deeper_grids_have_no_more_states():
    for sensors in (PAPER, REALISTIC):
        layout = Layout.of(sensors, CONFIG)
        assert layout.north.stop - layout.north.start == layout.nodes == 71
    deep = (Layout.of(SUITE, msgspec.structs.replace(CONFIG, deepest_m=deepest_m)) for deepest_m in (500.0, 2000.0))
    assert len({layout.size for layout in deep}) == 1


@pytest.mark.parametrize("depth_m", [0.0, 0.4, 8.0, 33.9, 61.0, 70.0])
@pytest.mark.parametrize("from_m", [0.0, 70.0])
def test_beams_and_plan_find_their_nodes_in_the_window_wherever_the_vehicle_is(from_m, depth_m):
    belief = Belief.blank(LAYOUT, 0)
    for depth in (from_m, depth_m):
        sink(belief, depth)
    first, last = belief.column.first, belief.column.first + CELLS - 1
    assert 0 <= first <= max(depth_m - 3.0, 0.0)
    assert min(depth_m + 7.0 + 3.0, 70.0) <= last <= 70


@pytest.fixture
def uneven():
    """Return a prior whose mean and standard deviation change with depth."""
    rng = np.random.default_rng(2)
    prior = node_prior(WHOLE)
    return dataclasses.replace(
        prior, mean_mps=rng.standard_normal(prior.mean_mps.shape), sd_mps=rng.uniform(0.5, 2, len(prior.sd_mps))
    )


def started(prior, layout=LAYOUT):
    """Return a belief at the surface with some knowledge of the states other than water."""
    belief = Belief.blank(layout, 0)
    belief.P[:15, :15] = np.eye(15)
    belief.P[layout.beam_bias, layout.beam_bias] = np.eye(4)
    write_prior(belief, WINDOW)
    nodes = slice(0, layout.north.stop - layout.north.start)
    belief.column.prior = prior
    for axis, states in enumerate((layout.north, layout.east)):
        belief.x[states] = prior.mean_mps[nodes, axis]
        belief.P[states, states] = prior.covariance(nodes)
        m = layout.mean.start + axis
        belief.P[m, m] = belief.P[m, states] = belief.P[states, m] = prior.common_sd_mps**2
    return belief


def test_a_window_that_has_sunk_through_unmeasured_water_has_the_priors_moments(uneven):
    belief = started(uneven)
    for depth in np.arange(0.0, 50.0, 0.7):
        sink(belief, depth)
    first = belief.column.first
    assert first > 30
    nodes = slice(first, first + CELLS)
    for axis, states in enumerate((LAYOUT.north, LAYOUT.east)):
        np.testing.assert_allclose(belief.x[states], uneven.mean_mps[nodes, axis], atol=1e-12)
        np.testing.assert_allclose(belief.P[states, states], uneven.covariance(nodes), atol=1e-12)
        np.testing.assert_allclose(belief.P[LAYOUT.mean.start + axis, states], uneven.common_sd_mps**2, atol=1e-12)
    np.testing.assert_allclose(belief.P[LAYOUT.north, LAYOUT.east], 0, atol=1e-12)


def measured(belief, node, gain, variance, z):
    """Condition the belief on z = c_node + gain . [north, heading, beam bias] + noise with textbook formulas."""
    H = np.zeros((2, belief.layout.size))
    H[[0, 1], states_of(belief, [node])] = 1.0
    H[:, [0, 8, belief.layout.beam_bias.start]] = gain
    K = np.linalg.solve(H @ belief.P @ H.T + variance * np.eye(2), H @ belief.P).T
    belief.x += K @ (z - H @ belief.x)
    P = belief.P - K @ H @ belief.P
    belief.P[:] = 0.5 * (P + P.T)


def test_measurements_of_dropped_depths_are_as_if_they_had_been_kept(uneven):
    """Down, up, down and up again, water and biases measured on the way, position only at the top, before it all.

    Velocity, which a window does not follow so far, is not measured. Compared with the belief that keeps all nodes:
    every state of the window, every correlation; and what would be saved of all depths.
    """
    rng = np.random.default_rng(5)
    whole_layout = Layout.of(SUITE, WHOLE)
    window, whole = started(uneven), started(uneven, whole_layout)
    before = np.arange(LAYOUT.north.start)

    def measure(nodes, by_position):
        for node in nodes:
            gain, z = rng.standard_normal((2, 3)), rng.standard_normal(2)
            gain[:, 0] *= by_position
            for belief in (window, whole):
                measured(belief, node, gain, 0.1, z)
                belief.column.mark_observed(np.array([node - 1]))

    measure(range(1, CELLS, 2), by_position=1.0)
    for depth in (45.0, 0.0, 52.0, 0.0, 20.0):
        sink(window, depth)
        first = window.column.first
        nodes = np.arange(first, first + CELLS)
        a = np.concatenate([before, states_of(window, nodes)])
        b = np.concatenate([before, states_of(whole, nodes)])
        assert sorted(a) == list(range(LAYOUT.size))
        assert set(window.column.dropped).isdisjoint(nodes)
        x, P = whole.x.copy(), whole.P
        x[2] = window.x[2]
        np.testing.assert_allclose(window.x[a], x[b], atol=1e-6)
        np.testing.assert_allclose(window.P[np.ix_(a, a)], P[np.ix_(b, b)], atol=1e-6)
        np.testing.assert_array_equal(window.P, window.P.T)
        measure(rng.choice(nodes[1:], 6, replace=False), by_position=0.0)
    assert len(window.column.dropped) > CELLS


def test_a_position_fix_removes_the_shared_error_of_dropped_depths():
    """The position error of the dropped grid points no longer applies, and P must stay a covariance."""
    rng = np.random.default_rng(8)
    belief = started(node_prior(WHOLE))
    for node in range(CELLS):
        measured(belief, node, np.array([[1.0, 0, 0], [0, 0, 0]]), 1e-4, rng.standard_normal(2))
    sink(belief, 30.0)
    link = belief.column.dropped[3]
    assert abs(link.position_cross_covariance[0, 0]) > 0.2 * np.sqrt(
        link.covariance[0, 0] * link.position_covariance[0, 0]
    )
    belief.P[0, :] *= 1e-3  # as fixed to a thousandth of what it was
    belief.P[:, 0] *= 1e-3
    sink(belief, 0.0)
    assert np.linalg.eigvalsh(belief.P)[0] > -1e-12


def test_a_depth_is_seen_once_an_accepted_beam_has_measured_beside_it():
    """Beams of 1 to 5 m at 10.2 m; the four readings of the third cell are outliers."""
    config = msgspec.structs.replace(WHOLE, gate_probability=0.999)
    belief = Belief.blank(Layout.of(SUITE, config), 0)
    belief.x[2] = 10.2
    belief.P[:15, :15] = 1e-6 * np.eye(15)
    write_prior(belief, config)
    filter_ = ErrorStateFilter(msgspec.structs.replace(SUITE, adcp=LEVEL), config, belief)
    assert not belief.column.observed.any()
    z = np.zeros((4, 5))
    z[:, 2] = 5.0
    z[1:, 4] = np.nan
    filter_.correct(AdcpPing(t_ns=0, range_m=np.arange(1.0, 6.0), beam_velocity_mps=z))
    assert filter_.account["adcp.gate"] == 4
    at = 10.2 + np.array([1.0, 2.0, 4.0, 5.0]) * np.cos(LEVEL.beam_angle_rad)
    assert set(np.flatnonzero(belief.column.observed)) == {*np.floor(at).astype(int), *np.floor(at).astype(int) + 1}
    assert belief.copy().column.observed is not belief.column.observed


def test_a_walk_in_time_makes_a_remembered_depth_less_certain():
    """Only random walk after the drop counts, that of the grid point and of the states it depends on."""
    config = msgspec.structs.replace(WINDOW, current_change_mps_per_rts=1e-3)
    gained = []
    for before_s, after_s in ((50.0, 0.0), (50.0, 100.0)):
        belief = started(node_prior(WHOLE))
        add_random_walk(belief, config, before_s)
        for node in range(CELLS):
            measured(belief, node, np.zeros((2, 3)), 1e-4, np.zeros(2))
        sink(belief, 12.0)
        link = belief.column.dropped[0]
        belief.column.walked += after_s * 1e-6
        water = conditioning_states(LAYOUT, 0) >= LAYOUT.north.start
        assert np.abs(link.regression[:, water]).max() > 0.1
        np.testing.assert_allclose(
            link_covariance(link, water, belief.column.walked) - link.covariance,
            after_s * 1e-6 * (np.eye(2) + link.regression[:, water] @ link.regression[:, water].T),
            atol=1e-12,
        )
        sink(belief, 0.0)
        gained.append(belief.P[LAYOUT.north.start, LAYOUT.north.start])
    assert 1e-4 < gained[1] - gained[0] < 2e-4
