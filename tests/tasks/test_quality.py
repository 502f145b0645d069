"""The epsilon figure against cases with a known answer."""

import numpy as np
import pytest

from hpac_gym.tasks.quality import CONE_EDGES, contact_wrenches, largest_ball


def test_the_ball_in_a_cube_and_in_a_cross_polytope():
    cube = np.array(np.meshgrid(*[[-1, 1]] * 4)).reshape(4, -1).T
    assert largest_ball(cube) == pytest.approx(1.0)
    assert largest_ball(cube + np.array([0.25, 0, 0, 0])) == pytest.approx(0.75)
    cross = np.vstack([np.eye(6), -np.eye(6)])
    assert largest_ball(cross) == pytest.approx(1 / np.sqrt(6))


def test_no_ball_where_the_origin_is_outside_or_the_points_are_flat():
    assert largest_ball(np.eye(3) + 1) == 0.0
    assert largest_ball(np.vstack([np.eye(6), -np.eye(6)])[:6]) == 0.0
    flat = np.column_stack([np.random.default_rng(0).standard_normal((20, 5)), np.zeros(20)])
    assert largest_ball(flat) == 0.0
    assert largest_ball(np.empty((0, 6))) == 0.0


def test_primitive_wrenches_lie_on_the_friction_cone():
    point = np.array([[0.03, 0, 0.01]])
    normal = np.array([[-1.0, 0, 0]])
    wrenches = contact_wrenches(point, normal, 0.5, np.zeros(3), 0.03)
    assert wrenches.shape == (CONE_EDGES, 6)
    np.testing.assert_allclose(wrenches[:, :3] @ normal[0], 1.0)
    np.testing.assert_allclose(np.linalg.norm(wrenches[:, 1:3], axis=1), 0.5)
    np.testing.assert_allclose(wrenches[:, 3:] * 0.03, np.cross(point, wrenches[:, :3]), atol=1e-12)


def test_more_friction_and_more_contacts_never_resist_less():
    angle = np.linspace(0, 2 * np.pi, 3, endpoint=False)
    normal = -np.column_stack([np.cos(angle), np.sin(angle), np.zeros(3)])
    figures = [
        largest_ball(contact_wrenches(-0.03 * normal, normal, mu, np.zeros(3), 0.03))
        for mu in (0.3, 0.6, 0.9)
    ]
    assert 0 < figures[0] < figures[1] < figures[2]
    two = largest_ball(contact_wrenches(-0.03 * normal[:2], normal[:2], 0.6, np.zeros(3), 0.03))
    assert two <= figures[1]
