"""Simulation of n commanded hands: servos and an engine."""

import importlib.util
from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from hpac_gym.body.object_sets import RestingObject, resting
from hpac_gym.body.objects import ObjectSpec
from hpac_gym.errors import ParameterError
from hpac_gym.model import servo_from_synergy, synergy_from_servo
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import Engine, SceneSetup, SceneState
from hpac_gym.physics.servos import Servos
from hpac_gym.physics.settings import WorldSettings
from hpac_gym.settings import check_choice

ENGINES = ("pybullet", "mujoco")
SET_UPS = ("pybullet/twin", "mujoco/twin", "mujoco/light")
"""Engine and body of every supported combination."""
INSTEAD = {
    "pybullet": "PyBullet has wheels for CPython up to 3.11 on Linux alone; use engine='mujoco'",
    "mujoco": "pip install 'mujoco-core[rendering]==4.0.*'",
}
"""What to do without the package of an engine."""


class Simulation:
    """Servos and physics of n worlds.

    Args:
        engine: the physics.

    Attributes:
        servos: the servos of all worlds.
    """

    changing = ("servos",)

    def __init__(self, engine: Engine) -> None:
        self.engine = engine
        self.servos = Servos(engine.num_worlds, engine.dt)

    def reset(self, worlds: Sequence[int], setups: Sequence[SceneSetup]) -> None:
        """Start episodes in some worlds: hands at rest on their manifold, servos at the angles that
        hold them there.

        A servo zero moves the hand, not the servo: commands do not account for it.

        Raises:
            ParameterError: The engine cannot simulate one of the hands; no world has changed.
        """
        for setup in setups:
            self.engine.require(setup.hand_settings)
        horn = [servo_from_synergy(setup.synergy, setup.hand) for setup in setups]
        self.engine.reset(
            worlds, [_held(setup, servo) for setup, servo in zip(setups, horn, strict=True)]
        )
        self.servos.reset(
            worlds,
            horn,
            [setup.hand_settings.servo for setup in setups],
            [setup.hand_settings.servo_zero for setup in setups],
        )

    def command(self, servo: Array, duration: float) -> None:
        """Start a move in every world: to servo angles (n, 6) [rad] within a duration [s]."""
        self.servos.command(servo, duration)

    def advance(self, wrist: Array, push: Array | None = None) -> None:
        """Advance by k physics steps while the wrists follow their tables of offsets.

        Args:
            wrist: offsets of the wrists, along the world's axes, shape (n, k, 3) [m].
            push: force on the objects at their centres of mass, along the world's axes, shape (n,
                k, 3) [N]; None is no force.

        Raises:
            PhysicsError: A world's simulation failed; the message names the world.
        """
        self.engine.advance(*self.servos.advance(wrist.shape[1]), wrist, push)

    def rest(self, seconds: float) -> None:
        """Advance by a duration [s], rounded to physics steps, with the wrists at their start."""
        self.advance(np.zeros((self.engine.num_worlds, round(seconds / self.engine.dt), 3)))

    def state(self) -> SceneState:
        """Current state of every world."""
        state = self.engine.state()
        state.horn = self.servos.horn + self.servos.zero
        return state


def _held(setup: SceneSetup, servo: Array) -> SceneSetup:
    """The setup with the synergy at which its servos truly hold the hand for given encoder angles,
    shape (6,) [rad].
    """
    if not any(setup.hand_settings.servo_zero):
        return setup
    true = np.clip(
        servo + setup.hand_settings.servo_zero, setup.hand.servo_min, setup.hand.servo_max
    )
    return replace(setup, synergy=synergy_from_servo(true, setup.hand))


def is_installed(engine: str) -> bool:
    """Whether the package of an engine is installed."""
    return importlib.util.find_spec(engine) is not None


def make_engine(
    name: str, num_worlds: int = 1, settings: WorldSettings = WorldSettings(), visuals: bool = False
) -> Engine:
    """Create an engine by name.

    Args:
        name: one of `ENGINES`.
        num_worlds: n.
        settings: settings of every world.
        visuals: load visual shapes.

    Raises:
        ParameterError: Unknown engine, its package is not installed, or fewer than one world.
    """
    if num_worlds < 1:
        raise ParameterError(f"{num_worlds} worlds: at least 1 is needed")
    check_choice("engine", name, ENGINES)
    if not is_installed(name):
        raise ParameterError(
            f"engine {name!r} needs a package that is not installed: {INSTEAD[name]}"
        )
    if name == "pybullet":
        from hpac_gym.physics.pybullet.engine import PyBulletEngine as Chosen
    else:
        from hpac_gym.physics.mujoco.engine import MuJoCoEngine as Chosen
    return Chosen(num_worlds, settings, visuals)


@cache
def resting_object(spec: ObjectSpec) -> RestingObject:
    """An object with its stable poses, found by dropping it in MuJoCo.

    Raises:
        ParameterError: It has no stable pose, or MuJoCo is not installed.
    """
    if not is_installed("mujoco"):
        raise ParameterError(f"the poses of an object need MuJoCo: {INSTEAD['mujoco']}")
    from hpac_gym.physics.mujoco.resting import poses_of

    model = spec.solid_model
    return resting(model, spec.friction, poses_of(model, spec.friction))
