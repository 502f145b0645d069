"""The training script, run as a person runs it: whole, killed, resumed, stopped, with a full
disk.
"""

import copy
import errno
import json
import os
import re
import signal
from pathlib import Path
from shutil import copytree

import numpy as np
import pytest

from agents import RecipeError, RunError, runs as runs_of, train, trials
from agents.curves import read_curve, report
from agents.learner import Learner
from agents.recipes import RECIPES, with_settings
from agents.trials import training_task, worlds_of
from hpac_gym.envs.options import checked_options
from hpac_gym.evaluation.evaluate import evaluate
from hpac_gym.policies import read_policy
from tests.agents.small import SETTINGS, SMALL, fitted, train_here
from tests.processes import killed_at_the_second, started, wait_for


def curve(folder: Path) -> list[float]:
    return read_curve(folder / "progress.csv")["episodes"].tolist()


SHORT = ["--episodes", 24, "--seed", 3, *SMALL, "--random-episodes", 4]
RUNS = {"grasp": ["grasp", *SHORT], "grasp-type": ["grasp-type", *SHORT, "--script-std", 0.01]}


@pytest.fixture(scope="module")
def trained(tmp_path_factory) -> Path:
    """The folder of whole runs, by the names of their recipes."""
    folder = tmp_path_factory.mktemp("whole")
    for recipe, words in RUNS.items():
        train_here(*words, "--out", folder / recipe)
    return folder


def test_a_run_leaves_its_policy_curve_settings_and_checkpoint(trained):
    about = read_policy(trained / "grasp" / "policy.hpac").about
    assert about["env_id"] == "hpac_gym:HPAC-Grasp-v0"
    assert about["episodes"] >= 24
    assert (about["settings"]["seed"], about["settings"]["set_ups"]) == (3, ["mujoco/twin"])
    assert set(about["versions"]) >= {
        "python",
        "torch",
        "mujoco-core",
        "gymnasium",
        "numpy",
        "hpac_gym",
    }
    assert curve(trained / "grasp")[-1] == about["episodes"]
    assert len(list((trained / "grasp").glob("checkpoint-*"))) == 1
    assert (trained / "grasp" / "learning_curve.png").exists()


@pytest.mark.parametrize(
    ("recipe", "env_id", "sizes", "options"),
    [
        ("grasp", "HPAC-Grasp-v0", (44, 6), {}),
        ("grasp-type", "HPAC-GraspType-v0", (78, 12), {"types": "test"}),
    ],
)
def test_a_trained_policy_is_judged(trained, recipe, env_id, sizes, options):
    policy = trained / recipe / "policy.hpac"
    assert (
        read_policy(policy).sizes
        == sizes
        == (len(read_policy(policy).about["made_for"]["observation"]), sizes[1])
    )
    judged = evaluate([str(policy)], env_id, 2, options={"engine": "mujoco", **options})
    assert judged.summary()["policies"]["learned"]["episodes"] == 2


@pytest.mark.parametrize("recipe", RUNS)
def test_a_killed_and_resumed_training_ends_with_the_policy_of_an_uninterrupted_one(
    recipe, trained, tmp_path
):
    with killed_at_the_second(train, "save_checkpoint"):
        train_here(*RUNS[recipe], "--out", tmp_path)
    assert 8 <= runs_of.saved_trials(tmp_path) < 16
    with (tmp_path / "progress.csv").open("a") as file:
        file.write("20,1.0,0.5,20,0.1\n2")  # after the checkpoint
    train_here("--out", tmp_path, "--resume")
    assert curve(tmp_path) == curve(trained / recipe)
    ends = (read_policy(folder / "policy.hpac") for folder in (tmp_path, trained / recipe))
    assert len({policy.about["sha256"] for policy in ends}) == 1


