"""Tables that define observations and rewards. A row binds name, unit, bounds and meaning to its
function.

A deployed observation contains only what a sensorless hand plus one external camera can provide:
its own commands, what the model predicts from them, and what the camera sees. Nothing in it reads
the simulated joints."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray

from hpac_gym.body.objects import SHAPES
from hpac_gym.errors import ParameterError, ShapeError
from hpac_gym.model import JOINTS, SERVOS
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import SceneSetup, SceneState
from hpac_gym.tasks.grip import Grip

LENGTH_UNIT = 0.05
"""Lengths in the observation are multiples of this [m], so that every entry is of the order of one.
"""
GRASP_CENTRE = np.array([0.045, 0.005, 0.1125])
"""Origin of `object_pos` in the hand frame [m]: in front of the knuckles."""
AXES = ("x", "y", "z")


@dataclass(slots=True)
class Moment:
    """Input of the terms: n worlds after a control step, as arrays with a leading axis n."""

    state: SceneState
    servo: Array
    """Commanded servo angles as a policy sees them, shape (n, 6) [rad]."""
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
    commanded: Array | None = None
    """Servo angles really commanded, shape (n, 6) [rad]; None outside a simulation."""


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
            lambda now: rows.take(now.phase, axis=0),
        ),
        Term(
            "progress",
            ("time",),
            "1",
            0.0,
            1.0,
            "share of the episode that has passed",
            lambda now: now.state.time[:, None] / duration,
        ),
    )


def require_own_names(kind: str, terms: Iterable[Term | RewardTerm]) -> None:
    """Refuse terms of one name, of which one would be lost.

    Raises:
        ParameterError: There are such; `kind` says of what they are terms.
    """
    names = [term.name for term in terms]
    if same := next((name for name in names if names.count(name) > 1), None):
        raise ParameterError(f"{kind} has two terms {same!r}: each needs a name of its own")


def _require_columns(term: Term, value: Any, rows: int) -> None:
    """Refuse a value that has not a column for each label of its term."""
    shape = (rows, len(term.labels))
    if np.shape(value) != shape:
        raise ShapeError(
            f"term {term.name!r} must have shape {shape}, not {np.shape(value)}"
        ) from None


class Layout:
    """Observation vectors of n worlds, defined by a table of terms.

    Args:
        terms: the table.
        num_worlds: n.

    Raises:
        ParameterError: Two terms have one name.

    Attributes:
        space: bounds of one world's vector.
        slices: slice of each term's entries, by the term's name.
    """

    changing = ("_fixed",)

    def __init__(self, terms: Sequence[Term], num_worlds: int) -> None:
        require_own_names("the observation", terms)
        low = np.concatenate([np.full(len(term.labels), term.low) for term in terms])
        high = np.concatenate([np.full(len(term.labels), term.high) for term in terms])
        self.space = Box(low.astype(np.float32), high.astype(np.float32), dtype=np.float32)
        ends = np.cumsum([len(term.labels) for term in terms]).tolist()
        self.slices = {
            term.name: slice(end - len(term.labels), end)
            for term, end in zip(terms, ends, strict=True)
        }
        self._terms = tuple(terms)
        self._fixed = {
            term.name: np.zeros((num_worlds, len(term.labels)), np.float32)
            for term in terms
            if term.fixed
        }

    def start(self, worlds: Sequence[int], setups: Sequence[SceneSetup]) -> None:
        """Begin episodes with these setups."""
        index = np.asarray(worlds)
        for term in self._terms:
            if term.fixed:
                values = np.array([term.value(setup) for setup in setups], np.float32)
                _require_columns(term, values, len(setups))
                self._fixed[term.name][index] = values

    def see(self, now: Moment) -> NDArray[np.float32]:
        """Observation vectors, shape (n, size), clipped to the bounds (an object out of view).

        Raises:
            ShapeError: A term's value has not a column for each of its labels, or is NaN.
        """
        parts = [self._fixed[term.name] if term.fixed else term.value(now) for term in self._terms]
        try:
            seen = np.concatenate(parts, axis=1, dtype=np.float32)
            np.maximum(seen, self.space.low, out=seen)
        except ValueError:
            for term, part in zip(self._terms, parts, strict=True):
                _require_columns(term, part, len(now.servo))
            raise
        if np.isnan(seen).any():
            bad = next(
                term.name
                for term, part in zip(self._terms, parts, strict=True)
                if np.isnan(part).any()
            )
            raise ShapeError(f"term {bad!r} is not a number: NaN")
        return np.minimum(seen, self.space.high, out=seen)
