"""Tables that define observations and rewards. A row binds name, unit, bounds and meaning to its
function.

A deployed observation contains only what a sensorless hand plus one external camera can provide:
its own commands, what the model predicts from them, and what the camera sees. Nothing in it reads
the simulated joints."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray

from hpac_gym.body.objects import SHAPES
from hpac_gym.model import DIGITS, JOINTS, SERVOS
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import PARTS, SceneSetup, SceneState
from hpac_gym.tasks.grip import Grip

LENGTH_UNIT = 0.05
"""Lengths in the observation are multiples of this [m], so that every entry is of the order of one.
"""
FORCE_UNIT = 10.0
"""Unit of forces in the observation [N]."""
SPEED_UNIT = 10.0
"""Unit of joint speeds and of the object's spin in the observation [rad/s]."""
GRASP_CENTRE = np.array([0.045, 0.005, 0.1125])
"""Origin of `object_pos` in the hand frame [m]: in front of the knuckles."""
AXES = ("x", "y", "z")


@dataclass(slots=True)
class Moment:
    """Input of the terms: n worlds after a control step, as arrays with a leading axis n."""

    state: SceneState
    servo: Array
    """Commanded servo angles, shape (n, 6) [rad]."""
    predicted: Array
    """Joint angles that the model predicts for the command, shape (n, 15) [rad]."""
    down: Array
    """Direction of gravity in the hand frame, shape (n, 3)."""
    phase: NDArray[np.int_]
    """Index of the task's phase, shape (n,)."""
    last_action: Array
    """Last action on the servos, shape (n, 6)."""
    action_change: Array
    """Difference between the last action and the one before it, shape (n, 6)."""
    seen: dict[str, Array] = field(default_factory=dict)
    """Measurements of the task's camera, by name."""
    grip: Grip | None = None
    """Grip of the hand on the object; None for a task without an object."""
    outcome: NDArray[np.int_] | None = None
    """Status of each episode, an index into `OUTCOMES`, shape (n,)."""
    began: NDArray[np.int_] | None = None
    """Index of the phase in which the control step began, to which its reward belongs, shape (n,)."""


@dataclass(frozen=True, slots=True)
class Term:
    """A block of entries in the observation vector."""

    name: str
    labels: tuple[str, ...]
    unit: str
    low: float
    high: float
    meaning: str
    value: Callable[[Any], Any]
    """Function of a `Moment`, shape (n, len(labels)); with `fixed`, of a `SceneSetup`, shape
    (len(labels),).
    """
    fixed: bool = False
    """True if the entries depend only on the episode's setup and are the same in all of its steps.
    """


@dataclass(frozen=True, slots=True)
class RewardTerm:
    """One summand of the dense reward."""

    name: str
    meaning: str
    value: Callable[[Moment], Array]
    """Function of a `Moment`, shape (n,)."""


def column(values: Any) -> Array:
    """One value per world as a column, shape (n, 1)."""
    return np.asarray(values, dtype=float)[:, None]


COMMAND_TERMS = (
    Term("servo", SERVOS, "rad", 0.0, 2.0, "commanded servo angle", lambda now: now.servo),
    Term(
        "joint_pos",
        JOINTS,
        "rad",
        0.0,
        2.0,
        "joint angle that the model predicts for the command, Eqs. (12), (13)",
        lambda now: now.predicted,
    ),
)
"""Terms of the hand's own commands, which every environment observes."""

OBJECT_TERMS = (
    Term(
        "object_pos",
        AXES,
        "0.05 m",
        -4.0,
        4.0,
        "seen centre of the object in the hand frame, from `GRASP_CENTRE`",
        lambda now: (now.seen["position"] - GRASP_CENTRE) / LENGTH_UNIT,
    ),
    Term(
        "object_up",
        AXES,
        "1",
        -1.0,
        1.0,
        "seen z axis of the object in the hand frame; zero for a sphere",
        lambda now: now.seen["up"],
    ),
    Term(
        "object_side",
        AXES,
        "1",
        -1.0,
        1.0,
        "seen x axis of the object in the hand frame; zero for a sphere or cylinder",
        lambda now: now.seen["side"],
    ),
    Term(
        "object_size",
        AXES,
        "0.05 m",
        0.0,
        2.0,
        "seen half extents of the object along its own axes",
        lambda now: now.seen["half_extents"] / LENGTH_UNIT,
    ),
    Term(
        "object_shape",
        SHAPES,
        "0/1",
        0.0,
        1.0,
        "shape of the object, one-hot",
        lambda setup: [float(setup.object.shape == shape) for shape in SHAPES],
        fixed=True,
    ),
    Term(
        "down",
        AXES,
        "1",
        -1.0,
        1.0,
        "direction of gravity in the hand frame, which the arm knows",
        lambda now: now.down,
    ),
)
"""Terms that the camera measures, and the direction of gravity, which the arm knows."""


