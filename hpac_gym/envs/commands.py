"""What moves n hands: commands, from actions to the servo angles that arrive, and their wrists' scripted
motion.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache, partial
from pathlib import Path

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray

from hpac_gym.body.urdf import WRIST_RANGE
from hpac_gym.envs.options import CALIBRATED
from hpac_gym.errors import ParameterError, ShapeError, WorkspaceError
from hpac_gym.model import (
    DIGITS,
    HPAC,
    JOINTS,
    SERVOS,
    Hand,
    ServoCommand,
    action_from_synergy,
    elastic_joints_from_servo,
    load_hand,
    servo_from_synergy,
    streamed_servo,
)
from hpac_gym.model.calibration import Calibration, Friction
from hpac_gym.model.checks import Array, as_array, as_bounded_array
from hpac_gym.model.command import ACTION_TOLERANCE
from hpac_gym.model.maps import CommandMap
from hpac_gym.physics.engine import SceneSetup
from hpac_gym.tasks.task import CONTROL_HZ, Task

FILES = Path(__file__).parents[1] / "body" / "data" / "calibrated"
"""Hand files of the held-out hands, which `python -m experiments.held_out` makes. The hand with a
dead finger has none, since `hpac calibrate` refuses it: it keeps the nominal numbers.
"""
Transmit = Callable[[ServoCommand], ServoCommand]


def actions_of(given: NDArray, space: Box, name: str) -> Array:
    """Actions as an array of exactly the shape of their space.

    Raises:
        ShapeError: Not numeric, or of another shape.
    """
    actions = as_array(given, space.shape[-1], name)
    if actions.shape != space.shape:
        raise ShapeError(f"{name} must have shape {space.shape}, not {actions.shape}")
    return actions


@dataclass(slots=True)
class LinkFaults:
    """What becomes of a world's commands on their way to the hand."""

    lost: float = 0.0
    """Share that never arrives."""
    late: float = 0.0
    """Share that arrives late, at any time of its control period."""
    rng: np.random.Generator | None = None
    """Draws both; only a faultless link has none."""

    def moved(self) -> float:
        """Share of a command's move that its control period sees."""
        if self.lost and self.rng.random() < self.lost:
            return 0.0
        if self.late and self.rng.random() < self.late:
            return self.rng.random()
        return 1.0


