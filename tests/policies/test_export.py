"""An exported policy decides as the policy file does, and says what it is made for."""

import json
from pathlib import Path

import gymnasium
import numpy as np
import pytest

from hpac import main
from hpac_gym.envs.randomization import changed_hand
from hpac_gym.evaluation import evaluate
from hpac_gym.model import HPAC
from hpac_gym.policies import PolicyError, read_policy
from hpac_gym.policies.export import export
from hpac_gym.policies.loading import load_policy, needed_options
from hpac_gym.policies.onnx_model import read_onnx
from hpac_gym.policies.policy_file import SHIPPED
from tests.options import called

onnxruntime = pytest.importorskip("onnxruntime")


@pytest.fixture(scope="module")
def env():
    env = gymnasium.make("HPAC-Grasp-v0", engine="mujoco")
    yield env
    env.close()


@pytest.fixture
def folder(tmp_path) -> Path:
    """An exported policy."""
    export(SHIPPED["grasp"], tmp_path / "out")
    return tmp_path / "out"


@pytest.mark.parametrize(
    "name",
    ["grasp", *(pytest.param(name, marks=pytest.mark.slow) for name in SHIPPED if name != "grasp")],
)
def test_onnxruntime_decides_as_the_numpy_reader_does_on_1e4_observations(name, tmp_path):
    export(SHIPPED[name], tmp_path)
    session = onnxruntime.InferenceSession(
        (tmp_path / "model.onnx").read_bytes(), providers=["CPUExecutionProvider"]
    )
    actor = read_policy(name).actor
    rng = np.random.default_rng(1)
    scaled = rng.uniform(-1.2, 1.2, (10_000, actor.sizes[0])) * rng.uniform(
        0, actor.observation_clip, (10_000, 1)
    )
    seen = (actor.observation_mean + scaled * np.minimum(actor.observation_scale, 4.0)).astype(
        np.float32
    )
    decided = session.run(None, {"observation": seen})[0]
    assert np.std(decided, axis=0).mean() > 0.1, "the decisions differ"
    np.testing.assert_allclose(decided, [actor(row) for row in seen], rtol=0, atol=1e-6)


@pytest.mark.parametrize("name", ["gentle", "grasp"])
def test_it_acts_in_the_environment_as_the_policy_file_does(name, tmp_path):
    export(SHIPPED[name], tmp_path)
    made = {"engine": "mujoco", **needed_options(name)}
    with gymnasium.make(read_policy(name).about["env_id"], **made) as env:
        policy = load_policy(name, env)
        exported = read_onnx(tmp_path, env)
        seen = env.reset(seed=0)[0]
        acted = []
        state = other = None
        for _ in range(30):
            action, state = policy.predict(seen, state)
            theirs, other = exported.predict(seen, other)
            assert theirs == pytest.approx(action, abs=1e-5)
            acted.append(action)
            seen = env.step(action)[0]
    assert np.ptp(acted, axis=0).max() > 0.1


@pytest.mark.parametrize("name", ["gentle", "grasp-any-wrist"])
def test_a_policy_that_needs_options_gives_them_when_it_is_exported_too(name, tmp_path):
    export(SHIPPED[name], tmp_path)
    assert needed_options(str(tmp_path)) == needed_options(name)
    for option, value in needed_options(name).items():
        assert f'It needs `{option}="{value}"`: ' in (tmp_path / "README.md").read_text()
    with (
        gymnasium.make(read_policy(name).about["env_id"]) as env,
        pytest.raises(PolicyError, match=r"; it needs (obs='load'|wrist='free')"),
    ):
        load_policy(str(tmp_path), env)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "README.md").touch()
    for folder, file in (("mine", "README.md"), ("", "model.onnx")):
        with pytest.raises(PolicyError, match=f"{file}' exists already: name another folder"):
            export(SHIPPED["grasp"], tmp_path / folder)
    page = (tmp_path / "README.md").read_text()
    assert f"`observation`, float32 (n, {read_policy(name).actor.sizes[0]})" in page
    assert ('`obs="load"`' in page) == (name == "gentle")
    assert ("moves the hand from where it is" in page) == (name == "gentle")