def progress_terms(phases: tuple[str, ...], duration: float) -> tuple[Term, ...]:
    """Terms of the progress of an episode with these phases and this duration [s]."""
    rows = np.eye(len(phases))
    return (
        Term(
            "phase",
            phases,
            "0/1",
            0.0,
            1.0,
            "phase of the wrist motion, one-hot",
            lambda now: rows[now.phase],
        ),
        Term(
            "progress",
            ("time",),
            "1",
            0.0,
            1.0,
            "share of the episode that has passed",
            lambda now: column(now.state.time) / duration,
        ),
    )


HAND_TERMS = (
    Term(
        "true_joint_pos",
        JOINTS,
        "rad",
        -0.5,
        2.0,
        "true joint angle",
        lambda now: now.state.joint_pos,
    ),
    Term(
        "true_joint_vel",
        JOINTS,
        "10 rad/s",
        -5.0,
        5.0,
        "true joint speed",
        lambda now: now.state.joint_vel / SPEED_UNIT,
    ),
    Term("horn", SERVOS, "rad", 0.0, 2.0, "angle of the servo's horn", lambda now: now.state.horn),
    Term(
        "tension",
        SERVOS[:-1],
        "10 N",
        0.0,
        10.0,
        "tension of the driving tendon",
        lambda now: now.state.tension / FORCE_UNIT,
    ),
)
"""True state of the hand, which only a critic may observe."""