def test_a_killed_training_goes_on_from_its_last_checkpoint_and_an_interrupted_one_saves_itself(
    tmp_path,
):
    with killed_at_the_second(train, "save_checkpoint"):
        train_here("grasp", "--out", tmp_path, "--episodes", 100_000, *SMALL)
    killed = state_of(tmp_path)
    first = runs_of.latest_checkpoint(tmp_path)
    with started("-m", "agents.train", "--out", str(tmp_path), "--resume") as process:
        wait_for(
            lambda: runs_of.latest_checkpoint(tmp_path) != first or process.poll() is not None, 600
        )
        process.send_signal(signal.SIGINT)
        said = process.communicate()[1].splitlines()
    assert (process.returncode, said[-1].split(" after")[0]) == (130, "interrupted")
    interrupted = state_of(tmp_path)
    aim = interrupted["episodes"] + 12
    train_here("--out", tmp_path, "--resume", "--episodes", aim)
    done = state_of(tmp_path)
    assert aim <= done["episodes"] < aim + 8
    for before, after in ((killed, interrupted), (interrupted, done)):
        assert before["episodes"] < after["episodes"]
        assert before["updates"] < after["updates"]
        assert before["seconds"] < after["seconds"]
        assert before["env_steps"] < after["env_steps"]
    steps = curve(tmp_path)
    assert steps == sorted(set(steps)), "the rows after the checkpoint were taken back"


def state_of(folder: Path) -> dict:
    return json.loads((runs_of.latest_checkpoint(folder) / "state.json").read_text())


def test_a_time_limit_ends_a_training_cleanly(tmp_path, capsys):
    train_here(
        "grasp",
        "--out",
        tmp_path,
        "--time-limit",
        0.01,
        *SMALL,
        "--checkpoint-every",
        10_000,
    )
    assert "time limit after" in capsys.readouterr().err
    assert read_policy(tmp_path / "policy.hpac").about["seconds"] >= 0.6


def test_a_training_takes_no_more_steps_than_it_may(tmp_path):
    train_here("grasp", "--out", tmp_path, "--env-steps", 403, *SMALL)
    about = read_policy(tmp_path / "policy.hpac").about
    assert about["env_steps"] == 400
    assert about["env_steps"] >= about["episodes"] * 20, (
        "a trial takes at least as long as the closing"
    )
    assert len(list((tmp_path / "tensorboard").iterdir())) == 1, "the last row is in the same file"


def test_a_new_run_keeps_nothing_of_the_one_that_it_replaces(tmp_path):
    files = {"run.json", "policy.hpac", "progress.csv", "learning_curve.png"}
    leaves = files | {"checkpoint-000000012", "tensorboard", ".lock"}
    for name in files | {"results.json", "results.md"}:
        (tmp_path / name).write_text("of the run before")
    (tmp_path / "checkpoint-000000900").mkdir()
    train_here("grasp", "--out", tmp_path, "--overwrite", *SMALL, "--episodes", 12)
    assert {path.name for path in tmp_path.iterdir()} == leaves


def test_a_checkpoint_that_cannot_be_removed_is_not_continued_by_another_run(tmp_path, monkeypatch):
    (tmp_path / "checkpoint-000000008").mkdir()
    monkeypatch.setattr("shutil.rmtree", lambda path, **how: None)
    with pytest.raises(
        RunError, match=r"cannot remove checkpoint '.*checkpoint-000000008' of the run before"
    ):
        train.main(["grasp", "--overwrite", "--out", str(tmp_path), *SMALL])


@pytest.fixture(scope="module")
def recipe():
    return with_settings(RECIPES["grasp"], {"episodes": "40", **SETTINGS})


@pytest.fixture(scope="module")
def learner(recipe):
    return fitted(recipe, 60)


def test_a_run_is_not_resumed_with_fewer_trials_than_it_has(trained, tmp_path):
    folder = copytree(trained / "grasp", tmp_path / "run")
    before = (folder / "run.json").read_bytes()
    with pytest.raises(RecipeError, match=r"episodes is 8: the run has \d+ trials already"):
        train.main(["--resume", "--out", str(folder), "--episodes", "8"])
    assert (folder / "run.json").read_bytes() == before


def test_what_is_beside_a_run_does_not_stop_it(trained, tmp_path, monkeypatch):
    """Another folder with the name of a checkpoint, and the results of an earlier policy, which
    say nothing about the new one and are not in its picture.
    """
    folder = copytree(trained / "grasp", tmp_path / "run")
    (folder / "checkpoint-old").mkdir()
    numbers = {"episodes": 10, "success_rate": 0.5, "interval_95": [0.24, 0.76]}
    numbers |= {"return_mean": 1.0, "failures_by_phase": {}}
    results = {"env_id": "a:B-v0", "first_seed": 1, "last_seed": 10, "differences": []}
    (folder / "results.json").write_text(json.dumps(results | {"policies": {"learned": numbers}}))
    drawn = []
    monkeypatch.setattr("matplotlib.axes.Axes.axhline", lambda *_, **how: drawn.append(how))
    train_here("--resume", "--out", folder, "--episodes", 26, drawn=True)
    assert curve(folder)[-1] == 26
    assert drawn == []
    assert (folder / "learning_curve.png").stat().st_size
    assert [path.name for path in report(folder)] == ["results.md", "learning_curve.png"]
    assert drawn[0]["label"] == "learned, 10 held-out episodes: 50%"


