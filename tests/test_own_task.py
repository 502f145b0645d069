"""docs/own_task.md as a new user follows it: its programs run, and its tasks go wherever an id goes."""

import json
import re
import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AsyncVectorEnv

import hpac_gym
from agents import POLICY
from hpac_gym.envs import Grasp, HandEnv, HandVectorEnv, Posture, make_task
from hpac_gym.envs.registered import options_of_id
from hpac_gym.envs.snapshots import undeclared
from hpac_gym.errors import EnvError, HpacError, ParameterError
from hpac_gym.evaluation.environment import make_env, make_envs
from hpac_gym.tasks.grasp import GraspConfig
from hpac_gym.tasks.task import Task
from hpac_gym.tasks.terms import RewardTerm, Term, column
from tests.processes import ROOT, python

PAGE = (ROOT / "docs" / "own_task.md").read_text(encoding="utf-8")
CHANGED, FRESH, USED = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)
COMMANDS = re.search(r"```\n(hpac evaluate.*?)```", PAGE, flags=re.DOTALL)[1].splitlines()
IDS = ("My-Gentle-v0", "My-Touch-v0")


@pytest.fixture(scope="module", autouse=True)
def folder(tmp_path_factory):
    """The folder of the user, with his module, which is imported here too."""
    where = tmp_path_factory.mktemp("own")
    (where / "mytasks.py").write_text(f"{CHANGED}\n{FRESH}")
    sys.path.append(str(where))
    yield where
    sys.path.remove(str(where))


def run(folder: Path, *words: str) -> str:
    """What a Python program prints in that folder."""
    # The installed `hpac` has not the folder on its path, as `python -m` has.
    own = ["-P"] if "hpac" in words else []
    done = python(*own, *words, folder=folder)
    assert done.returncode == 0, done.stderr
    return done.stdout


def to_the_end(env: gymnasium.Env) -> Iterator[tuple]:
    """The steps of the running episode with closing fingers, up to its last one."""
    over = False
    while not over:
        returned = env.step(np.array([0.0, 0.6, 0.6, 0.6, 0.6, 0.5], np.float32))
        over = returned[2]
        yield returned


def test_the_page_is_short_and_a_task_from_nothing_fits_on_a_screen():
    assert len(PAGE.split()) <= 500
    assert len(FRESH.splitlines()) <= 50


class Changed(Grasp):
    """`Grasp` with one more reward term or one more entry of the observation, judged otherwise, or
    with other attributes.
    """

    def __init__(self, reward=None, seen=None, fixed=None, judged=None, **own):
        super().__init__()
        self.judged = judged
        if reward:
            self.reward_terms = (*self.reward_terms, RewardTerm("mine", "", reward))
        if fixed:
            known = Term("known", ("one", "two"), "kg", 0.0, 1.0, "", fixed, fixed=True)
            self.terms = (*self.terms, known)
        if seen:
            self.terms = (*self.terms, Term("seen", ("one",), "1", 0.0, 1.0, "", seen))
        for name, value in own.items():
            setattr(self, name, value)

    def judge(self, state, dt):
        outcome = super().judge(state, dt)
        return self.judged(outcome) if self.judged else outcome


def test_a_task_without_reward_terms_pays_nothing():
    single, many = (Changed(reward_terms=()) for _ in range(2))
    with HandEnv(single) as env, closing(HandVectorEnv(many, 2)) as envs:
        env.reset(seed=0)
        envs.reset(seed=0)
        assert env.step(np.zeros(6))[1] == 0.0
        assert envs.step(np.zeros((2, 6)))[1].tolist() == [0.0, 0.0]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"reward": lambda now: 1.0}, r"reward term 'mine' must have shape \(2,\), not \(\)"),
        (
            {"reward": lambda now: column(now.state.time)},
            r"reward term 'mine' .* \(2,\), not \(2, 1\)",
        ),
        (
            {"seen": lambda now: now.state.time},
            r"term 'seen' must have shape \(2, 1\), not \(2,\)",
        ),
        ({"seen": lambda now: now.state.touching}, r"term 'seen' .* \(2, 1\), not \(2, 6\)"),
        (
            {"reward": lambda now: np.log(now.state.time - 1.0)},
            r"reward term 'mine' must be finite, not \[nan nan\]",
        ),
        ({"seen": lambda now: column(now.state.time) * np.nan}, "term 'seen' is not a number: NaN"),
        ({"fixed": lambda setup: setup.object.mass}, r"term 'known' .* \(2, 2\), not \(2,\)"),
        ({"judged": lambda found: True}, r"judge must return \(2,\) indices .*, not True"),
        ({"judged": lambda found: found + 7}, r"indices into running, success, failure, not array"),
        ({"push": lambda times: np.ones((2, 3))}, r"push .* shape \(2, 6, 3\), not \(2, 3\)"),
        (
            {"wrist_path": lambda setup, times: np.full((len(times), 3), 2.0)},
            r"leads 2 m .* 1 m",
        ),
        ({"setup": lambda rng, hand: None}, "SceneSetup, not N"),
    ],
)
def test_what_cannot_be_used_is_named(given, message):
    """A reward with a column each would be added up to n rewards for each of n environments."""
    with (  # noqa: PT012
        closing(HandVectorEnv(Changed(**given), 2)) as envs,
        pytest.raises(HpacError, match=message),
    ):
        envs.reset(seed=0)
        envs.step(np.zeros((2, 6)))


