"""Algorithms of Stable-Baselines3 as contenders: what they train acts from a policy file as it does
in their own hands.
"""

import os
import re
import sys
from dataclasses import fields, replace
from inspect import signature
from shutil import copyfile

import numpy as np
import pytest
from jax import tree

from agents import RecipeError, RunError, race, reproduce, train
from hpac_gym.command import INTERRUPTED, run
from hpac_gym.envs.sb3 import HandVecEnv
from hpac_gym.policies import PolicyFile, read_policy, write_policy
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


def small(name: str) -> race.Contender:
    return replace(race.CONTENDERS[name], num_envs=2, **FEW.get(name, FEW_UPDATES))


SLOW = [
    pytest.param(name, True, marks=pytest.mark.slow)
    for name in race.CONTENDERS
    if name not in ("ppo", "crossq")
]


@pytest.mark.parametrize(
    ("name", "trained"), [("ppo", True), ("crossq", True), ("sbx-crossq", False), *SLOW]
)
def test_the_policy_file_acts_as_the_trained_model_predicts(name, trained, tmp_path):
    model = race.learner_of(small(name), share=lambda: 0.0)
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
    write_policy(tmp_path / "policy.hpac", PolicyFile(race.actor_of(model), {"env_id": GRASP}))
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
    assert reproduce.main(words) == 0
    *_, first, second = capsys.readouterr().out.splitlines()
    assert first.startswith("| sac | 0 |")
    assert second.startswith("| one-step SAC | 0 | 60,0")
    assert reproduce.main([*words, "--learner", "sac", "--seeds", "2"]) == 0
    *_, second, _, last = capsys.readouterr().out.splitlines()
    assert second.startswith("| sac | 1 |")
    assert last.startswith("sac: 2 runs: median ")
    about = read_policy(tmp_path / "sac-1" / "policy.hpac").about
    assert about["processor_seconds"] >= 0.3
    assert (about["algorithm"], about["settings"]["seed"], about["action_repeat"]) == (
        "sac",
        1,
        small("sac").action_repeat,
    )
    with pytest.raises(RunError, match="already holds a run"):
        race.main(["sac", "--out", str(tmp_path / "sac-0")])
    path = tmp_path / "sac-1" / "policy.hpac"
    write_policy(path, PolicyFile(read_policy(path).actor, about | {"processor_seconds": 0.2}))
    assert reproduce.main([*words, "--learner", "sac", "--seeds", "2"]) == 0
    told = capsys.readouterr()
    assert (
        "sac-1' was interrupted after 0 s: remove it to train it again; its row is left out"
        in told.err
    )
    assert told.out.splitlines()[-1].startswith("| sac | 0 |")
    with pytest.raises(RecipeError, match="unknown learner 'td3': known are sac, grasp"):
        reproduce.main([*words, "--learner", "td3"])


def test_ctrl_c_in_a_training_ends_the_table(tmp_path, monkeypatch, capsys):
    begun = []
    monkeypatch.setattr(train, "main", lambda words: begun.append(words) or INTERRUPTED)
    assert (
        run(lambda: reproduce.main(f"race --runs {tmp_path} --learner grasp --seeds 3".split()))
        == INTERRUPTED
    )
    assert len(begun) == 1


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
        race.race(small(name), tmp_path, time_limit=60.0)


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
    assert reproduce.main(f"race --runs {tmp_path} --episodes 1".split()) == 0
    told = capsys.readouterr()
    assert told.err.endswith(f"{needs}; its row is left out\n")
    assert [line.split("|")[1].strip() for line in told.out.splitlines()] == [
        "learner",
        "---",
        "one-step SAC",
    ]
    assert not (tmp_path / "sbx-sac-0").exists()


def test_help_shows_every_setting_with_its_default_for_each_algorithm(capsys):
    with pytest.raises(SystemExit):
        race.main(["--help"])
    told = " ".join(capsys.readouterr().out.split())
    assert all(
        f"--{entry.name.replace('_', '-')} VALUE" in told
        for entry in fields(race.Contender)
        if entry.name != "algorithm"
    )
    assert (
        "number of parallel worlds (default: ppo 128, sac 32, tqc 32, crossq 32, sbx-sac 32,"
        in told
    )
    assert (
        "sac, tqc, sbx-sac, sbx-tqc: step of the target networks towards the critics (default: 0.01)"
        in told
    )


@pytest.mark.filterwarnings("ignore:You have specified a mini-batch size")
@pytest.mark.parametrize("name", race.CONTENDERS)
def test_every_setting_can_be_changed_and_reaches_its_algorithm(name):
    contender = race.CONTENDERS[name]
    changed = {"num_envs": 3, "hidden": (16,), "log_std_init": -1.0}
    for key, value in contender.settings.items():
        if key not in (*changed, "algorithm"):
            changed[key] = value + 1 if isinstance(value, int) else 0.9 * value + 0.01
    changed = {key: changed[key] for key in contender.settings if key in changed}
    model = race.learner_of(replace(contender, **changed), share=lambda: 0.0)
    own = set(changed) & set(signature(type(model)).parameters) - {"seed"}
    assert set(changed) - own - {"log_std_init"} == {"num_envs", "seed", "action_repeat", "hidden"}
    for key in own:
        value = {**model.policy_kwargs, **vars(model)}[key]
        value = value.frequency if key == "train_freq" else value(1.0) if callable(value) else value
        assert value == changed[key] != getattr(contender, key), key
    assert (model.env.num_envs, [len(bias) for _, bias in race.actor_of(model).layers]) == (
        3,
        [16, 6],
    )
    model.env.close()


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        ("ppo --tau 0.02", "tau is a setting of sac, tqc, sbx-sac, sbx-tqc, not of ppo"),
        ("sac --gamma 2", "gamma is 2.0: it must lie in 0…1"),
        ("crossq --n-steps few", "n_steps is 'few': it must be a whole number"),
        (
            "ppo --n-steps 1 --num-envs 1",
            "num_envs and n_steps are 1: an update of ppo needs at least 2 decisions",
        ),
    ],
)
def test_a_wrong_setting_is_refused_before_there_is_a_folder(words, complaint, tmp_path):
    with pytest.raises(RecipeError, match=complaint):
        race.main([*words.split(), "--out", str(tmp_path / "run")])
    assert not (tmp_path / "run").exists()


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
