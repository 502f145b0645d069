"""The object sets: how many, how different, graspable, as published, and at rest in the poses that
they come with.
"""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from hpac_gym.body.geometry import table_of
from hpac_gym.body.object_models import load_object_models
from hpac_gym.body.object_sets import SPLITS, RestingObject, object_set, resting_pose
from hpac_gym.errors import ParameterError
from hpac_gym.physics.engine import matrix_from_quaternion
from hpac_gym.tasks.grasp_data import GRASPS
from tools.families import FAMILIES, NEW_FAMILIES
from tools.object_families import (
    FIELDS,
    MAX_MASS,
    MAX_PLAIN_MASS,
    MIN_DIFFERENCE,
    MIN_MASS,
    SPAN,
    difference,
)

SETS = {split: object_set(split) for split in SPLITS}
EVERY = list({thing.name: thing for things in SETS.values() for thing in things}.values())
PLAIN = SETS["wide"][200:]
TURNED = ("plain_093", "plain_110")
"""Blocks of which rounding chose the other side; the sampler turns them."""
DRAWN = [*SETS["train"], *SETS["test"]]
SOURCES = {
    name: entry
    for file in ("objects.toml", "real_objects.toml")
    for name, entry in table_of(file).items()
    if name != "friction_of_named_objects"
}
"""Entries of the real objects, with the sources of their numbers."""
SOURCE_FIELDS = {"source", "published", "chosen"}
MEASURES = {"x", "y", "z", "mass"}


def test_there_are_200_to_train_on_or_400_50_held_out_and_52_real_ones():
    assert {split: len(things) for split, things in SETS.items()} == {
        "train": 200,
        "wide": 400,
        "test": 50,
        "real": 52,
    }
    assert len(EVERY) == 502
    assert [thing.name for thing in SETS["train"][:2]] == ["train_000", "train_001"]
    assert SETS["wide"][:200] == SETS["train"]
    assert object_set("test") is object_set("test")


@pytest.mark.parametrize("split", ["tests", "", None, 3])
def test_an_unknown_split_names_the_splits(split):
    with pytest.raises(ParameterError, match="is not one of train, wide, test, real"):
        object_set(split)


def test_no_held_out_object_is_like_a_training_object():
    pairs = [
        *itertools.product(SETS["test"], SETS["train"]),
        *itertools.product([*SETS["test"], *SETS["real"]], PLAIN),
    ]
    nearest = min(difference(held.model, known.model) for held, known in pairs)
    assert nearest > MIN_DIFFERENCE == 0.1
    known = SETS["train"][0].model
    assert (
        difference(known, replace(known, size=tuple(1.04 * side for side in known.size)))
        < MIN_DIFFERENCE
    )


def test_held_out_objects_are_partly_of_families_that_training_has_not():
    train, test = ({thing.model.about for thing in SETS[split]} for split in ("train", "test"))
    assert train == set(FAMILIES)
    assert test == train | set(NEW_FAMILIES)
    assert not train & set(NEW_FAMILIES)
    assert sum(thing.model.about in NEW_FAMILIES for thing in SETS["test"]) == 30


@pytest.mark.parametrize(
    ("file", "fields"),
    [
        ("objects", FIELDS | SOURCE_FIELDS),
        ("held_out_objects", FIELDS),
        ("real_objects", FIELDS | SOURCE_FIELDS | {"friction"}),
        ("procedural_objects", FIELDS | {"friction"}),
    ],
)
def test_an_object_in_a_file_has_its_fields_and_kinds_of_solids(file, fields):
    kinds = {"box", "cylinder", "sphere", "capsule", "ring"}
    for name, entry in table_of(f"{file}.toml").items():
        if name != "friction_of_named_objects":
            assert entry.keys() == fields, name
            assert {solid["kind"] for solid in entry["solids"]} <= kinds, name


