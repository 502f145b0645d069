"""A simulated hand behind pulses: servos that look at them, the body, an object, and the arm that
carries the hand; also the camera that sees the object.

`hpac virtual` drives it in real time; `LockStep` in virtual time, for tests and experiments."""

from collections import deque
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from hpac_gym.body.objects import ObjectSpec
from hpac_gym.bridge import VirtualHand, servo_from_pulses
from hpac_gym.deploy.arm import Arm
from hpac_gym.deploy.observer import Pose
from hpac_gym.deploy.poses import Source
from hpac_gym.envs import HandEnv
from hpac_gym.model import DIGITS, synergy_from_servo
from hpac_gym.model.checks import Array, as_finite_vector
from hpac_gym.physics.engine import SceneSetup, SceneState
from hpac_gym.tasks.cameras import CameraNoise
from hpac_gym.tasks.task import CONTROL_HZ, RUNNING

LATCH_US = 20_000
"""Period of a servo's pulses [µs]."""
LATE = 0.125
"""Time by which the arm follows what it is told: two steps, to have a smooth path, and a margin [s].
"""
LONGEST_GAP_US = 500_000
"""Time that is caught up at most, for example after a computer has slept [µs]."""
FAR = 0.5
"""Distance from the hand beyond which an object is put back [m]."""
ASIDE = 0.01
"""Way from its place beyond which an object is put back while nothing drives the hand [m]."""
OPEN = 0.15
"""Largest true flexion of the servos of an open hand, with the zeros of a hidden one [rad]."""
OPENED_AFTER_US = 3_000_000
"""Time without pulses after which somebody opens a hand that was left closed (chosen) [µs]."""
KEPT = 200
"""Offsets that an arm remembers: of seconds, much more than it is late (chosen)."""
NEVER = 1 << 62


class Path:
    """Offsets of the wrist that an arm is told, 20 a second, and follows smoothly."""

    def __init__(self) -> None:
        self._told: deque[tuple[int, Array]] = deque(maxlen=KEPT)

    def tell(self, time: float, offset: Array) -> None:
        """Take note of an offset, shape (3,) [m], for a time [s]."""
        self._told.append((round(time * CONTROL_HZ), offset))

    def at(self, time: float) -> Array:
        """The offset at a time [s]: a cubic through what was told, at rest before and after it."""
        if time <= 0:
            return np.zeros(3)
        step, share = divmod(time * CONTROL_HZ, 1.0)
        before, start, end, after = (self._of(int(step) + k) for k in (-1, 0, 1, 2))
        slope = (end - before) / 2
        last = (after - start) / 2
        bend = 3 * (end - start) - 2 * slope - last
        twist = slope + last - 2 * (end - start)
        return start + share * (slope + share * (bend + share * twist))

    def _of(self, step: int) -> Array:
        """What was told for a step, or last before it."""
        known = (offset for told, offset in reversed(self._told) if told <= step)
        return next(known, np.zeros(3))


