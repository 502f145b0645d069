"""Algorithms of Stable-Baselines3 as contenders: what they train acts from a policy file as it does
in their own hands.
"""

import os
import re
import sys
from shutil import copyfile

import numpy as np
import pytest
from jax import tree

from agents import RecipeError, RunError, race, reproduce, target_of, train
from agents.curves import read_curve
from agents.runs import alone_in
from hpac_gym.command import INTERRUPTED, run
from hpac_gym.envs.sb3 import HandVecEnv
from hpac_gym.policies import PolicyFile, read_policy, write_policy
from hpac_gym.policies.made_for import options_of
from hpac_gym.policies.policy_file import SHIPPED

# Of TensorFlow Probability, on import.
pytestmark = pytest.mark.filterwarnings("ignore:jax.core.pytype_aval_mappings")
# Faster.
os.environ.setdefault(
    "XLA_FLAGS", "--xla_backend_optimization_level=0 --xla_llvm_disable_expensive_passes=true"
)
GRASP = "HPAC-Grasp-v0"
FEW_UPDATES = {"learning_starts": 8, "gradient_steps": 1, "batch_size": 16}
# One compilation.
FEW = {
    "ppo": {"n_steps": 8, "batch_size": 16, "n_epochs": 1},
    "sbx-crossq": FEW_UPDATES | {"policy_delay": 1},
}


def small(name: str) -> dict:
    return race.CONTENDERS[name] | {"num_envs": 2} | FEW.get(name, FEW_UPDATES)


SLOW = [
    pytest.param(name, True, marks=pytest.mark.slow)
    for name in race.CONTENDERS
    if name not in ("ppo", "crossq")
]


@pytest.mark.parametrize(
    ("name", "trained"), [("ppo", True), ("crossq", True), ("sbx-crossq", False), *SLOW]
)
def test_the_policy_file_acts_as_the_trained_model_predicts(name, trained, tmp_path):
    model = race.learner_of(name, small(name), share=lambda: 0.0)
    random = np.random.default_rng(0)
    if trained:
        model.learn(40)
    else:  # changes every array instead, since JAX takes long to compile the training
        state = model.policy.actor_state

        def more(array):
            return array + random.uniform(0.1, 0.5, np.shape(array))

        changed = {name: tree.map(more, getattr(state, name)) for name in ("params", "batch_stats")}
        model.policy.actor_state = state.replace(**changed)
    if name == "ppo":
        model.policy.action_net.bias.data[0] = 5.0  # beyond the bound
    write_policy(tmp_path / "policy.hpac", PolicyFile(race.trained_actor(model), {"env_id": GRASP}))
    actor = read_policy(tmp_path / "policy.hpac").actor
    scaling = model.get_vec_normalize_env()
    seen = random.uniform(-1, 1, (20, 44))
    predicted, _ = model.predict(scaling.normalize_obs(seen), deterministic=True)
    wanted = np.tanh(predicted) if name == "ppo" else predicted
    np.testing.assert_allclose([actor(row) for row in seen], wanted, atol=1e-5)
    assert np.ptp(wanted, axis=0)[1:].min() > 1e-3, "the actions depend on what is seen"
    model.env.close()


