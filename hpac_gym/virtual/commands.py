"""``hpac virtual``: a hand for those who have none, behind a port like that of a real one.

The real firmware runs in a process of its own behind a pseudo-terminal. Its pulses drive a simulated
body with an object; an arm does what `hpac deploy --arm` tells it; a camera sends poses."""

from __future__ import annotations

import argparse
import json
import select
import signal
import socket
import sys
import time
from contextlib import ExitStack, closing, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hpac_gym.body.geometry import HPAC_GEOMETRY
from hpac_gym.body.hands import hand_set
from hpac_gym.bridge import BridgeError, HostBoard, open_transport, servo_from_pulses
from hpac_gym.bridge.stop import stop
from hpac_gym.calibration.record import JOINT_COLUMNS
from hpac_gym.command import add_json, say, seconds, whole_number
from hpac_gym.deploy import arm as arms
from hpac_gym.deploy import poses
from hpac_gym.deploy.commands import object_of
from hpac_gym.errors import ParameterError
from hpac_gym.evaluation.environment import make_env
from hpac_gym.model import DIGITS, HPAC, SERVOS, synergy_from_servo
from hpac_gym.model.checks import Array
from hpac_gym.output import OutputError
from hpac_gym.physics.engine import PhysicsError, SceneSetup, SceneState
from hpac_gym.registration import GRASP, GRASP_ANY, PICK_PLACE
from hpac_gym.tasks.posture import CAMERA_NOISE
from hpac_gym.tasks.task import OUTCOMES, RUNNING
from hpac_gym.virtual.body import Body
from hpac_gym.virtual.wire import Faults, Relay

POSE_HZ = 60
"""Poses a second, and looks at the pulses."""
POLICIES = {GRASP: "grasp", GRASP_ANY: "grasp-any", PICK_PLACE: "pick-place"}
"""Environments whose scenes there are, and the shipped policy of each."""
CAN = "cylinder:0.02,0.05"
"""The object where nothing else is asked for."""
IN_REACH = (0.0285, 0.0, 0.12)
"""Place of the palm's side of the object in the hand's frame, without a seed [m]; chosen: the thumb
does not touch a can there on its way, and the policy, and five digits that close together, hold it.
"""
ABOUT = "A virtual hand: the real firmware, whose pulses drive a simulated body."
OUT_OF_REACH = np.array([0.35, 0.0, 0.12])
"""Place of the object while the hand is swept, in the hand's frame [m]."""
FRICTION = (0.0, 5e-3)
SKIN = (0.8, 1.2)
"""Ranges of a hidden hand's Coulomb friction of the joints [N·m] and of the factor of its skin's
friction, beside what `hpac_gym.body.hands` draws; those of the randomization `hand`.
"""


