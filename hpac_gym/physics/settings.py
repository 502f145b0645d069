"""Settings of the simulated hand and its world, as data for every engine."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf, pi
from types import MappingProxyType

from hpac_gym.settings import check_bounds, setting

GRAVITY = 9.81
"""Gravitational acceleration [m/s²]."""


@dataclass(frozen=True, slots=True)
class ServoSettings:
    """Data-sheet parameters of a servo.

    Raises:
        ParameterError: A speed that is not positive, or a negative dead band or lag.
    """

    speed: float = setting(8.0, bounds=(0.0, inf), above=True, unit="rad/s")
    """No-load speed of the horn [rad/s]; chosen: 0.13 s/60°, a common hobby servo."""
    dead_band: float = setting(2e-3, bounds=(0.0, inf), unit="rad")
    """Largest error that causes no motion [rad]; chosen: 1.3 µs of pulse, a digital servo."""
    lag: float = setting(0.0, bounds=(0.0, inf), unit="s")
    """Delay from the ramp to the servo's response: transport, electronics, filtering [s]; rounded
    to physics steps.
    """

    def __post_init__(self) -> None:
        check_bounds(self, "servo")


@dataclass(frozen=True, slots=True)
class Damping:
    """Damping of tendons and joints.

    Raises:
        ParameterError: A negative value.
    """

    ratio: float = setting(0.3, bounds=(0.0, inf))
    """Damping ratio of each tendon with the inertia that it moves."""
    joint: float = setting(5e-3, bounds=(0.0, inf), unit="N·m·s/rad")
    """Viscous friction of every joint [N·m·s/rad]."""
    overrun: float = setting(1.0, bounds=(0.0, inf))
    """Fraction of its damping that a slack drive keeps against flexion faster than its servo's; in
    MuJoCo a taut one has it in addition. The twin's armature represents servos, which stop at their
    target: without this a finger would overshoot with inertia that is not its own."""

    def __post_init__(self) -> None:
        check_bounds(self, "damping")


TIGHTEST = 1e-4
"""Largest shortening of a driving tendon [m]: with the stiffness of `hpac.toml` it then pulls with
25 N at rest.
"""


@dataclass(frozen=True, slots=True)
class HandSettings:
    """Settings of the simulated hand beyond the model's parameters.

    Raises:
        ParameterError: A field has the wrong number of values or leaves its bounds.
    """

    servo: ServoSettings = ServoSettings()
    damping: Damping = Damping()
    slack: tuple[float, ...] = setting((0.0,) * 5, bounds=(-TIGHTEST, inf), size=5, unit="m")
    """Slack that each driving tendon winds up before it pulls, by digit [m]; negative for a tendon
    that pulls at rest.
    """
    strength: tuple[float, ...] = setting((1.0,) * 5, bounds=(0.0, 1.0), size=5)
    """Fraction of its stall force that each driving tendon can exert, by digit; 0 is a dead digit.
    """
    servo_zero: tuple[float, ...] = setting((0.0,) * 6, bounds=(-pi, pi), size=6, unit="rad")
    """True angle of each servo's horn when its encoder reads 0 [rad]."""
    joint_friction: float = setting(0.0, bounds=(0.0, inf), unit="N·m")
    """Coulomb friction of every joint [N·m]."""
    tendon_friction: float = setting(0.0, bounds=(0.0, 1.0))
    """Fraction of the tendons' load that every joint's guides hold back as friction, in addition to
    `joint_friction`.
    """
    armature: tuple[float, float, float] = setting(
        (3.2e-3, 1.2e-3, 3.6e-4), bounds=(0.0, inf), size=3, unit="kg·m²"
    )
    """Inertia added about each MCP, MP and CMC, about each PIP and IP, and about each DIP [kg·m²].
    """
    hub_inertia: float = setting(0.0, bounds=(0.0, inf), unit="kg·m²")
    """Inertia of a servo's gears and rotor, reflected to its hub [kg·m²]; it moves with the driving
    tendon. See `BODIES`.
    """
    contact_friction: float = setting(0.9, bounds=(0.0, inf), above=True)
    """Coulomb coefficient of the hand's skin, to be multiplied by the object's."""

    def __post_init__(self) -> None:
        check_bounds(self)


BODIES: Mapping[str, HandSettings] = MappingProxyType(
    {
        "twin": HandSettings(),
        "light": HandSettings(armature=(0.0, 0.0, 0.0), hub_inertia=1.3e-3),
    }
)
"""The named bodies. *twin* carries armatures on its joints, which explicit integration needs: they
change no static force, and keep the stiffest tendon's ω dt below 1.5 at 120 Hz. *light*, like the
real hand, has the links' and the servo hubs' own inertia.

The hub's 1.3e-3 kg·m² are those of a DYNAMIXEL XL-320, the nearest servo to this hand's (0.39 N·m
stall torque for the 0.32 N·m that pull 40 N on an 8 mm hub) with measured values: Rhoban's Better
Actuator Models identified 1.1e-3 to 1.5e-3 kg·m² at its horn (github.com/Rhoban/bam, params/xl320;
the XL-330, 0.52 N·m, has 1.8e-3). Through the data sheet's 238:1 gear that is a rotor of 2.3e-8
kg·m²: 3 g of iron, 8 mm wide. At 120 Hz the fingers come to rest from 3e-4 kg·m² on, and chatter
without any."""


@dataclass(frozen=True, slots=True)
class WorldSettings:
    """Settings of the integration; `docs/physics.md` has the measurements behind the numbers.

    Raises:
        ParameterError: A rate that is not positive, negative iterations or torsion, a wrist without
            force, or an error reduction outside ]0, 1].
    """

    physics_hz: int = setting(120, bounds=(0, inf), above=True, unit="Hz")
    """Physics steps per second."""
    gravity: float = setting(GRAVITY, bounds=(-inf, inf), unit="m/s²")
    """Gravitational acceleration along −z [m/s²]."""
    collisions: bool = True
    """False lets the hand pass through itself and everything else."""
    solver_iterations: int = setting(0, bounds=(0, inf))
    """Iterations of Bullet's iterative solver; 200 are enough. 0 selects its direct solver, which
    is faster, but holds an object that fingers squeeze out only within half of the friction
    cone."""
    error_reduction: float = setting(0.4, bounds=(0.0, 1.0), above=True)
    """Fraction of a penetration, or of a joint-limit violation, that a PyBullet step corrects
    (Bullet's ERP).
    """
    torsion: float | None = setting(None, bounds=(0.0, inf), number=True, unit="m")
    """Torsional friction torque of a contact with the object, per newton of normal force [m]. None
    is the engine's own: 5 mm in MuJoCo (`hpac_gym.physics.mjcf.TORSION`), 0 in PyBullet, whose
    direct solver knows none."""
    wrist_effort: float | None = setting(None, bounds=(0.0, inf), above=True, number=True, unit="N")
    """Largest force of the wrist along each axis [N]. None is the engine's own:
    `hpac_gym.body.urdf.WRIST_EFFORT` in PyBullet, no limit in MuJoCo, where a limited wrist is
    softer and lags by a quarter of a millimetre under the hand's weight."""

    def __post_init__(self) -> None:
        check_bounds(self)

    @property
    def dt(self) -> float:
        """Physics step [s]."""
        return 1.0 / self.physics_hz
