"""From an action to what reaches the servos: the model's pipeline, and a link that may lose frames."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from hpac_gym.envs.randomization import stream
from hpac_gym.model import Hand, ServoCommand, servo_from_action, servo_from_synergy, stream_command
from hpac_gym.model.checks import Array


class Link:
    """The host's side of one episode.

    Args:
        hand: what the host believes of the hand.
        synergy: where the hand starts, shape (6,) [rad].
        dt: control period [s].
        drawn: values of a `Randomization`; `dropped_frames` counts here.
        rng: what the losses are derived from.
    """

    def __init__(self, hand: Hand, synergy: Array, dt: float, drawn: Mapping[str, Array], rng: np.random.Generator) -> None:
        self._hand, self._dt = hand, dt
        self.command = ServoCommand(servo_from_synergy(synergy, hand), dt)
        self._arrived = self.command
        self._lost_share = float(drawn.get("dropped_frames", [0.0])[0])
        self._losses = stream(rng, "losses")

    def send(self, action: Array, transmit: Callable[[ServoCommand], ServoCommand]) -> ServoCommand:
        """The command for one action, as it arrives: a lost one leaves the servos where the last one sent them.

        Raises:
            ShapeError: `action` has the wrong shape.
            WorkspaceError: `action` has NaN, or leaves −1…1.
        """
        target = servo_from_action(action, self._hand)
        self.command = stream_command(self.command.servo, target, self._dt, self._hand)
        if self._lost_share and self._losses.random() < self._lost_share:
            return ServoCommand(self._arrived.servo, self._dt)
        self._arrived = transmit(self.command)
        return self._arrived
