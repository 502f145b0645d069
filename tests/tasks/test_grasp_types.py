"""The sixteen grasp types: each is its posture, executed; and a rule tells a grasp from one that
only holds.
"""

import hashlib
from dataclasses import replace

import numpy as np
import pytest

from hpac_gym.model import (
    HPAC,
    POSTURES,
    action_from_synergy,
    joints_from_synergy,
    reach,
    servo_from_action,
)
from hpac_gym.physics.engine import HAND_QUATERNION, matrix_from_quaternion
from hpac_gym.tasks.grasp_data import GRASPS, GraspError, quaternion_from_rpy
from hpac_gym.tasks.grasp_holds import Hold, Hole, Look
from hpac_gym.tasks.grasp_rules import (
    ASKED,
    GRASP_TYPES,
    TYPE_SPLITS,
    Rule,
)
from hpac_gym.tasks.grasp_types import GraspByType, GraspTypeConfig
from hpac_gym.tasks.occlusion import in_the_way
from hpac_gym.tasks.placing import START, wrist_choice

NAMES = list(GRASPS)
TIPS = {
    digit: f"{joint}_link"
    for digit, joint in zip(
        HPAC.digits, ("thumb_ip", *(f"{f}_dip" for f in list(HPAC.digits)[1:])), strict=True
    )
}


@pytest.mark.parametrize("name", NAMES)
def test_a_type_closes_to_its_posture_by_eqs_14_and_15_without_retuning(name: str):
    """What the closure ends in is the servo command u* of the posture's q_d, and the posture is one
    that six servos reach.
    """
    taken = reach(POSTURES[name].target_joint_pos)
    closed = GRASP_TYPES[name].start.closed
    np.testing.assert_allclose(
        servo_from_action(action_from_synergy(closed)), taken.servo, atol=1e-9
    )
    np.testing.assert_allclose(joints_from_synergy(closed), taken.joint_pos, atol=1e-9)
    assert taken.distance < 0.01


def test_the_named_grasps_of_v0_stay_as_they_are():
    """Frozen: how an episode begins. The closed shapes are the script's, which may be improved."""
    numbers = np.array(
        [[*grasp.preshape, *grasp.position, *grasp.hand_rpy] for grasp in GRASPS.values()]
    )
    assert (
        hashlib.sha256(np.round(1e6 * numbers).astype(np.int64).tobytes()).hexdigest()[:16]
        == "7be8206f8ca5cc94"
    )


def look(
    force: dict[str, float],
    normal=(1.0, 0.0, 0.0),
    point=(0.0, 0.0, 0.0),
    rotation=None,
    centre=(0.5, 0.0, 0.0),
) -> Look:
    """Contacts of some links with one normal and one point, the hand open."""
    count = len(force)
    spread = [np.tile(np.asarray(vector, float), (count, 1)) for vector in (point, normal)]
    turn = np.eye(3) if rotation is None else rotation
    return Look(
        tuple(force), np.array(list(force.values())), *spread, turn, np.array(centre), np.zeros(15)
    )


def hold(*looks: Look) -> Hold:
    return Hold(looks)


def is_kept(rule: Rule, found: Hold) -> bool:
    return min(rule.clauses(found).values()) == 1


PINCH = {TIPS["thumb"]: 3.0, TIPS["index"]: 3.0}
BALL = {TIPS["index"]: 3.0, "thumb_cmc_link": 3.0}
"""A finger against the ball of the thumb."""
TURNED = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
TILTED = TURNED[:, [2, 1, 0]] * [1, 1, -1]


