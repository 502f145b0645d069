"""The scene of a virtual hand: environment, object, and the hand that a seed draws."""

import argparse
from dataclasses import replace
from typing import Any

import numpy as np

from hpac_gym.body.geometry import HPAC_GEOMETRY
from hpac_gym.body.hands import hand_set
from hpac_gym.command import whole_number
from hpac_gym.deploy.commands import object_of
from hpac_gym.envs.randomization import PRESETS
from hpac_gym.errors import ParameterError
from hpac_gym.evaluation.environment import make_env
from hpac_gym.model import DIGITS, HPAC, SERVOS, synergy_from_servo
from hpac_gym.physics.engine import SceneSetup
from hpac_gym.registration import GRASP, GRASP_ANY, PICK_PLACE

POLICIES = {GRASP: "grasp", GRASP_ANY: "grasp-any", PICK_PLACE: "pick-place"}
"""Environments whose scenes there are, and the shipped policy of each."""
CAN = "cylinder:0.02,0.05"
"""The object where nothing else is asked for."""
IN_REACH = (0.0285, 0.0, 0.12)
"""Place of the palm's side of the object in the hand's frame, without a seed [m]; chosen: the thumb
does not touch a can there on its way, and the policy, and five digits that close together, hold it.
"""


def add_scene(parser: argparse.ArgumentParser) -> None:
    """The arguments of a scene."""
    parser.add_argument(
        "--env", default=GRASP, choices=POLICIES, metavar="ID", help=f"scene ({GRASP})"
    )
    parser.add_argument("--grasp", metavar="NAME", help="scene of one of the sixteen named grasps")
    parser.add_argument(
        "--object",
        metavar="SHAPE:M,M",
        help=f"the object ({CAN}; with --seed one that is drawn)",
    )
    parser.add_argument(
        "--seed", type=whole_number(0), help="draw a hand that is not the nominal one, and a scene"
    )


def scene_env(options: argparse.Namespace) -> Any:
    """The environment of a scene."""
    more: dict[str, Any] = {}
    if options.env != GRASP and (options.grasp or options.object):
        raise ParameterError(
            f"--grasp and --object are of {GRASP}; {options.env} has its own object"
        )
    if options.grasp:
        more["grasp"] = options.grasp
    if options.object or (options.env == GRASP and not options.grasp and options.seed is None):
        more["object"] = object_of(options.object or CAN)
    return make_env(options.env, engine="mujoco", body="light", **more)


def scene(env: Any, env_id: str, seed: int | None) -> SceneSetup:
    """The scene of a seed, with the hand open and the thumb turned as the task has it; a seed hides a
    hand from the set ``train`` in it, whose friction is drawn as by the randomization ``hand``.
    """
    env.reset(seed=seed or 0)
    setup = env.episodes.setups[0]
    if env_id != GRASP:  # an `Observer` has drawn the same orientation and target
        drawn = env.task.setup(np.random.default_rng(0), HPAC)
        setup = replace(drawn, hand_settings=setup.hand_settings)
    if seed is not None:
        rng = np.random.default_rng([seed, 7])
        variants = hand_set("train")
        variant = variants[rng.integers(len(variants))]
        ranges = PRESETS["hand"]
        settings = replace(
            variant.over(setup.hand_settings),
            joint_friction=rng.uniform(*ranges.joint_friction),
            contact_friction=setup.hand_settings.contact_friction
            * rng.uniform(*ranges.skin_friction),
        )
        setup = replace(setup, hand=variant.hand, geometry=variant.geometry, hand_settings=settings)
    elif env_id == GRASP and setup.object.model is None:
        x, y, z = IN_REACH
        setup = replace(setup, position=np.array([x + setup.object.half_extents[0], y, z]))
    hand = setup.hand
    synergy = synergy_from_servo(np.clip(0.0, hand.servo_min, hand.servo_max), hand)
    synergy[-1] = np.clip(setup.synergy[-1], hand.synergy_min[-1], hand.synergy_max[-1])
    return replace(setup, synergy=synergy)


def revealed(seed: int | None, setup: SceneSetup) -> str:
    """What was drawn, in words."""
    item = setup.object
    lines = [
        f"object: {item.shape}, half sizes {[round(1e3 * x, 1) for x in item.half_extents]} mm, "
        f"{1e3 * item.mass:.0f} g, friction {item.friction:.2f}"
    ]
    if seed is None:
        return "\n".join([*lines, "hand: the nominal one; --seed draws another"])
    given = setup.hand_settings
    size = (
        setup.geometry.digits[2].phalanges[0].length / HPAC_GEOMETRY.digits[2].phalanges[0].length
    )
    lines += [
        f"hand {setup.hand.name}, {size:.0%} of the nominal size, joint friction {1e3 * given.joint_friction:.1f} mN·m, "
        f"skin friction {given.contact_friction:.2f}",
        _row("slack [mm]", DIGITS, np.array(given.slack) * 1e3),
        _row("strength", DIGITS, given.strength),
        _row("servo zero [deg]", SERVOS, np.degrees(given.servo_zero)),
    ]
    return "\n".join(lines)


def _row(what: str, names: Any, values: Any) -> str:
    return f"{what}: " + ", ".join(
        f"{name} {value:.2g}" for name, value in zip(names, values, strict=True)
    )
