"""Fingerprints of the environments: `python -m tests.envs.fingerprints --write` writes
`fingerprints.json` anew.

The environments are frozen: whoever has to change the file has changed the physics, the reward or
the observation, and raises the environment's -v number. The file must hold on every processor,
although the last bit of sine and cosine differs between processors and contact makes it grow. Each
case therefore compares only what cannot grow:

* Free motion, until something touches the hand, to 1e-6. The object is fixed meanwhile: one that
  stands on its support at a distance of exactly zero falls in the first physics step or not, and a
  round one goes on rocking by 1e-4 rad.
* The first `TOUCHED_STEPS` control steps from the first touch on, to 1e-4, if the object is one
  sphere or one box. On a cylinder, or on many boxes that make up a round shape, the points of
  contact jump.
* Stories: whole episodes with prescribed states instead of a simulation, to 1e-5.
* On MuJoCo free motion alone, to 2e-3. These cases, and the counts "on MuJoCo", hold where
  there is no PyBullet.
* Outcomes and lengths of many whole episodes, counted.

No seed is chosen: a case takes the first ones.
"""

import argparse
import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import chain, count
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from scipy.stats import binom

from hpac_gym.body.objects import ObjectSpec
from hpac_gym.envs import GRASPS
from hpac_gym.envs.randomization import PRESETS
from hpac_gym.model import HPAC, JOINTS, SERVOS, action_from_synergy
from hpac_gym.model.joints import JOINT_INDEX
from hpac_gym.physics.engine import SceneSetup
from hpac_gym.registration import GENTLE, GRASP, GRASP_ANY, GRASP_TYPE, PICK_PLACE, POSTURE
from hpac_gym.tasks.grasp_rules import GRASP_TYPES
from hpac_gym.tasks.placing import wrist_choice
from tests.envs.stories import Story

FILE = Path(__file__).with_name("fingerprints.json")
TIGHT = (1e-6, 1e-6)
LOOSE = (1e-4, 1e-5)
"""Relative and absolute tolerances of means: of what does not touch anything, and of what does or
is a picture.
"""
LOOSEST = (1e-3, 2e-3)
"""On MuJoCo, where a digit rests on a soft stop at angle zero: another rounding of the hand's
geometry, by 1e-17, moves it by 1e-4 rad.
"""
TOUCHED_STEPS = 3
"""Control steps after the first touch that are compared, 18 physics steps."""

# Policies: the actions of an episode, given its environment, its first observation and a generator
# ---------------------------

Policy = Callable[[gymnasium.Env, Any, np.random.Generator], Iterator[np.ndarray]]
OPEN = np.array([-1.0, -1, -1, -1, -1, 0.5])
CLOSED = np.array([0.3, 1, 1, 1, 1, 0.5])
CLOSE_STEPS = 16
NEVER = 10_000


def closing(begin: int = 6, let_go: int = NEVER) -> Policy:
    """Closes slowly from a step on, and opens at another one.

    Some noise makes every servo's every motion count; more would loosen a named grasp.
    """

    def policy(env: gymnasium.Env, first: Any, rng: np.random.Generator) -> Iterator[np.ndarray]:
        grasp = getattr(getattr(env.unwrapped, "task", None), "grasp", None)
        opened, closed = (
            (OPEN, CLOSED)
            if grasp is None
            else map(action_from_synergy, (grasp.preshape, grasp.closed))
        )
        noise = 0.05 if grasp is None else 0.01
        for step in count():
            share = 0.0 if step >= let_go else min(max((step + 1 - begin) / CLOSE_STEPS, 0.0), 1.0)
            yield opened + share * (closed - opened) + rng.uniform(-noise, noise, 6)

    return policy


def own(env: gymnasium.Env, first: Any, rng: np.random.Generator) -> Iterator[np.ndarray]:
    """The scripted closure of the requested type."""
    script = env.unwrapped.task.script()
    while True:
        yield script.act(first)[:6] + rng.uniform(-0.01, 0.01, 6)