@pytest.mark.parametrize(
    ("rule", "good", "bad"),
    [
        (Rule(touch=("thumb", "index")), hold(look(PINCH)), hold(look({TIPS["index"]: 3.0}))),
        (Rule(fingers=1), hold(look(PINCH)), hold(look({TIPS["thumb"]: 3.0}))),
        (Rule(digits=2), hold(look(PINCH)), hold(look({TIPS["thumb"]: 3.0, "palm": 1.0}))),
        (Rule(never=("palm",)), hold(look(PINCH)), hold(look(PINCH | {"palm": 0.1}))),
        (Rule(tips=True), hold(look(PINCH)), hold(look(PINCH | {"index_mcp_link": 3.0}))),
        (
            Rule(touch=("thumb",)),
            hold(look({"thumb_mp_link": 3.0})),
            hold(look({"thumb_cmc_link": 3.0})),
        ),
        (Rule(digits=2), hold(look(PINCH)), hold(look(BALL))),
        (Rule(never=("palm",)), hold(look(PINCH)), hold(look(PINCH | BALL))),
        (Rule(force=4.0), hold(look(PINCH)), hold(look({TIPS["thumb"]: 3.0}))),
        (Rule(), hold(look(PINCH), look(PINCH)), hold(look(PINCH), look(PINCH, rotation=TURNED))),
        (
            Rule(turn_deg=180, tilt_deg=20),
            hold(look(PINCH, rotation=TURNED)),
            hold(look(PINCH, rotation=TILTED)),
        ),
        (Rule(axis="x", along=0.7), hold(look(PINCH)), hold(look(PINCH, normal=(0.0, 1.0, 0.0)))),
        (Rule(axis="z", across=0.7), hold(look(PINCH)), hold(look(PINCH, normal=(0.0, 0.0, 1.0)))),
        (Rule(side="index"), hold(look(PINCH, normal=(0.0, 1.0, 0.0))), hold(look(PINCH))),
        (
            Rule(button=0.04, press=2.0),
            hold(look(PINCH, normal=(0.0, 0.0, -1.0), point=(0.0, 0.0, 0.05))),
            hold(look(PINCH, normal=(0.0, 0.0, -1.0), point=(0.0, 0.0, 0.03))),
        ),
        (
            Rule(button=0.04, press=2.0),
            hold(look({TIPS["thumb"]: 3.0}, normal=(0.0, 0.0, -1.0), point=(0.0, 0.0, 0.05))),
            hold(look({TIPS["thumb"]: 3.0}, point=(0.0, 0.0, 0.05))),
        ),
    ],
    ids=[
        "touch",
        "fingers",
        "digits",
        "never",
        "tips",
        "metacarpal",
        "digits but the metacarpal",
        "never the metacarpal",
        "force",
        "turn",
        "tilt",
        "along",
        "across",
        "side",
        "button",
        "pressed",
    ],
)
def test_a_rule_tells_a_good_hold_from_a_bad_one(rule: Rule, good: Hold, bad: Hold):
    assert is_kept(rule, good), rule.clauses(good)
    assert not is_kept(rule, bad), rule.clauses(bad)
    assert all(0 <= value <= 1 for found in (good, bad) for value in rule.clauses(found).values())


def test_a_part_touches_if_it_does_in_half_of_the_hold():
    rule = Rule(touch=("thumb",))
    without = look({TIPS["index"]: 3.0})
    assert is_kept(rule, hold(look(PINCH), without))
    assert not is_kept(rule, hold(look(PINCH), without, without))


def test_a_digit_goes_through_a_ring_that_is_put_over_it_and_not_through_one_beside_it():
    """The open index lies along z of the hand, its last two links from z = 137 to 188 mm at y = 35
    to 40 mm.
    """
    ring = Hole(centre=(0.0, 0.0, 0.0), axis="z", half=(0.014, 0.014))
    rule = Rule(through=("index",), holes=(ring,))
    assert is_kept(rule, hold(look(PINCH, centre=(0.0, 0.038, 0.165))))
    assert not is_kept(rule, hold(look({TIPS["thumb"]: 3.0}, centre=(0.0, 0.038, 0.165)))), (
        "it must touch, too"
    )
    without = [look({TIPS["thumb"]: 3.0}, centre=(0.0, 0.038, 0.165))] * 4
    assert not is_kept(rule, hold(look(PINCH, centre=(0.0, 0.038, 0.165)), *without)), (
        "a fifth of the hold is not enough"
    )
    assert not is_kept(rule, hold(look(PINCH, centre=(0.0, 0.060, 0.165))))
    assert not is_kept(rule, hold(look(PINCH, centre=(0.0, 0.038, 0.200)))), "beyond its tip"
    for place, inside in ((0.0139, True), (0.0141, False)):
        assert ring.hit(np.array([place, 0.0, -0.01]), np.array([place, 0.0, 0.01])) == inside


@pytest.mark.parametrize(
    ("types", "message"),
    [
        ("club", "'club'; there are all, train, test, large_cylinder"),
        (["rod", 3], "3;"),
        ([], r"\[\];"),
        (None, "None;"),
    ],
)
def test_an_unknown_type_is_named(types, message: str):
    with pytest.raises(GraspError, match=f"no grasp type {message}"):
        GraspByType(types)


def test_the_splits_part_the_types_and_their_objects():
    assert TYPE_SPLITS["all"] == tuple(GRASP_TYPES) == tuple(NAMES)
    assert sorted(TYPE_SPLITS["train"] + TYPE_SPLITS["test"]) == sorted(NAMES)
    drawn = {objects: drawn_setups("all", objects, 300) for objects in ("train", "test")}
    for name in NAMES:
        start = GRASP_TYPES[name].start
        own, held_out = (
            {setup.object for setup in drawn[objects] if setup.grasp == name}
            for objects in ("train", "test")
        )
        assert {spec.model.name for spec in own} == {start.object.name}
        assert len(own) == 1
        assert held_out
        assert not own & held_out
    assert {setup.grasp for setup in drawn_setups(["rod", "hook"], "train", 20)} == {"rod", "hook"}


