"""A trained policy in one file: weights, observation scaling and provenance.

A file ``.hpac`` is a compressed tar of ``policy.json`` (description and training, with the SHA-256 of
the weights) and ``actor.npz`` (plain arrays: reading them executes no foreign code, and needs neither
PyTorch nor Stable-Baselines3). It is no zip, so that nobody takes it for a model of
Stable-Baselines3, nor does that."""

import gzip
import hashlib
import io
import json
import os
import tarfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from hpac_gym.errors import PolicyError
from hpac_gym.output import replacing
from hpac_gym.policies.closure import Closures
from hpac_gym.policies.increments import Increments

Kind = TypeVar("Kind", Closures, Increments)

FORMAT = 2
SUFFIX = ".hpac"
SHIPPED = {
    path.stem: path for path in sorted((Path(__file__).parent / "trained").glob(f"*{SUFFIX}"))
}
"""The policies that come with the package, one for each environment, by name."""


@dataclass(frozen=True, slots=True)
class Actor:
    """The deterministic part of a trained actor: scaling, a multilayer perceptron with ReLU, tanh.

    Attributes:
        observation_mean: subtracted from an observation, shape (n,).
        observation_scale: divisor of the difference, shape (n,).
        observation_clip: bound of the scaled observation.
        layers: weight, shape (outputs, inputs), and bias, shape (outputs,), of every layer.
        mean_clip: bound of the last layer's output, before tanh.
    """

    observation_mean: NDArray[Any]
    observation_scale: NDArray[Any]
    observation_clip: float
    layers: tuple[tuple[NDArray[Any], NDArray[Any]], ...]
    mean_clip: float

    def __call__(self, observation: NDArray[Any]) -> NDArray[np.float32]:
        """The action for an observation, shape (n,) → shape (m,), −1…1; computed in double
        precision, returned in single.
        """
        scaled = (
            np.asarray(observation, dtype=float) - self.observation_mean
        ) / self.observation_scale
        value = np.clip(scaled, -self.observation_clip, self.observation_clip)
        *hidden, (last_weight, last_bias) = self.layers
        for weight, bias in hidden:
            value = np.maximum(weight.astype(float) @ value + bias, 0)
        bounded = np.clip(
            last_weight.astype(float) @ value + last_bias, -self.mean_clip, self.mean_clip
        )
        action: NDArray[np.float32] = np.tanh(bounded).astype(np.float32)
        return action

    @property
    def sizes(self) -> tuple[int, int]:
        """Numbers of inputs and outputs."""
        return len(self.observation_mean), len(self.layers[-1][1])


@dataclass(frozen=True, slots=True)
class PolicyFile:
    """Contents of a policy file: the actor, and a description with at least ``env_id``."""

    actor: Actor
    about: dict[str, Any]

    @property
    def action_repeat(self) -> int:
        """Number of control steps for which each action is held, as in training."""
        steps: int = self.about.get("action_repeat", 1)
        return steps

    @property
    def closures(self) -> Closures | None:
        """The closures among which the actor decides; None if it sets actions.

        Raises:
            PolicyError: The ranges are invalid.
        """
        return from_description(Closures, self.about.get("closure"))

    @property
    def increments(self) -> Increments | None:
        """How the actor moves the hand from where it is; None if it does not.

        Raises:
            PolicyError: They are invalid.
        """
        return from_description(Increments, self.about.get("increments"))

    @property
    def sizes(self) -> tuple[int, int]:
        """Numbers of observed values and of action values.

        Raises:
            PolicyError: The closures or increments are invalid, or do not fit the actor.
        """
        return sizes_of(self.actor.sizes, self.closures, self.increments)


def from_description(kind: type[Kind], told: Mapping[str, Any] | None) -> Kind | None:
    """The closures or increments that a policy's description has; None if it has none.

    Raises:
        PolicyError: A name is unknown or missing, or a value is invalid.
    """
    try:
        return None if told is None else kind(**told)
    except (TypeError, ValueError) as error:
        raise PolicyError(f"invalid {kind.__name__}: {error}") from None


def sizes_of(
    actor: tuple[int, int], closures: Closures | None, moves: Increments | None
) -> tuple[int, int]:
    """Numbers of observed values and of action values, of the numbers of an actor's inputs and
    outputs and of how it decides.

    Raises:
        PolicyError: The actor has other numbers than its closures or increments.
    """
    observed, decided = actor
    if moves is not None:
        if observed % (moves.frames + 1) or decided != len(moves.start) or closures:
            raise PolicyError(
                f"increments do not fit an actor of {observed} values that sets {decided}"
            )
        return observed // (moves.frames + 1), decided
    if closures is not None:
        if decided != len(closures.names):
            raise PolicyError(
                f"a closure takes {len(closures.names)} numbers, the actor sets {decided}"
            )
        return observed, closures.actions(np.zeros((1, decided)), [0]).shape[1]
    return observed, decided


