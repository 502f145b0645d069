"""Measures an engine's hand against the paper and against statics: ``python -m
experiments.conformance``.

One suite for every engine and body. It compares an engine's output (`SceneState`, `Contacts`) with
the model's equations, the tendon law in NumPy and forward kinematics from the geometry; no engine
is its own reference."""

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass, replace
from functools import partial

import numpy as np

from hpac_gym.body.geometry import HPAC_GEOMETRY, Geometry, link_poses
from hpac_gym.body.objects import ObjectSpec
from hpac_gym.command import command_parser, run, whole_number
from hpac_gym.errors import ParameterError
from hpac_gym.model import (
    FINGERS,
    HPAC,
    JOINT_INDEX,
    SERVO_INDEX,
    SERVOS,
    Hand,
    joints_from_synergy,
    servo_from_synergy,
)
from hpac_gym.model.command import minimum_jerk
from hpac_gym.physics.engine import HAND_POSITION, Engine, SceneSetup
from hpac_gym.physics.mechanics import mass_matrix
from hpac_gym.physics.settings import BODIES, HandSettings, WorldSettings
from hpac_gym.physics.simulation import ENGINES, SET_UPS, Simulation, is_installed, make_engine
from hpac_gym.physics.tendons import Drive, Tendons, element_rows

Factory = Callable[[int, WorldSettings], Engine]
"""Makes an engine of n worlds."""

_ROOTS = [JOINT_INDEX[name] for name in SERVOS]
_PALM_DOWN = (0.0, float(np.sqrt(0.5)), 0.0, float(np.sqrt(0.5)))


@dataclass(frozen=True, slots=True)
class Figure:
    """One measured quantity and its limit; it holds if the value is at most the limit."""

    name: str
    value: float
    limit: float
    unit: str

    @property
    def holds(self) -> bool:
        return bool(self.value <= self.limit)


def free_space(
    make: Factory,
    settings: HandSettings,
    world: WorldSettings,
    postures: int = 25,
    seed: int = 0,
    hand: Hand = HPAC,
    geometry: Geometry = HPAC_GEOMETRY,
) -> tuple[float, float, float]:
    """Hands at random synergies, without gravity and without collisions, so that the whole
    workspace is free space.

    Returns:
        Largest deviation of PIP, DIP and IP from Eqs. (12), (13) for the simulated MCP and MP
        [rad]; largest deviation of MCP, MP and CMC from the command [°]; largest residual joint
        speed after eight seconds [rad/s].
    """
    rng = np.random.default_rng(seed)
    synergy = hand.synergy_max * rng.uniform(0.03, 0.97, (postures, len(SERVOS)))
    setup = SceneSetup(None, hand=hand, geometry=geometry, hand_settings=settings)
    with _hands(make, postures, setup, replace(world, gravity=0.0, collisions=False)) as hands:
        hands.command(servo_from_synergy(synergy, hand), 0.4)
        hands.rest(8.0)
        state = hands.state()
    manifold = np.abs(state.joint_pos - joints_from_synergy(state.joint_pos[:, _ROOTS], hand)).max()
    command = np.degrees(np.abs(state.joint_pos[:, _ROOTS] - synergy).max())
    return float(manifold), float(command), float(np.abs(state.joint_vel).max())


def blocked_fingertip(
    make: Factory, settings: HandSettings, world: WorldSettings, finger: str
) -> tuple[float, float]:
    """A fingertip closes on a fixed frictionless ball.

    Returns:
        Largest relative deviation of the contact torque Jᵀf from the tendon torque at MCP, PIP and
        DIP; largest residual joint speed [rad/s].
    """
    joints = [f"{finger}_{suffix}" for suffix in ("mcp", "pip", "dip")]
    index = [JOINT_INDEX[name] for name in joints]
    synergy = np.zeros(len(SERVOS))
    synergy[SERVO_INDEX[f"{finger}_mcp"]] = 0.6
    digit = HPAC_GEOMETRY.digit(finger)
    ball = 0.004
    position, rotation = link_poses(digit, joints_from_synergy(synergy)[index])[-1]
    centre = position + rotation @ [digit.phalanges[-1].capsule.radius + ball + 3e-4, 0.0, 0.012]
    peg = ObjectSpec("sphere", (ball, ball, ball), mass=0.1, friction=1e-9)
    setup = SceneSetup(peg, centre, synergy=synergy, hand_settings=settings, fixed=True)
    with _hands(make, 1, setup, replace(world, gravity=0.0)) as hands:
        synergy[SERVO_INDEX[f"{finger}_mcp"]] = 0.9
        hands.command(servo_from_synergy(synergy)[None], 0.4)
        hands.rest(8.0)
        state = hands.state()
        contacts = hands.engine.contacts(0)
    law = Tendons(HPAC, np.eye(15), world.dt, settings.damping, settings.slack)
    tendon, _ = law.torque(state.joint_pos[0], np.zeros(15), state.horn[0], np.zeros(len(SERVOS)))
    torque = np.zeros(len(joints))
    poses = link_poses(digit, state.joint_pos[0, index])
    for point, normal, force, link in zip(
        contacts.point, contacts.normal, contacts.force, contacts.link, strict=True
    ):
        point = setup.hand_rotation.T @ (point - HAND_POSITION - state.palm_offset[0])
        push = setup.hand_rotation.T @ (-force * normal)
        for i, (origin, turn) in enumerate(poses[: joints.index(link.removesuffix("_link")) + 1]):
            torque[i] += turn[:, 1] @ np.cross(point - origin, push)
    share = np.abs(torque / np.array(tendon)[index] + 1).max()
    return float(share), float(np.abs(state.joint_vel).max())


