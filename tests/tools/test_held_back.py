"""Choosing settings on training objects: none that is held back is trained on."""

from agents import POLICY, train
from agents.recipes import RECIPES
from hpac_gym.body.object_sets import object_set
from hpac_gym.envs import GraspAny
from hpac_gym.policies.policy_file import SHIPPED
from tools import held_back

TRAINED = SHIPPED["grasp-any"]


def test_the_objects_are_split_by_families():
    back, rest = (
        {entry.name for entry in held_back.keep(GraspAny(), part).setups.objects}
        for part in (True, False)
    )
    assert len(back) == 40
    assert not back & rest
    assert back | rest == {entry.name for entry in object_set("train")}


def test_it_trains_without_them(tmp_path, monkeypatch):
    def trained(words, make):
        assert (
            not {entry.name for entry in make(RECIPES["grasp-any"]).setups.objects}
            & held_back.HELD_BACK
        )
        assert words == ["grasp-any", "--out", str(tmp_path), "--sizes", "1,1"]
        return 5

    monkeypatch.setattr(train, "main", trained)
    assert held_back.main(["--out", str(tmp_path), "--sizes", "1,1"]) == 5


def test_it_evaluates_what_is_trained(tmp_path, capsys):
    (tmp_path / POLICY).symlink_to(TRAINED)
    assert held_back.main(["--out", str(tmp_path), "--episodes", "12"]) == 0
    rows = [line.split(" | ") for line in capsys.readouterr().out.splitlines()[2:]]
    assert [row[:2] for row in rows] == [
        ["| trained on", "nominal"],
        ["| held back", "nominal"],
        ["| held back", "train"],
    ]
    assert all(20 < float(row[2].split()[0]) < 95 for row in rows)