def test_the_card_tells_layout_numbers_rate_and_hashes(folder):
    told = json.loads((folder / "card.json").read_text())
    assert told["observation"][21] == {
        "name": "object_pos",
        "label": "x",
        "unit": "0.05 m",
        "low": -4.0,
        "high": 4.0,
    }
    assert (told["control_hz"], len(told["action"]), len(told["decision"]["numbers"])) == (20, 6, 8)
    assert told["hand_sha256"] == read_policy("grasp").about["made_for"]["hand_sha256"]
    page = (folder / "README.md").read_text()
    assert page.startswith("---\nlibrary_name: hpac_gym\n")
    assert "| 21 | object_pos | x | 0.05 m | -4 | 4 |" in page


def test_a_policy_of_a_goal_environment_is_exported_with_its_goals(tmp_path):
    """Its input has the parts of an observation in the order of their names, as its card says."""
    export(SHIPPED["posture"], tmp_path)
    with gymnasium.make("HPAC-Posture-v1", engine="mujoco") as env:
        exported = read_onnx(tmp_path, env)
        seen = env.reset(seed=0)[0]
        bounds = [env.observation_space[name] for name in sorted(seen)]
    joined = np.concatenate([seen["achieved_goal"], seen["desired_goal"], seen["observation"]])
    wanted = read_policy("posture").actor(joined)
    np.testing.assert_allclose(exported.predict(seen)[0], wanted, atol=1e-6)
    told = json.loads((tmp_path / "card.json").read_text())["observation"]
    assert [entry["name"] for entry in told[:37:6]] == ["achieved_goal"] * 3 + [
        "desired_goal"
    ] * 2 + ["servo", "joint_pos"]
    np.testing.assert_array_equal(
        [entry["low"] for entry in told], np.concatenate([space.low for space in bounds])
    )


def test_a_calibrated_hand_is_taken_and_another_layout_a_refusal(folder, env):
    other = gymnasium.make(
        "HPAC-Grasp-v0", engine="mujoco", model=changed_hand(HPAC, np.full(5, 0.9))
    )
    for load in (lambda: read_onnx(folder, other), lambda: load_policy("grasp", other)):
        policy = load()
        assert policy.predict(other.reset(seed=0)[0])[0].shape == (6,)
    other.close()
    card = json.loads((folder / "card.json").read_text())
    (folder / "card.json").write_text(json.dumps(card | {"hand_sha256": "0" * 64}))
    with pytest.warns(UserWarning, match="was made with another hand, and acts here with"):
        read_onnx(folder, env)
    (folder / "card.json").write_text(json.dumps(card, sort_keys=True))
    read_onnx(folder, env)
    card["observation"].pop(0)
    (folder / "card.json").write_text(json.dumps(card))
    with pytest.raises(PolicyError, match="observation entry 0 was servo index_mcp"):
        read_onnx(folder, env)


@pytest.mark.parametrize("exported", [False, True])
def test_an_observation_that_it_does_not_take_is_refused(exported, folder):
    with (
        gymnasium.make("HPAC-Grasp-v0", obs="privileged") as env,
        pytest.raises(PolicyError, match=r"maps \(44, 6\) values, .* needs \(136, 6\)"),
    ):
        load_policy(str(folder) if exported else "grasp", env)


@pytest.mark.parametrize(
    "card", ['{"env_id": 5}', '{"env_id": "A-v0", "decision": null}', "[" * 100_000]
)
def test_a_card_of_nonsense_ends_in_one_line(card, tmp_path):
    (tmp_path / "card.json").write_text(card)
    with pytest.raises(PolicyError, match="is not an exported policy"):
        needed_options(str(tmp_path))


