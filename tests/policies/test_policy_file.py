import base64
import hashlib
import io
import json
import re
import tarfile
import zipfile
from dataclasses import replace
from pathlib import Path

import cloudpickle
import gymnasium
import numpy as np
import pytest

from hpac_gym.policies import PolicyError, PolicyFile, read_policy, write_policy
from hpac_gym.policies.loading import about, load_policy
from tests.policies.episodes import tiny_policy

ROOT = Path(__file__).resolve().parents[2]
TINY = "tests.tiny_task:Tiny-v0"


@pytest.fixture
def policy() -> PolicyFile:
    return tiny_policy()


@pytest.fixture
def path(policy, tmp_path):
    write_policy(tmp_path / "policy.hpac", policy)
    return tmp_path / "policy.hpac"


def test_a_policy_reads_back_as_it_was_written(policy, path):
    again = read_policy(path)
    seen = np.linspace(-1, 1, 6)
    assert np.array_equal(again.actor(seen), policy.actor(seen))
    assert again.about["env_id"] == TINY
    first = path.read_bytes()
    write_policy(path, policy)
    assert path.read_bytes() == first, "the same policy gives the same bytes"


def test_changed_weights_keep_their_description_and_get_a_hash_of_their_own(path):
    before = read_policy(path)
    write_policy(path, PolicyFile(replace(before.actor, mean_clip=1.0), before.about))
    after = read_policy(path)
    assert after.about.pop("sha256") != before.about.pop("sha256")
    assert (after.about, after.actor.mean_clip) == (before.about, 1.0)


def test_actions_stay_inside_of_the_action_space(policy):
    for seen in (np.full(6, 1e6), np.full(6, -1e6), np.zeros(6)):
        action = policy.actor(seen)
        assert action.dtype == np.float32
        assert np.all(np.abs(action) <= 1)


def rewrite(path, **members):
    """Write the archive again with some members changed by a function each."""
    with tarfile.open(path) as archive:
        held = {name: archive.extractfile(name).read() for name in archive.getnames()}
    unchanged = lambda data: data  # noqa: E731
    pack(path, {n: members.get(n.partition(".")[0], unchanged)(d) for n, d in held.items()})


def pack(path, members):
    """Write an archive of these members."""
    with tarfile.open(path, "w:gz") as archive:
        for name, data in members.items():
            data = data.encode() if isinstance(data, str) else data
            entry = tarfile.TarInfo(name)
            entry.size = len(data)
            archive.addfile(entry, io.BytesIO(data))


def edit(**changes):
    return lambda data: json.dumps(json.loads(data) | changes)


