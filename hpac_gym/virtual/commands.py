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

import numpy as np

from hpac_gym.bridge import HostBoard, pulses_from_servo
from hpac_gym.command import add_json, ended_as_by_ctrl_c, say, seconds, whole_number
from hpac_gym.errors import ParameterError
from hpac_gym.physics.engine import SceneSetup
from hpac_gym.registration import GRASP
from hpac_gym.virtual.body import Body
from hpac_gym.virtual.hand import POSE_HZ, Tracker, Virtual
from hpac_gym.virtual.scene import POLICIES, add_scene, revealed, scene, scene_env
from hpac_gym.virtual.wire import Faults, Relay

ABOUT = "A virtual hand: the real firmware, whose pulses drive a simulated body."
ABOUT_PLAY = (
    "A simulated hand. Each slider is a servo; the other joints follow by their tendons. "
    "Close it on the object, and lift."
)
OUT_OF_REACH = np.array([0.35, 0.0, 0.12])
"""Place of the object while the hand is swept, in the hand's frame [m]."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `hpac virtual`."""
    add_scene(parser)
    parser.add_argument(
        "--reveal", action="store_true", help="tell at once, not at the end, what was drawn"
    )
    parser.add_argument("--pose-port", type=int, default=0, help="UDP port that poses go to (free)")
    parser.add_argument("--arm-port", type=int, default=0, help="UDP port of the arm (a free one)")
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
        ports = (options.arm_port, options.pose_port)
        hand = Virtual(body, board, relay, *ports, options.blind, options.json)
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
