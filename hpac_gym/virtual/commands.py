"""``hpac virtual``: a hand for those who have none, behind a port like that of a real one.
``hpac play``: six sliders move a simulated hand in the browser; without port, firmware or policy.

The real firmware runs in a process of its own behind a pseudo-terminal. Its pulses drive a simulated
body with an object; an arm does what `hpac deploy --arm` tells it; a camera sends poses."""

import argparse
import sys
import time
from contextlib import ExitStack, closing, suppress
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from hpac_gym.body.geometry import HPAC_GEOMETRY
from hpac_gym.body.hands import hand_set
from hpac_gym.bridge import HostBoard, pulses_from_servo
from hpac_gym.command import add_json, ended_as_by_ctrl_c, say, seconds, whole_number
from hpac_gym.deploy.commands import object_of
from hpac_gym.envs.randomization import PRESETS
from hpac_gym.errors import ParameterError
from hpac_gym.evaluation.environment import make_env
from hpac_gym.model import DIGITS, HPAC, SERVOS, synergy_from_servo
from hpac_gym.physics.engine import SceneSetup
from hpac_gym.registration import GRASP, GRASP_ANY, PICK_PLACE
from hpac_gym.virtual.body import Body
from hpac_gym.virtual.hand import POSE_HZ, Tracker, Virtual
from hpac_gym.virtual.wire import Faults, Relay

ABOUT = "A virtual hand: the real firmware, whose pulses drive a simulated body."
ABOUT_PLAY = (
    "A simulated hand. Each slider is a servo; the other joints follow by their tendons. "
    "Close it on the object, and lift."
)
OUT_OF_REACH = np.array([0.35, 0.0, 0.12])
"""Place of the object while the hand is swept, in the hand's frame [m]."""
POLICIES = {GRASP: "grasp", GRASP_ANY: "grasp-any", PICK_PLACE: "pick-place"}
"""Environments whose scenes there are, and the shipped policy of each."""
CAN = "cylinder:0.02,0.05"
"""The object where nothing else is asked for."""
IN_REACH = (0.0285, 0.0, 0.12)
"""Place of the palm's side of the object in the hand's frame, without a seed [m]; chosen: the thumb
does not touch a can there on its way, and the policy, and five digits that close together, hold it.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `hpac virtual`."""
    add_scene(parser)
    parser.add_argument(
        "--reveal", action="store_true", help="tell at once, not at the end, what was drawn"
    )
    parser.add_argument(
        "--pose-port", type=int, default=0, help="UDP port that poses go to; 0: a free one"
    )
    parser.add_argument(
        "--arm-port", type=int, default=0, help="UDP port of the arm; 0: a free one"
    )
    for fault in fields(Faults):
        parser.add_argument(
            f"--{fault.name}",
            type=float,
            default=fault.default,
            metavar="X",
            help=fault.metadata["meaning"],
        )
    parser.add_argument(
        "--heat", type=whole_number(0), default=0, metavar="PERCENT", help="heat of its servos"
    )
    parser.add_argument(
        "--blind",
        type=seconds,
        default=np.inf,
        metavar="S",
        help="the camera loses the object so long after an episode has begun, until the pulses are off [s]",
    )
    parser.add_argument(
        "--angles",
        type=Path,
        metavar="CSV",
        help="it stands before a camera, its object out of reach: its joint angles, for `hpac sweep`",
    )
    parser.add_argument(
        "--reset-on-open", action="store_true", help="the board restarts when its port is opened"
    )
    parser.add_argument("--view", action="store_true", help="show it in the browser")
    parser.add_argument("--no-browser", action="store_true", help="print the page's address only")
    add_json(parser)
    parser.set_defaults(run=run)


def add_scene(parser: argparse.ArgumentParser) -> None:
    """The arguments of a scene."""
    parser.add_argument("--env", default=GRASP, choices=POLICIES, metavar="ID", help="scene")
    parser.add_argument("--grasp", metavar="NAME", help="scene of one of the sixteen named grasps")
    parser.add_argument(
        "--object",
        metavar="SHAPE:M,M",
        help=f"the object ({CAN}; with --seed one that is drawn)",
    )
    parser.add_argument(
        "--seed", type=whole_number(0), help="draw a hand that is not the nominal one, and a scene"
    )