class Bonus(Posture):
    """`Posture` with another reward beside that which hindsight replay computes."""

    def __init__(self):
        super().__init__()
        self.reward_terms = (*self.reward_terms, RewardTerm("bonus", "", lambda now: [1.0]))


def twice(name):
    """Two terms of one name in the observation or the reward."""
    terms = getattr(Grasp(), name)
    return Changed(**{name: (*terms, terms[0])})


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: twice("terms"), "the observation has two terms 'servo': each needs"),
        (lambda: twice("reward_terms"), "the reward has two terms 'contact': each needs"),
        (Bonus, "Bonus has goals and 2 reward terms: one is possible"),
        (
            lambda: "HPAC-Grasp-v0",
            "'HPAC-Grasp-v0' is no hpac_gym.tasks.task.Task: gymnasium.make takes an",
        ),
        (lambda: Changed(phases=("a", "b"), ends=()), "phases .* is not a time of each, in order"),
        (
            lambda: Changed(phases=("a", "b"), ends=(1.0, 2.0, 3.0)),
            "is not a time of each, in order",
        ),
        (lambda: Changed(phases=("a", "b"), ends=(2.0, 1.0)), "is not a time of each, in order"),
    ],
)
def test_terms_that_do_not_go_together_are_refused(make, message):
    with pytest.raises(ParameterError, match=message):
        HandEnv(make())


def test_a_list_of_rewards_and_any_array_of_outcomes_will_do():
    with HandEnv(Changed(lambda now: [0.5], judged=lambda found: np.broadcast_to(False, 1))) as env:
        for _ in range(2):
            env.reset(seed=0)
            _, _, over, _, info = env.step(np.zeros(6))
            assert not over
            assert info["reward_terms"]["mine"] == 0.5


class Told(Grasp):
    def report(self, now):
        return {**super().report(now), "touching": now.state.touching}


def test_a_task_may_report_several_numbers_of_each_world():
    """Also in the step in which one world begins an episode and the others go on."""
    envs = HandVectorEnv(Told(), 3, max_episode_steps=3)
    with HandEnv(Told()) as env, closing(envs):
        env.reset(seed=5)
        _, infos = envs.reset(seed=3)
        assert infos["touching"].shape == (3, 6)
        assert infos["_touching"].tolist() == [True] * 3
        *_, infos = envs.step(np.zeros((3, 6)))
        *_, alone = env.step(np.zeros(6))
        assert infos["touching"][2].tolist() == alone["touching"]
        mask = [False, True, False]
        _, infos = envs.reset(seed=4, options={"reset_mask": np.array(mask)})
        assert infos["touching"].shape == (3, 6)
        assert infos["_touching"].tolist() == mask
        for over in ([False] * 3, [True, False, True]):
            _, _, _, truncated, _ = envs.step(np.zeros((3, 6)))
            assert truncated.tolist() == over
        *_, infos = envs.step(np.zeros((3, 6)))
        assert infos["touching"].shape == (3, 6)
        assert infos["_randomized"].tolist() == [True, False, True]


def test_a_changed_task_has_its_reward_term_its_sampling_and_its_entry():
    with (
        gymnasium.make("mytasks:My-Gentle-v0", limit=0.0, randomize="nominal") as env,
        gymnasium.make("HPAC-Grasp-v0") as plain,
    ):
        seen, info = env.reset(seed=3)
        before, _ = plain.reset(seed=3)
        np.testing.assert_array_equal(seen[:-1], before)
        assert seen[-1] in (0.0, 1.0)
        mass, other = (each.unwrapped.episodes.setups[0].object.mass for each in (env, plain))
        assert mass == other / 2
        forces = []
        for _, reward, *_, info in to_the_end(env):
            forces.append(info["contact_force"])
            assert info["reward_terms"]["squeeze"] == pytest.approx(-0.01 * forces[-1])
            assert reward == pytest.approx(sum(info["reward_terms"].values()))
        assert max(forces) > 0