class Body:
    """A hand in a simulated scene, its arm, and the camera.

    Args:
        env: an environment on MuJoCo, whose task judges what happens.
        seed: of the episode that is drawn, and of the camera's noise.
        setup: the scene; None draws one.
        noise: noise of the camera.
        by_table: the arm follows the task's own table instead of what it is told.

    Attributes:
        setup: the scene.
        outcome: how the task judges the episode since `begin`.
    """

    def __init__(
        self,
        env: HandEnv,
        seed: int,
        setup: SceneSetup | None = None,
        noise: CameraNoise = CameraNoise(),
        by_table: bool = False,
    ) -> None:
        self._env = env
        self._simulation = env.episodes.simulation
        self._seed = seed
        self._noise = noise
        self._rng = np.random.default_rng([seed, 9])
        self._by_table = by_table
        self._latch_us = 0
        self._at_us = 0.0
        self._powered = True
        self._driven_us = 0.0
        self.place(setup)
        self._turned: float = self._simulation.servos.horn[0, -1]

    def place(self, setup: SceneSetup | None, servo: Array | None = None) -> None:
        """Put the object at its place and the wrist at its start, the hand as its servos have it by
        their encoders, shape (6,) [rad].
        """
        if servo is not None:
            hand = setup.hand
            synergy = synergy_from_servo(np.clip(servo, hand.servo_min, hand.servo_max), hand)
            setup = replace(setup, synergy=synergy)
        # Not `reset` of the environment, which refuses a hand that its servos left in the object.
        episodes = self._env.episodes
        episodes.reset([0], [np.random.default_rng(self._seed)], None if setup is None else [setup])
        self.setup: SceneSetup = episodes.setups[0]
        self._table = self._env.task.wrist_path(self.setup, episodes.wrists.times)
        self.outcome = RUNNING
        self._path = Path()
        self._began_us: float | None = None
        self._step = 0

    def begin(self, now_us: int) -> None:
        """The arm stands at the object: an episode begins."""
        self._powered = True
        self._at_us = now_us
        self._latch_us = now_us
        self._began_us = now_us if self._by_table else None

    def tell(self, told: Mapping[str, Any]) -> None:
        """The arm is told where the wrist shall be; one with a table knows.

        Raises:
            ShapeError, KeyError, TypeError, OverflowError: It is no time and three finite numbers.
        """
        if self._by_table:
            return
        numbers = [1e6 * told["time"], *told["offset"]]
        time_us, *offset = as_finite_vector(numbers, 4, "time and offset")
        if self._began_us is None:
            self._began_us = self._at_us - time_us + 1e6 * LATE
        self._path.tell(1e-6 * time_us, np.array(offset))

    def follow(self, now_us: int, pulses: Array, by_hand: Array | None = None) -> None:
        """Advance to a time [µs]. Servos look at their pulses, shape (6,) [ns], every 20 ms; without
        any they stay where they are, or where somebody turns them by hand, shape (6,) [rad].
        """
        if now_us - self._at_us > LONGEST_GAP_US:
            self._at_us = now_us
            self._latch_us = now_us
        self._powered &= bool(pulses.all())
        if pulses.any() or by_hand is not None:
            self._driven_us = now_us
        while self._latch_us <= now_us:
            self._advance(self._latch_us)
            servo = servo_from_pulses(pulses) if pulses.all() else by_hand
            if servo is not None:
                self._simulation.command(servo[None], self._simulation.engine.dt)
            self._latch_us += LATCH_US
        self._advance(now_us)

    def _advance(self, until_us: float) -> None:
        """Advance the physics; the task looks 20 times a second."""
        simulation = self._simulation
        dt = simulation.engine.dt
        looks = round(self._env.dt / dt)
        while (steps := int((until_us - self._at_us) / (1e6 * dt) + 1e-6)) > 0:
            steps = min(steps, looks - self._step % looks)
            simulation.advance(self._wrist(steps, dt)[None])
            self._step += steps
            self._at_us += 1e6 * steps * dt
            if self._step % looks == 0 and self._began_us is not None and self.outcome == RUNNING:
                state = simulation.state()
                state.time[0] = max(self._at_us - self._began_us, 0.0) * 1e-6
                self._env.task.watch(state, self._env.dt, simulation.engine.contacts)
                self.outcome = int(self._env.task.judge(state, self._env.dt)[0])

    def _wrist(self, steps: int, dt: float) -> Array:
        """Offsets of the wrist in the next physics steps, shape (steps, 3) [m]."""
        if self._by_table:
            return self._table[np.minimum(self._step + np.arange(steps), len(self._table) - 1)]
        if self._began_us is None:
            return np.zeros((steps, 3))
        since = (self._at_us - self._began_us) * 1e-6
        return np.array([self._path.at(since + dt * (i + 1)) for i in range(steps)])

    def state(self) -> SceneState:
        """The true state of the scene."""
        return self._simulation.state()

    @property
    def _idle_us(self) -> int:
        """Time for which nothing has driven the hand [µs]."""
        return round(self._at_us - self._driven_us)

    def tidy_up(self, state: SceneState) -> None:
        """Somebody puts the object back when an episode is over, that is, its pulses were off since
        it began, or the object far away, or aside while nothing drives the hand, and the hand open.
        A hand that stays closed without pulses, as after an ESTOP, is opened then.
        """
        over = self._began_us is not None and not self._powered
        lost = np.linalg.norm(state.object_pos[0]) > FAR
        moved = np.linalg.norm(state.object_pos[0] - self.setup.position) > ASIDE
        closed = state.horn[0, : len(DIGITS)].max() >= OPEN
        if closed and self._idle_us < OPENED_AFTER_US:
            return
        if over or lost or (moved and self._idle_us > 0):
            self.put_back()

    def put_back(self) -> None:
        """Put the object and the wrist back, the hand as its servos have it. Where nothing drives it,
        somebody opens it and turns the thumb to where it was at first: elsewhere it may lie in the
        object.
        """
        servo = self._simulation.servos.horn[0].copy()
        if self._idle_us > 0:
            servo = np.append(np.zeros(len(DIGITS)), self._turned)
        self.place(self.setup, servo)

    def seen(self, state: SceneState) -> Pose:
        """The object of a state as a camera sees it, in the hand's frame."""
        place = state.object_pos[0] + self._noise.position * self._rng.standard_normal(3)
        turn = Rotation.from_rotvec(self._noise.angle * self._rng.standard_normal(3))
        seen = turn * Rotation.from_matrix(state.object_rotation[0])
        return Pose(place, tuple(seen.as_quat().tolist()))


class LockStep(Source, Arm):
    """A body in virtual time, with the firmware that drives it: source of poses and arm of an
    episode. Nothing moves before the arm is ready, nor after the outcome.

    Args:
        env: an environment on MuJoCo.
        seed, setup, noise, by_table: as for `Body`.

    Attributes:
        body: the body.
        hand: the firmware, for `HandLink(hand.connect)`.
        seen_object: the object as the camera measures it.
    """

    def __init__(
        self,
        env: HandEnv,
        seed: int,
        setup: SceneSetup | None = None,
        noise: CameraNoise = CameraNoise(),
        by_table: bool = True,
    ) -> None:
        self.body = Body(env, seed, setup, noise, by_table)
        error = 1 + noise.size * self.body._rng.standard_normal()
        item = self.body.setup.object
        half = tuple(side * error for side in item.half_extents)
        self.seen_object = ObjectSpec(item.shape, half, 0.1, 0.8)
        self.tell = self.body.tell
        self.hand = VirtualHand(on_pulses=self._on_pulses, quiet_until_us=NEVER)

    def _on_pulses(self, now_us: int, pulses: Array) -> None:
        self.body.follow(now_us, pulses)
        running = self.body.outcome == RUNNING
        self.hand.quiet_until_us = self.body._latch_us if running else NEVER

    def ready(self, wait: Any, told: Mapping[str, Any]) -> None:
        """The arm's table and the physics begin."""
        if not self.body._by_table:
            self.body.place(self.body.setup, servo_from_pulses(self.hand.pulses()))
        self.body.begin(self.hand.now_us)
        self.hand.quiet_until_us = self.hand.now_us

    def latest(self) -> tuple[Pose, float]:
        """The object as a camera sees it."""
        if self.hand.quiet_until_us < NEVER:
            self.body.follow(self.hand.now_us, self.hand.pulses())
        return self.body.seen(self.body.state()), 0.0
