"""Twenty shapes that no training saw: ``python -m experiments.shapes``.

Each is a few boxes, cylinders and spheres that were put together by hand for this, in the size of
things that people hold, and comes in the stable poses that drops find. Script and policies grasp
each in the same episodes."""

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from experiments.results import add_workers_and_out, compared, write_results
from hpac_gym.body.own_objects import own_object
from hpac_gym.command import command_parser, run, whole_number
from hpac_gym.evaluation.evaluate import run_block
from hpac_gym.evaluation.seeds import HELD_OUT_SEED
from hpac_gym.evaluation.workers import shared
from hpac_gym.output import markdown
from hpac_gym.policies.loading import needed_options
from hpac_gym.registration import GRASP_ANY

SCRIPTED = "scripted"

BOX = '<box size="{} {} {}"/>'
ROD = '<cylinder radius="{}" length="{}"/>'
BALL = '<sphere radius="{}"/>'
LYING = (0.0, 1.5708, 0.0)

Solid = tuple[str, tuple[float, ...], tuple[float, float, float], tuple[float, float, float]]


def solid(
    form: str,
    size: Sequence[float],
    place: Sequence[float] = (0, 0, 0),
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Solid:
    """One part of a shape: its size and place in mm, its turn as roll, pitch and yaw [rad]."""
    x, y, z = place
    metres = tuple(1e-3 * side for side in size)
    return form, metres, (1e-3 * x, 1e-3 * y, 1e-3 * z), turn


SHAPES: Mapping[str, tuple[float, tuple[Solid, ...]]] = {
    "hammer": (0.18, (solid(ROD, (11, 150), turn=LYING), solid(BOX, (26, 66, 26), (85, 0, 0)))),
    "T handle": (0.09, (solid(ROD, (10, 90)), solid(ROD, (10, 70), (0, 0, 50), LYING))),
    "angle bracket": (0.12, (solid(BOX, (64, 40, 12)), solid(BOX, (12, 40, 60), (-26, 0, 36)))),
    "double ball": (
        0.10,
        (
            solid(ROD, (10, 70), turn=LYING),
            solid(BALL, (21,), (40, 0, 0)),
            solid(BALL, (21,), (-40, 0, 0)),
        ),
    ),
    "mushroom": (0.06, (solid(ROD, (13, 46)), solid(ROD, (30, 16), (0, 0, 30)))),
    "spool": (
        0.07,
        (
            solid(ROD, (14, 50)),
            solid(ROD, (27, 8), (0, 0, 24)),
            solid(ROD, (27, 8), (0, 0, -24)),
        ),
    ),
    "cross": (0.11, (solid(BOX, (84, 24, 24)), solid(BOX, (24, 84, 24)))),
    "stair": (
        0.13,
        (
            solid(BOX, (72, 40, 20)),
            solid(BOX, (48, 40, 20), (12, 0, 20)),
            solid(BOX, (24, 40, 20), (24, 0, 40)),
        ),
    ),
    "channel": (
        0.10,
        (
            solid(BOX, (90, 44, 10)),
            solid(BOX, (90, 10, 36), (0, 22, 18)),
            solid(BOX, (90, 10, 36), (0, -22, 18)),
        ),
    ),
    "cup with handle": (
        0.16,
        (
            solid(ROD, (33, 84)),
            solid(BOX, (24, 12, 12), (42, 0, 24)),
            solid(BOX, (24, 12, 12), (42, 0, -24)),
            solid(BOX, (12, 12, 60), (54, 0, 0)),
        ),
    ),
    "tower": (
        0.20,
        (
            solid(BOX, (60, 60, 30)),
            solid(BOX, (42, 42, 40), (0, 0, 35)),
            solid(BOX, (26, 26, 40), (0, 0, 75)),
        ),
    ),
    "cone of discs": (
        0.09,
        (solid(ROD, (31, 20)), solid(ROD, (24, 20), (0, 0, 20)), solid(ROD, (16, 22), (0, 0, 41))),
    ),
    "bean": (
        0.05,
        (solid(BALL, (19,), (-20, 0, 0)), solid(BALL, (22,)), solid(BALL, (18,), (18, 10, 0))),
    ),
    "round bar": (
        0.10,
        (
            solid(ROD, (17, 64), turn=LYING),
            solid(BALL, (17,), (32, 0, 0)),
            solid(BALL, (17,), (-32, 0, 0)),
        ),
    ),
    "pan": (0.22, (solid(ROD, (36, 28)), solid(BOX, (100, 20, 14), (80, 0, 6)))),
    "knobbed lid": (0.15, (solid(BOX, (76, 56, 22)), solid(BALL, (16,), (0, 0, 22)))),
    "ring": (
        0.08,
        tuple(
            solid(BOX, (14, 24, 20), place, (0.0, 0.0, turn))
            for place, turn in (
                ((28, 0, 0), 0.0),
                ((20, 20, 0), 0.785),
                ((0, 28, 0), 1.571),
                ((-20, 20, 0), 2.356),
                ((-28, 0, 0), 3.142),
                ((-20, -20, 0), 3.927),
                ((0, -28, 0), 4.712),
                ((20, -20, 0), 5.498),
            )
        ),
    ),
    "big key": (0.09, (solid(BOX, (80, 18, 18)), solid(ROD, (24, 18), (-52, 0, 0)))),
    "flask": (
        0.24,
        (solid(ROD, (27, 90)), solid(ROD, (12, 40), (0, 0, 65)), solid(ROD, (15, 12), (0, 0, 86))),
    ),
    "star prism": (
        0.12,
        tuple(solid(BOX, (50, 28, 44), turn=(0.0, 0.0, turn)) for turn in (0.0, 1.047, 2.094)),
    ),
}
"""Mass [kg] and parts of each shape, by name. Drawn once, before any policy was judged on them."""


def urdf_of(name: str) -> str:
    """A shape as URDF."""
    mass, parts = SHAPES[name]
    shapes = "".join(
        f'<collision><origin xyz="{" ".join(map(str, place))}" rpy="{" ".join(map(str, turn))}"/>'
        f"<geometry>{form.format(*size)}</geometry></collision>"
        for form, size, place, turn in parts
    )
    return f'<robot name="{name}"><link name="shape"><inertial><mass value="{mass}"/></inertial>{shapes}</link></robot>'


def grasped(policy: str, name: str, body: str, episodes: int) -> list[bool]:
    """Successes of a policy at a shape, by seed."""
    with TemporaryDirectory() as folder:
        file = Path(folder) / f"{name.replace(' ', '_')}.urdf"
        file.write_text(urdf_of(name))
        options = {"engine": "mujoco", "body": body, "object": own_object(file)}
        seeds = range(HELD_OUT_SEED, HELD_OUT_SEED + episodes)
        rows = run_block([policy], GRASP_ANY, needed_options(policy) | options, seeds)
    return [episode.success for (episode,) in rows]


def main(argv: list[str] | None = None) -> None:
    """Grasp every shape with every policy and the script, print a row a policy, write them."""
    parser = command_parser("experiments.shapes", __doc__)
    parser.add_argument("--policy", nargs="+", default=["grasp-any", "grasp-any-wrist"])
    parser.add_argument("--body", choices=("twin", "light"), default="twin")
    parser.add_argument("--episodes", type=whole_number(1), default=50, help="of each shape")
    add_workers_and_out(parser)
    arguments = parser.parse_args(argv)
    names = [SCRIPTED, *arguments.policy]
    jobs = [(name, shape, arguments.body, arguments.episodes) for name in names for shape in SHAPES]
    held: dict[str, dict[str, list[bool]]] = {name: {} for name in names}
    done = shared(grasped, jobs, arguments.workers, "shapes")
    for (name, shape, *_), found in zip(jobs, done, strict=True):
        held[name][shape] = found
    cells = [_cell(name, held[name], held[SCRIPTED]) for name in names]
    options = f"--body {arguments.body} --episodes {arguments.episodes}"
    words = f"shapes --policy {' '.join(arguments.policy)} {options}"
    write_results(arguments.out, words, cells=cells)
    rows = [
        (cell["policy"], f"{cell['success_rate']:.1%}", f"{100 * cell['difference']:+.1f}")
        for cell in cells
    ]
    print(markdown(("policy", "success", "points over the script"), rows))


def _cell(
    name: str, held: Mapping[str, list[bool]], script: Mapping[str, list[bool]]
) -> dict[str, Any]:
    """A policy's successes, by shape and in all, and its difference from the script."""
    mine, others = ([won for shape in SHAPES for won in part[shape]] for part in (held, script))
    shapes = {shape: sum(found) for shape, found in held.items()}
    return {"policy": name, **compared(mine, others), "shapes": shapes}


if __name__ == "__main__":
    sys.exit(run(main))