def add_scene(parser: argparse.ArgumentParser) -> None:
    """The arguments of a scene."""
    parser.add_argument(
        "--env", default=GRASP, choices=POLICIES, metavar="ID", help=f"scene ({GRASP})"
    )
    parser.add_argument("--grasp", metavar="NAME", help="scene of one of the sixteen named grasps")
    parser.add_argument(
        "--object",
        metavar="SHAPE:M,M",
        help=f"the object ({CAN}; with --seed one that is drawn)",
    )
    parser.add_argument(
        "--seed", type=whole_number(0), help="draw a hand that is not the nominal one, and a scene"
    )


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `hpac virtual`."""
    add_scene(parser)
    parser.add_argument(
        "--reveal", action="store_true", help="tell at once, not at the end, what was drawn"
    )
    parser.add_argument("--pose-port", type=int, default=0, help="UDP port that poses go to (free)")
    parser.add_argument("--arm-port", type=int, default=0, help="UDP port of the arm (a free one)")
    for name, help_text in (
        ("loss", "share of the frames that are lost, in each direction"),
        ("damage", "share of the frames that are damaged"),
        ("jitter", "the host's frames are late by up to this [s]"),
        ("latency", "the hand's frames are late by this [s], 0.016 for many USB adapters"),
    ):
        parser.add_argument(f"--{name}", type=float, default=0.0, metavar="X", help=help_text)
    parser.add_argument(
        "--heat", type=whole_number(0), default=0, metavar="PERCENT", help="heat of its servos"
    )
    parser.add_argument(
        "--blind",
        type=seconds,
        default=np.inf,
        metavar="S",
        help="the camera loses the object so long after an episode has begun, until the pulses are off [s]",
    )
    parser.add_argument(
        "--angles",
        type=Path,
        metavar="CSV",
        help="it stands before a camera, its object out of reach: its joint angles, for `hpac sweep`",
    )
    parser.add_argument(
        "--reset-on-open", action="store_true", help="the board restarts when its port is opened"
    )
    parser.add_argument("--view", action="store_true", help="show it in the browser")
    parser.add_argument("--no-browser", action="store_true", help="print the page's address only")
    add_json(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Be a hand until Ctrl-C."""
    faults = Faults(options.loss, options.damage, options.jitter, options.latency)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with ExitStack() as stack:
        env = stack.enter_context(env_of(options))
        setup = scene(env.unwrapped, options.env, options.seed)
        if options.angles:
            setup = replace(setup, position=OUT_OF_REACH)
        body = Body(env.unwrapped, options.seed or 0, setup)
        words = ("--boot-text",) * options.reset_on_open + ("--heat", str(options.heat))
        board = stack.enter_context(HostBoard(words))
        relay = None
        if faults != Faults() or options.reset_on_open:
            relay = Relay(board, faults, options.seed or 0, options.reset_on_open)
            stack.callback(relay.close)
        hand = Virtual(body, board, relay, options.arm_port, options.pose_port)
        stack.callback(hand.close)
        hand.blind = options.blind
        hand.as_json = options.json
        if options.angles:
            hand.tracker = Tracker(options.angles)
            stack.callback(hand.tracker.close)
        if options.view:
            from hpac_gym.view.page import HandPage

            hand.page = HandPage(
                setup, ABOUT, stop=partial(_estop, board), browser=not options.no_browser
            )
            stack.callback(hand.page.close)
        try:
            ports = {"pose_port": hand.pose_port, "arm_port": hand.arm_port}
            say(options.json, _greeting(options, hand, setup), port=hand.port, **ports)
            while True:
                hand.turn()
        except KeyboardInterrupt:
            print(file=sys.stderr)
        if not options.reveal:
            drawn = _revealed(options.seed, setup)
            say(options.json, drawn, drawn=drawn.splitlines())
    return 0


def _estop(board: HostBoard) -> None:
    """Stop the hand from the page's thread, as `hpac estop` does."""
    with suppress(BridgeError), closing(open_transport(board.port, lock=False)) as transport:
        stop(transport)


def env_of(options: argparse.Namespace) -> Any:
    """The environment of a scene."""
    more: dict[str, Any] = {}
    if options.env != GRASP and (options.grasp or options.object):
        raise ParameterError(
            f"--grasp and --object are of {GRASP}; {options.env} has its own object"
        )
    if options.grasp:
        more["grasp"] = options.grasp
    elif options.env == GRASP and (options.object or options.seed is None):
        more["object"] = object_of(options.object or CAN)
    return make_env(options.env, engine="mujoco", body="light", **more)


def scene(env: Any, env_id: str, seed: int | None) -> SceneSetup:
    """The scene of a seed, with the hand open; a seed hides a hand from the set ``train`` in it."""
    env.reset(seed=seed or 0)
    setup = env.episodes.setups[0]
    if env_id != GRASP:  # an `Observer` has drawn the same orientation and target
        drawn = env.task.setup(np.random.default_rng(0), HPAC)
        setup = replace(drawn, hand_settings=setup.hand_settings)
    if seed is not None:
        rng = np.random.default_rng([seed, 7])
        variants = hand_set("train")
        variant = variants[rng.integers(len(variants))]
        settings = replace(
            variant.over(setup.hand_settings),
            joint_friction=rng.uniform(*FRICTION),
            contact_friction=setup.hand_settings.contact_friction * rng.uniform(*SKIN),
        )
        setup = replace(setup, hand=variant.hand, geometry=variant.geometry, hand_settings=settings)
    elif env_id == GRASP and setup.object.model is None:
        x, y, z = IN_REACH
        setup = replace(setup, position=np.array([x + setup.object.half_extents[0], y, z]))
    rest = np.clip(0.0, setup.hand.servo_min, setup.hand.servo_max)
    return replace(setup, synergy=synergy_from_servo(rest, setup.hand))