class Commands:
    """The commands of n hands, each of one control period.

    Args:
        num_worlds: n.
        model: the hand with which commands are computed, or the name of one for every episode's hand.
        choices: names of an action's entries beyond those of the servos.
        transmit: function applied to a command on its way to the servos, for n = 1; None is the
            identity.

    Attributes:
        servo: commanded servo angles, shape (n, 6) [rad].
        predicted: joint angles that the model predicts for them, shape (n, 15) [rad].
        last_action: last action on the servos, shape (n, 6).
        faults: what loses or delays a share of each world's commands.
    """

    changing = ("servo", "predicted", "last_action", "_arrived", "_flexing", "faults")

    def __init__(
        self,
        num_worlds: int,
        model: Hand | str,
        choices: tuple[str, ...],
        transmit: Transmit | None,
    ) -> None:
        self._model = model
        self._choices = choices
        self.transmit = transmit
        self.servo = np.zeros((num_worlds, len(SERVOS)))
        self.predicted = np.zeros((num_worlds, len(JOINTS)))
        self.last_action = np.zeros((num_worlds, len(SERVOS)))
        self._arrived = self.servo.copy()
        self._flexing = np.ones((num_worlds, len(SERVOS)), dtype=bool)
        self.faults = [LinkFaults()] * num_worlds
        self._map = CommandMap(model if isinstance(model, Hand) else HPAC, num_worlds)
        # Most tasks begin with the same posture.
        self._start_of = lru_cache(maxsize=16)(partial(_start_of, self._map.bounds))

    def start(self, worlds: Sequence[int], setups: Sequence[SceneSetup]) -> None:
        """Begin episodes in some worlds: hands at rest at the synergies of their setups."""
        # The previous `Moment` keeps the arrays.
        self.servo, self.predicted, self.last_action = (
            kept.copy() for kept in (self.servo, self.predicted, self.last_action)
        )
        for world, setup in zip(worlds, setups, strict=True):
            start = self._start_of(*setup.synergy.tolist())
            self.servo[world], self.predicted[world], self.last_action[world] = start
        index = np.asarray(worlds)
        self._flexing[index] = True
        if isinstance(self._model, str):
            self._map.take(worlds, [_model(self._model, setup) for setup in setups])
        if self._map.inverts_files:
            synergy = np.stack([setup.synergy for setup in setups])
            self.servo[index] = self._map.servo_from_synergy(synergy, self._flexing[index], index)
            self.predicted[index] = self._map.joints_from_servo(self.servo, self._flexing)[index]
        self._arrived[index] = self.servo[index]

    def target(self, actions: NDArray) -> Array:
        """Servo angles that actions, shape (n, 6), or more columns with a free wrist, ask for, shape
        (n, 6) [rad].

        Raises:
            ShapeError: Wrong shape.
            WorkspaceError: NaN, or an action that leaves −1…1: wrap in
                `gymnasium.wrappers.ClipAction`.
        """
        servos = actions[:, : len(SERVOS)]
        flexing = self._flexing
        if self._map.inverts_files:
            change = servos - self.last_action
            flexing = np.where(change == 0, flexing, change > 0)
        try:
            target = self._map.servo_from_action(servos, flexing)
            if self._choices:
                one = np.ones(len(self._choices))
                chosen = actions[:, len(SERVOS) :]
                as_bounded_array(
                    chosen, -one, one, self._choices, "action", "(no unit)", ACTION_TOLERANCE
                )
        except WorkspaceError as error:
            if np.isnan(actions).any():
                raise
            raise WorkspaceError(
                f"{error}; gymnasium.wrappers.ClipAction clips it, and gymnasium.wrappers.vector.ClipAction a batch's"
            ) from None
        self._flexing = flexing
        return target

    def stream(self, target: Array) -> Array:
        """Command one control period of the move to a target, shape (n, 6) [rad]; returns the angles
        that the servos have in its end: after a lost command the previous ones, after a late one
        they are on the way.
        """
        self.servo = streamed_servo(self.servo, target, 1.0 / CONTROL_HZ, self._map.bounds)
        arrived = self.servo.copy()
        for world, faults in enumerate(self.faults):
            share = faults.moved()
            if self.transmit is not None and share:
                arrived[world] = self.transmit(self.command).servo
            if share < 1.0:
                last = self._arrived[world]
                arrived[world] = last + share * (arrived[world] - last)
        self._arrived = arrived
        return arrived

    def record(self, actions: NDArray) -> Array:
        """Note the actions on the servos that were carried out; returns their change, shape (n, 6)."""
        servos = np.array(actions[:, : len(SERVOS)], dtype=float)  # the caller may reuse its array
        change = servos - self.last_action
        self.last_action = servos
        self.predicted = self._map.joints_from_servo(self.servo, self._flexing)
        return change

    @property
    def shown(self) -> Array:
        """Commanded servo angles as a policy sees them, shape (n, 6) [rad]."""
        return self._map.shown_servo(self.servo, self.predicted)

    @property
    def command(self) -> ServoCommand:
        """Last servo command of world 0, as a bridge sends it to the real hand."""
        return ServoCommand(self.servo[0], 1.0 / CONTROL_HZ)