def held_cylinder(
    make: Factory, settings: HandSettings, world: WorldSettings
) -> tuple[float, float]:
    """A cylinder of 0.15 kg, 50 mm wide, is grasped on its post, lifted by 60 mm and held for 10 s.

    Returns:
        Displacement in the hand while it is held [m], infinite if it is lost; largest joint speed
        at the end [rad/s].
    """
    synergy = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.2])
    spec = ObjectSpec("cylinder", (0.025, 0.025, 0.06), mass=0.15, friction=0.8)
    setup = SceneSetup(spec, np.array([0.042, 0.0, 0.105]), synergy=synergy, hand_settings=settings)
    share = np.linspace(0.0, 1.0, round(0.6 / world.dt) + 1)[1:]
    path = np.zeros((1, round((0.6 + 0.5) / world.dt), 3))
    path[0, :, 2] = 0.06
    path[0, : len(share), 2] *= minimum_jerk(share)
    with _hands(make, 1, setup, world) as hands:
        hands.command(servo_from_synergy(np.array([[0.9, *HPAC.synergy_max[1:5], 1.2]])), 0.8)
        hands.rest(1.5)
        hands.advance(path)
        start = hands.state()
        hands.advance(np.broadcast_to(path[:, -1:], (1, round(10.0 / world.dt), 3)))
        end = hands.state()
    held = (
        end.touching[0].any()
        and not end.supported[0]
        and np.linalg.norm(end.object_pos[0] - setup.position) < 0.06
    )
    creep = np.linalg.norm(end.object_pos[0] - start.object_pos[0])
    return float(creep) if held else np.inf, float(np.abs(end.joint_vel).max())


def slack_droop(make: Factory, settings: HandSettings, world: WorldSettings) -> float:
    """Largest MCP angle of the fingers with the palm down and all servos at rest [rad]."""
    setup = SceneSetup(None, hand_settings=settings, hand_quaternion=_PALM_DOWN)
    with _hands(make, 1, setup, world) as hands:
        hands.rest(4.0)
        joints = hands.state().joint_pos[0]
    return float(joints[[JOINT_INDEX[f"{finger}_mcp"] for finger in FINGERS]].max())


def opposition_gap(
    make: Factory, settings: HandSettings, world: WorldSettings, finger: str
) -> float:
    """Distance between thumb pad and finger pad in the simulated opposition posture [m]."""
    setup = SceneSetup(
        None, synergy=np.array(HPAC_GEOMETRY.opposition[finger]), hand_settings=settings
    )
    with _hands(make, 1, setup, replace(world, gravity=0.0)) as hands:
        joints = hands.state().joint_pos[0]
    pads = []
    for name in ("thumb", finger):
        digit = HPAC_GEOMETRY.digit(name)
        position, rotation = link_poses(
            digit, joints[[JOINT_INDEX[phalanx.joint] for phalanx in digit.phalanges]]
        )[-1]
        pads.append(position + rotation @ digit.pad)
    return float(np.linalg.norm(pads[0] - pads[1]))


def stiffest_mode(
    settings: HandSettings,
    world: WorldSettings,
    hand: Hand = HPAC,
    geometry: Geometry = HPAC_GEOMETRY,
) -> float:
    """Largest ω dt of the hand's tendons over the workspace; an engine with explicit torques needs
    it well below 2.
    """
    inertia = mass_matrix(geometry, settings.armature, hand.synergy_max / 2, hand)
    rows, stiffness = element_rows(hand)
    elastic = rows.T @ (stiffness[:, None] * rows)
    elastic[_ROOTS[-1], _ROOTS[-1]] += hand.cmc_stiffness
    drives = [Drive.of(digit) for digit in hand.digits.values()]
    squares = []
    for share in np.linspace(0.0, 1.0, 11):
        matrix = elastic.copy()
        for drive, angle in zip(drives, (share * hand.synergy_max).tolist(), strict=False):
            matrix[drive.joint, drive.joint] += drive.stiffness * drive.chord_and_arm(angle)[1] ** 2
        squares.append(np.linalg.eigvals(np.linalg.solve(inertia, matrix)).real.max())
    return float(np.sqrt(max(squares)) * world.dt)


