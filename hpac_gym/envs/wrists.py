"""The scripted motion of n wrists, and forces on their objects, as tables by control step."""

from collections.abc import Sequence

import numpy as np

from hpac_gym.body.urdf import WRIST_RANGE
from hpac_gym.errors import ParameterError, ShapeError
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import SceneSetup
from hpac_gym.tasks.task import CONTROL_HZ, Task


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