class Wrists:
    """The motion that a task scripts for the wrists of n worlds.

    Args:
        task: has the wrist's path and the forces on the objects.
        num_worlds: n.
        dt: physics step [s].

    Raises:
        ParameterError: The physics' rate is no multiple of the commands', or the task's duration not
            finite or shorter than a control step.

    Attributes:
        times: ends of an episode's physics steps [s].
        step: number of control steps of the running episodes, shape (n,).
    """

    changing = ("step", "_way")

    def __init__(self, task: Task, num_worlds: int, dt: float) -> None:
        if (rate := round(1 / dt)) % CONTROL_HZ:
            raise ParameterError(
                f"physics_hz = {rate} Hz must be a multiple of {CONTROL_HZ} Hz, the rate of the commands"
            )
        self._task = task
        self._substeps = rate // CONTROL_HZ
        times = np.cumsum(np.full(task.control_steps * self._substeps, dt))
        self.times = tuple(times.tolist())
        self.step = np.zeros(num_worlds, dtype=int)
        self._clock = self._by_step(times)
        self._rows = np.arange(num_worlds) * len(self._clock)
        self._way = np.zeros((num_worlds, *self._clock.shape, 3))

    def _by_step(self, table: Array) -> Array:
        """A table with a row for each physics step, by control steps: shape (steps + 1, k, ...),
        the last of which is for all after the episode's end.
        """
        after = np.repeat(table[-1:], self._substeps, axis=0)
        return np.concatenate([table, after]).reshape(-1, self._substeps, *table.shape[1:])

    def start(self, worlds: Sequence[int], setups: Sequence[SceneSetup]) -> None:
        """Begin episodes in some worlds.

        Raises:
            ParameterError: A path leaves the wrist's range.
        """
        self.step[np.asarray(worlds)] = 0
        for world, setup in zip(worlds, setups, strict=True):
            path = self._task.wrist_path(setup, self.times)
            if not (far := float(np.abs(path).max())) <= WRIST_RANGE:
                raise ParameterError(
                    f"the wrist's path leads {far:.3g} m along an axis, allowed {WRIST_RANGE:g} m"
                )
            self._way[world] = self._by_step(path)

    def advance(self) -> tuple[Array, Array | None]:
        """Advance by one control step; returns offsets of the wrists, shape (n, k, 3) [m], and forces
        on the objects, shape (n, k, 3) [N], or None.

        Raises:
            ShapeError: The task's forces have another shape.
        """
        step = np.minimum(self.step, len(self._clock) - 1)
        self.step += 1
        way = self._way.reshape(-1, *self._way.shape[2:]).take(self._rows + step, axis=0)
        push = self._task.push(self._clock.take(step, axis=0))
        if push is not None and np.shape(push) != way.shape:
            raise ShapeError(
                f"push must return None or forces of shape {way.shape}, not {np.shape(push)}"
            )
        return way, push


def _start_of(hand: Hand, *synergy: float) -> tuple[Array, Array, Array]:
    """Servo angles [rad], predicted joint angles [rad] and action of a hand that starts at a
    synergy [rad].
    """
    servo = servo_from_synergy(synergy, hand)
    return servo, elastic_joints_from_servo(servo, hand), action_from_synergy(synergy, hand)


def _model(name: str, setup: SceneSetup) -> Hand:
    """The model of an episode's hand for the option `model`, "hand" or "calibrated".

    "hand" is a hand file with the true numbers of the simulated hand: slack is a part of the
    servo's zero, since it is wound up before the tendon pulls.
    """
    if name == CALIBRATED:
        return _calibrated(setup.hand.name)
    settings = setup.hand_settings
    hubs = [digit.servo_radius for digit in setup.hand.digits.values()]
    wound = [slack / hub for slack, hub in zip(settings.slack, hubs, strict=True)]
    zero = np.subtract(settings.servo_zero, [*wound, 0.0]).tolist()
    friction = Friction(settings.joint_friction, settings.tendon_friction)
    return replace(setup.hand, calibration=Calibration(tuple(zero), (friction,) * len(DIGITS)))


@cache
def _calibrated(name: str) -> Hand:
    path = FILES / f"{name.removeprefix('H-PAC ')}.toml"
    return load_hand(path) if path.exists() else HPAC