@pytest.mark.parametrize("name", ["card.json", "model.onnx"])
def test_a_damaged_export_ends_in_one_line(folder, env, name):
    data = (folder / name).read_bytes()
    (folder / name).write_bytes(data[: len(data) // 2])
    with pytest.raises(PolicyError, match="is not an exported policy") as caught:
        read_onnx(folder, env)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("change", "line"),
    [
        (
            {"decision": {"control_steps": 0, "closure": None}},
            "control_steps is 0, and must be a whole number of at least 1",
        ),
        ({"decision": {"control_steps": 1.5, "closure": None}}, "control_steps is 1.5, and must"),
        ({"decision": {"control_steps": "x", "closure": None}}, "is not an exported policy"),
        ({"decision": {"closure": []}}, "is not an exported policy: invalid Closures"),
        ({"observation": [{"name": "servo"}]}, "is damaged: made_for is not readable"),
        ({"control_hz": 50}, "control_hz was 50, and is 20"),
        (
            {"env_id": "HPAC-PickPlace-v0"},
            "was trained on HPAC-PickPlace-v0, not on HPAC-Grasp-v0",
        ),
    ],
)
def test_a_card_that_cannot_be_followed_ends_in_one_line(folder, env, change, line):
    card = json.loads((folder / "card.json").read_text())
    (folder / "card.json").write_text(json.dumps(card | change))
    with pytest.raises(PolicyError, match=line):
        read_onnx(folder, env)


def test_the_bundle_has_the_evaluation_and_a_film_in_the_hub_s_layout(tmp_path):
    """The hub reads the YAML header, shows the result of the model index, and plays
    ``replay.mp4``.
    """
    yaml = pytest.importorskip("yaml")
    policy = str(SHIPPED["grasp"])
    words = ["--episodes", "4", "--workers", "1", "--no-baselines", "--policy"]
    results = ["--out", f"{tmp_path}/results.json"]
    assert called(evaluate, *words, policy, *results) == 0
    (tmp_path / "film.mp4").write_bytes(b"\0\0\0\x1cftypisom")
    given = ["--evaluation", f"{tmp_path}/results.json", "--film", f"{tmp_path}/film.mp4"]
    assert main(["export", policy, "--out", f"{tmp_path}/out", *given]) == 0
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names == {"README.md", "card.json", "model.onnx", "replay.mp4"}
    _, header, page = (tmp_path / "out" / "README.md").read_text().split("---\n", 2)
    told = yaml.safe_load(header)
    judged = json.loads((tmp_path / "results.json").read_text())
    assert (told["library_name"], told["pipeline_tag"], told["license"]) == (
        "hpac_gym",
        "reinforcement-learning",
        "mit",
    )
    (result,) = told["model-index"][0]["results"]
    assert result["dataset"]["name"] == "HPAC-Grasp-v0"
    assert result["metrics"] == [
        {"type": "success_rate", "value": judged["policies"]["learned"]["success_rate"]}
    ]
    assert "| learned | 4 |" in page
    assert called(evaluate, *words, f"{tmp_path}/out", "--out", f"{tmp_path}/again.json") == 0
    assert json.loads((tmp_path / "again.json").read_text())["policies"] == judged["policies"]
    given = [policy, "--evaluation", f"{tmp_path}/again.json"]
    assert main(["export", *given, "--out", f"{tmp_path}/third"]) == 0


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (
            "{trained} --evaluation {folder}/results.json",
            "evaluates other weights, 12ab…, than those of the policy, ",
        ),
        ("{trained} --evaluation {trained}", "grasp.hpac: not UTF-8 text"),
        (
            "{trained} --evaluation {folder}/other.json",
            "is not a result of hpac evaluate, or is damaged: no card can be made of it: KeyError('policy')",
        ),
        (
            "{trained} --evaluation {folder}/several.json",
            "several.json' compares 2 policies: evaluate this one alone",
        ),
        (
            "{trained} --evaluation {folder}/bent.json",
            "bent.json' is not a result of hpac evaluate, or is damaged: no card can be",
        ),
        ("{trained} --film {folder}/results.json", "is not an MP4 file"),
        ("{trained} --film {folder}/none.mp4", "cannot read film"),
    ],
)
def test_what_does_not_belong_to_the_policy_is_refused_before_anything_is_written(
    words, line, tmp_path, capsys
):
    results = {
        "policies": {"learned": {}},
        "first_seed": 1,
        "last_seed": 2,
        "policy": {"sha256": "12ab"},
    }
    (tmp_path / "results.json").write_text(json.dumps(results))
    (tmp_path / "several.json").write_text(json.dumps(results | {"files": [{}, {}]}))
    (tmp_path / "other.json").write_text("{}")
    sha256 = read_policy(SHIPPED["grasp"]).about["sha256"]
    (tmp_path / "bent.json").write_text(json.dumps(results | {"policy": {"sha256": sha256}}))
    assert (
        main(
            [
                "export",
                *words.format(trained=SHIPPED["grasp"], folder=tmp_path).split(),
                "--out",
                f"{tmp_path}/out",
            ]
        )
        == 2
    )
    assert line in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
