"""Fingerprints of the environments: `python tests/envs/fingerprints.py --write` writes `fingerprints.json` anew.

A fingerprint is taken of some episodes with given actions: a hash of every observation and reward to the bit, which any two
runs on one machine share, and the observations and rewards summed up with fixed weights, which other processors give too, to
within rounding. The file holds the sums. Who has to change it has changed the physics, the reward or the observation, and
raises the environment's -v number; before the first release the same number may stay.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

import hpac_gym  # noqa: F401  registers the environments

FILE = Path(__file__).with_name("fingerprints.json")
IDS = sorted(name for name in gymnasium.registry if name.startswith("HPAC-"))
SEEDS = (9, 12, 14, 15)
"""Of episodes in which rounding does not grow: no slipping on the edge, no contact that is barely made."""
TOLERANCE = 1e-3
"""Of the sums: what other processors' sine and cosine may change."""

OPEN, CLOSED = np.array([-1.0, -1, -1, -1, -1, 0.5]), np.array([0.3, 1, 1, 1, 1, 0.5])
CLOSE_STEPS = 16
CLOSING = {"HPAC-PickPlace-v0": (12, 74)}
"""Steps after which the hand begins to close and to open, where that is not at once and never."""
NOISE = 0.05
"""Half range of what is added to every action, so that every servo's every motion counts."""


def action(name: str, step: int, rng: np.random.Generator) -> np.ndarray:
    """Closes, holds, opens; it does not look at the observation."""
    begin, end = CLOSING.get(name, (0, 10_000))
    share = min(max((step + 1 - begin) / CLOSE_STEPS, 0.0), 1.0) if step < end else 0.0
    return np.clip(OPEN + share * (CLOSED - OPEN) + rng.uniform(-NOISE, NOISE, 6), -1, 1).astype(np.float32)


def flat(observation: Any) -> np.ndarray:
    """An observation as one vector of float64."""
    if isinstance(observation, dict):
        return np.concatenate([flat(observation[name]) for name in sorted(observation)])
    return np.asarray(observation, dtype=float).ravel()


def fingerprint(env: gymnasium.Env) -> dict[str, Any]:
    """The hash of the episodes, and for each its length, its return, and a weighted sum of its observations."""
    digest, episodes = hashlib.sha256(), []
    for seed in SEEDS:
        observation, _ = env.reset(seed=seed)
        seen, total = [flat(observation)], 0.0
        rng, over = np.random.default_rng([seed, 5]), False
        while not over:
            observation, reward, terminated, truncated, _ = env.step(action(env.spec.id, len(seen) - 1, rng))
            seen.append(flat(observation))
            total += float(reward)
            digest.update(seen[-1].tobytes() + np.float64(reward).tobytes())
            over = terminated or truncated
        weights = np.cos(np.arange(seen[0].size))
        episodes.append({"steps": len(seen) - 1, "return": total, "observed": float(np.mean(seen, axis=0) @ weights)})
    return {"hash": digest.hexdigest(), "episodes": episodes}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true", help=f"write {FILE.name} instead of printing")
    parser.add_argument("ids", nargs="*", default=IDS, help="environments; all by default")
    arguments = parser.parse_args()
    found = {}
    for name in arguments.ids or IDS:
        with gymnasium.make(name) as env:
            found[name] = fingerprint(env)
    if arguments.write:
        sums = json.loads(FILE.read_text(encoding="utf-8")) if FILE.exists() else {}
        sums |= {name: taken["episodes"] for name, taken in found.items()}
        FILE.write_text(json.dumps(dict(sorted(sums.items())), indent=1) + "\n", encoding="utf-8")
    else:
        json.dump(found, sys.stdout)


if __name__ == "__main__":
    main()