def apart(env: gymnasium.Env, first: Any, rng: np.random.Generator) -> Iterator[np.ndarray]:
    """First the fingers close and open, then the thumb, so that they never touch."""
    for step in count():
        action = np.full(6, -1.0)
        action[slice(1, 5) if step < 20 else [0, 5]] = np.sin(np.pi * (step % 20) / 20) * 2 - 1
        yield action * rng.uniform(0.9, 1.0, 6)


def reaching(env: gymnasium.Env, first: Any, rng: np.random.Generator) -> Iterator[np.ndarray]:
    """Command the goal's synergy, without feedback."""
    goal = first["desired_goal"][[JOINT_INDEX[name] for name in SERVOS]]
    while True:
        yield action_from_synergy(np.clip(goal, HPAC.synergy_min, HPAC.synergy_max)) + rng.uniform(
            -0.01, 0.01, 6
        )


def flicked(env: gymnasium.Env, first: Any, rng: np.random.Generator) -> Iterator[np.ndarray]:
    """Keep the hand open; at the tenth step a joint gets a speed beyond the servos'."""
    from tests.envs.engine import flick  # needs PyBullet

    for step in count():
        if step == 10:
            flick(env, "index_dip", 60.0)
        yield np.full(6, -0.5)


def clenched(env: gymnasium.Env, first: Any, rng: np.random.Generator) -> Iterator[np.ndarray]:
    """Make a fist at once, which the wrist carries into any obstacle."""
    while True:
        yield CLOSED


def restless(env: gymnasium.Env, first: Any, rng: np.random.Generator) -> Iterator[np.ndarray]:
    """Jump between extreme actions, each held for five steps."""
    while True:
        action = rng.choice([-1.0, 1.0], 6)
        yield from [action] * 5


# Episodes
# ------------------------------------------------------------------------------------------------------------------


def leaves(observation: Any) -> list[np.ndarray]:
    """The vectors of an observation; pictures are scaled to 0…1."""
    if isinstance(observation, dict):
        return list(chain.from_iterable(leaves(observation[name]) for name in sorted(observation)))
    values = np.asarray(observation)
    return [values.ravel() / (255.0 if values.dtype == np.uint8 else 1.0)]


def numbers(info: dict[str, Any], prefix: str = "") -> dict[str, float]:
    """The numbers of an info by name, without the values drawn by randomization, which would reveal
    a seeded fault.
    """
    found: dict[str, float] = {}
    for name, value in info.items():
        if name == "randomized":
            continue
        if isinstance(value, dict):
            found |= numbers(value, f"{prefix}{name}.")
        elif not isinstance(value, str):
            found |= {
                f"{prefix}{name}.{index}": float(number)
                for index, number in enumerate(np.atleast_1d(value))
            }
    return found


def whole(env: gymnasium.Env, action: np.ndarray) -> np.ndarray:
    """An action of the environment from its first six numbers; a free wrist goes to the pose of the
    requested type.
    """
    if env.action_space.shape == (len(SERVOS),):
        return action
    return np.append(
        action, wrist_choice(GRASP_TYPES[env.unwrapped.episodes.setups[0].grasp].start)
    ).astype(np.float32)


