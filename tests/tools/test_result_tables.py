"""The benchmark's files of the documentation tell what the rules ask for."""

import shlex

import pytest

from hpac_gym.evaluation import benchmark
from tests.options import parsed
from tools.result_tables import result_files

FILES = result_files()


@pytest.mark.parametrize("name", FILES)
def test_a_file_tells_its_method_and_its_command_makes_it_again(name):
    file = FILES[name]
    told = parsed(benchmark, *shlex.split(file["command"])[2:])
    assert (told.env, told.policy, told.about) == tuple(
        file[key] for key in ("env_id", "policy", "about")
    )
    assert bool(file["about"]) == bool(file["budget"]), "a trained method has a line on it"
