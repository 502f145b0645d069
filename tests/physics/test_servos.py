"""The servos' motion against the law of one servo, written here a second time, and in the hand."""

import numpy as np
import pytest

from hpac_gym.errors import ParameterError
from hpac_gym.physics.engine import Viewpoint
from hpac_gym.physics.servos import Servos
from hpac_gym.physics.settings import Damping, HandSettings, ServoSettings, WorldSettings

DT = 1 / 120


class OneServo:
    """A ramp, a lag of whole steps, a speed limit and a dead band, in plain numbers."""

    def __init__(self, horn: float, settings: ServoSettings) -> None:
        self.horn = self.start = self.target = horn
        self.passed = 1.0
        self.duration = 1.0
        self.settings = settings
        self.queue = [horn] * round(settings.lag / DT)

    def ramp(self) -> float:
        return self.start + min(self.passed / self.duration, 1.0) * (self.target - self.start)

    def command(self, target: float, duration: float) -> None:
        self.start = self.ramp()
        self.target = target
        self.passed = 0.0
        self.duration = duration

    def step(self) -> tuple[float, float]:
        self.passed += DT
        self.queue.append(self.ramp())
        error = self.queue.pop(0) - self.horn
        moved = 0.0
        if abs(error) > self.settings.dead_band:
            moved = max(-self.settings.speed * DT, min(self.settings.speed * DT, error))
        self.horn += moved
        return self.horn, moved / DT


SETTINGS = [
    ServoSettings(),
    ServoSettings(speed=1.0, dead_band=0.03, lag=0.05),
    ServoSettings(speed=3.0, lag=0.15),
]


def test_every_world_follows_the_law_of_one_servo_through_commands_and_resets():
    rng = np.random.default_rng(0)
    servos = Servos(3, DT)
    expected = {}

    def reset(worlds: list[int]) -> None:
        angles = rng.uniform(0.0, 1.0, (len(worlds), 6))
        servos.reset(worlds, angles, [SETTINGS[world] for world in worlds])
        expected.update(
            {
                world: [OneServo(a, SETTINGS[world]) for a in row]
                for world, row in zip(worlds, angles, strict=True)
            }
        )

    reset([0, 1, 2])
    for step in range(40):
        if step % 9 == 8:
            reset([[0], [2, 1], [2], [1]][step // 9])
        target = rng.uniform(0.0, 1.5, (3, 6))
        duration = rng.choice([0.02, 0.05, 0.3])
        servos.command(target, duration)
        for world, row in expected.items():
            for servo, angle in zip(row, target[world], strict=True):
                servo.command(angle, duration)
        angle, speed = servos.advance(6)
        law = np.array(
            [[[servo.step() for _ in range(6)] for servo in expected[world]] for world in range(3)]
        )
        np.testing.assert_allclose(angle, law[..., 0].transpose(0, 2, 1), atol=1e-12)
        np.testing.assert_allclose(speed, law[..., 1].transpose(0, 2, 1), atol=1e-9)
        np.testing.assert_array_equal(servos.horn, angle[:, -1])


def test_no_step_moves_nothing():
    servos = Servos(1, DT)
    servos.command(np.ones((1, 6)), 0.5)
    angle, speed = servos.advance(0)
    assert angle.shape == speed.shape == (1, 0, 6)
    np.testing.assert_array_equal(servos.horn, 0.0)


@pytest.mark.parametrize(
    ("settings", "name", "value", "message"),
    [
        (
            ServoSettings,
            "speed",
            0.0,
            r"servo speed = 0.0 rad/s must be a number within \]0, inf\[ rad/s",
        ),
        (
            ServoSettings,
            "dead_band",
            -1.0,
            r"servo dead_band = -1.0 rad must be a number within \[0, inf\[ rad",
        ),
        (Damping, "joint", -1.0, r"damping joint = -1.0 N·m·s/rad"),
        (HandSettings, "slack", (-1e-3,) * 5, "slack = .* m must be 5 values within"),
        (HandSettings, "slack", (0.0, *[float("nan")] * 4), "slack = .* m must be 5 values within"),
        (
            HandSettings,
            "strength",
            (1.0, 1.0, 1.2, 1.0, 1.0),
            "strength = .* must be 5 values within",
        ),
        (HandSettings, "servo_zero", (0.0,) * 5, "servo_zero = .* rad must be 6 values within"),
        (HandSettings, "joint_friction", float("nan"), "joint_friction = nan N·m must be a number"),
        (HandSettings, "tendon_friction", -0.1, "tendon_friction = -0.1 must be a number within"),
        (HandSettings, "armature", (1.0,), r"armature = \(1.0,\) kg·m² must be 3 values within"),
        (HandSettings, "hub_inertia", -1.0, "hub_inertia = -1.0 kg·m²"),
        (HandSettings, "contact_friction", 0.0, r"contact_friction = 0.0 must .* \]0, inf\["),
        (WorldSettings, "physics_hz", 0, "physics_hz = 0 Hz"),
        (WorldSettings, "torsion", -1.0, "torsion = -1.0 m"),
        (WorldSettings, "wrist_effort", 0.0, "wrist_effort = 0.0 N"),
        (Viewpoint, "distance", 0.0, "picture distance = 0.0 m must be a number"),
    ],
)
def test_settings_name_the_bad_value(settings, name, value, message):
    with pytest.raises(ParameterError, match=message):
        settings(**{name: value})
