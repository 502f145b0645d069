"""What counts as held."""

import numpy as np
import pytest

from hpac_gym.envs.grip import MAX_SLIP, Grip

DT = 0.05
PLACE, ASIDE = np.array([0.05, 0.0, 0.1]), np.array([0.0, 1.0, 0.0])
TOUCHED, FREE, STANDS = (True, False), (False, False), (True, True)
"""Whether the hand and whether a support touches the object."""


def grip_after(*steps, place=PLACE) -> Grip:
    grip = Grip()
    for touched, supported in steps:
        grip.follow(place, touched, supported, DT)
    return grip


def test_an_object_that_stands_is_not_held_though_the_hand_touches_it():
    assert not grip_after(STANDS).holds
    assert grip_after(STANDS, STANDS).time == 0.0


def test_it_is_held_from_when_its_support_is_gone():
    grip = grip_after(STANDS, TOUCHED, TOUCHED)
    assert grip.holds
    assert grip.time == pytest.approx(2 * DT)


def test_an_object_that_nothing_touches_is_not_held():
    assert not grip_after(FREE).holds


def test_one_step_without_a_contact_is_forgiven_and_two_are_not():
    assert grip_after(TOUCHED, FREE).holds
    assert grip_after(TOUCHED, FREE, TOUCHED).time == pytest.approx(3 * DT)
    lost = grip_after(TOUCHED, FREE, FREE)
    assert not lost.holds
    assert lost.time == lost.slip == lost.firmness == 0.0


def test_slip_counts_from_where_the_carrying_began():
    grip = grip_after(STANDS, TOUCHED)
    grip.follow(PLACE + 0.9 * MAX_SLIP * ASIDE, *TOUCHED, DT)
    assert grip.slip == pytest.approx(0.9 * MAX_SLIP)
    assert grip.holds
    assert grip.firmness == pytest.approx(0.1)
    grip.follow(PLACE + 1.1 * MAX_SLIP * ASIDE, *TOUCHED, DT)
    assert not grip.holds


def test_what_moved_before_the_grasp_settled_is_no_slip():
    grip = grip_after(STANDS, TOUCHED)
    grip.follow(PLACE + 1.1 * MAX_SLIP * ASIDE, *TOUCHED, DT)
    grip.settle()
    assert grip.holds
    assert grip.time == pytest.approx(2 * DT)
    grip.follow(PLACE + 2.0 * MAX_SLIP * ASIDE, *TOUCHED, DT)
    assert grip.slip == pytest.approx(0.9 * MAX_SLIP)


def test_nothing_settles_that_is_not_carried():
    grip = grip_after(STANDS)
    grip.settle()
    assert not grip.holds