@pytest.mark.parametrize("env_id", IDS)
def test_a_batch_gives_what_single_environments_give(env_id):
    batch = gymnasium.make_vec(f"mytasks:{env_id}", 3, engine="mujoco")
    assert type(batch) is HandVectorEnv
    seen, _ = batch.reset(seed=[7, 8, 9])
    with gymnasium.make(f"mytasks:{env_id}", engine="mujoco") as env:
        assert type(env.unwrapped) is HandEnv
        assert env.spec.max_episode_steps == batch.spec.max_episode_steps
        alone, _ = env.reset(seed=9)
        for action in np.random.default_rng(0).uniform(-1, 1, (10, 3, 6)).astype(np.float32):
            np.testing.assert_array_equal(seen[2], alone)
            seen, rewards, terminated, *_ = batch.step(action)
            alone, reward, over, *_ = env.step(action[2])
            assert (reward, over) == (rewards[2], terminated[2])
    batch.close()


@pytest.mark.parametrize("env_id", IDS)
def test_a_state_is_saved_with_that_of_the_task(env_id, monkeypatch):
    """Without the task's own arrays, the touch of `Touch` would go on from elsewhere."""
    with gymnasium.make(f"mytasks:{env_id}", engine="mujoco") as made:
        env = made.unwrapped
        env.reset(seed=0)
        state = next(env.save_state() for *_, info in to_the_end(env) if info["contact_force"] > 0)
        first = [returned[1:3] for returned in to_the_end(env)]
        env.restore_state(state)
        assert [returned[1:3] for returned in to_the_end(env)] == first
        assert len(first) > 5
        env.reset(seed=0)
        assert undeclared(env.episodes, lambda: list(to_the_end(env))) == []
        if env_id == "My-Touch-v0":
            monkeypatch.setattr(type(env.task), "changing", Task.changing)
            env.reset(seed=0)
            assert undeclared(env.episodes, lambda: list(to_the_end(env))) == ["task._since"]


def test_a_spec_survives_json_and_the_defaults_are_those_of_register():
    with gymnasium.make("mytasks:My-Gentle-v0", limit=2.0) as env:
        again = EnvSpec.from_json(env.spec.to_json())
        assert again.kwargs["randomize"] == "hand"
        with gymnasium.make(again) as other:
            assert other.unwrapped.task.limit == 2.0
            assert other.unwrapped.randomization == env.unwrapped.randomization
            assert other.unwrapped.randomization.slack != (0.0, 0.0)
    told = {option.name: option.default for option in options_of_id("My-Gentle-v0")}
    assert told["limit"] == 4.0
    assert told["randomize"] == "hand"


@pytest.mark.pybullet
def test_on_pybullet_make_vec_makes_processes():
    envs = gymnasium.make_vec("mytasks:My-Touch-v0", 2, engine="pybullet", hold=0.2)
    assert type(envs) is AsyncVectorEnv
    assert envs.get_attr("obs") == ("deploy", "deploy")
    envs.reset(seed=0)
    assert np.isfinite(envs.step(envs.action_space.sample())[1]).all()
    envs.close()


def test_the_commands_take_it(folder):
    evaluate, record, _ = (line.split() for line in COMMANDS)
    few = ["--episodes", "6", "--engine", "mujoco", "--workers", "2", "--json"]
    judged = json.loads(run(folder, "-m", *evaluate, *few))
    assert set(judged["policies"]) == {"scripted", "random"}
    assert judged["env_id"] == "mytasks:My-Gentle-v0"
    assert judged["policies"]["scripted"]["success_rate"] > 0
    told = run(folder, "-m", *record, "--episodes", "2", "--engine", "mujoco")
    assert told.startswith("2 episodes, ")
    assert (folder / "touches").is_dir()


@pytest.mark.slow
def test_learners_take_it(folder):
    race = COMMANDS[2].split()[1:]
    run(folder, *race, "--minutes", "0.05", "--set", "num_envs=4",
        "--set", "policy_kwargs.net_arch=8,8")  # fmt: skip
    judged = run(
        folder, "-m", "hpac", "evaluate", "--policy", f"runs/gentle/{POLICY}", "--episodes", "2",
        "--engine", "mujoco", "--no-baselines",
    )  # fmt: skip
    assert f"| runs/gentle/{POLICY} | 2 |" in judged
    short = ["--episodes", "40", "--random-episodes", "20", "--num-envs", "8", "--hidden", "8"]
    train = ["agents.train", "grasp", "--env", "mytasks:My-Touch-v0", "--out", "runs/touch"]
    run(folder, "-m", *train, *short, "--checkpoint-every", "20", "--batch-size", "8",
        "--actor-batch-size", "8")  # fmt: skip
    assert (folder / "runs" / "touch" / POLICY).exists()
    used = USED.replace("100_000", "64").replace("64,", "2,").replace("16,", "2,")
    run(folder, "-c", used)


