"""Whether the hand holds an object, in many worlds at once: each world here is one story."""

import numpy as np
import pytest

from hpac_gym.tasks.grip import MAX_SLIP, Grip

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
    grip.settle(np.array([True, False, True]))
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