def test_a_damaged_curve_ends_a_resumed_run_in_one_error_and_is_kept(trained, tmp_path):
    folder = copytree(trained / "grasp", tmp_path / "run")
    (folder / "progress.csv").write_text("episodes\nabc,1\n")
    with pytest.raises(RunError, match=r"progress\.csv' is not a learning curve"):
        train.main(["--resume", "--out", str(folder), "--episodes", "26"])
    assert (folder / "progress.csv").read_text() == "episodes\nabc,1\n"


def test_a_training_that_ends_before_its_first_trial_can_be_resumed(tmp_path):
    words = [*RUNS["grasp"], "--out", tmp_path]
    train_here(*words, "--time-limit", 1e-6)
    assert not (tmp_path / "progress.csv").exists()
    train_here("--resume", "--out", tmp_path)
    assert curve(tmp_path)[-1] == 24


def test_the_exported_actor_acts_as_the_learner_does_without_its_exploration(learner):
    narrow = copy.deepcopy(learner)
    narrow.networks.actor.log_std.bias.data.fill_(-100.0)  # clamped to the narrowest distribution
    seen = np.random.default_rng(0).uniform(-3, 3, (20, 60)).astype(np.float32)
    acted = [learner.networks.policy()(row[:44]) for row in seen]
    np.testing.assert_allclose(acted, narrow.decide(seen), atol=0.1)


class Patient:
    """Decides on nothing in particular, and wants the last of the worlds it is asked about."""

    def decide(self, seen):
        return np.zeros((len(seen), 8))

    def accepted(self, seen, decisions):
        return np.arange(len(seen)) == len(seen) - 1


def started_worlds(recipe, seed):
    made = worlds_of(recipe)
    for worlds in made:
        worlds.start(seed)
    return made


def test_set_ups_share_the_worlds_and_no_two_worlds_a_seed(monkeypatch):
    monkeypatch.setattr("agents.trials.DRAWS", 1)
    recipe = with_settings(
        RECIPES["grasp"], {"num_envs": "5", "set_ups": "mujoco/twin,mujoco/twin"}
    )
    made = started_worlds(recipe, 100)
    for worlds in made:
        worlds.step(Patient())
    drawn = [worlds.first_seen for worlds in made]
    assert [len(seen) for seen in drawn] == [2, 3]
    assert len(np.unique(np.concatenate(drawn)[:, :44], axis=0)) == 5
    assert [row.tolist() for seen in drawn for row in seen[:, -2:]] == 2 * [[1, 0]] + 3 * [
        [0, 1]
    ], "critics are told the set-up"
    for worlds in made:
        worlds.close()


def test_weak_contacts_have_less_friction_of_the_skin_and_none_against_turning():
    drawn = {}
    for contacts in ("usual", "weak"):
        [worlds] = started_worlds(
            with_settings(RECIPES["grasp"], {"num_envs": "8", "contacts": contacts}), 100
        )
        worlds.step(Patient())
        friction = [setup.hand_settings.contact_friction for setup in worlds.episodes.setups]
        drawn[contacts] = np.array(friction), worlds.episodes.options.world.torsion
        worlds.close()
    factors = drawn["weak"][0] / drawn["usual"][0]
    assert np.ptp(drawn["usual"][0]) == 0
    assert 0.5 <= factors.min() < 0.75 < factors.max() <= 1.0
    assert (drawn["usual"][1], drawn["weak"][1]) == (None, 0.0)


def test_something_runs_beside_each_step_of_the_physics_and_a_trial_tells_how_its_closing_ended():
    [worlds] = started_worlds(with_settings(RECIPES["grasp"], {"num_envs": "2"}), 7)
    calls = []
    seen, *_, end_state = worlds.step(Patient())
    while not len(seen):
        seen, *_, end_state = worlds.step(Patient(), lambda: calls.append(0))
    assert len(calls) > 5
    assert np.abs(end_state - seen[:, worlds.deployed :]).max() > 0.1, "not how it began"
    worlds.close()