class NoTerms(Task):
    duration = 1.0

    def setup(self, rng, hand):
        raise NotImplementedError

    def judge(self, state, dt):
        raise NotImplementedError


class Long(Grasp):
    duration = 3.0
    terms = reward_terms = ()

    def __init__(self):
        """Without the settings of its class."""


class Settled(Long):
    config = GraspConfig()


class Noisy(Grasp):
    def __init__(self, noise=0.1):
        super().__init__()


class Endless(Long):
    duration = np.inf


class Half(Task):
    duration = 1.0


class Goals(Grasp):
    goal_terms = Posture.goal_terms


@pytest.mark.parametrize(
    ("task", "steps", "error", "message"),
    [
        (Grasp(), None, ParameterError, "must be a class or a function that makes a task"),
        ("mytasks", None, ParameterError, "'mytasks' must be a class .* 'module:name'"),
        (Grasp, 0, ParameterError, "max_episode_steps = 0 must be a whole number"),
        (Grasp, 1.5, ParameterError, r"max_episode_steps = 1\.5 must"),
        (Grasp, 30, ParameterError, "lasts 64 steps: Wrong-v0 has at most 29"),
        (Long, 60, ParameterError, "an episode lasts 60 steps: .* register it with more than 60"),
        (Settled, 60, ParameterError, "an episode lasts 60 steps: .* register it with more than"),
        (Noisy, 70, ParameterError, "its task's 'noise' is an option of every environment"),
        (Endless, 60, ParameterError, "an episode of inf s must have .* an end"),
        (NoTerms, None, ParameterError, "Wrong-v0: NoTerms has no terms, reward_terms"),
        (Goals, None, ParameterError, "Goals has goal_terms but no measure and goal_reward"),
        (Half, None, TypeError, "abstract.*judge.*setup"),
        (lambda: 3, None, ParameterError, "Wrong-v0 needs a .*Task, not 3"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
@pytest.mark.filterwarnings("ignore:.*Overriding environment")
def test_what_is_no_task_is_refused(task, steps, error, message):
    with pytest.raises(error, match=message):  # noqa: PT012
        hpac_gym.register("Wrong-v0", task, max_episode_steps=steps)
        gymnasium.make("Wrong-v0")


def test_an_id_of_the_package_or_of_nobody_is_refused():
    with pytest.raises(ParameterError, match="'HPAC-Grasp-v0' is an id of hpac_gym"):
        hpac_gym.register("HPAC-Grasp-v0", Grasp)
    with pytest.raises(ParameterError, match="'mytasks:Mine-v0' must be without its module"):
        hpac_gym.register("mytasks:Mine-v0", Grasp)
    for wrong in ("Mine-v0", "nosuchmodule:Mine-v0"):
        with pytest.raises(EnvError, match=f"no environment '{wrong}'") as error:
            make_task(wrong)
        assert isinstance(error.value, HpacError)
        assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("x = (\n", r"'broken_task:Mine-v0': '\(' was never closed \(broken_task.py, line 1\)"),
        ("raise ValueError('hi')\n", "'broken_task:Mine-v0': hi"),
    ],
)
def test_a_module_that_cannot_be_imported_is_told_in_one_line(tmp_path, monkeypatch, text, told):
    (tmp_path / "broken_task.py").write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(EnvError, match=f"^no environment {told}$"):
        make_env("broken_task:Mine-v0")


class Counting(Grasp):
    def __init__(self, count=0, row=0, env_id=0):
        super().__init__()
        self.given = (count, row, env_id)


def test_an_option_may_have_any_name():
    hpac_gym.register("Counting-v0", Counting)
    given = {"count": 1, "row": 2, "env_id": 3}
    with (
        make_env("Counting-v0", **given) as env,
        closing(make_envs("Counting-v0", 2, **given)) as envs,
    ):
        assert env.unwrapped.task.given == envs.unwrapped.task.given == (1, 2, 3)


@pytest.mark.filterwarnings("ignore:.*Overriding environment")
def test_an_unknown_option_is_named():
    class Passing(Grasp):
        def __init__(self, bonus=1.0, **others):
            super().__init__(**others)

    hpac_gym.register("Wrong-v0", Passing)
    for env_id, known in (("mytasks:My-Gentle-v0", "config, object, limit"), ("Wrong-v0", "bonus")):
        with pytest.raises(TypeError, match=f"unknown options limits: there are {known}, hand"):
            gymnasium.make(env_id, limits=3)
