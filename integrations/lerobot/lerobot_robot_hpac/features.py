"""What LeRobot calls the numbers of the hand, and the hand's own numbers behind those names.

LeRobot's rollout passes on only what is called ``….pos`` or ``….vel``, and sends observed ``….pos``
back as actions when it returns to the initial position: an observation and an action of one name
are therefore the same quantity, −1 (open) to 1 (closed)."""

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from lerobot.processor import ObservationProcessorStep, ProcessorStepRegistry
from lerobot.utils.constants import OBS_ENV_STATE, OBS_STATE

from hpac_gym.deploy.commands import object_of
from hpac_gym.deploy.errors import PoseError
from hpac_gym.deploy.poses import Source, source_of
from hpac_gym.errors import HpacError
from hpac_gym.model import HPAC, JOINTS, SERVOS, Hand, action_from_synergy, synergy_from_servo
from hpac_gym.model.checks import Array
from hpac_gym.model.maps import CommandMap

ACTIONS = tuple(f"{name}.pos" for name in SERVOS)
"""The six actions, −1…1, and what the hand was commanded last."""
PREDICTED = tuple(f"predicted_{name}.pos" for name in JOINTS)
"""Joint angles that the model predicts [rad]; the hand measures none."""
POSE = tuple(f"object_{name}.pos" for name in ("x", "y", "z", "qx", "qy", "qz", "qw"))
"""Place of an object in the hand's frame [m], and its rotation."""

_sources: dict[str, Source] = {}
_objects: defaultdict[str, list[str | None]] = defaultdict(list)
"""Open sources, and what each of their users calls the object."""


class ActionError(HpacError, ValueError):
    """An action lacks a servo, or is not finite."""


@ProcessorStepRegistry.register(name="hpac_environment_state")
@dataclass
class EnvironmentStateStep(ObservationProcessorStep):
    """A step of a policy's preprocessor that gives what the hand observes also as the environment's
    state: ACT and diffusion want either that or a picture, and a robot of LeRobot cannot give it.
    """

    def observation(self, observation: dict[str, Any]) -> dict[str, Any]:
        """The observation with one more entry."""
        return {**observation, OBS_ENV_STATE: observation[OBS_STATE]}

    def transform_features(self, features: Any) -> Any:
        """Which features there are is the policy's own affair."""
        return features


def named(names: Sequence[str], values: Sequence[float]) -> dict[str, float]:
    """Numbers by their names."""
    return dict(zip(names, map(float, values), strict=True))


def clipped(action: Mapping[str, float]) -> Array:
    """The six numbers of an action within −1…1, shape (6,); names without ``.pos``, as in the data
    sets of ``hpac record``, are understood, and others ignored.

    Raises:
        ActionError: One is missing or not finite.
    """
    values = [float(action.get(f"{name}.pos", action.get(name, np.nan))) for name in SERVOS]
    if not np.isfinite(values).all():
        raise ActionError(f"an action must have six finite numbers {', '.join(ACTIONS)}: {action}")
    return np.clip(values, -1.0, 1.0)


class Commands:
    """The pipeline of one hand: actions to servo angles, and back.

    Args:
        hand: the model, as `hpac calibrate` writes it.
    """

    def __init__(self, hand: Hand = HPAC) -> None:
        self._map = CommandMap(hand)
        self._flexing = np.ones((1, len(SERVOS)), dtype=bool)
        self._last = -np.ones(len(SERVOS))

    def servo(self, action: Array) -> Array:
        """Servo angles for an action, shape (6,) → (6,) [rad]."""
        change = action - self._last
        self._flexing = np.where(change == 0, self._flexing, change > 0)
        self._last = action
        return self._map.servo_from_action(action[None], self._flexing)[0]

    def predicted(self, servo: Array) -> Array:
        """Joint angles that the model predicts for servo angles, shape (6,) → (15,) [rad]."""
        return self._map.joints_from_servo(servo[None], self._flexing)[0]

    def action(self, servo: Array) -> Array:
        """The action that leads to servo angles, shape (6,) [rad] → (6,)."""
        shown = self._map.shown_servo(servo[None], self.predicted(servo)[None])[0]
        bounds = self._map.bounds
        shown = np.clip(shown, bounds.servo_min, bounds.servo_max)
        return action_from_synergy(synergy_from_servo(shown, bounds), bounds)


@contextmanager
def shared_source(text: str, seen: str | None) -> Iterator[Source]:
    """The source of poses of a ``pose``, see `hpac_gym.deploy.poses.source_of`: one for robot and
    teleoperator, since a port or a camera can be opened only once. The last one closes it.

    Raises:
        PoseError: A camera, and they do not name the same object.
    """
    objects = _objects[text]
    if text.startswith("camera:") and (not seen or {*objects} - {seen}):
        told = ", ".join(map(str, [*objects, seen]))
        raise PoseError(f"{text} needs one object for robot and teleoperator; given: {told}")
    if not objects:
        _sources[text] = source_of(text, object_of(seen) if seen else None)
    objects.append(seen)
    try:
        yield _sources[text]
    finally:
        objects.remove(seen)
        if not objects:
            _sources.pop(text).close()