def test_trials_that_are_sure_to_succeed_are_tried_less_often(learner):
    seen = np.zeros((4_000, 60), np.float32)
    decisions = np.zeros((4_000, 8))
    sure = copy.deepcopy(learner)
    lost = copy.deepcopy(learner)
    sure.networks.critics.biases[-1].data.fill_(50.0)
    lost.networks.critics.biases[-1].data.fill_(-50.0)
    assert 0.25 < sure.accepted(seen, decisions).mean() < 0.35
    assert lost.accepted(seen, decisions).all()


def test_losses_calibration_entropy_and_acceptance_are_logged(trained):
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    board = EventAccumulator(str(trained / "grasp" / "tensorboard"))
    board.Reload()
    logged = {name: board.Scalars(f"train/{name}")[-1] for name in LOGGED}
    assert {entry.step for entry in logged.values()} == {24}
    assert all(np.isfinite(entry.value) for entry in logged.values())
    assert 0 <= logged["brier_score"].value <= 1
    assert 0 < logged["acceptance"].value <= 1
    assert logged["alpha"].value == pytest.approx(np.exp(-3), rel=0.1)


LOGGED = (
    "success_rate",
    "entropy",
    "target_entropy",
    "alpha",
    "survival_loss",
    "auxiliary_loss",
    "actor_loss",
    "brier_score",
    "acceptance",
)


def test_the_brier_score_is_that_of_the_predictions_for_new_trials(learner):
    fresh = copy.deepcopy(learner)
    fresh.metrics()
    seen = np.zeros((10, 60), np.float32)
    decisions = np.zeros((10, 8))
    survived = np.array([4] * 3 + [0] * 7)
    expected = np.mean((fresh.predicted(seen, decisions) - (survived == 4)) ** 2)
    fresh.add(seen, decisions, survived, np.zeros((10, 16)))
    assert fresh.metrics()["brier_score"] == pytest.approx(expected)
    assert "brier_score" not in fresh.metrics(), "means are since the last call"


