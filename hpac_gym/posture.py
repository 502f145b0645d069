"""``hpac posture``: show or draw the paper's gestures and grasp shapes, or send one to a hand."""

import argparse
import json
from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np

from hpac_gym.errors import ParameterError
from hpac_gym.figures import new_figure, require, save
from hpac_gym.model import (
    HPAC,
    JOINTS,
    POSTURES,
    SERVOS,
    Hand,
    Posture,
    ServoCommand,
    load_hand,
    move_duration,
    posture,
    reach,
)
from hpac_gym.physics.engine import HAND_POSITION, Viewpoint
from hpac_gym.physics.stand import HAND, UPRIGHT, WORLD, HandOnStand
from hpac_gym.progress import progress

SHEET_COLUMNS = 6
FINGERS = tuple(name for name in SERVOS if not name.startswith("thumb"))
SETTLE = 0.5  # s after the move
LOOK_AT = HAND_POSITION + np.array([0.03, 0.0, 0.10])  # m, the middle of the hand
SHEET_CAMERA = Viewpoint(width=480, height=480, distance=0.30, yaw_deg=55.0, pitch_deg=-12.0)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `hpac posture`."""
    parser.add_argument(
        "name",
        metavar="NAME|list|all",
        help="a posture, the list of them, or all on a contact sheet",
    )
    parser.add_argument(
        "--model", type=Path, metavar="FILE", help="hand file of the commands (default: nominal)"
    )
    parser.add_argument(
        "--out", type=Path, metavar="PNG", help="draw the posture here (all: runs/postures.png)"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument(
        "--port", metavar="PORT", help="hold the posture on this port's hand until Ctrl-C"
    )
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Run the command: list, show, draw or send postures."""
    hand = load_hand(arguments.model)
    everything = arguments.name in ("list", "all")
    if everything and arguments.port:
        raise ParameterError(f"--port takes one posture, not '{arguments.name}'")
    shown = list(POSTURES.values()) if everything else [posture(arguments.name)]
    sheet = arguments.out or (Path("runs/postures.png") if arguments.name == "all" else None)
    if sheet:
        require(sheet)
    if arguments.json:
        print(json.dumps({item.name: description(item, hand) for item in shown}))
    elif everything:
        print("\n".join(summary(item, hand) for item in shown))
    else:
        print(table(shown[0], hand))
    if sheet:
        draw(shown, sheet, hand)
        if not arguments.json:
            print(f"drawn to {sheet}")
    if arguments.port:
        from hpac_gym.bridge.commands import send_and_hold

        send_and_hold(arguments.port, commands_to(shown[0], hand), hand)
    return 0


def commands_to(item: Posture, hand: Hand = HPAC) -> list[ServoCommand]:
    """Commands that move an open hand to a posture at the rate limit, one after the other.

    In a gesture the thumb turns in front of the palm, the fingers close, and the thumb closes over
    them, as a person makes a fist."""
    servo = reach(item.target_joint_pos, hand).servo
    duration = max(move_duration(hand.servo_min, servo, hand), 0.1)
    rest = np.clip(0.0, hand.servo_min, hand.servo_max)
    still_open = [("thumb_mp", *FINGERS), ("thumb_mp",), ()] if item.kind == "gesture" else [()]
    return [
        ServoCommand(np.where(np.isin(SERVOS, names), rest, servo), duration)
        for names in still_open
    ]


def description(item: Posture, hand: Hand = HPAC) -> dict[str, object]:
    """Description of a posture as data, by joint and servo name [rad]."""
    taken = reach(item.target_joint_pos, hand)
    return {
        "panel": item.panel,
        "kind": item.kind,
        "about": item.about,
        "aliases": list(item.aliases),
        "target_rad": dict(zip(JOINTS, item.target_joint_pos.tolist(), strict=True)),
        "reachable_rad": dict(zip(JOINTS, taken.joint_pos.tolist(), strict=True)),
        "servo_rad": dict(zip(SERVOS, taken.servo.tolist(), strict=True)),
        "distance_rad": taken.distance,
    }


def summary(item: Posture, hand: Hand = HPAC) -> str:
    """Description of a posture in one line."""
    names = "/".join((item.name, *item.aliases))
    distance = reach(item.target_joint_pos, hand).distance
    return f"{item.panel:>2}  {names:<20} {item.kind:<10} {distance:5.3f} rad off  {item.about}"


def table(item: Posture, hand: Hand = HPAC) -> str:
    """Table of a posture's joint and servo angles."""
    taken = reach(item.target_joint_pos, hand)
    lines = [
        f"{item.name}: {item.about} (panel {item.panel})",
        f"{'joint':<12} target [rad]  reachable [rad]",
    ]
    for name, target, joint in zip(
        JOINTS, item.target_joint_pos, taken.joint_pos.round(9) + 0.0, strict=True
    ):
        lines.append(f"{name:<12} {target:12.3f} {joint:16.3f}")
    lines.append(f"distance from the nearest reachable posture: {taken.distance:.3f} rad")
    lines.append(f"{'servo':<12} angle [rad]")
    lines += [f"{name:<12} {angle:11.3f}" for name, angle in zip(SERVOS, taken.servo, strict=True)]
    return "\n".join(lines)


def draw(items: Sequence[Posture], path: Path, hand: Hand = HPAC) -> None:
    """Draw a contact sheet of postures, each reached by the simulated hand from open."""
    columns = min(SHEET_COLUMNS, len(items))
    rows = -(-len(items) // columns)
    figure = new_figure(2.2 * columns, 2.4 * rows)
    axes = np.ravel(figure.subplots(rows, columns, squeeze=False))
    for axis in axes:
        axis.set_axis_off()
    for axis, item in zip(axes, progress(items, "contact sheet"), strict=False):
        axis.imshow(picture(item, hand))
        axis.set_title(f"{item.panel} {item.name.replace('_', ' ')}", fontsize=8)
    save(
        figure,
        path,
        f"{hand.name}, simulated in MuJoCo, from the open hand; in gestures the fingers close, then the thumb over them",
        picture=True,
    )


def picture(item: Posture, hand: Hand = HPAC) -> np.ndarray:
    """RGB of the simulated hand in a posture, shape (height, width, 3)."""
    with closing(take(item, hand, visuals=True)) as sim:
        return sim.simulation.engine.picture(0, SHEET_CAMERA, LOOK_AT)


def take(item: Posture, hand: Hand = HPAC, visuals: bool = False) -> HandOnStand:
    """Simulate a hand that moves from open to a posture; the caller closes it."""
    settings = replace(HAND, servo_zero=hand.calibration.servo_zero)
    sim = HandOnStand(hand, settings, WORLD, UPRIGHT, visuals)
    sim.reset(np.zeros(len(SERVOS)))
    for command in commands_to(item, hand):
        sim.command(command.servo, command.duration)
        sim.step(command.duration)
    sim.step(SETTLE)
    return sim
