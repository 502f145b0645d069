"""A virtual hand in real time: body, board, wire, arm and camera."""

import json
import select
import time
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

import numpy as np

from hpac_gym.bridge import (
    BridgeError,
    HostBoard,
    PortError,
    open_transport,
    servo_from_pulses,
)
from hpac_gym.bridge.stop import UNCONFIRMED, stop
from hpac_gym.calibration.record import JOINT_COLUMNS
from hpac_gym.command import say
from hpac_gym.deploy import arm as arms, poses
from hpac_gym.deploy.errors import MALFORMED, VERSION, packet, udp
from hpac_gym.model.checks import Array
from hpac_gym.output import Lines
from hpac_gym.physics.engine import PhysicsError, SceneState
from hpac_gym.tasks.posture import CAMERA_NOISE
from hpac_gym.tasks.task import OUTCOMES, RUNNING
from hpac_gym.virtual.body import Body
from hpac_gym.virtual.wire import Relay

POSE_HZ = 60
"""Poses a second, and looks at the pulses."""


class Tracker(Lines):
    """A camera that measures the joints, as a file of angles for `hpac sweep --angles`.

    Raises:
        OutputError: The file cannot be written.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._rng = np.random.default_rng(0)
        self.append(",".join(("time_s", *JOINT_COLUMNS)))

    def write(self, joint_pos: Array) -> None:
        """Write joint angles, shape (15,) [rad], with the camera's noise."""
        seen = joint_pos + CAMERA_NOISE * self._rng.standard_normal(len(joint_pos))
        self.append(",".join((f"{time.time():.4f}", *(f"{angle:.5f}" for angle in seen))))


class Virtual:
    """A body, the board that drives it, its arm and its camera, in real time.

    Args:
        body: the body.
        board: the running firmware.
        relay: a bad wire in front of it.
        arm_port: UDP port at which the arm is told; 0 is a free one.
        pose_port: UDP port to which poses are sent; 0 is a free one.
        blind: time from the beginning of an episode to the loss of its object [s].
        as_json: whether outcomes are told as JSON.

    Raises:
        DeployError: A port cannot be opened.

    Attributes:
        port: the hand's port.
        page: a `hpac_gym.view.page.HandPage`, or None.
        tracker: a `Tracker`, or None.
        stopped: what came of the page's ESTOP, until there are pulses again.
        arm_port, pose_port: the UDP ports.
    """

    def __init__(
        self,
        body: Body,
        board: HostBoard,
        relay: Relay | None = None,
        arm_port: int = 0,
        pose_port: int = 0,
        blind: float = np.inf,
        as_json: bool = False,
    ) -> None:
        self.body = body
        self.port = relay.port if relay else board.port
        self._board = board
        self._relay = relay
        self._arm = udp(f"UDP port {arm_port}", "127.0.0.1", arm_port, bind=True)
        self.arm_port = self._arm.getsockname()[1]
        with udp("a free port", "127.0.0.1", 0, bind=True) as probe:
            self.pose_port = pose_port or probe.getsockname()[1]
        self._camera = udp(f"UDP port {self.pose_port}", "127.0.0.1", self.pose_port)
        self._began = time.monotonic()
        self._due = 0.0
        self._phase = ""
        self._episodes = 0
        self._told = RUNNING
        self._driven = False
        self.stopped = ""
        self.page: Any = None
        self.tracker: Tracker | None = None
        self._blind = blind
        self._as_json = as_json
        self._seen_until = np.inf

    def turn(self) -> None:
        """Wait until there is something to do, and do it; to be called again and again.

        Raises:
            PortError: The board has ended.
        """
        now = time.monotonic() - self._began
        until = min(self._due, self._relay.due() if self._relay else np.inf)
        watched = [self._arm, *(self._relay.descriptors() if self._relay else ())]
        select.select(watched, [], [], max(until - now, 0.0))
        now = time.monotonic() - self._began
        if self._relay:
            self._relay.turn(now)
        self._hear(round(1e6 * now))
        if now >= self._due:
            self._due = max(self._due + 1 / POSE_HZ, now)
            if self._board.process.poll() is not None:
                raise PortError(f"{self.port}: the board behind it has ended")
            pulses = self._board.pulses()
            by_hand = self.page.wanted() if self.page else None
            try:
                self.body.follow(round(1e6 * now), pulses, by_hand)
            except PhysicsError as error:
                said = f"{error}; everything is put back"
                say(self._as_json, said, episode=self._episodes, error=str(error))
                self.body.place(self.body.setup)
            state = self.body.state()
            self.body.tidy_up(state)
            if not pulses.any():  # an episode that was given up before the hand closed is over, too
                self._phase = ""
                self._seen_until = np.inf
            if now < self._seen_until:
                seen = self.body.seen(state)
                told = {"position": seen.position.tolist(), "quaternion": seen.quaternion}
                with suppress(OSError):  # nobody listens
                    self._camera.send(json.dumps({poses.PACKET: VERSION, **told}).encode())
            if self.body.outcome not in (RUNNING, self._told):
                self._told = self.body.outcome
                outcome = OUTCOMES[self._told]
                said = f"episode {self._episodes}: {outcome}"
                say(self._as_json, said, episode=self._episodes, outcome=outcome)
            if self.tracker:
                self.tracker.write(state.joint_pos[0])
            if self.page:
                self._show(state, pulses)

    def _show(self, state: SceneState, pulses: Array) -> None:
        """Show the hand on the page, whose sliders drive it while no program does."""
        from hpac_gym.view.page import Shown

        if self.page.object_back.is_set():
            self.page.object_back.clear()
            self.body.put_back()
        if self.page.due():
            driven = bool(pulses.any())
            if driven and not self._driven:
                self.stopped = ""
            self._driven = driven
            self.page.free(not driven)
            servo = servo_from_pulses(pulses) if pulses.all() else self.page.wanted()
            outcome = f"episode {self._episodes}: {OUTCOMES[self.body.outcome]}"
            driver = "A program drives the hand. " if driven else "The sliders drive the hand. "
            text = (self.stopped or driver) + outcome * bool(self._episodes)
            self.page.show(Shown.of_state(state, servo, text))

    def _hear(self, now_us: int) -> None:
        """The arm does what it is told; what is no packet is ignored."""
        while True:
            try:
                data, address = self._arm.recvfrom(4096)
            except OSError:
                return
            with suppress(OSError, *MALFORMED):
                told = packet(data, arms.PACKET)
                if told["phase"] != "ready":
                    self.body.tell(told)
                elif self._phase != "ready":
                    # Its thumb has swept the scene when it was armed, or it has kept its power since.
                    if not self._phase or self.body.outcome != RUNNING:
                        self.body.put_back()
                    self.body.begin(now_us)
                    self._seen_until = 1e-6 * now_us + self._blind
                    self._told = RUNNING
                    self._episodes += 1
                self._phase = told["phase"]
                if self._phase == "ready":
                    answer = json.dumps({arms.PACKET: VERSION, "ready": True})
                    self._arm.sendto(answer.encode(), address)

    def estop(self) -> None:
        """Stop the hand, as `hpac estop` does, from any thread; `stopped` tells what came of it."""
        try:
            with closing(open_transport(self._board.port, lock=False)) as transport:
                stop(transport)
            self.stopped = f"Stopped: fault estop until `hpac clear --port {self.port}`. "
        except BridgeError as error:
            self.stopped = UNCONFIRMED.format(error)

    def close(self) -> None:
        """Close the sockets."""
        self._arm.close()
        self._camera.close()