@dataclass
class Episode:
    """One episode: observations and infos from the reset on, and the rewards of the steps between
    them.
    """

    observations: list[list[np.ndarray]]
    rewards: list[float]
    infos: list[dict[str, float]]
    touch: int | None = None
    """Index of the first observation after a touch."""

    def bits(self) -> bytes:
        everything = [
            *chain.from_iterable(self.observations),
            self.rewards,
            *(list(info.values()) for info in self.infos),
        ]
        return b"".join(np.asarray(part, dtype=float).tobytes() for part in everything)

    def means(self, rows: Sequence[int]) -> dict[str, Any]:
        """Count, sum of rewards, size of an observation, means of its runs of entries, and of the
        infos by name in order.

        Of an entry x, x + x²/3 is taken, so that neither its sign is lost nor what swings about
        zero, and how much it changes from step to step, which tells how large its noise is.

        Args:
            rows: of the observations; those beyond the end of the episode are left out.
        """
        rows = [row for row in rows if row < len(self.observations)]
        runs = []
        for steps in zip(*(self.observations[row] for row in rows), strict=True):
            x = np.array(steps)
            seen = (x + x**2 / 3).mean(axis=0) + np.abs(np.diff(x, axis=0)).sum(axis=0) / len(x)
            seen *= 1 + np.cos(np.arange(seen.size)) / 2
            runs += [float(run.mean()) for run in np.array_split(seen, min(16, -(-seen.size // 4)))]
        infos = [self.infos[row] for row in rows]
        names = sorted(set(chain.from_iterable(infos)))
        return {
            "rows": len(rows),
            "return": sum(self.rewards[row - 1] for row in rows if row > 0),
            "size": sum(part.size for part in self.observations[0]),
            "observed": runs,
            "info": [
                float(np.mean([info[name] for info in infos if name in info])) for name in names
            ],
        }


def fix_on_mujoco(env: gymnasium.Env, fixed: bool) -> None:
    """Fix the object of an environment that has been reset where it is, or let it go."""
    for group in env.unwrapped.episodes.simulation.engine._rows:
        moved = group.at.motion[len(JOINTS) :]
        group.parameters.fields["dof_damping"][:, moved] = 1e9 if fixed else 0.0


# The cases
# -----------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Case:
    """Some episodes of an id with options."""

    id: str
    options: dict[str, Any]
    policy: Policy
    seeds: range = range(1)
    about: str = ""
    reset: dict[str, Any] = field(default_factory=dict)
    """Options of every reset."""
    story: Story | None = None

    @property
    def name(self) -> str:
        return "/".join(filter(None, [self.id, *self.options.values(), self.about]))

    @property
    def on_mujoco(self) -> bool:
        return self.options.get("engine") == "mujoco"

    def make(self, **options: Any) -> gymnasium.Env:
        return gymnasium.make(self.id, **{"engine": "pybullet"} | self.options, **options)

    def play(
        self,
        env: gymnasium.Env,
        seed: int,
        limit: int = NEVER,
        watch: bool = False,
        pinned: bool = False,
    ) -> Episode:
        """One episode, or its first steps.

        Args:
            env: the environment.
            seed: seed of the episode.
            limit: largest number of steps.
            watch: end the episode at the first touch.
            pinned: fix the object where it starts.
        """
        observation, info = env.reset(seed=seed, options=self.reset or None)
        watched = nullcontext(bool)
        retold = nullcontext()
        if self.on_mujoco:
            fix_on_mujoco(env, pinned)
            if watch:
                watched = nullcontext(lambda: bool(env.unwrapped.state.touching.any()))
        elif pinned or watch or self.story:
            from tests.envs.engine import pin, told, watching_for_touch

            if pinned:
                pin(env)
            if watch:
                watched = watching_for_touch(env)
            if self.story:
                retold = told(env, self.story)
        episode = Episode([leaves(observation)], [], [numbers(info)])
        over = False
        actions = self.policy(env, observation, np.random.default_rng([seed, 5]))
        with retold, watched as touched:
            while not over and len(episode.rewards) < limit:
                action = np.clip(next(actions), -1, 1)
                observation, reward, terminated, truncated, info = env.step(whole(env, action))
                episode.observations.append(leaves(observation))
                episode.rewards.append(float(reward))
                episode.infos.append(numbers(info))
                over = terminated or truncated
                if episode.touch is None and touched():
                    episode.touch = limit = len(episode.rewards)
        return episode


def heavy() -> SceneSetup:
    """A box of 60 kg in the way of the wrist of `HPAC-PickPlace-v0`."""
    place = np.array([0.16, 0.0, 0.155])
    spec = ObjectSpec("box", (0.026, 0.026, 0.07), mass=60.0, friction=1.0)
    return SceneSetup(
        spec, place, 0.0, np.array([0, 0, 0, 0, 0, 1.2]), target=place + np.array([0.2, 0.0, 0.0])
    )


USUAL = {
    GRASP: closing(),
    GRASP_ANY: closing(),
    GENTLE: closing(),
    PICK_PLACE: closing(12, 74),
    POSTURE: apart,
}
PRIVILEGED = {"obs": "privileged"}
MUJOCO = {"engine": "mujoco"}
PLACED_BY_SCRIPT = {"wrist": "script"}
"""With a free wrist the first step replaces the scene, after which an object cannot be pinned nor a
story be used.
"""
ASIDE = np.array([0.6, -0.4, 0.3])
"""Direction in which the object of a story slips."""
HELD = Story(
    gripped=((0.4, np.inf),),
    carried=(1.2, np.inf),
    supported=((0.0, 1.25),),
    slip={0.4: 0 * ASIDE, 1.2: 0.01 * ASIDE, 3.2: 0.024 * ASIDE},
)
MISSED = replace(HELD, gripped=((0.4, 2.05), (2.1, 2.4), (2.5, np.inf)))
SLIPS = replace(HELD, slip={1.8: 0 * ASIDE, 3.1: 0.027 * ASIDE})
KNOCKED = Story(gripped=((0.4, np.inf),), slip={0.5: 0 * ASIDE, 1.0: 0.1 * ASIDE})
PLACED = Story(
    gripped=((0.9, 2.05), (2.1, 2.4), (2.5, 3.9)),
    carried=(1.8, 3.7),
    supported=((0.0, 1.85),),
    placed=((3.7, np.inf),),
    slip={0.9: 0 * ASIDE, 3.7: 0.01 * ASIDE},
)
DROPPED = Story(gripped=((0.9, 2.6),), carried=(1.8, 2.6), supported=((0.0, 1.85),))
SQUEEZED = Story(
    gripped=((0.4, np.inf),),
    carried=(3.0, np.inf),
    supported=((0.0, 3.05),),
    slip={3.5: 0 * ASIDE, 5.9: 0.01 * ASIDE, 7.0: 0.05 * ASIDE},
)
SHAKEN = replace(SQUEEZED, gripped=((0.4, 4.2),))
ROLLED = Story(gripped=((0.4, np.inf),), slip={0.5: 0 * ASIDE, 2.0: 0.4 * ASIDE})
STORIES = {
    GRASP: {"held": HELD, "missed": MISSED, "slips": SLIPS, "knocked": KNOCKED},
    GRASP_ANY: {"squeezed": SQUEEZED, "shaken": SHAKEN, "rolled": ROLLED},
    PICK_PLACE: {"placed": PLACED, "dropped": DROPPED},
}
CASES = (
    *(Case(name, {}, policy, range(4)) for name, policy in USUAL.items()),
    *(Case(name, {"obs": "image"}, policy) for name, policy in USUAL.items()),
    *(
        Case(name, {"reward": "sparse"}, policy, range(2))
        for name, policy in (USUAL | {POSTURE: reaching}).items()
    ),
    *(
        Case(name, {"randomize": preset} | PRIVILEGED, policy, range(2))
        for name, policy in USUAL.items()
        for preset in PRESETS
    ),
    *(  # a restless hand crushes a gentle task's object at once
        Case(name, PRIVILEGED, restless, range(4), about="restless")
        for name in USUAL
        if name != GENTLE
    ),
    Case(GRASP_ANY, {"objects": "real", "hands": "train"} | PRIVILEGED, closing(), range(3)),
    *(
        Case(GRASP_TYPE, PLACED_BY_SCRIPT | options, own, range(2))
        for options in (
            {},
            {"reward": "sparse"},
            {"objects": "test", "randomize": "full"} | PRIVILEGED,
        )
    ),
    Case(GRASP_TYPE, PLACED_BY_SCRIPT | PRIVILEGED, restless, about="restless"),
    *(
        Case(
            GRASP_TYPE,
            PLACED_BY_SCRIPT | {"types": name} | PRIVILEGED,
            own,
            about="held",
            story=HELD,
        )
        for name in ("rod", "large_cylinder")
    ),
    *(Case(GRASP, {"grasp": name} | PRIVILEGED, closing(), range(2)) for name in GRASPS),
    *(
        Case(GRASP, {"grasp": name, "variant": variant} | PRIVILEGED, closing())
        for name, grasp in GRASPS.items()
        for variant in grasp.held_out
    ),
    Case(PICK_PLACE, PRIVILEGED, clenched, about="jams", reset={"setup": heavy()}),
    Case(POSTURE, PRIVILEGED, flicked, about="flicked"),
    Case(POSTURE, {"reward": "sparse", "randomize": "nominal"}, reaching, range(2)),
    *(
        Case(name, PRIVILEGED, closing(), about=about, story=story)
        for name, stories in STORIES.items()
        for about, story in stories.items()
    ),
    Case(GRASP, {"reward": "sparse"}, closing(), about="held", story=HELD),
    Case(PICK_PLACE, {"reward": "sparse"}, closing(), about="placed", story=PLACED),
    *(
        Case(GRASP, {"grasp": name} | PRIVILEGED, closing(), about="held", story=HELD)
        for name in ("large_sphere", "scissors", "hook")
    ),
    *(
        Case(name, MUJOCO | options, policy, range(2))
        for name, policy in USUAL.items()
        for options in (PRIVILEGED, {"randomize": "full", "reward": "sparse"})
    ),
    Case(GRASP_TYPE, MUJOCO | PLACED_BY_SCRIPT | PRIVILEGED, own, range(2)),
    *(
        Case(GRASP, MUJOCO | {"grasp": name} | PRIVILEGED, closing())
        for name in ("small_sphere", "scissors", "hook")
    ),
)
BY_NAME = {case.name: case for case in CASES}


@cache
def kept() -> dict[str, Any]:
    """Contents of the file, by the names of the cases."""
    return json.loads(FILE.read_text(encoding="utf-8")) if FILE.exists() else {}


def tolerances(case: Case) -> dict[str, tuple[float, float]]:
    """Relative and absolute tolerance of each part of a case's fingerprints."""
    if case.on_mujoco:
        return {"free": LOOSEST}
    return {"free": LOOSE if case.options.get("obs") == "image" else TIGHT, "touched": LOOSE}


def parts(
    case: Case,
    env: gymnasium.Env,
    seed: int,
    touch: int | None,
    touched: bool,
) -> dict[str, Any]:
    """The means of an episode before and after the first touch.

    Args:
        case: the case.
        env: its environment.
        seed: seed of the episode.
        touch: index of the first observation after a touch; None without a touch.
        touched: include the steps after the touch.
    """
    limit = NEVER if touch is None else touch - 1
    free = case.play(env, seed, limit, pinned=case.story is None)
    found = {"free": free.means(range(len(free.observations)))}
    if touched:
        rows = range(touch, touch + TOUCHED_STEPS)
        found["touched"] = case.play(env, seed, rows[-1]).means(rows)
    return found


def differences(case: Case, **fault: Any) -> list[str]:
    """What of a case's fingerprint differs from the file's, optionally with a fault."""
    with case.make(**fault) as env:
        found = [
            parts(case, env, then["seed"], then["touch"], "touched" in then)
            for then in kept()[case.name]
        ]
    return [
        f"seed {then['seed']}, {part}: {name} is {values}, was {then[part][name]}"
        for then, now in zip(kept()[case.name], found, strict=True)
        for part, tolerance in tolerances(case).items()
        for name, values in now.get(part, {}).items()
        if np.shape(values) != np.shape(then[part][name])
        or not np.allclose(values, then[part][name], *tolerance)
    ]


def digest(env: gymnasium.Env, case: Case, steps: int = 30) -> str:
    """A hash of the first steps of a case's first episode, to the bit; the hand is closed by
    then.
    """
    return hashlib.sha256(case.play(env, case.seeds[0], steps).bits()).hexdigest()


def taken(case: Case) -> list[dict[str, Any]]:
    """New entry of the file for a case."""
    from tests.envs.engine import simple

    rows = []
    with case.make() as env:
        for seed in case.seeds:
            env.reset(seed=seed, options=case.reset or None)
            touchable = not case.on_mujoco and simple(env)
            touch = None if case.story else case.play(env, seed, watch=True, pinned=True).touch
            touched = touch is not None and touchable
            rows.append({"seed": seed, "touch": touch} | parts(case, env, seed, touch, touched))
    return rows


# Outcomes
# ------------------------------------------------------------------------------------------------------------------


FLIPS = 0.05
ALARM = 1e-6
"""Share of whole episodes that rounding may end otherwise, and how often more of them may by
chance.

Of 248 episodes, six took another number of steps with glibc's other sine and cosine, and none had
another outcome; with a disturbance of 1e-9 up to eight and one. """


def most_flips(episodes: int) -> int:
    """Largest number of `episodes` that rounding changes, except with probability `ALARM`."""
    return int(binom.isf(ALARM, episodes, FLIPS))


BATCHES = {
    "HPAC-Grasp-v0": (Case(GRASP, {}, closing(0), range(40)),),
    "HPAC-GraspAny-v1": (Case(GRASP_ANY, {}, closing(0), range(8)),),
    "HPAC-GraspType-v0": (Case(GRASP_TYPE, {}, own, range(6)),),
    "HPAC-Grasp-v0 on MuJoCo": (Case(GRASP, MUJOCO, closing(0), range(20)),),
    "HPAC-GraspAny-v1 on MuJoCo": (Case(GRASP_ANY, MUJOCO, closing(0), range(8)),),
    "HPAC-PickPlace-v0 on MuJoCo": (Case(PICK_PLACE, MUJOCO, closing(12, 74), range(10)),),
    "HPAC-GraspType-v0 on MuJoCo": (Case(GRASP_TYPE, {"engine": "mujoco"}, own, range(10)),),
    "HPAC-Gentle-v0": (Case(GENTLE, {}, closing(0), range(10)),),
    "HPAC-PickPlace-v0": (Case(PICK_PLACE, {}, closing(12, 74), range(20)),),
    "HPAC-Posture-v1": (Case(POSTURE, {"randomize": "nominal"}, reaching, range(20)),),
    "named grasps": tuple(Case(GRASP, {"grasp": name}, closing(0)) for name in GRASPS),
}
"""Whole episodes whose ends are counted."""


def ends(batch: Sequence[Case], **fault: Any) -> list[list[int]]:
    """Steps and success of every episode."""
    rows = []
    for case in batch:
        with case.make(**fault) as env:
            for seed in case.seeds:
                episode = case.play(env, seed)
                rows.append([len(episode.rewards), int(episode.infos[-1]["is_success.0"])])
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--write", action="store_true", help=f"write {FILE.name} instead of printing hashes"
    )
    parser.add_argument("names", nargs="*", default=list(BY_NAME), help="of cases; all by default")
    arguments = parser.parse_args()
    cases = [BY_NAME[name] for name in arguments.names]
    if not arguments.write:
        found = {}
        for case in cases:
            with case.make() as env:
                found[case.name] = digest(env, case)
        print(json.dumps(found))
        return
    ids = {case.id for case in cases}
    rows = {case.name: taken(case) for case in cases}
    # Numbers with eight digits.
    rows = json.loads(json.dumps(rows), parse_float=lambda text: float(f"{float(text):.8g}"))
    rows = kept() | rows
    rows |= {f"ends/{name}": ends(batch) for name, batch in BATCHES.items() if batch[0].id in ids}
    known = {*BY_NAME, *(f"ends/{name}" for name in BATCHES)} & set(rows)
    lines = (
        f"{json.dumps(name)}:{json.dumps(rows[name], separators=(',', ':'))}"
        for name in sorted(known)
    )
    FILE.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