def test_objects_are_bodies_that_there_can_be():
    """Positive mass, which is that of the solids; moments of inertia of which none is more than the
    sum of both others; mass centre inside; middle at the origin.
    """
    for name, model in (
        {thing.name: thing.model for thing in EVERY} | load_object_models()
    ).items():
        moments = np.linalg.eigvalsh(model.inertia)
        (low, high) = model.turned_bounds(np.eye(3))
        masses = [solid.mass for solid in model.solids]
        assert min(masses) > 0, name
        assert sum(masses) == pytest.approx(model.mass, rel=1e-6), name
        np.testing.assert_allclose(high + low, 0.0, atol=2e-4, err_msg=name)
        assert moments[0] > 0, name
        assert moments[2] <= (moments[0] + moments[1]) * (1 + 1e-9), name
        assert (model.center_of_mass > low).all(), name
        assert (model.center_of_mass < high).all(), name
        np.testing.assert_allclose(high - low, model.size, rtol=0.05, err_msg=name)
    assert all(MIN_MASS <= thing.model.mass <= MAX_MASS for thing in DRAWN)
    assert all(MIN_MASS <= thing.model.mass <= MAX_PLAIN_MASS for thing in PLAIN)
    assert all(0.4 <= thing.friction <= 1.0 for thing in EVERY)


def test_mass_centres_are_not_all_in_the_middle():
    """Of the drawn objects, a fifth and more have theirs farther from it than a tenth of their
    longest side.
    """
    off = [np.linalg.norm(thing.model.center_of_mass) / max(thing.model.size) for thing in DRAWN]
    assert np.mean(np.array(off) > 0.1) > 0.2


def fits(thing: RestingObject) -> bool:
    """Whether the hand spans the object's narrower side in one of its poses."""
    return any(pose.width <= SPAN for pose in thing.poses)


def test_the_hand_spans_every_object_in_at_least_one_of_its_poses():
    wide = [thing.name for thing in EVERY if not fits(thing)]
    assert wide == ["plain_101", "plain_169"]  # which lie on their larger sides, and are not drawn
    model = load_object_models()["quoit"]
    quoit = RestingObject(model, 0.7, (resting_pose(model, (0, 0, 0, 1), 1.0),), False)
    assert not fits(quoit)


def test_a_pose_lies_on_its_lowest_point():
    for thing in EVERY:
        assert thing.poses, thing.name
        assert sum(pose.share for pose in thing.poses) <= 1.0 + 1e-9, thing.name
        for pose in thing.poses:
            low, high = thing.model.turned_bounds(matrix_from_quaternion(pose.quaternion))
            np.testing.assert_allclose(high - low, pose.size, atol=1e-9)
            assert pose.height == pytest.approx(-low[2], abs=1e-9)
            if thing.name not in TURNED:
                assert pose.size[0] > pose.size[1] - 5e-4, thing.name


def test_real_objects_are_within_five_percent_of_what_their_sources_print():
    """Every measure that is not published says where it is from; the quoit is the one named object
    that is in no set.
    """
    for model in (*(thing.model for thing in SETS["real"]), load_object_models()["quoit"]):
        low, high = model.turned_bounds(np.eye(3))
        found = dict(zip("xyz", high - low, strict=True)) | {"mass": model.mass}
        source, published, chosen = (
            SOURCES[model.name][name] for name in ("source", "published", "chosen")
        )
        for measure, interval in published.items():
            assert 0.95 * np.min(interval) <= found[measure] <= 1.05 * np.max(interval), (
                model.name,
                measure,
            )
        assert bool(chosen) == (published.keys() < MEASURES), model.name
        assert published or source == "none found", model.name


def test_most_real_objects_have_all_their_measures_from_a_source():
    assert len(SOURCES) == 53
    assert sum(entry["published"].keys() == MEASURES for entry in SOURCES.values()) >= 35


def test_named_grasps_objects_are_the_same_here_but_for_the_quoit():
    named = {grasp.object.name: grasp for grasp in GRASPS.values() if grasp.object.name != "quoit"}
    here = {thing.name: thing for thing in SETS["real"] if thing.name in named}
    assert {name: thing.friction for name, thing in here.items()} == {
        name: grasp.friction for name, grasp in named.items()
    }
    assert all(thing.model is load_object_models()[name] for name, thing in here.items())


def test_a_stand_is_for_what_stands_upright():
    for thing in EVERY:
        if thing.stand:
            assert all(pose.width < pose.size[2] for pose in thing.poses), thing.name
    assert 20 < sum(thing.stand for thing in EVERY) < 150