def test_a_task_of_ones_own_is_trained_with_its_options(tmp_path, monkeypatch):
    """What was set, or is the id's own, reaches the worlds, the policy file and a resumed run."""
    (tmp_path / "my_task.py").write_text(
        "import hpac_gym\nfrom hpac_gym.tasks.grasp import Grasp, GraspConfig\n"
        "def made(gap=0.01):\n    return Grasp(GraspConfig(gap=(gap, gap)))\n"
        "hpac_gym.register('Own-Gap-v0', made, 65, body='light', randomize='hand', noise={'position': 0.01})\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    out = tmp_path / "run"
    words = [
        "--env",
        "my_task:Own-Gap-v0",
        "--set",
        "gap=0.02",
        "--out",
        out,
        *SMALL,
        "--episodes",
        8,
    ]
    tasks = []
    monkeypatch.setattr(
        trials, "training_task", lambda recipe: tasks.append(training_task(recipe)) or tasks[-1]
    )
    checked = []
    monkeypatch.setattr(
        trials, "checked_options", lambda **given: checked.append(given) or checked_options(**given)
    )
    train_here("grasp", *words)
    assert tasks[0].config.gap == (0.02, 0.02)
    assert checked[0]["noise"] == {"position": 0.01}
    about = read_policy(out / "policy.hpac").about
    assert about["env_id"] == "my_task:Own-Gap-v0"
    told = about["settings"]
    assert told["options"] == {"gap": 0.02}
    assert (told["set_ups"], told["randomize"]) == (["mujoco/light"], "hand")
    train_here("--resume", "--out", out, "--episodes", 10)


def test_an_episode_ends_at_the_limit_of_its_id_as_a_failure_and_a_short_training_says_so(
    tmp_path, monkeypatch, capsys
):
    (tmp_path / "endless.py").write_text(
        "import hpac_gym\nimport numpy as np\nfrom hpac_gym.tasks.grasp import Grasp\n"
        "class Endless(Grasp):\n"
        "    def judge(self, state, dt):\n        return np.zeros(len(state.time), int)\n"
        "hpac_gym.register('Endless-v0', Endless, 65)\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    train_here("grasp", "--env", "endless:Endless-v0", "--out", tmp_path / "run",
               "--num-envs", 4, "--hidden", 8, "--episodes", 8, "--set", "randomize=full")  # fmt: skip
    assert "it has learned nothing yet" in capsys.readouterr().err
    assert json.loads((tmp_path / "run" / "run.json").read_text())["randomize"] == "full"
    state = next((tmp_path / "run").glob("checkpoint-*")) / "state.json"
    assert json.loads(state.read_text())["env_steps"] == 4 * 65 * 2


def test_an_object_of_ones_own_is_what_is_trained_on(tmp_path, monkeypatch):
    words = ["--object", "sphere:0.03", "--set", "config.weights.effort=-0.1", *SMALL]
    recipe = train._fresh_recipe(train.parsed(["grasp", "--out", str(tmp_path), *map(str, words)]))
    (worlds,) = started_worlds(recipe, 100)
    worlds.step(Patient())
    assert {setup.object.half_extents for setup in worlds.episodes.setups} == {(0.03,) * 3}
    assert worlds.episodes.task.config.weights.effort == -0.1
    worlds.close()


@pytest.mark.parametrize("failing", ["numpy.savez", "os.fsync", "os.rename"])
def test_a_full_disk_keeps_the_checkpoint_before(learner, tmp_path, monkeypatch, failing):
    kept = train.save_checkpoint(tmp_path, learner, {"seconds": 1.0})
    before = {path.name: path.read_bytes() for path in kept.iterdir()}

    def no_space(*_, **__):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(learner.trials, "count", learner.trials.count - 1)
    monkeypatch.setattr(failing, no_space)
    with pytest.raises(RunError, match=rf"No space left on device; '{kept.name}' is kept"):
        train.save_checkpoint(tmp_path, learner, {"seconds": 2.0})
    monkeypatch.undo()
    assert list(tmp_path.iterdir()) == [kept]
    assert {path.name: path.read_bytes() for path in kept.iterdir()} == before


def test_a_diverged_learner_is_not_saved_over_the_checkpoint_before(learner, tmp_path):
    kept = train.save_checkpoint(tmp_path, learner, {"seconds": 1.0})
    for name in ("actor", "critics"):
        broken = copy.deepcopy(learner)
        next(getattr(broken.networks, name).parameters()).data[0] = float("nan")
        broken.trials.count -= 1
        with pytest.raises(
            RunError, match=rf"diverged, {name}/\S+ is not finite; '{kept.name}' is kept"
        ):
            train.save_checkpoint(tmp_path, broken, {"seconds": 2.0})
    assert list(tmp_path.iterdir()) == [kept]


def told(path: Path, name: str, value: object) -> None:
    path.write_text(json.dumps(json.loads(path.read_text()) | {name: value}))


def half(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


@pytest.mark.parametrize(
    ("name", "change", "complaint"),
    [
        ("state.json", half, "damaged"),
        ("arrays.npz", half, "damaged"),
        (
            "state.json",
            lambda path: path.write_text(
                re.sub(r'"mujoco-core": "[^"]*"', '"mujoco-core": "1.2"', path.read_text())
            ),
            r"of other versions: it was written with mujoco-core 1\.2, not \S+ as here",
        ),
        *(
            (
                "state.json",
                lambda path, name=name, value=value: told(path, name, value),
                f"{name} is",
            )
            for name, value in [
                ("updates", -5),
                ("updates", 3.5),
                ("seconds", "x"),
                ("seconds", float("nan")),
                ("env_steps", None),
            ]
        ),
    ],
)
def test_a_checkpoint_that_does_not_fit_is_refused_in_one_error_and_kept(
    learner, recipe, tmp_path, name, change, complaint
):
    path = train.save_checkpoint(tmp_path, learner, {"seconds": 1.0})
    change(path / name)
    with pytest.raises(RunError, match=complaint):
        runs_of.load_checkpoint(path, Learner(recipe, observed=60, deployed=44, phases=4), {})
    assert len(list(path.iterdir())) == 2


@pytest.mark.parametrize("words", [["--overwrite"], ["--resume"]])
def test_a_folder_that_another_training_writes_to_is_refused_and_kept(trained, tmp_path, words):
    folder = copytree(trained / "grasp", tmp_path / "run")
    begin = [] if words == ["--resume"] else ["grasp"]
    with (
        runs_of.alone_in(folder),
        pytest.raises(RunError, match=f"another training is writing to folder '{folder}'"),
    ):
        train.main([*begin, *words, "--out", str(folder)])
    assert curve(folder) == curve(trained / "grasp")
