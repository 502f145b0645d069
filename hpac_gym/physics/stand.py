"""A simulated hand in a stand: no object, no wrist, servos to command and joints to measure."""

from dataclasses import replace

from hpac_gym.model import Hand
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import SceneSetup
from hpac_gym.physics.settings import Damping, HandSettings, WorldSettings
from hpac_gym.physics.simulation import Simulation, make_engine

WORLD = WorldSettings(physics_hz=640, error_reduction=0.2)
"""Smaller time steps than in the environments, so that the integration is stable at twice the
tendon stiffness.
"""

HAND = HandSettings(armature=(1e-3, 3e-4, 3e-4), damping=Damping(0.4, overrun=0.0))
"""The simulated hand of the rig, with smaller armatures than in the environments, as this rate
permits.
"""

UPRIGHT = (0.0, 0.0, 0.0, 1.0)
"""Orientation of a hand with fingers upwards, quaternion xyzw."""


class HandOnStand:
    """A simulated hand, fixed at its palm, with commanded servos and measurable joints.

    Args:
        hand: the model's parameters.
        settings: settings of the simulated hand.
        world: settings of the integration.
        orientation: orientation of the hand frame in the world, quaternion xyzw.
        visuals: whether pictures will be rendered.
        engine: name of the engine.
    """

    def __init__(
        self,
        hand: Hand,
        settings: HandSettings,
        world: WorldSettings,
        orientation: tuple[float, ...],
        visuals: bool = False,
        engine: str = "mujoco",
    ) -> None:
        self._setup = SceneSetup(
            None, hand=hand, hand_settings=settings, hand_quaternion=orientation
        )
        self.simulation = Simulation(make_engine(engine, 1, world, visuals))
        self.close = self.simulation.engine.close
        self.step = self.simulation.rest  # advances by a time [s], in whole physics steps

    def reset(self, synergy: Array) -> None:
        """Put the hand at rest at a synergy, shape (6,) [rad]."""
        self.simulation.reset([0], [replace(self._setup, synergy=synergy)])

    def command(self, servo: Array, seconds: float) -> None:
        """Start a move to servo angles, shape (6,) [rad], of the given duration [s]."""
        self.simulation.command(servo[None], seconds)

    @property
    def commanded(self) -> Array:
        """Present commanded servo angles on the way to the target, shape (6,) [rad]."""
        return self.simulation.servos.commanded[0]

    @property
    def joint_pos(self) -> Array:
        """True joint angles, shape (15,) [rad]."""
        return self.simulation.state().joint_pos[0]