def figures(
    make: Factory, body: str = "twin", world: WorldSettings = WorldSettings(), postures: int = 25
) -> list[Figure]:
    """All measured quantities of an engine and a body, with their limits.

    Args:
        make: factory of the engine.
        body: one of `BODIES`.
        world: world settings, whose physics rate is under test.
        postures: number of random postures in free space.
    """
    settings = BODIES[body]
    manifold, command, free_speed = free_space(make, settings, world, postures)
    blocked, blocked_speed = np.max(
        [blocked_fingertip(make, settings, world, finger) for finger in FINGERS], axis=0
    )
    creep, held_speed = held_cylinder(make, settings, world)
    # NumPy's maximum is NaN if any of them is.
    speed = float(np.max([free_speed, blocked_speed, held_speed]))
    gap = np.max(
        [opposition_gap(make, settings, world, finger) for finger in ("index", "middle", "ring")]
    )
    return [
        Figure("free space: PIP, DIP, IP against Eqs. (12), (13)", manifold, 1e-3, "rad"),
        Figure("free space: MCP, MP, CMC against the command", command, 0.3, "deg"),
        Figure("blocked fingertip: contact torque against tendon torque", 100 * blocked, 1.0, "%"),
        Figure("held cylinder, 0.15 kg: creep in 10 s", 1e3 * creep, 2.0, "mm"),
        Figure("opposition: thumb to index, middle and ring", 1e3 * float(gap), 2.0, "mm"),
        Figure(
            "palm down, servos at rest: most drooping MCP",
            slack_droop(make, settings, world),
            0.3,
            "rad",
        ),
        Figure(
            "chatter: joint speed of hands at rest, free, blocked, holding", speed, 0.05, "rad/s"
        ),
    ]


@contextmanager
def _hands(make: Factory, n: int, setup: SceneSetup, world: WorldSettings) -> Iterator[Simulation]:
    """n worlds, reset to the same setup."""
    with closing(make(n, world)) as engine:
        hands = Simulation(engine)
        hands.reset(range(n), [setup] * n)
        yield hands


def main(argv: list[str] | None = None) -> int:
    """Measure every requested combination that is installed; exit status 1 if a limit is exceeded.

    Raises:
        ParameterError: No requested combination is installed.
    """
    parser = command_parser("experiments.conformance", __doc__)
    parser.add_argument("--engine", choices=ENGINES, help="this engine alone")
    parser.add_argument("--body", choices=tuple(BODIES), help="this body alone")
    parser.add_argument(
        "--physics-hz",
        type=whole_number(1),
        default=WorldSettings().physics_hz,
        metavar="HZ",
        help="physics steps a second",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    arguments = parser.parse_args(argv)
    world = WorldSettings(physics_hz=arguments.physics_hz)
    wanted = [
        (engine, body)
        for engine, body in (set_up.split("/") for set_up in SET_UPS)
        if arguments.engine in (None, engine)
        and arguments.body in (None, body)
        and is_installed(engine)
    ]
    if not wanted:
        raise ParameterError(
            f"engine {arguments.engine or 'any'} with body {arguments.body or 'any'} is not installed, or not one of "
            + ", ".join(SET_UPS)
        )
    measured = {}
    for engine, body in wanted:
        rows = figures(partial(make_engine, engine), body, world)
        if engine == "pybullet":
            rows.append(
                Figure("stiffest tendon: omega dt", stiffest_mode(BODIES[body], world), 1.5, "1")
            )
        measured[f"{engine}/{body}"] = rows
    if arguments.json:
        told = {
            name: [{**asdict(figure), "holds": figure.holds} for figure in rows]
            for name, rows in measured.items()
        }
        print(json.dumps(told, indent=2))
    else:
        for name, rows in measured.items():
            print(name)
            for figure in rows:
                missed = "" if figure.holds else "  MISSED"
                print(
                    f"  {figure.name:<62} {figure.value:9.2g} {figure.unit:<5} mark {figure.limit:g}{missed}"
                )
    return 0 if all(figure.holds for rows in measured.values() for figure in rows) else 1


if __name__ == "__main__":
    sys.exit(run(main))
