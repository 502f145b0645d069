"""Replay a policy over the wire: ``python -m agents.replay --policy FILE --out runs/NAME``.

Every command goes policy → ServoCommand → serial frame → pseudo-terminal → firmware core → pulse
widths → simulated servos: the simulated hand executes the pulses, not the policy's commands. The
folder gets ``grasps.mp4``, ``grasps.png`` (the end of each phase), ``wire.jsonl`` (every frame) and
``replay.json``."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from itertools import islice
from pathlib import Path

import gymnasium
import imageio.v2 as imageio
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from agents import RunError
from hpac_gym.bridge import (
    FaultError,
    HandLink,
    HostBoard,
    LinkStatistics,
    VirtualHand,
    WireLog,
    servo_from_pulses,
)
from hpac_gym.command import command_parser, run, whole_number
from hpac_gym.errors import HpacError
from hpac_gym.evaluation.environment import make_env
from hpac_gym.evaluation.episodes import run_episodes, single
from hpac_gym.evaluation.evaluate import env_id_of
from hpac_gym.evaluation.seeds import HELD_OUT_SEED
from hpac_gym.model import SERVOS, ServoCommand, move_duration
from hpac_gym.output import replacing, writable_folder, write_text
from hpac_gym.physics.engine import PhysicsError
from hpac_gym.policies import Policy
from hpac_gym.policies.loading import load_policy
from hpac_gym.progress import progress
from hpac_gym.tasks.task import CONTROL_HZ

PULSE_TOLERANCE = 2e-4
"""Tolerance between the pulses at the end of a move and the commanded angles [rad]: two steps of
the wire.
"""
# watchdog period: longest time between two commands before the hand executes its safe action [s]
WATCHDOG = 0.5
ATTEMPTS = 3  # attempts at an episode before a watchdog stop becomes an error
HELD_PICTURES = CONTROL_HZ // 2  # pictures for which the film shows the end of an episode
SHEET_WIDTH = 1200  # width of the sheet of stills [px]


@dataclass
class Report:
    """Results of a replay."""

    policy: str
    env_id: str
    first_seed: int
    episodes: int = 0
    successes: int = 0
    moves: int = 0
    worst_pulse_error_rad: float = 0.0
    frames_sent: int = 0
    frames_acked: int = 0
    frames_rejected: int = 0
    frames_retried: int = 0
    watchdog_stops: int = 0
    round_trip_p50_ms: float = 0.0
    round_trip_p99_ms: float = 0.0

    def count(self, wire: Wire, statistics: LinkStatistics) -> None:
        """Take over the counts of the wire and of its link."""
        self.moves = wire.moves
        self.worst_pulse_error_rad = wire.worst_error
        self.frames_sent = statistics.sent
        self.frames_acked = statistics.acked
        self.frames_rejected = statistics.rejected
        self.frames_retried = statistics.retried
        self.round_trip_p50_ms, self.round_trip_p99_ms = (
            1e3 * statistics.round_trip(share) for share in (50, 99)
        )

    @property
    def faults(self) -> list[str]:
        """Violated requirements, one line each; a frame that was repeated on a busy machine is
        acknowledged once.
        """
        lines = []
        if self.worst_pulse_error_rad > PULSE_TOLERANCE:
            lines.append(
                f"pulses are {self.worst_pulse_error_rad:.2e} rad off, above {PULSE_TOLERANCE:.0e} rad"
            )
        if self.frames_acked + self.frames_retried != self.frames_sent or self.frames_rejected:
            lines.append(self.frames)
        return lines

    @property
    def frames(self) -> str:
        """What became of the frames."""
        repeated = f" ({self.frames_retried} repeated)" if self.frames_retried else ""
        return f"{self.frames_acked} of {self.frames_sent} frames{repeated} acknowledged, {self.frames_rejected} rejected"

    def __str__(self) -> str:
        return (
            f"{self.successes} of {self.episodes} episodes succeeded over the wire; {self.moves} moves, pulses at most "
            f"{self.worst_pulse_error_rad:.1e} rad from the command\n"
            f"{self.frames}, round trip p50 {self.round_trip_p50_ms:.2f} ms, p99 {self.round_trip_p99_ms:.2f} ms"
        )


class Wire:
    """Sends each command to the firmware and returns the servo angles of its pulses at the end of
    the move.

    The pulses of a real hand at a port cannot be read: then the simulated hand executes the
    acknowledged command."""

    def __init__(self, hand: HostBoard | VirtualHand | None, link: HandLink) -> None:
        self._hand = hand
        self._link = link
        self.moves = 0
        self.worst_error = 0.0
        self.arrived: list[ServoCommand] = []

    def begin(self, servo: np.ndarray) -> None:
        """Re-arm, which moves the servos to rest, and move to the start of an episode."""
        self._link.clear()
        self._link.arm(watchdog=WATCHDOG)
        self._servo = np.zeros(len(SERVOS))
        self.arrived = []
        self.transmit(ServoCommand(servo, 1 / CONTROL_HZ))
        self.arrived = []

    def transmit(self, command: ServoCommand) -> ServoCommand:
        """Send a command and return it as received by the servos.

        The first one takes as long as it needs: with a free wrist, it is the preshape of a hand
        that is out of reach."""
        duration = command.duration
        if not self.arrived and (least := move_duration(self._servo, command.servo)) > duration:
            # 10 % slower than the limit: the firmware rounds to milliseconds and refuses moves that
            # are too fast.
            duration = 1.1 * least + 0.01
        self._servo = command.servo
        self._link.move(ServoCommand(command.servo, duration))
        self._link.wait()
        self.moves += 1
        if self._hand is not None:
            servo = servo_from_pulses(self._hand.pulses())
            self.worst_error = max(self.worst_error, float(np.abs(servo - command.servo).max()))
            command = ServoCommand(servo, command.duration)
        self.arrived.append(command)
        return command


def replay(
    policy: Policy, env: gymnasium.Env, wire: Wire, seeds: range, report: Report
) -> dict[int, list[ServoCommand]]:
    """Run the episodes of these seeds with the wire between policy and simulated hand; returns the
    received commands of each.

    If the machine is too busy to feed the hand's watchdog, the episode is repeated, at most twice,
    and counted.

    Raises:
        FaultError: The watchdog tripped three times in one episode.
    """
    commands = {}
    for seed in progress(seeds, "replaying"):
        for attempt in range(ATTEMPTS):
            try:
                report.successes += _run_episode(policy, env, wire, seed)
                break
            except FaultError:
                if attempt == ATTEMPTS - 1:
                    raise
                report.watchdog_stops += 1
        commands[seed] = wire.arrived
        report.episodes += 1
    return commands


def _run_episode(policy: Policy, env: gymnasium.Env, wire: Wire, seed: int) -> bool:
    for step in run_episodes(single(env), [policy], [seed]):
        if step.number == 0:
            wire.begin(env.unwrapped.command.servo)
    return step.success


def film(
    policy: str,
    env_id: str,
    options: dict[str, str],
    commands: dict[int, list[ServoCommand]],
    out: Path,
) -> None:
    """Render the episodes without the wire: the same commands and seed give a bit-identical motion.

    Raises:
        PhysicsError: The engine cannot draw.
        OutputError: The film cannot be written.
    """
    rest: Iterator[ServoCommand] = iter(())
    font = ImageFont.load_default(15)
    sheet = []

    def add(picture: np.ndarray, text: str, count: int = 1) -> None:
        image = Image.fromarray(picture)
        ImageDraw.Draw(image).text((10, 8), text, fill=(40, 40, 40), font=font)
        for _ in range(count):
            video.append_data(np.asarray(image))

    with ExitStack() as stack:
        temporary = stack.enter_context(replacing(out / "grasps.mp4"))
        video = stack.enter_context(
            imageio.get_writer(temporary, fps=CONTROL_HZ, macro_block_size=None, quality=7)
        )
        env = stack.enter_context(
            gymnasium.make(
                env_id, render_mode="rgb_array", transmit=lambda _: next(rest), **options
            )
        )
        actor = load_policy(policy, env)
        for seed, received in progress(commands.items(), "filming"):
            rest = iter(received)
            phase = None
            picture = None
            stills = []
            steps = run_episodes(single(env), [actor], [seed])
            for step in islice(steps, 1, len(received) + 1):
                last = picture
                picture = env.render()
                if (now := step.info.get("phase", "")) != phase:  # a task without phases has none
                    stills.append(picture if last is None else last)
                    phase = now
                add(picture, f"seed {seed}   {phase}")
            stills.append(picture)
            sheet.append(stills)
            add(
                picture,
                f"seed {seed}   {'success' if step.success else 'failure'}",
                HELD_PICTURES,
            )
    columns = max(map(len, sheet))
    blank = np.full_like(sheet[0][0], 255)
    image = Image.fromarray(
        np.vstack([np.hstack([*row, *[blank] * (columns - len(row))]) for row in sheet])
    )
    with replacing(out / "grasps.png") as temporary:
        size = SHEET_WIDTH, round(SHEET_WIDTH * image.height / image.width)
        image.resize(size, Image.Resampling.LANCZOS).save(temporary)


def main(argv: list[str] | None = None) -> int:
    parser = command_parser("agents.replay", __doc__)
    parser.add_argument("--policy", required=True, help="random, scripted, or a policy file")
    parser.add_argument("--out", type=Path, required=True, help="folder of the results")
    parser.add_argument("--episodes", type=whole_number(1), default=8, help="held-out episodes")
    parser.add_argument(
        "--seed-start",
        type=whole_number(0),
        default=HELD_OUT_SEED,
        help="seed of the first episode",
    )
    parser.add_argument("--engine", help="pybullet or mujoco (default: the environment's own)")
    parser.add_argument("--body", help="twin or light (default: the environment's own)")
    parser.add_argument("--hand", metavar="TOML", help="the hand that is simulated")
    parser.add_argument("--model", metavar="TOML", help="the hand that commands are computed with")
    hands = parser.add_mutually_exclusive_group()
    hands.add_argument(
        "--virtual", action="store_true", help="firmware in this process, on a virtual clock"
    )
    hands.add_argument(
        "--port", help="serial port of a hand, which then moves like the simulated one"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    args = parser.parse_args(argv)
    writable_folder(args.out)
    env_id = env_id_of(args.policy)
    options = {
        name: getattr(args, name)
        for name in ("engine", "body", "hand", "model")
        if getattr(args, name) is not None
    }
    report = Report(args.policy, env_id, args.seed_start)
    try:
        with ExitStack() as stack:
            env = stack.enter_context(
                make_env(env_id, transmit=lambda command: wire.transmit(command), **options)
            )
            # Errors are raised before an earlier log is replaced.
            policy = load_policy(args.policy, env)
            hand = (
                None
                if args.port
                else stack.enter_context(VirtualHand() if args.virtual else HostBoard())
            )
            log = stack.enter_context(WireLog(args.out / "wire.jsonl"))
            link = stack.enter_context(HandLink(hand.connect if hand else args.port, log=log))
            wire = Wire(hand, link)
            commands = replay(
                policy, env, wire, range(args.seed_start, args.seed_start + args.episodes), report
            )
            link.clear()
            report.count(wire, link.statistics)
    except OSError as error:
        if isinstance(error, HpacError) or error.filename:
            raise
        raise RunError(
            f"cannot write '{args.out / 'wire.jsonl'}': {error.strerror or error}"
        ) from None
    text = json.dumps(asdict(report), indent=2)
    write_text(args.out / "replay.json", text + "\n")
    try:
        film(args.policy, env_id, options, commands, args.out)
    except PhysicsError as error:
        print(f"no film: {error}", file=sys.stderr)
    print(text if args.json else report)
    if report.faults:
        raise RunError(f"the wire check failed: {'; '.join(report.faults)}")
    return 0


if __name__ == "__main__":
    sys.exit(run(main))
