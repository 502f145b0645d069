"""The shapes that no training saw: bodies that a hand can hold, judged in the same episodes."""

import numpy as np
import pytest

from experiments import shapes
from hpac_gym.body.object_sets import object_set
from hpac_gym.body.own_objects import own_object


@pytest.mark.parametrize("name", shapes.SHAPES)
def test_a_shape_is_one_body_in_the_size_of_what_people_hold(name, tmp_path):
    file = tmp_path / "shape.urdf"
    file.write_text(shapes.urdf_of(name))
    model = own_object(file).solid_model
    mass, parts = shapes.SHAPES[name]
    assert model.mass == pytest.approx(mass)
    assert len(model.solids) == len(parts)
    assert 0.017 < min(model.size) < max(model.size) < 0.2
    near = [
        np.linalg.norm(one.center - other.center) - (max(one.size) + max(other.size)) / 2
        for place, one in enumerate(model.solids)
        for other in model.solids[:place]
    ]
    assert not near or min(near) < 0  # parts that touch


def test_there_are_twenty_and_no_split_has_them():
    names = {entry.name for split in ("train", "test", "real") for entry in object_set(split)}
    assert len(shapes.SHAPES) == 20
    assert not names & set(shapes.SHAPES)


def test_a_row_counts_what_was_held_and_what_the_script_did_not_hold():
    script = {key: [False, True] for key in shapes.SHAPES}
    cell = shapes._cell("some", {key: [True, True] for key in shapes.SHAPES}, script)
    assert (cell["successes"], cell["difference"]) == (40, 0.5)
    assert shapes._cell("script", script, script)["difference"] == 0.0