class Tracker:
    """A camera that measures the joints, as a file of angles for `hpac sweep --angles`.

    Raises:
        OutputError: The file cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self._rng = np.random.default_rng(0)
        try:
            self._file = path.open("w", encoding="utf-8", buffering=1)
        except OSError as error:
            raise OutputError(f"cannot write '{path}': {error.strerror}") from None
        print("time_s", *JOINT_COLUMNS, sep=",", file=self._file)

    def write(self, joint_pos: Array) -> None:
        """Write joint angles, shape (15,) [rad], with the camera's noise."""
        seen = joint_pos + CAMERA_NOISE * self._rng.standard_normal(len(joint_pos))
        row = [f"{angle:.5f}" for angle in seen]
        print(f"{time.time():.4f}", *row, sep=",", file=self._file)

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class Virtual:
    """A body, the board that drives it, its arm and its camera, in real time.

    Args:
        body: the body.
        board: the running firmware.
        relay: a bad wire in front of it.
        arm_port: UDP port at which the arm is told; 0 is a free one.
        pose_port: UDP port to which poses are sent; 0 is a free one.

    Raises:
        ParameterError: A port cannot be opened.

    Attributes:
        port: the hand's port.
        page: a `hpac_gym.view.page.HandPage`, or None.
        tracker: a `Tracker`, or None.
        as_json: whether outcomes are told as JSON.
        blind: time from the beginning of an episode to the loss of its object [s].
        arm_port, pose_port: the UDP ports.
    """

    def __init__(
        self, body: Body, board: HostBoard, relay: Relay | None, arm_port: int, pose_port: int
    ) -> None:
        self.body = body
        self.port = relay.port if relay else board.port
        self._board = board
        self._relay = relay
        self._arm = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._arm.setblocking(False)
        self._camera = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._camera.setblocking(False)
        try:
            self._arm.bind(("127.0.0.1", arm_port))
            self.pose_port = pose_port or _free_port()
            self._camera.connect(("127.0.0.1", self.pose_port))
        except (OSError, OverflowError) as error:
            self.close()
            raise ParameterError(f"UDP port {arm_port or pose_port}: {error}") from None
        self.arm_port = self._arm.getsockname()[1]
        self._began = time.monotonic()
        self._due = 0.0
        self._phase = ""
        self._episodes = 0
        self._told = RUNNING
        self.page: Any = None
        self.tracker: Tracker | None = None
        self.blind = np.inf
        self._seen_until = np.inf

    def turn(self) -> None:
        """Wait until there is something to do, and do it; to be called again and again."""
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
            pulses = self._board.pulses()
            by_hand = self.page.wanted() if self.page else None
            try:
                self.body.follow(round(1e6 * now), pulses, by_hand)
            except PhysicsError as error:
                said = f"{error}; everything is put back"
                say(self.as_json, said, episode=self._episodes, error=str(error))
                self.body.place(self.body.setup)
            state = self.body.state()
            self.body.tidy_up(state)
            if not pulses.any():
                self._seen_until = np.inf
            if now < self._seen_until:
                self._see(state)
            self._judge()
            if self.tracker:
                self.tracker.write(state.joint_pos[0])
            if self.page:
                self._show(state, pulses)

    def _see(self, state: SceneState) -> None:
        """Send the object's pose."""
        pose = self.body.seen(state)
        packet = {poses.PACKET: poses.VERSION, "position": pose.position.tolist()}
        with suppress(OSError):  # nobody listens
            self._camera.send(json.dumps(packet | {"quaternion": pose.quaternion}).encode())

    def _show(self, state: SceneState, pulses: Array) -> None:
        """Show the hand on the page, whose sliders drive it while no program does."""
        from hpac_gym.view.page import Shown

        if self.page.wants_object_back():
            self.body.place(self.body.setup, state.horn[0])
        if self.page.due():
            driven = bool(pulses.any())
            self.page.free(not driven)
            servo = servo_from_pulses(pulses) if pulses.all() else self.page.wanted()
            outcome = f"episode {self._episodes}: {OUTCOMES[self.body.outcome]}"
            driver = "A program drives the hand. " if driven else "The sliders drive the hand. "
            self.page.show(Shown.of_state(state, servo, driver + outcome * bool(self._episodes)))

    def _hear(self, now_us: int) -> None:
        """The arm does what it is told; what is no packet is ignored."""
        while True:
            try:
                data, address = self._arm.recvfrom(4096)
            except OSError:
                return
            try:
                told = json.loads(data)
                if told[arms.PACKET] != arms.VERSION:
                    continue
                if told["phase"] != "ready":
                    self.body.tell(told)
                elif self._phase != "ready":
                    if self.body.outcome != RUNNING:  # the hand may have kept its power since
                        self.body.place(self.body.setup, self.body.state().horn[0])
                    self.body.begin(now_us)
                    self._seen_until = 1e-6 * now_us + self.blind
                    self._told = RUNNING
                    self._episodes += 1
                self._phase = told["phase"]
                if self._phase == "ready":
                    answer = json.dumps({arms.PACKET: arms.VERSION, "ready": True})
                    self._arm.sendto(answer.encode(), address)
            except (OSError, ValueError, KeyError, TypeError):
                continue

    def _judge(self) -> None:
        """Tell the outcome of an episode once."""
        if self.body.outcome not in (RUNNING, self._told):
            self._told = self.body.outcome
            outcome = OUTCOMES[self._told]
            said = f"episode {self._episodes}: {outcome}"
            say(self.as_json, said, episode=self._episodes, outcome=outcome)

    def close(self) -> None:
        """Close the sockets."""
        self._arm.close()
        self._camera.close()


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def _greeting(options: argparse.Namespace, hand: Virtual, setup: SceneSetup) -> str:
    """The hand's port, and what to type in a second terminal."""
    item = setup.object
    half = {"cylinder": item.half_extents[1:], "sphere": item.half_extents[:1]}
    sizes = ",".join(f"{size:.4g}" for size in half.get(item.shape, item.half_extents))
    policy = f"scripted --grasp {options.grasp}" if options.grasp else POLICIES[options.env]
    words = (
        f"hpac deploy {policy} --port {hand.port} --object {item.shape}:{sizes}"
        f" --pose udp:{hand.pose_port} --arm udp:127.0.0.1:{hand.arm_port}"
    )
    lines = [f"virtual hand at {hand.port}; Ctrl-C ends it. In a second terminal:", "", words, ""]
    if options.reveal:
        lines.append(_revealed(options.seed, setup))
    return "\n".join(lines)


def _revealed(seed: int | None, setup: SceneSetup) -> str:
    """What was drawn, in words."""
    item = setup.object
    lines = [
        f"object: {item.shape}, half sizes {[round(1e3 * x, 1) for x in item.half_extents]} mm, "
        f"{1e3 * item.mass:.0f} g, friction {item.friction:.2f}"
    ]
    if seed is None:
        return "\n".join([*lines, "hand: the nominal one; --seed draws another"])
    given = setup.hand_settings
    size = (
        setup.geometry.digits[2].phalanges[0].length / HPAC_GEOMETRY.digits[2].phalanges[0].length
    )
    lines += [
        f"hand {setup.hand.name}, {size:.0%} of the nominal size, joint friction {1e3 * given.joint_friction:.1f} mN·m, "
        f"skin friction {given.contact_friction:.2f}",
        _row("slack [mm]", DIGITS, np.array(given.slack) * 1e3),
        _row("strength", DIGITS, given.strength),
        _row("servo zero [deg]", SERVOS, np.degrees(given.servo_zero)),
    ]
    return "\n".join(lines)


def _row(what: str, names: Any, values: Any) -> str:
    return f"{what}: " + ", ".join(
        f"{name} {value:.2g}" for name, value in zip(names, values, strict=True)
    )