DAMAGE = {
    "missing": lambda path: path.unlink(),
    "a folder": lambda path: (path.unlink(), path.mkdir()),
    "empty": lambda path: path.write_bytes(b""),
    "text": lambda path: path.write_text("policy"),
    "cut in half": lambda path: path.write_bytes(path.read_bytes()[: path.stat().st_size // 2]),
    "a flipped byte": lambda path: path.write_bytes(flip(path.read_bytes(), 600)),
    "another archive": lambda path: pack(path, {"a.txt": "a"}),
    "no weights": lambda path: pack(
        path, {"policy.json": '{"format": 2, "sha256": "", "env_id": ""}'}
    ),
    "weights of another": lambda path: rewrite(path, actor=lambda data: data + b"\0"),
    "a later format": lambda path: rewrite(path, policy=edit(format=99)),
    "no environment": lambda path: rewrite(path, policy=edit(env_id=None)),
    "no time for an action": lambda path: rewrite(path, policy=edit(action_repeat=0)),
    "a closure of other numbers": lambda path: rewrite(
        path, policy=edit(closure={"goal": [0.0, 1.0]})
    ),
    "a closure of nonsense": lambda path: rewrite(path, policy=edit(closure={"goal": [1.0, 0.0]})),
    "no archive of weights": lambda path: reweigh(path, b"PK\x03\x04"),
    "means of two axes": lambda path: reweigh(path, observation_mean=np.zeros((6, 6))),
    "a hole in the weights": lambda path: reweigh(path, bias_0=np.full(8, np.nan, np.float32)),
    "a scale of zero": lambda path: reweigh(path, observation_scale=np.zeros(6)),
    "a clip that is not positive": lambda path: reweigh(path, observation_clip=-1.0),
    "another that is not": lambda path: reweigh(path, mean_clip=0.0),
    "complex weights": lambda path: reweigh(path, bias_0=np.zeros(8, complex)),
    "biases of two axes": lambda path: reweigh(path, bias_0=np.zeros((8, 1), np.float32)),
    "a list for a description": lambda path: rewrite(path, policy=lambda data: "[]"),
    "an interface of nonsense": lambda path: rewrite(path, policy=edit(made_for=[1])),
    "broken json": lambda path: rewrite(path, policy=lambda data: data[:-5]),
    "another environment": lambda path: rewrite(path, policy=edit(env_id="HPAC-Grasp-v7")),
}


def reweigh(path, packed=None, **changes):
    """Write the archive again with other weights, or other arrays among them, and their hash."""
    with tarfile.open(path) as archive:
        arrays = dict(np.load(io.BytesIO(archive.extractfile("actor.npz").read())))
    if packed is None:
        changed = io.BytesIO()
        np.savez(changed, **arrays | changes)
        packed = changed.getvalue()
    sha256 = hashlib.sha256(packed).hexdigest()
    rewrite(path, actor=lambda data: packed, policy=edit(sha256=sha256))


def flip(data: bytes, at: int) -> bytes:
    return data[:at] + bytes([data[at] ^ 0x55]) + data[at + 1 :]


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_bad_file_ends_in_one_policy_error_that_names_it(path, damage):
    DAMAGE[damage](path)
    with pytest.raises(PolicyError) as caught:
        load_policy(str(path), gymnasium.make(TINY))
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_name_that_looks_like_another_kind_of_file_is_not_written(policy, tmp_path):
    with pytest.raises(PolicyError, match=r"policy\.zip' must end in \.hpac"):
        write_policy(tmp_path / "policy.zip", policy)
    assert not list(tmp_path.iterdir())


def test_stable_baselines3_says_that_a_policy_file_is_none_of_its_own(path):
    from stable_baselines3 import PPO

    with pytest.raises(ValueError, match=r"policy\.hpac wasn't a zip-file"):
        PPO.load(path)


class Trap:
    """Creates a file where it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


def test_no_pickle_is_loaded_from_a_policy_file_nor_named_anywhere(path, tmp_path):
    packed = io.BytesIO()
    np.savez(packed, observation_mean=np.array([Trap(tmp_path / "sprung")], dtype=object))
    reweigh(path, packed.getvalue())
    with pytest.raises(PolicyError, match=r"is damaged .*: Object arrays cannot be loaded"):
        read_policy(path)
    assert not (tmp_path / "sprung").exists()
    packed.seek(0)
    np.load(packed, allow_pickle=True)["observation_mean"]
    assert (tmp_path / "sprung").exists(), "the trap works"
    spring = tmp_path / "sprung"
    spring.unlink()
    pickled = base64.b64encode(cloudpickle.dumps(Trap(spring))).decode()
    with zipfile.ZipFile(path, "w") as archive:  # a model of Stable-Baselines3 by another name
        archive.writestr("data", json.dumps({"policy": {":serialized:": pickled}}))
    for load in (about, lambda name: load_policy(name, gymnasium.make(TINY))):
        with pytest.raises(PolicyError, match=r"is not a policy file \(\.hpac\)"):
            load(str(path))
    assert not spring.exists()
    with pytest.raises(PolicyError):
        load_policy(str(path.rename(tmp_path / "model.zip")), gymnasium.make(TINY))
    assert spring.exists(), "this trap works too"
    unsafe = re.compile(r"pickle as|from pickle|pickle\.load|torch\.load|allow_pickle=True|joblib")
    sources = [
        file for name in ("agents", "hpac_gym", "tools") for file in (ROOT / name).rglob("*.py")
    ]
    assert len(sources) > 100
    assert [file for file in sources if unsafe.search(file.read_text(encoding="utf-8"))] == []
