"""Link of a new grid point to its neighbour, against the conditional of a Gaussian."""

import numpy as np
import pytest

from ltv_mpc.localisation.water.column import NodePrior


@pytest.mark.parametrize("walked", [0.0, 0.3])
@pytest.mark.parametrize(("node", "neighbour"), [(1, 0), (1, 2)])
def test_a_new_grid_point_is_conditioned_on_its_neighbour_and_the_common_part(node, neighbour, walked):
    """[c_k, c_i, m] are jointly Gaussian; the random walk adds variance to each grid point independently."""
    sd, common, rho = np.array([0.5, 1.5, 0.8]), 0.7, 0.6
    mean = np.array([[0.1, -0.2], [0.3, 0.5], [-0.4, 0.9]])
    prior = NodePrior(mean_mps=mean, sd_mps=sd, common_sd_mps=common, correlation=rho)
    k, i = node, neighbour
    P = common**2 + np.array(
        [[sd[k] ** 2 + walked, rho * sd[k] * sd[i], 0], [rho * sd[k] * sd[i], sd[i] ** 2 + walked, 0], [0, 0, 0]]
    )
    A = P[0, 1:] @ np.linalg.inv(P[1:, 1:])
    C = P[0, 0] - A @ P[1:, 0]
    link = prior.link(node, neighbour, walked)
    for axis in range(2):
        np.testing.assert_allclose(link.regression[axis, [axis, 2 + axis]], A)
        np.testing.assert_allclose(link.regression[axis, [1 - axis, 3 - axis]], 0)
        assert link.velocity_mps[axis] == mean[k, axis]
        np.testing.assert_allclose(link.conditioning_states[[axis, 2 + axis]], [mean[i, axis], 0])
    np.testing.assert_allclose(link.covariance, C * np.eye(2), atol=1e-15)
    assert link.walk_variance_m2ps2 == walked


def test_certain_water_depends_on_nothing():
    link = NodePrior.certain(3).link(1, 0, 0.0)
    np.testing.assert_array_equal(link.regression, [[0, 0, 1, 0], [0, 0, 0, 1]])
    np.testing.assert_array_equal(link.covariance, np.zeros((2, 2)))