def write_policy(path: str | os.PathLike[str], policy: PolicyFile) -> None:
    """Write a policy file, deterministically to the byte.

    Raises:
        PolicyError: The name does not end in .hpac.
        OutputError: The folder cannot be written, or the disk is full.
    """
    if Path(path).suffix != SUFFIX:
        raise PolicyError(f"the name of policy file '{path}' must end in {SUFFIX}")
    actor = policy.actor
    arrays: dict[str, Any] = {
        "observation_mean": actor.observation_mean,
        "observation_scale": actor.observation_scale,
        "observation_clip": np.float64(actor.observation_clip),
        "mean_clip": np.float64(actor.mean_clip),
    }
    for number, (weight, bias) in enumerate(actor.layers):
        arrays |= {f"weight_{number}": weight, f"bias_{number}": bias}
    packed = io.BytesIO()
    np.savez(packed, **arrays)
    own = {"format": FORMAT, "sha256": hashlib.sha256(packed.getvalue()).hexdigest()}
    about = own | policy.about | own  # first in order, and not those of a file that was read
    members = {
        "policy.json": (json.dumps(about, indent=2) + "\n").encode(),
        "actor.npz": packed.getvalue(),
    }
    bundle = io.BytesIO()
    with tarfile.open(fileobj=bundle, mode="w") as archive:
        for name, data in members.items():
            entry = tarfile.TarInfo(name)
            entry.size = len(data)
            archive.addfile(entry, io.BytesIO(data))
    with replacing(path) as temporary:
        temporary.write_bytes(gzip.compress(bundle.getvalue(), mtime=0))


def policy_path(name: str | os.PathLike[str]) -> Path:
    """The path of a policy: of a shipped one by its name, such as `grasp`; `./grasp` is a file."""
    return SHIPPED.get(str(name), Path(name))


def read_policy(path: str | os.PathLike[str]) -> PolicyFile:
    """Read a policy file, or a policy of `SHIPPED` by its name.

    Raises:
        PolicyError: The file is missing, damaged, not a policy file, or of a later format.
    """
    try:
        bundle = io.BytesIO(gzip.decompress(policy_path(path).read_bytes()))
        with tarfile.open(fileobj=bundle, mode="r:") as archive:
            # A member that is no file is None, which has nothing to read.
            about = json.loads(archive.extractfile("policy.json").read())  # type: ignore[union-attr]
            packed = archive.extractfile("actor.npz").read()  # type: ignore[union-attr]
        if about["format"] != FORMAT:
            raise ValueError(f"its format is {about['format']}, this version reads {FORMAT}")
        if about["sha256"] != hashlib.sha256(packed).hexdigest():
            raise ValueError("its weights do not match their SHA-256")
        if not isinstance(about["env_id"], str):
            raise ValueError("its env_id is not a string")
        arrays = dict(np.load(io.BytesIO(packed), allow_pickle=False))
        policy = PolicyFile(_actor_from_arrays(arrays), about)
        if not (isinstance(policy.action_repeat, int) and policy.action_repeat >= 1):
            raise ValueError(f"its action_repeat is {policy.action_repeat!r}")
        policy.sizes  # noqa: B018  raises if closure or increments are invalid
        return policy
    except FileNotFoundError:
        raise PolicyError(f"no policy file '{path}'") from None
    except gzip.BadGzipFile:
        raise PolicyError(f"'{path}' is not a policy file ({SUFFIX})") from None
    except OSError as error:
        raise PolicyError(f"cannot read policy file '{path}': {error.strerror or error}") from None
    except Exception as error:  # a damaged file can make its reader raise anything
        raise PolicyError(
            f"policy file '{path}' is damaged or of a later version: {error}"
        ) from None


def _actor_from_arrays(arrays: dict[str, NDArray[Any]]) -> Actor:
    count = sum(name.startswith("weight_") for name in arrays)
    layers = tuple(
        (arrays[f"weight_{number}"], arrays[f"bias_{number}"]) for number in range(count)
    )
    mean = arrays["observation_mean"]
    scale = arrays["observation_scale"]
    clips = arrays["observation_clip"], arrays["mean_clip"]
    width = len(mean)
    for weight, bias in layers:
        if weight.shape != (len(bias), width) or bias.ndim != 1:
            raise ValueError(
                f"a layer of shape {weight.shape} and {bias.shape} does not follow {width} values"
            )
        width = len(bias)
    if (
        not layers
        or mean.ndim != 1
        or scale.shape != mean.shape
        or not all(array.dtype.kind == "f" for array in arrays.values())
        or not all(np.all(np.isfinite(array)) for array in arrays.values())
        or not all(np.all(entry > 0) for entry in (scale, *clips))
    ):
        raise ValueError("the arrays of the actor are not those of a policy")
    return Actor(mean, scale, float(clips[0]), layers, float(clips[1]))