def test_the_table_of_the_race_trains_who_is_missing_and_judges_all(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(race, "CONTENDERS", {"sac": small("sac")})
    ours = tmp_path / "grasp-0"
    ours.mkdir()
    copyfile(SHIPPED["grasp"], ours / "policy.hpac")
    words = f"race --runs {tmp_path} --minutes 0.005 --episodes 2".split()
    reproduce.main(words)
    *_, first, second = capsys.readouterr().out.splitlines()
    assert first.startswith("| sac | 0 |")
    assert second.startswith("| one-step SAC | 0 | 60,0")
    reproduce.main([*words, "--learner", "sac", "--seeds", "2"])
    *_, second, _, last = capsys.readouterr().out.splitlines()
    assert second.startswith("| sac | 1 |")
    assert last.startswith("sac: 2 runs: median ")
    about = read_policy(tmp_path / "sac-1" / "policy.hpac").about
    assert about["processor_seconds"] >= 0.3
    assert (about["algorithm"], about["settings"]["seed"], about["action_repeat"]) == (
        "sac",
        1,
        small("sac")["action_repeat"],
    )
    assert about["env_steps"] == about["decisions"] * about["action_repeat"] > 0
    assert about["settings"]["options"] == {}
    assert len(read_curve(tmp_path / "sac-1" / "progress.csv")) > 0
    with (
        alone_in(tmp_path / "new"),
        pytest.raises(RunError, match="another training is writing to folder"),
    ):
        race.main(["sac", "--out", str(tmp_path / "new")])
    path = tmp_path / "sac-1" / "policy.hpac"
    write_policy(path, PolicyFile(read_policy(path).actor, about | {"processor_seconds": 0.2}))
    reproduce.main([*words, "--learner", "sac", "--seeds", "2"])
    told = capsys.readouterr()
    assert (
        "sac-1' was interrupted after 0 s: remove it to train it again; its row is left out"
        in told.err
    )
    assert told.out.splitlines()[-1].startswith("| sac | 0 |")


@pytest.mark.parametrize(("name", "left"), [("ppo", "progress.csv"), ("grasp", "run.json")])
def test_a_run_that_was_killed_before_its_first_policy_is_left_out_and_the_table_goes_on(
    name, left, tmp_path, capsys
):
    for seed in range(2):
        (tmp_path / f"{name}-{seed}").mkdir()
    (tmp_path / f"{name}-0" / left).touch()
    copyfile(SHIPPED["grasp"], tmp_path / f"{name}-1" / "policy.hpac")
    files = list(reproduce.race(tmp_path, [name], 2, 15.0))
    assert files == [str(tmp_path / f"{name}-1" / "policy.hpac")]
    (told,) = capsys.readouterr().err.splitlines()
    assert told.endswith(
        f"{name}-0' was interrupted before its first policy: remove it to train it again; its row is left out"
    )


def test_ctrl_c_in_a_training_ends_the_table(tmp_path, monkeypatch, capsys):
    begun = []
    monkeypatch.setattr(train, "main", lambda words: begun.append(words) or INTERRUPTED)
    assert (
        run(lambda: reproduce.main(f"race --runs {tmp_path} --learner grasp --seeds 3".split()))
        == INTERRUPTED
    )
    assert len(begun) == 1


def test_a_policy_tells_the_options_without_which_it_does_not_fit():
    needed = {"wrist": "free", "obs": "load"}
    assert options_of(target_of("HPAC-GraspAny-v1", **needed, engine="mujoco")) == needed


@pytest.mark.parametrize("name", ["ppo", "sbx-sac"])
def test_a_training_that_diverges_ends_in_one_error(name, tmp_path, monkeypatch):
    made = race.learner_of

    def broken(*words):
        model = made(*words)
        if name == "ppo":
            model.policy.action_net.bias.data[0] = float("nan")
        else:
            state = model.policy.actor_state
            model.policy.actor_state = state.replace(
                params=tree.map(lambda values: values * float("nan"), state.params)
            )
        return model

    monkeypatch.setattr(race, "learner_of", broken)
    with pytest.raises(RunError, match="diverged"):
        race.race(name, small(name), tmp_path, time_limit=60.0)


def test_without_sbx_one_line_names_the_extra_and_the_table_leaves_its_row_out(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.setitem(sys.modules, "sbx", None)
    monkeypatch.setattr(race, "CONTENDERS", {"sbx-sac": small("sbx-sac")})
    needs = "sbx-sac needs sbx, which is not installed: pip install '.[train,sbx]' in a checkout of hpac_gym"
    with pytest.raises(RecipeError, match=re.escape(needs)):
        race.main(["sbx-sac", "--out", str(tmp_path / "sbx-sac-0")])
    (tmp_path / "grasp-0").mkdir()
    copyfile(SHIPPED["grasp"], tmp_path / "grasp-0" / "policy.hpac")
    reproduce.main(f"race --runs {tmp_path} --episodes 1".split())
    told = capsys.readouterr()
    assert told.err.endswith(f"{needs}; its row is left out\n")
    assert [line.split("|")[1].strip() for line in told.out.splitlines()] == [
        "learner",
        "---",
        "one-step SAC",
    ]
    assert not (tmp_path / "sbx-sac-0").exists()


def test_what_is_set_reaches_the_algorithm_the_worlds_and_the_environment(tmp_path, monkeypatch):
    given = []
    monkeypatch.setattr(race, "race", lambda *words: given.extend(words))
    own = ["gamma=0.9", "num_envs=2", "n_steps=256", "policy_kwargs.net_arch=16,16"]
    words = [word for text in (*own, "config.gap=0.01,0.02") for word in ("--set", text)]
    race.main(["ppo", "--out", str(tmp_path), *words])
    name, settings, *_, options = given
    assert options == {"config": {"gap": [0.01, 0.02]}}
    model = race.learner_of(name, settings, share=lambda: 0.0)
    assert (model.gamma, model.n_steps, model.env.num_envs) == (0.9, 256, 2)
    assert [len(bias) for _, bias in race.trained_actor(model).layers] == [16, 16, 6]
    assert model.policy.log_std[0] == race.CONTENDERS["ppo"]["policy_kwargs"]["log_std_init"]
    model.env.close()


def test_a_decision_is_held_and_an_episode_that_begins_meanwhile_waits_with_an_open_hand():
    plain = HandVecEnv(GRASP, 2, engine="mujoco")
    held = HandVecEnv(GRASP, 2, engine="mujoco")
    held = race.Decisions(held, 5, bound=3.0)
    for worlds in (plain, held):
        worlds.seed(4)
        worlds.reset()
    decision = np.full((2, 6), 0.5)
    ends = []
    while not ends:
        rewards = np.zeros(2)
        over = np.zeros(2, dtype=bool)
        for step in range(5):
            seen, gained, done, _ = plain.step(np.where(over[:, None], -1.0, np.tanh(decision)))
            rewards = rewards + gained * ~over
            over = over | done
            ends = ends + [step] * any(done)
        same, summed, dones, infos = held.step(decision)
        np.testing.assert_array_equal(same, seen)
        np.testing.assert_allclose(summed, rewards, rtol=1e-6)
        np.testing.assert_array_equal(dones, over)
    assert min(ends) < 4, "an episode began within the decision"
    assert all(
        ("terminal_observation" in told) == done for told, done in zip(infos, dones, strict=True)
    )
    plain.close()
    held.close()
