"""Whether the hand holds an object, in many worlds at once: each world here is one story; and the
epsilon figure against cases with a known answer.
"""

import numpy as np
import pytest

from hpac_gym.tasks.grip import CONE_EDGES, MAX_SLIP, Grip, contact_wrenches, largest_ball

DT = 0.05
PLACE = np.array([0.05, 0.0, 0.1])
ASIDE = np.array([0.0, 1.0, 0.0])
TOUCHED = (True, False)
FREE = (False, False)
STANDS = (True, True)
"""Whether the hand and whether a support touches the object."""


def grip_after(*stories, moved=0.0) -> Grip:
    """The grip of as many worlds as there are stories, each as many steps long as the first; the
    last step moves the object.
    """
    grip = Grip(len(stories))
    grip.start(range(len(stories)), [PLACE - ASIDE] * len(stories))
    for step, now in enumerate(zip(*stories, strict=True)):
        touched, supported = np.array(now).T
        place = PLACE + (moved * ASIDE if step == len(stories[0]) - 1 else 0.0)
        grip.follow(np.tile(place, (len(stories), 1)), touched, supported, DT)
    return grip


def test_an_object_is_held_while_the_hand_touches_it_and_no_support_does():
    grip = grip_after([STANDS, STANDS, STANDS], [STANDS, TOUCHED, TOUCHED], [FREE, FREE, FREE])
    np.testing.assert_array_equal(grip.holds, [False, True, False])
    np.testing.assert_allclose(grip.time, [0.0, 2 * DT, 0.0])


def test_one_step_without_a_contact_is_forgiven_and_two_are_not():
    grip = grip_after([TOUCHED, TOUCHED, FREE], [TOUCHED, FREE, TOUCHED], [TOUCHED, FREE, FREE])
    np.testing.assert_array_equal(grip.holds, [True, True, False])
    np.testing.assert_allclose(grip.time, [3 * DT, 3 * DT, 0.0])
    assert grip.slip[2] == grip.firmness[2] == 0.0


def test_slip_counts_from_where_the_carrying_began():
    grip = grip_after([STANDS, TOUCHED, TOUCHED], [TOUCHED, STANDS, TOUCHED], moved=0.9 * MAX_SLIP)
    np.testing.assert_allclose(grip.slip, [0.9 * MAX_SLIP, 0.0])
    np.testing.assert_allclose(grip.firmness, [0.1, 1.0])
    assert grip.holds.all()
    assert not grip_after([TOUCHED, TOUCHED], moved=1.1 * MAX_SLIP).holds
    np.testing.assert_allclose(grip.moved, 1.0 + 0.9 * MAX_SLIP)


def test_what_moved_before_the_grasp_settled_is_no_slip():
    grip = grip_after(
        [TOUCHED, TOUCHED], [TOUCHED, TOUCHED], [STANDS, STANDS], moved=1.1 * MAX_SLIP
    )
    grip.settle(np.array([True, False, True]), np.tile(PLACE + 1.1 * MAX_SLIP * ASIDE, (3, 1)))
    np.testing.assert_array_equal(grip.holds, [True, False, False])
    np.testing.assert_allclose(grip.time, [2 * DT, 2 * DT, 0.0])
    grip.follow(
        np.tile(PLACE + 2.0 * MAX_SLIP * ASIDE, (3, 1)), np.array([True] * 3), np.zeros(3, bool), DT
    )
    np.testing.assert_allclose(grip.slip, [0.9 * MAX_SLIP, 2.0 * MAX_SLIP, 0.0])


def test_an_episode_that_starts_carries_nothing_and_leaves_the_others_alone():
    grip = grip_after([TOUCHED, TOUCHED], [TOUCHED, TOUCHED])
    grip.start([1], [PLACE])
    np.testing.assert_array_equal(grip.carrying, [True, False])
    assert grip.time[0] == pytest.approx(2 * DT)
    assert grip.time[1] == 0.0
    np.testing.assert_allclose(grip.moved, [1.0, 0.0])


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
