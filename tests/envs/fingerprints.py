"""Fingerprints of the environments: `python tests/envs/fingerprints.py --write` writes `fingerprints.json` anew.

A fingerprint is taken of some episodes with given actions: a hash of every observation, reward and info to the bit, which any
two runs on one machine share, and their means, which other processors give too, to within rounding. The file holds the means.
The environments are frozen: whoever has to change the file has changed the physics, the reward or the observation, and raises
the environment's -v number.

Writing chooses the episodes: those in which rounding does not grow, as it does where something slips on an edge or is barely
touched, and which show what a case is for.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any
from unittest.mock import patch

import gymnasium
import numpy as np

import hpac_gym  # noqa: F401  registers the environments
from hpac_gym.envs import GRASPS
from hpac_gym.envs.randomization import PRESETS
from hpac_gym.model import HPAC, SERVOS, action_from_synergy
from hpac_gym.model.joints import JOINT_INDEX

FILE = Path(__file__).with_name("fingerprints.json")
IDS = sorted(name for name in gymnasium.registry if name.startswith("HPAC-"))
GRASP, PICK_PLACE, POSTURE = "HPAC-Grasp-v0", "HPAC-PickPlace-v0", "HPAC-Posture-v0"
RELATIVE, ABSOLUTE = 1e-3, 1e-4
"""Tolerances of the means: what other processors' sine and cosine may change."""

# Policies: the actions of an episode, given its environment, its first observation and a generator ---------------------------

Policy = Callable[[gymnasium.Env, Any, np.random.Generator], Iterator[np.ndarray]]
OPEN, CLOSED = np.array([-1.0, -1, -1, -1, -1, 0.5]), np.array([0.3, 1, 1, 1, 1, 0.5])
CLOSE_STEPS = 16
NEVER = 10_000


def closing(begin: int = 0, let_go: int = NEVER, again: int = NEVER) -> Policy:
    """Closes slowly from a step on, opens at another one, and closes again at a third.

    Some noise makes every servo's every motion count; more would loosen a named grasp.
    """

    def policy(env: gymnasium.Env, first: Any, rng: np.random.Generator) -> Iterator[np.ndarray]:
        grasp = getattr(getattr(env.unwrapped, "task", None), "grasp", None)
        opened, closed = (OPEN, CLOSED) if grasp is None else map(action_from_synergy, (grasp.preshape, grasp.closed))
        noise = 0.05 if grasp is None else 0.01
        for step in range(NEVER):
            share = 0.0 if let_go <= step < again else min(max((step + 1 - begin) / CLOSE_STEPS, 0.0), 1.0)
            yield opened + share * (closed - opened) + rng.uniform(-noise, noise, 6)

    return policy


def reaching(env: gymnasium.Env, first: Any, rng: np.random.Generator) -> Iterator[np.ndarray]:
    """To the goal, as far as the model knows the way."""
    goal = first["desired_goal"][[JOINT_INDEX[name] for name in SERVOS]]
    while True:
        yield action_from_synergy(np.clip(goal, HPAC.synergy_min, HPAC.synergy_max)) + rng.uniform(-0.01, 0.01, 6)


def clenched(env: gymnasium.Env, first: Any, rng: np.random.Generator) -> Iterator[np.ndarray]:
    """A fist at once, which the wrist carries into whatever there is."""
    while True:
        yield CLOSED


def restless(hold: int = 5) -> Policy:
    """From one extreme to another, each held for some steps; after nine a thumb under the fingers may snap out at full speed."""

    def policy(env: gymnasium.Env, first: Any, rng: np.random.Generator) -> Iterator[np.ndarray]:
        while True:
            action = rng.choice([-1.0, 1.0], 6)
            yield from [action] * hold

    return policy


# Episodes ------------------------------------------------------------------------------------------------------------------


def flat(observation: Any) -> np.ndarray:
    """An observation as one vector of float64."""
    return np.concatenate(leaves(observation))


def leaves(observation: Any) -> list[np.ndarray]:
    """The vectors that an observation consists of; a picture from 0 to 1."""
    if isinstance(observation, dict):
        return list(chain.from_iterable(leaves(observation[name]) for name in sorted(observation)))
    values = np.asarray(observation)
    return [values.ravel() / (255.0 if values.dtype == np.uint8 else 1.0)]