PRIVILEGED_TERMS = (
    Term(
        "last_action",
        SERVOS,
        "1",
        -1.0,
        1.0,
        "last action; before the first one, that of the initial posture",
        lambda now: now.last_action,
    ),
    Term(
        "contact_force",
        PARTS,
        "10 N",
        0.0,
        10.0,
        "normal force between the object and a part of the hand",
        lambda now: now.state.contact_force / FORCE_UNIT,
    ),
    *HAND_TERMS,
    Term(
        "true_object_pos",
        AXES,
        "0.05 m",
        -4.0,
        4.0,
        "true centre of the object in the hand frame, from `GRASP_CENTRE`",
        lambda now: (now.state.object_pos - GRASP_CENTRE) / LENGTH_UNIT,
    ),
    Term(
        "true_object_up",
        AXES,
        "1",
        -1.0,
        1.0,
        "true z axis of the object in the hand frame",
        lambda now: now.state.object_rotation[:, :, 2],
    ),
    Term(
        "true_object_side",
        AXES,
        "1",
        -1.0,
        1.0,
        "true x axis of the object in the hand frame",
        lambda now: now.state.object_rotation[:, :, 0],
    ),
    Term(
        "object_vel",
        AXES,
        "m/s",
        -5.0,
        5.0,
        "velocity of the object relative to the world, along the axes of the hand frame",
        lambda now: now.state.object_vel,
    ),
    Term(
        "object_spin",
        AXES,
        "10 rad/s",
        -5.0,
        5.0,
        "angular velocity of the object, along the axes of the hand frame",
        lambda now: now.state.object_spin / SPEED_UNIT,
    ),
    Term(
        "supported",
        ("touches",),
        "0/1",
        0.0,
        1.0,
        "whether the object touches its support or the table",
        lambda now: column(now.state.supported),
    ),
    Term(
        "hold_time",
        ("time",),
        "s",
        0.0,
        10.0,
        "duration of carrying the object without interruption",
        lambda now: column(now.grip.time),
    ),
    Term(
        "slip",
        ("distance",),
        "0.05 m",
        0.0,
        4.0,
        "displacement of the object's centre in the hand since then",
        lambda now: column(now.grip.slip / LENGTH_UNIT),
    ),
    Term(
        "object_start",
        AXES,
        "0.05 m",
        -10.0,
        10.0,
        "`true_object_pos` at the start of the episode",
        lambda setup: (setup.position - GRASP_CENTRE) / LENGTH_UNIT,
        fixed=True,
    ),
    Term(
        "true_object_size",
        AXES,
        "0.05 m",
        0.0,
        4.0,
        "true half extents of the object along its own axes",
        lambda setup: np.array(setup.object.half_extents) / LENGTH_UNIT,
        fixed=True,
    ),
    Term(
        "object_mass",
        ("mass",),
        "kg",
        0.0,
        5.0,
        "true mass of the object",
        lambda setup: [setup.object.mass],
        fixed=True,
    ),
    Term(
        "object_friction",
        ("friction",),
        "1",
        0.0,
        5.0,
        "true Coulomb coefficient between skin and object",
        lambda setup: [setup.object.friction * setup.hand_settings.contact_friction],
        fixed=True,
    ),
    Term(
        "joint_friction",
        ("friction",),
        "0.01 N·m",
        0.0,
        2.0,
        "Coulomb friction of every joint",
        lambda setup: [setup.hand_settings.joint_friction / 0.01],
        fixed=True,
    ),
    Term(
        "tendon_stiffness",
        DIGITS,
        "1000 N",
        0.0,
        10.0,
        "EA of a digit's tendon",
        lambda setup: [digit.tendon_stiffness / 1e3 for digit in setup.hand.digits.values()],
        fixed=True,
    ),
    Term(
        "slack",
        DIGITS,
        "mm",
        0.0,
        3.0,
        "slack that a driving tendon winds up before it pulls",
        lambda setup: [1e3 * slack for slack in setup.hand_settings.slack],
        fixed=True,
    ),
    Term(
        "servo_lag",
        ("lag",),
        "0.1 s",
        0.0,
        2.0,
        "delay from a command to the servos' response",
        lambda setup: [setup.hand_settings.servo.lag / 0.1],
        fixed=True,
    ),
    Term(
        "dead_band",
        ("error",),
        "0.01 rad",
        0.0,
        10.0,
        "largest error that causes no servo motion",
        lambda setup: [setup.hand_settings.servo.dead_band / 0.01],
        fixed=True,
    ),
)
"""Terms that are known only in simulation: for a critic, whose actor observes only the deployed
part.
"""


class Layout:
    """Observation vectors of n worlds, defined by a table of terms.

    Args:
        terms: the table.
        num_worlds: n.

    Attributes:
        space: bounds of one world's vector.
        slices: slice of each term's entries, by the term's name.
    """

    changing = ("_values",)

    def __init__(self, terms: Sequence[Term], num_worlds: int) -> None:
        low = np.concatenate([np.full(len(term.labels), term.low) for term in terms])
        high = np.concatenate([np.full(len(term.labels), term.high) for term in terms])
        self.space = Box(low.astype(np.float32), high.astype(np.float32), dtype=np.float32)
        ends = np.cumsum([len(term.labels) for term in terms]).tolist()
        self.slices = {
            term.name: slice(end - len(term.labels), end)
            for term, end in zip(terms, ends, strict=True)
        }
        self._values = np.zeros((num_worlds, ends[-1]))
        self._fixed = [(term.value, self.slices[term.name]) for term in terms if term.fixed]
        self._changing = [(term.value, self.slices[term.name]) for term in terms if not term.fixed]

    def start(self, worlds: Sequence[int], setups: Sequence[SceneSetup]) -> None:
        """Begin episodes with these setups."""
        for world, setup in zip(worlds, setups, strict=True):
            for value, where in self._fixed:
                self._values[world, where] = value(setup)

    def see(self, now: Moment) -> NDArray[np.float32]:
        """Observation vectors, shape (n, size), clipped to the bounds (an object out of view)."""
        for value, where in self._changing:
            self._values[:, where] = value(now)
        return np.minimum(
            np.maximum(self._values, self.space.low), self.space.high, dtype=np.float32
        )