def run(options: argparse.Namespace) -> int:
    """Be a hand until Ctrl-C."""
    if options.heat > 100:
        raise ParameterError(f"--heat {options.heat} % must be at most 100 %")
    if options.angles and (options.env != GRASP or options.grasp):
        raise ParameterError("--angles has no scene: it goes without --env and --grasp")
    faults = Faults(**{fault.name: getattr(options, fault.name) for fault in fields(Faults)})
    with ExitStack() as stack:
        stack.enter_context(ended_as_by_ctrl_c())
        env = stack.enter_context(scene_env(options))
        setup = scene(env.unwrapped, options.env, options.seed)
        if options.angles:
            setup = replace(setup, position=OUT_OF_REACH)
        body = Body(env.unwrapped, options.seed or 0, setup)
        words = ("--boot-text",) * options.reset_on_open + ("--heat", str(options.heat))
        board = stack.enter_context(HostBoard(words))
        relay = None
        if faults != Faults() or options.reset_on_open:
            relay = Relay(board, faults, options.seed or 0, options.reset_on_open)
            stack.enter_context(closing(relay))
        hand = Virtual(
            body, board, relay, options.arm_port, options.pose_port, options.blind, options.json
        )
        stack.enter_context(closing(hand))
        if options.angles:
            hand.tracker = stack.enter_context(Tracker(options.angles))
        if options.view:
            from hpac_gym.view.page import HandPage

            page = HandPage(setup, ABOUT, hand.estop, browser=not options.no_browser)
            hand.page = stack.enter_context(closing(page))
        try:
            ports = {"pose_port": hand.pose_port, "arm_port": hand.arm_port}
            say(options.json, _greeting(options, hand, setup), port=hand.port, **ports)
            while True:
                hand.turn()
        except KeyboardInterrupt:
            print(file=sys.stderr)
        if not options.reveal:
            drawn = revealed(options.seed, setup)
            say(options.json, drawn, drawn=drawn.splitlines())
    return 0


def _greeting(options: argparse.Namespace, hand: Virtual, setup: SceneSetup) -> str:
    """The hand's port, and what to type in a second terminal."""
    lines = [f"virtual hand at {hand.port}; Ctrl-C ends it. In a second terminal:", ""]
    if options.angles:
        return "\n".join([*lines, f"hpac sweep --port {hand.port} --angles {options.angles}", ""])
    item = setup.object
    half = {"cylinder": item.half_extents[1:], "sphere": item.half_extents[:1]}
    sizes = ",".join(f"{size:.4g}" for size in half.get(item.shape, item.half_extents))
    policy = f"scripted --grasp {options.grasp}" if options.grasp else POLICIES[options.env]
    words = (
        f"hpac deploy {policy} --port {hand.port} --object {item.shape}:{sizes}"
        f" --pose udp:{hand.pose_port} --arm udp:127.0.0.1:{hand.arm_port}"
    )
    lines += [words, ""]
    if options.reveal:
        lines.append(revealed(options.seed, setup))
    return "\n".join(lines)


def add_play(parser: argparse.ArgumentParser) -> None:
    """The arguments of `hpac play`."""
    add_scene(parser)
    parser.add_argument("--no-browser", action="store_true", help="print the page's address only")
    add_json(parser)
    parser.set_defaults(run=play)


def play(options: argparse.Namespace) -> int:
    """Move the hand as the sliders say, until Ctrl-C."""
    from hpac_gym.view.page import HandPage, Shown

    with ExitStack() as stack:
        env = stack.enter_context(scene_env(options)).unwrapped
        body = Body(env, options.seed or 0, scene(env, options.env, options.seed))
        page = HandPage(body.setup, ABOUT_PLAY, browser=not options.no_browser)
        stack.enter_context(closing(page))
        if options.json:
            say(True, "", page=page.address)
        stack.enter_context(suppress(KeyboardInterrupt))
        page.lift.visible = True
        began = time.monotonic()
        while True:
            now = time.monotonic() - began
            servo = page.wanted()
            body.tell({"time": now, "offset": [0.0, 0.0, page.lifted()]})
            body.follow(round(1e6 * now), pulses_from_servo(servo))
            state = body.state()
            body.tidy_up(state)
            if page.object_back.is_set():
                page.object_back.clear()
                body.put_back()
            if page.due():
                page.show(Shown.of_state(state, servo))
            time.sleep(1 / POSE_HZ)
    return 0


# The scene ----------------------------------------------------------------


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
