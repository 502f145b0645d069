"""An exported policy decides as the policy file does, and says what it is made for."""

import json
from pathlib import Path

import gymnasium
import numpy as np
import pytest

import hpac_gym  # noqa: F401  registers the environments
from hpac_gym.envs.randomization import changed_hand
from hpac_gym.model import HPAC
from hpac_gym.policies import Actor, Closures, PolicyError, PolicyFile, write_policy
from hpac_gym.policies.export import export, read_onnx
from hpac_gym.policies.made_for import made_for

onnxruntime = pytest.importorskip("onnxruntime")


@pytest.fixture(scope="module")
def env():
    env = gymnasium.make("HPAC-Grasp-v0", engine="mujoco")
    yield env
    env.close()


@pytest.fixture(scope="module")
def policy(env) -> PolicyFile:
    rng = np.random.default_rng(0)
    sizes = ((64, 44), (64, 64), (8, 64))
    drawn = [(rng.normal(0, m**-0.5, (n, m)), rng.normal(0, 0.3, n)) for n, m in sizes]
    layers = tuple((weight.astype(np.float32), bias.astype(np.float32)) for weight, bias in drawn)
    about = {"env_id": "hpac_gym:HPAC-Grasp-v0", "closure": {"goal": [-0.4, 1.0]}, "made_for": made_for(env)}
    return PolicyFile(Actor(rng.normal(0, 0.3, 44), rng.uniform(0.5, 2, 44), 8.0, layers, 4.0), about)


@pytest.fixture
def folder(policy, tmp_path) -> Path:
    write_policy(tmp_path / "policy.zip", policy)
    export(tmp_path / "policy.zip", tmp_path / "out")
    return tmp_path / "out"


def test_onnxruntime_decides_as_the_numpy_reader_does_on_1e5_observations(policy, folder):
    session = onnxruntime.InferenceSession((folder / "model.onnx").read_bytes(), providers=["CPUExecutionProvider"])
    seen = np.random.default_rng(1).uniform(-4, 4, (100_000, 44)).astype(np.float32)
    decided = np.concatenate([session.run(None, {"observation": rows})[0] for rows in np.split(seen, 50)])
    assert np.std(decided) > 0.3, "the decisions differ"
    actor = policy.actor
    value = np.clip((seen.astype(float) - actor.observation_mean) / actor.observation_scale, -8, 8)
    *hidden, (weight, bias) = [(weight.astype(float), bias) for weight, bias in actor.layers]
    for inner, offset in hidden:
        value = np.maximum(value @ inner.T + offset, 0)
    expected = np.tanh(np.clip(value @ weight.T + bias, -4, 4))
    np.testing.assert_allclose([actor(row) for row in seen[:200]], expected[:200], rtol=0, atol=1e-6)
    np.testing.assert_allclose(decided, expected, rtol=0, atol=1e-6)


def test_it_acts_in_the_environment_as_the_policy_file_does(policy, folder, env):
    exported, seen = read_onnx(folder, env), env.reset(seed=0)[0]
    exported.reset(0)
    closures = Closures.of(policy.about["closure"])
    for step in range(3):
        np.testing.assert_allclose(exported.act(seen), closures.actions(policy.actor(seen)[None], [step])[0], atol=1e-5)


def test_the_card_tells_layout_numbers_rate_and_hashes(policy, folder):
    told = json.loads((folder / "card.json").read_text())
    assert told["observation"][21] == {"name": "object_pos", "label": "x", "unit": "0.05 m", "low": -4.0, "high": 4.0}
    assert (told["control_hz"], len(told["action"]), len(told["decision"]["numbers"])) == (20, 6, 8)
    assert told["hand_sha256"] == policy.about["made_for"]["hand_sha256"]
    page = (folder / "README.md").read_text()
    assert page.startswith("---\nlibrary_name: hpac_gym\n")
    assert "| 21 | object_pos | x | 0.05 m | -4 | 4 |" in page


def test_it_is_refused_where_layout_or_hand_differ(folder, env):
    other = gymnasium.make("HPAC-Grasp-v0", engine="mujoco", hand=changed_hand(HPAC, np.full(5, 0.9)))
    with pytest.raises(PolicyError, match="does not fit HPAC-Grasp-v0: hand_sha256 was"):
        read_onnx(folder, other)
    other.close()
    card = json.loads((folder / "card.json").read_text())
    (folder / "card.json").write_text(json.dumps(card | {"control_hz": 50}))
    with pytest.raises(PolicyError, match="control_hz was 50, and is 20"):
        read_onnx(folder, env)
    card["observation"].pop(0)
    (folder / "card.json").write_text(json.dumps(card))
    with pytest.raises(PolicyError, match="observation entry 0 was servo index_mcp"):
        read_onnx(folder, env)


@pytest.mark.parametrize("name", ["card.json", "model.onnx"])
def test_a_damaged_export_ends_in_one_line(folder, env, name):
    data = (folder / name).read_bytes()
    (folder / name).write_bytes(data[: len(data) // 2])
    with pytest.raises(PolicyError, match="is not an exported policy") as caught:
        read_onnx(folder, env)
    assert "\n" not in str(caught.value)
