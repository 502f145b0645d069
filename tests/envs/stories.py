"""Prescribed sequences of states that replace the simulation, so that an environment's outputs are
exact.

The hand swings smoothly and the wrist follows its targets. Contacts and the object's position
follow each story: the object is held and slips slowly, is released, is knocked away, is put down.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np

from hpac_gym.model import JOINTS

Vector = np.ndarray
SWING = 0.3 + 0.4 * np.arange(len(JOINTS)) / len(JOINTS)
"""Frequency of each joint [Hz]."""
GRIP = {"thumb": 6.0, "index": 3.0, "middle": 2.5, "palm": 1.5}
"""Normal forces of a grip [N]."""
Span = tuple[float, float]
NEVER: Span = (np.inf, np.inf)


def within(time: float, *spans: Span) -> bool:
    """True if a time lies in one of the spans [s], with a tolerance of a millisecond."""
    return any(begin - 1e-3 < time < end - 1e-3 for begin, end in spans)


@dataclass(frozen=True)
class Story:
    """Contacts and motion of the object as functions of the time since the episode began [s]."""

    gripped: tuple[Span, ...] = (NEVER,)
    """Spans in which the hand touches the object."""
    carried: Span = NEVER
    """Span in which the object moves with the wrist."""
    supported: tuple[Span, ...] = ((0.0, np.inf),)
    """Spans in which it touches the post on which it started."""
    placed: tuple[Span, ...] = (NEVER,)
    """Spans in which it touches the post of its target."""
    slip: Mapping[float, Vector] = field(default_factory=dict)
    """Displacement of the object, less that by which it was carried, at some times, linear in
    between, shape (3,) [m].
    """

    def __call__(self, time: float) -> SimpleNamespace:
        """The state at a time [s]: angles [rad] and speeds [rad/s] of the joints, normal forces on the
        parts of the hand that touch the object [N]; of the object its displacement in the world, less
        that by which it was carried [m], rotation about the world's x axis [rad], velocity [m/s] and
        spin [rad/s]; and whether it moves with the wrist, touches the post on which it started, or
        the body that was added last, the post of its target.
        """
        phase = 2 * np.pi * SWING * time
        share = time % 1
        return SimpleNamespace(
            joint_pos=0.5 * (1 - np.cos(phase)),
            joint_vel=np.pi * SWING * np.sin(phase),
            forces={part: force * (1 + share) for part, force in GRIP.items()}
            if within(time, *self.gripped)
            else {},
            slipped=self._slipped(time),
            tilt=0.04 * np.sin(3 * time),
            velocity=np.array([0.3 * share, -0.2, 0.1 + 0.2 * share]),
            spin=np.array([2.0, -3.0 * share, 1.0]),
            carried=within(time, self.carried),
            supported=within(time, *self.supported),
            placed=within(time, *self.placed),
        )

    def _slipped(self, time: float) -> Vector:
        if not self.slip:
            return np.zeros(3)
        times = list(self.slip)
        places = np.array(list(self.slip.values()))
        return np.array([np.interp(time, times, places[:, axis]) for axis in range(3)])
