"""Finds the stable poses of the objects of `hpac_gym.body.object_sets`: ``python -m
tools.resting_poses``.

The poses that `hpac_gym.physics.mujoco.resting` finds are kept if the object stays at rest in them in
both engines of `hpac_gym`. Writes
``hpac_gym/body/data/resting_poses.toml``, whose last digits depend on the processor, so no test
compares it; tests check that the poses are stable in both engines."""

import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np

from hpac_gym.body.object_models import ObjectModel
from hpac_gym.body.object_sets import RestingObject, RestingPose, resting, split_models
from hpac_gym.body.objects import ObjectSpec, Support
from hpac_gym.command import command_parser, run
from hpac_gym.output import write_text
from hpac_gym.physics.engine import HAND_POSITION, Engine, SceneSetup, matrix_from_quaternion
from hpac_gym.physics.mujoco.resting import Found, poses_of
from hpac_gym.physics.simulation import ENGINES, make_engine
from hpac_gym.physics.supports import POST
from hpac_gym.progress import progress

FILE = Path(__file__).parents[1] / "hpac_gym" / "body" / "data" / "resting_poses.toml"
HEADER = """\
# Written by python -m tools.resting_poses: the ways in which objects stay by themselves, found by letting them come to rest.
# poses: quaternion xyzw of the object in the world, then the share of random drops that ended like this (0: set down so alone).
"""
_PLACE = np.array([-0.30, 0.0, 0.20])
"""Position of an object in the world, behind the wrist [m]."""


def setup_of(thing: RestingObject, pose: RestingPose) -> SceneSetup:
    """Setup with the object at rest behind the wrist, away from the hand, on a board or a post."""
    rotation = matrix_from_quaternion(pose.quaternion)
    # Half-side of a cube whose centre is as high as the object's origin.
    side = pose.height / np.abs(rotation[2]).sum()
    spec = ObjectSpec("box", (side, side, side), thing.model.mass, thing.friction, thing.model)
    place = SceneSetup(None).hand_rotation.T @ (_PLACE - HAND_POSITION)
    support = POST if thing.stand else Support((0.15, 0.15))
    return SceneSetup(spec, place, object_quaternion=pose.quaternion, support=support)


def restless(physics: Engine, entries: list[tuple[RestingObject, RestingPose]]) -> list[int]:
    """Indices of the objects that leave their pose, or move by more than 5 mm (round ones may
    roll), within 2 s.

    Args:
        physics: an engine with at least len(entries) worlds.
        entries: objects and poses.
    """
    worlds = physics.num_worlds
    k = round(2.0 / physics.dt)
    setups = [setup_of(*entry) for entry in entries]
    physics.reset(range(worlds), [*setups, *setups[:1] * (worlds - len(setups))])
    before = physics.state()
    still = np.zeros((worlds, k, 6))
    physics.advance(still, still, np.zeros((worlds, k, 3)))
    after = physics.state()
    to_world = SceneSetup(None).hand_rotation
    moved = []
    for index, (thing, _) in enumerate(entries):
        way = np.linalg.norm(after.object_pos[index] - before.object_pos[index])
        first, last = (
            Found.of(thing.model, to_world @ state.object_rotation[index])
            for state in (before, after)
        )
        if way > 0.005 or not last.same_as(first):
            moved.append(index)
    return moved


def without_restless(
    models: list[tuple[ObjectModel, float]], entries: dict[str, dict[str, Any]]
) -> None:
    """Remove poses that are not stable in both engines.

    Raises:
        RuntimeError: An object has no stable pose left.
    """
    jobs = [
        (
            model.name,
            numbers,
            resting(model, friction, {"stand": entries[model.name]["stand"], "poses": [numbers]}),
        )
        for model, friction in models
        for numbers in entries[model.name]["poses"]
    ]
    bad = set()
    engines = [make_engine(name, 8) for name in ENGINES]
    for start in progress(range(0, len(jobs), 8), "Both engines"):
        things = [(thing, thing.poses[0]) for *_, thing in jobs[start : start + 8]]
        bad |= {start + index for physics in engines for index in restless(physics, things)}
    for physics in engines:
        physics.close()
    for name, numbers, _ in (jobs[index] for index in bad):
        entries[name]["poses"].remove(numbers)
        print(f"{name}: an engine does not keep it still in {numbers}")
        if not entries[name]["poses"]:
            raise RuntimeError(f"{name} has no other pose")


def main(argv: list[str] | None = None) -> None:
    """Find the poses and write the file."""
    parser = command_parser("tools.resting_poses", __doc__)
    parser.add_argument(
        "names", nargs="*", help="names or name prefixes of the objects to update (default: all)"
    )
    names = tuple(parser.parse_args(argv).names) or ("",)
    objects = list(
        {
            name: entry for models in split_models().values() for name, entry in models.items()
        }.values()
    )
    entries = tomllib.loads(FILE.read_text(encoding="utf-8")) if FILE.exists() else {}
    wanted = [entry for entry in objects if entry[0].name.startswith(names)]
    if not wanted:
        parser.error(f"no object is named {', '.join(names)}...")
    entries |= {
        model.name: poses_of(model, friction)
        for model, friction in progress(wanted, "Resting poses")
    }
    without_restless(wanted, entries)
    text = HEADER
    for name in (model.name for model, _ in objects if model.name in entries):
        stand = str(entries[name]["stand"]).lower()
        poses = "".join(f"    {numbers},\n" for numbers in entries[name]["poses"])
        text += f"\n[{name}]\nstand = {stand}\nposes = [\n{poses}]\n"
    write_text(FILE, text)
    print(f"{FILE}: poses of {len(wanted)} objects of {len(objects)}")


if __name__ == "__main__":
    sys.exit(run(main))