def numbers(info: dict[str, Any], prefix: str = "") -> dict[str, float]:
    """What an info counts, by name."""
    found: dict[str, float] = {}
    for name, value in info.items():
        if isinstance(value, dict):
            found |= numbers(value, f"{prefix}{name}.")
        elif not isinstance(value, str):
            found |= {f"{prefix}{name}.{index}": float(number) for index, number in enumerate(np.atleast_1d(value))}
    return found


@dataclass
class Episode:
    """What happened in one episode."""

    observations: list[list[np.ndarray]]
    rewards: list[float]
    infos: list[dict[str, float]]

    def bits(self) -> bytes:
        everything = [*chain.from_iterable(self.observations), self.rewards, *(list(info.values()) for info in self.infos)]
        return b"".join(np.asarray(part, dtype=float).tobytes() for part in everything)

    def means(self) -> dict[str, Any]:
        """Length, return, size of an observation, means of its runs of entries, and of the infos by name in order.

        Of an entry x, x + x²/3 is taken, so that neither its sign is lost nor what swings about zero, and how much it changes
        from step to step, which tells how large its noise is.
        """
        runs = []
        for steps in zip(*self.observations, strict=True):
            x = np.array(steps)
            seen = (x + x**2 / 3).mean(axis=0) + np.abs(np.diff(x, axis=0)).mean(axis=0)
            seen *= 1 + np.cos(np.arange(seen.size)) / 2
            runs += [float(run.mean()) for run in np.array_split(seen, min(16, -(-seen.size // 4)))]
        names = sorted(set(chain.from_iterable(self.infos)))
        return {
            "steps": len(self.rewards),
            "return": sum(self.rewards),
            "size": sum(part.size for part in self.observations[0]),
            "observed": runs,
            "info": [float(np.mean([info[name] for info in self.infos if name in info])) for name in names],
        }


def play(env: gymnasium.Env, policy: Policy, seed: int, limit: int = NEVER, disturbance: float = 0.0) -> Episode:
    """One episode, or its first steps; a disturbance is added to all actions."""
    observation, info = env.reset(seed=seed)
    episode, over = Episode([leaves(observation)], [], [numbers(info)]), False
    actions = policy(env, observation, np.random.default_rng([seed, 5]))
    while not over and len(episode.rewards) < limit:
        observation, reward, terminated, truncated, info = env.step(np.clip(next(actions) + disturbance, -1, 1))
        episode.observations.append(leaves(observation))
        episode.rewards.append(float(reward))
        episode.infos.append(numbers(info))
        over = terminated or truncated
    return episode


def same(then: dict[str, Any], now: dict[str, Any], share: float = 1.0) -> bool:
    """Whether two episodes' means agree to a share of the tolerances."""
    return all(
        np.shape(then[name]) == np.shape(now[name]) and np.allclose(now[name], then[name], share * RELATIVE, share * ABSOLUTE)
        for name in now
    )


# The cases -----------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Case:
    """Some episodes of an id with options."""

    id: str
    options: dict[str, str]
    policy: Policy
    episodes: int = 1
    limit: int = NEVER
    """Steps that are looked at."""
    about: str = ""
    reacts: tuple[str, float] | None = None
    """A number of the code, and another value, which has to show in every one of the episodes."""

    @property
    def name(self) -> str:
        return "/".join(filter(None, [self.id, *self.options.values(), self.about]))

    def make(self, **options: Any) -> gymnasium.Env:
        return gymnasium.make(self.id, **self.options, **options)


USUAL = {GRASP: closing(), PICK_PLACE: closing(12, 74), POSTURE: closing()}
PRIVILEGED = {"obs": "privileged"}
LOST, SLIPPED = ("hpac_gym.envs.grip._MISSED_STEPS", 2), ("hpac_gym.envs.grip.MAX_SLIP", 0.022)
CASES = (
    *(Case(name, {}, policy, 4) for name, policy in USUAL.items()),
    *(Case(name, {"obs": "image"}, policy) for name, policy in USUAL.items()),
    *(Case(name, {"reward": "sparse"}, policy, 2) for name, policy in (USUAL | {POSTURE: reaching}).items()),
    *(Case(name, {"randomize": preset} | PRIVILEGED, policy, 2) for name, policy in USUAL.items() for preset in PRESETS),
    *(Case(name, PRIVILEGED, restless(), 2, about="restless") for name in IDS),
    *(Case(GRASP, {"grasp": name}, closing(), 2) for name in GRASPS),
    *(Case(GRASP, {"grasp": name, "variant": variant} | PRIVILEGED, closing(), 1, 20)
      for name, grasp in GRASPS.items() for variant in grasp.held_out),
    Case(GRASP, PRIVILEGED, closing(let_go=40), 2, about="let go", reacts=LOST),
    Case(GRASP, {"grasp": "large_sphere"}, closing(let_go=26), 2, about="let go", reacts=LOST),
    Case(GRASP, {"grasp": "scissors"}, closing(), 2, about="slips", reacts=SLIPPED),
    Case(PICK_PLACE, PRIVILEGED, closing(12, 50), 2, about="let go", reacts=LOST),
    Case(GRASP, PRIVILEGED, clenched, about="jams", reacts=("hpac_gym.sim.wrist.FORCE_LIMIT", 150.0)),
    Case(POSTURE, PRIVILEGED, restless(9), 2, about="snaps", reacts=("hpac_gym.sim.hand.MAX_JOINT_SPEED", 25.0)),
)  # fmt: skip
BY_NAME = {case.name: case for case in CASES}


def kept() -> dict[str, Any]:
    """What the file keeps, by the cases' names."""
    return json.loads(FILE.read_text(encoding="utf-8")) if FILE.exists() else {}


def fingerprint(env: gymnasium.Env, case: Case) -> dict[str, Any]:
    """The hash of the episodes that the file keeps of a case, and their means."""
    entry = kept()[case.name]
    episodes = [play(env, case.policy, one["seed"], entry["limit"]) for one in entry["episodes"]]
    digest = hashlib.sha256(b"".join(episode.bits() for episode in episodes)).hexdigest()
    return {"hash": digest, "episodes": [episode.means() for episode in episodes]}


def chosen(case: Case) -> dict[str, Any] | None:
    """What the file shall keep of a case: the longest of the first episodes in which rounding does not grow.

    Where it does in all of them, only the first steps count, in which the fingers meet the object. None if nothing serves.
    """
    seeds = range(80 if case.reacts else 16)
    with case.make() as env:
        for limit in (limit for limit in (NEVER, 40, 20, 16, 12, 9, 7, 5, 3, 2) if limit <= case.limit):
            found = []
            means = {seed: play(env, case.policy, seed, limit).means() for seed in seeds}
            for seed in sorted(seeds, key=lambda seed: -means[seed]["steps"]):
                disturbed = (play(env, case.policy, seed, limit, off).means() for off in (1e-9, -1e-9, 1e-12))
                if reacts(case, seed, limit, means[seed]) and all(same(means[seed], other, 0.3) for other in disturbed):
                    found.append({"seed": seed} | means[seed])
                if len(found) == case.episodes:
                    return {"limit": limit, "episodes": found}
    return None


def reacts(case: Case, seed: int, limit: int, means: dict[str, Any]) -> bool:
    """Whether an episode shows what its case is for."""
    if case.reacts is None:
        return True
    with patch(*case.reacts), case.make() as env:
        return not same(means, play(env, case.policy, seed, limit).means())


def rounded(value: Any) -> Any:
    """To six digits, all the way down."""
    if isinstance(value, dict):
        return {name: rounded(inner) for name, inner in value.items()}
    if isinstance(value, list):
        return [rounded(inner) for inner in value]
    return float(f"{value:.6g}") if isinstance(value, float) else value


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true", help=f"write {FILE.name} instead of printing")
    parser.add_argument("names", nargs="*", default=list(BY_NAME), help="of cases; all by default")
    arguments = parser.parse_args()
    found = kept()
    for case in (BY_NAME[name] for name in arguments.names):
        if arguments.write:
            found[case.name] = rounded(chosen(case))
            if found[case.name] is None:
                print(f"{case.name}: no episodes show what it is for; give it another policy", file=sys.stderr)
        else:
            with case.make() as env:
                found[case.name] = fingerprint(env, case)
    if not arguments.write:
        json.dump({name: found[name] for name in arguments.names}, sys.stdout)
        return
    rows = {name: found[name] for name in sorted(BY_NAME) if found.get(name)}
    lines = (f"{json.dumps(name)}:{json.dumps(row, separators=(',', ':'))}" for name, row in rows.items())
    FILE.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