def drawn_setups(types, objects: str, count: int, **more) -> list:
    task = GraspByType(types, objects, **more)
    rng = np.random.default_rng(0)
    return [task.setup(rng) for _ in range(count)]


def height_of(setup) -> float:
    """Height of the object's centre above the table [m]."""
    return 0.25 + (setup.hand_rotation @ setup.position)[2] - setup.support.table_height


def test_there_is_one_start_for_all_types():
    """The open hand, turned one way, the object out of reach; and the object as high above the
    table as its type has it.
    """
    for setup in drawn_setups("all", "train", 100):
        assert not setup.synergy.any()
        assert setup.hand_quaternion == HAND_QUATERNION
        start = GRASP_TYPES[setup.grasp].start
        assert np.abs(setup.position - START).max() <= max(start.position_noise)
        turn = matrix_from_quaternion(quaternion_from_rpy(start.hand_rpy))
        own = 0.25 + (turn @ start.position)[2] - start.support.table_height
        assert abs(height_of(setup) - own) <= 1.8 * max(start.position_noise)


@pytest.mark.parametrize("name", NAMES)
def test_an_action_puts_the_hand_where_the_type_has_it(name: str):
    """Hand, object and support are those of the wrist that a script places, with the same noise."""
    start = GRASP_TYPES[name].start
    free = GraspByType(name)
    script = GraspByType(name, wrist="script")
    choice = wrist_choice(start)
    assert np.abs(choice).max() <= 1
    action = np.append(action_from_synergy(start.preshape), choice)
    chosen = free.chosen(free.setup(np.random.default_rng(3)), action)
    placed = script.setup(np.random.default_rng(3))
    for name in ("synergy", "position", "hand_rotation"):
        np.testing.assert_allclose(getattr(chosen, name), getattr(placed, name), atol=1e-9)
    assert abs(height_of(chosen) - height_of(placed)) <= 2e-9
    assert (chosen.object, chosen.yaw, chosen.object_quaternion) == (
        placed.object,
        placed.yaw,
        placed.object_quaternion,
    )


def test_no_support_is_in_the_way_of_the_types_own_hands_but_a_wider_or_a_higher_one_is():
    """By geometry, without an engine."""
    for objects in ("train", "test"):
        assert not any(map(in_the_way, drawn_setups("all", objects, 60)))
        setups = drawn_setups("all", objects, 100, wrist="script")
        assert not any(map(in_the_way, setups))
    blocked = {
        name: {
            setup.grasp
            for setup in setups
            if in_the_way(replace(setup, support=replace(setup.support, **support)))
        }
        for name, support in (
            ("wide post", {"half_width": (0.1, 0.1)}),
            ("high table", {"table_height": 0.255}),
        )
    }
    beside = {"small_sphere", "large_sphere", "disk", "lateral_pinch"}
    assert beside <= blocked["wide post"] < set(NAMES)
    assert blocked["high table"] == set(NAMES)


def test_the_noise_has_the_spread_of_the_config():
    (wide,), (usual,) = (
        drawn_setups("press", "train", 1, config=GraspTypeConfig(spread=spread))
        for spread in (2.0, 1.0)
    )
    np.testing.assert_allclose(wide.position - START, 2 * (usual.position - START))
    assert wide.yaw == pytest.approx(2 * usual.yaw)


def test_a_rule_grows_with_its_object_and_is_told_in_numbers():
    press = GRASP_TYPES["press"].rule
    tape = GRASP_TYPES["tape_roll"].rule
    assert press.scaled(1.08).button == pytest.approx(1.08 * press.button)
    assert tape.scaled(0.92).holes[0].half[0] == pytest.approx(0.92 * 0.019)
    told = dict(zip(ASKED, GRASP_TYPES["tweezers"].rule.asked, strict=True))
    assert (told["along_x"], told["along_z"], told["through"]) == (0.7, 0.0, 0.0)
    assert dict(zip(ASKED, tape.asked, strict=True))["along_z"] == -0.7
    assert tape.asked_parts == [0, 1, 0, 0, 0, 0]
    assert GRASP_TYPES["hook"].rule.asked_parts == [0, -1, 0, 0, 0, 0]
    vectors = [tuple(kind.rule.asked_parts + kind.rule.asked) for kind in GRASP_TYPES.values()]
    assert len(set(vectors)) == 14, "both cylinders and the large sphere ask the same"
