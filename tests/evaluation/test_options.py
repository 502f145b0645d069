"""The options of an environment have the same names and meaning in every command."""

import argparse

import gymnasium
import pytest

import hpac
from hpac_gym.body.objects import ObjectSpec
from hpac_gym.errors import ParameterError
from hpac_gym.evaluation.environment import make_env
from hpac_gym.evaluation.options import OPTIONS, add_env_options, env_options, object_of, with_set
from tests.options import help_of

GRASP = "HPAC-Grasp-v0"


def options(*words: str, env_id: str = GRASP) -> dict:
    parser = argparse.ArgumentParser()
    add_env_options(parser, "id")
    return env_options(parser.parse_args(words), env_id)


def test_what_is_not_given_is_left_to_the_environment():
    assert options() == {}
    assert options("--engine", "mujoco", "--body", "light") == {"engine": "mujoco", "body": "light"}


def test_a_weight_is_set_by_the_path_of_its_name():
    found = options("--set", "config.weights.effort=-0.1", "--set", "config.gap=[0.01,0.02]")
    assert found == {"config": {"weights": {"effort": -0.1}, "gap": [0.01, 0.02]}}
    with make_env(GRASP, engine="mujoco", **found) as env:
        config = env.unwrapped.task.config
        assert (config.weights.effort, config.gap) == (-0.1, (0.01, 0.02))
    assert with_set(found, ["config.gap=1"])["config"]["gap"] == 1
    assert found["config"]["gap"] == [0.01, 0.02], "what was given before stays as it is"


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("wrist=free", "free"),
        ("randomize=null", None),
        ("a=true", True),
        ("a=False", False),
        ("noise=None", None),
        ("a=[0.5, 1]", [0.5, 1]),
        ("a=-0.7,1e-1", [-0.7, 0.1]),
        ("a=1,", "1,"),
        ("a=1,x", "1,x"),
        ("a=mine=yours", "mine=yours"),
    ],
)
def test_a_value_is_json_or_a_constant_of_python_or_else_text(text, value):
    assert list(options("--set", text).values()) == [value]


def test_an_object_is_a_shape_with_its_sizes_or_a_file():
    assert options("--object", "sphere:0.03") == {"object": "sphere:0.03"}
    assert object_of("sphere:0.03") == ObjectSpec(
        "sphere", (0.03, 0.03, 0.03), mass=0.1, friction=0.8
    )
    found = options(
        "--object", "mug.stl", "--set", "object.mass=0.3", "--set", "object.scale=0.001"
    )
    assert found == {"object": {"path": "mug.stl", "mass": 0.3, "scale": 0.001}}
    assert options("--object", "lamp.URDF") == {"object": {"path": "lamp.URDF"}}


def test_a_grasp_is_a_type_where_the_task_has_types():
    assert options("--grasp", "rod") == {"grasp": "rod"}
    assert options("--grasp", "hook", env_id="hpac_gym:HPAC-GraspType-v0") == {"types": "hook"}


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--set", "config"], "--set 'config' is not NAME=VALUE"),
        (["--set", "=3"], "is not NAME=VALUE"),
        (["--set", "config..a=3"], "is not NAME=VALUE"),
        (["--engine", "mujoco", "--set", "engine.rate=3"], "engine is 'mujoco', and has no rate"),
        (["--object", "ball"], "--object 'ball' is not one of cylinder:radius"),
        (["--object", "box:0.1,0.1"], "is not one of"),
        (["--object", "box:a,b,c"], "is not one of"),
    ],
)
def test_another_form_is_refused_in_one_line(words, says):
    with pytest.raises(ParameterError) as caught:
        options(*words)
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("command", ["evaluate", "record", "show"])
def test_every_command_that_makes_an_environment_has_them_all(command):
    told = help_of(command)
    missing = [name for name in (*OPTIONS, "set", "env", "normalize") if f"--{name}" not in told]
    assert not missing
    assert "train, wide, test or real" in told.replace("\n", " ")


def test_an_object_of_ones_own_is_evaluated_and_recorded(tmp_path, capsys):
    words = ["--policy", "grasp", "--engine", "mujoco", "--object", "cylinder:0.025,0.06"]
    assert (
        hpac.main(["evaluate", *words, "--episodes", "4", "--workers", "1", "--no-baselines"]) == 0
    )
    assert "cylinder" in capsys.readouterr().out
    assert hpac.main(["record", *words, "-n", "2", "--out", str(tmp_path / "data")]) == 0


def test_an_id_may_name_the_module_that_registers_it(tmp_path, monkeypatch, capsys):
    """In the folder of the user, as from a console script, which has its own folder first."""
    (tmp_path / "mine.py").write_text(
        "import gymnasium\nfrom tests.tiny_task import Tiny\ngymnasium.register('Mine-v0', Tiny)\n"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.path", [path for path in __import__("sys").path if path])
    words = ["evaluate", "--policy", "random", "--env", "mine:Mine-v0", "--episodes", "2"]
    assert hpac.main([*words, "--workers", "1"]) == 0
    assert "random" in capsys.readouterr().out
    gymnasium.registry.pop("Mine-v0")
