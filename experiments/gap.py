"""What it costs that a hand is not the simulated one: ``python -m experiments.gap``.

The same episodes of a policy on the nominal hand, on hands of a workshop before and after their
calibration, and with one cause at a time, in batches of worlds. The link is the batch's own ramp,
which is what the firmware's pulses do (`tests/experiments/test_gap.py`)."""

import sys
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from experiments.chain import calibrated
from experiments.results import add_workers_and_out, compared, percent, write_results
from hpac_gym.bridge import pulses_from_servo, servo_from_pulses
from hpac_gym.command import command_parser, run, whole_number
from hpac_gym.evaluation.episodes import run_episodes, worlds
from hpac_gym.evaluation.options import env_id_of
from hpac_gym.evaluation.seeds import HELD_OUT_SEED
from hpac_gym.evaluation.workers import shared
from hpac_gym.model.checks import Array
from hpac_gym.output import markdown
from hpac_gym.physics.simulation import Simulation
from hpac_gym.policies import Policy
from hpac_gym.policies.loading import load_policy
from hpac_gym.tasks.terms import LENGTH_UNIT

BATCH = 30
"""Episodes of a batch, which share a hand."""
NOMINAL = "nominal hand"
HAND = "workshop hands"
FILE = "after calibration"
BOARD = "pulses latched at 50 Hz, 14 bits"
OFF = {f"object seen {mm} mm off": 1e-3 * mm for mm in (3, 6, 10)}
"""Errors of a camera that stay for an episode, in a direction that is drawn [m]."""
RANGES: dict[str, dict[str, tuple[float, float]]] = {
    "servos 50 ms late": {"servo_lag": (0.05, 0.05)},
    "5 % of the commands lost": {"dropped_frames": (0.05, 0.05)},
    "half of the commands late": {"late_frames": (0.5, 0.5)},
    "1 mm of slack": {"slack": (1e-3, 1e-3)},
    "friction of the skin × 0.8": {"skin_friction": (0.8, 0.8)},
    "tendons 20 % softer": {"tendon_stiffness": (0.8, 0.8)},
}
ROWS = (NOMINAL, HAND, FILE, *OFF, *RANGES, BOARD)
LATCH = 0.02
"""Period of a servo's pulses [s]."""
STEP_NS = 20e6 / 2**14
"""Resolution of the ESP32's pulses [ns]."""


class Misled:
    """A policy whose camera is off.

    Args:
        policy: the policy.
        columns: of the object's centre in the observation.
        metres: by how much [m].
    """

    def __init__(self, policy: Policy, columns: slice, metres: float) -> None:
        self._policy = policy
        self._columns = columns
        self._metres = metres

    def set_random_seed(self, seed: int) -> None:
        """Draw the direction of an episode."""
        way = np.random.default_rng([seed, 10]).standard_normal(3)
        self._off = self._metres / LENGTH_UNIT * way / np.linalg.norm(way)

    def predict(self, observation: Array, *given: Any) -> tuple[Array, Any]:
        """The policy's action for what it believes to see."""
        seen = observation.copy()
        seen[self._columns] += self._off
        return self._policy.predict(seen, *given)


class Latched:
    """A simulation whose servos look at pulses of the board's resolution every 20 ms, as those of a
    hand do, instead of following the ramp itself.

    Args:
        simulation: the simulation; a move of it lasts a control step.
        step_ns: resolution of the pulses [ns].
    """

    def __init__(self, simulation: Simulation, step_ns: float = STEP_NS) -> None:
        self._simulation = simulation
        self._step_ns = step_ns
        self._to = simulation.servos.commanded
        self._latched = -1

    def __getattr__(self, name: str) -> Any:
        return getattr(self._simulation, name)

    def reset(self, worlds: Sequence[int], setups: Sequence[Any]) -> None:
        self._simulation.reset(worlds, setups)
        self._to[worlds] = self.servos.commanded[worlds]
        self._steps = 0

    def command(self, servo: Array, duration: float) -> None:
        """Begin a move: pulses become wider or narrower."""
        self._from = self._to
        self._to = servo.copy()
        self._begun = self._steps
        self._duration = duration

    def advance(self, wrist: Array, push: Array | None = None) -> None:
        """Advance; the servos look at the pulses as often as their period says."""
        dt = self.engine.dt
        for step in range(wrist.shape[1]):
            period = int(self._steps * dt / LATCH + 1e-9)
            if period != self._latched:
                self._latched = period
                share = min((self._steps - self._begun) * dt / self._duration, 1.0)
                pulses = pulses_from_servo(self._from + share * (self._to - self._from))
                held = np.rint(pulses / self._step_ns) * self._step_ns
                self._simulation.command(servo_from_pulses(held), dt)
            one = slice(step, step + 1)
            self._simulation.advance(wrist[:, one], None if push is None else push[:, one])
            self._steps += 1


def episodes(policy: str, row: str, block: int, seeds: Sequence[int]) -> list[bool]:
    """Successes of a row, by seed; a block has a workshop's hand of its own."""
    options: dict[str, Any] = {}
    if row in (HAND, FILE):
        hand, file = calibrated("workshop, slack", block)
        options = {"hand": hand} | ({"model": file} if row == FILE else {})
    elif row in RANGES:
        options = {"randomize": RANGES[row]}
    options["engine"] = "mujoco"
    with worlds(env_id_of(policy), options, len(seeds)) as (env, envs):
        player = load_policy(policy, env)
        policies: list[Any] = [player] * len(seeds)
        if row in OFF:
            columns = env.unwrapped.slices["object_pos"]
            policies = [Misled(player, columns, OFF[row]) for _ in seeds]
        if row == BOARD:
            inner = envs.unwrapped.episodes
            inner.simulation = Latched(inner.simulation)
        held = {
            step.seed: step.success for step in run_episodes(envs, policies, seeds) if step.over
        }
    return [held[seed] for seed in seeds]


def main(argv: list[str] | None = None) -> None:
    """Run the episodes, print a row a cause, write them."""
    parser = command_parser("experiments.gap", __doc__)
    parser.add_argument("--policy", default="grasp")
    parser.add_argument("--episodes", type=whole_number(BATCH), default=240, help="for each row")
    add_workers_and_out(parser)
    arguments = parser.parse_args(argv)
    blocks = arguments.episodes // BATCH
    jobs = [
        (arguments.policy, row, block, [HELD_OUT_SEED + block * BATCH + i for i in range(BATCH)])
        for row in ROWS
        for block in range(blocks)
    ]
    held: dict[str, list[bool]] = {row: [] for row in ROWS}
    batches = shared(episodes, jobs, arguments.workers, "batches")
    for (_, row, *_), found in zip(jobs, batches, strict=True):
        held[row] += found
    cells = [{"row": row, **compared(mine, held[NOMINAL])} for row, mine in held.items()]
    words = f"gap --policy {arguments.policy} --episodes {blocks * BATCH}"
    write_results(arguments.out, words, cells=cells)
    print(gap_table(cells))


def gap_table(cells: Sequence[Mapping[str, Any]]) -> str:
    """The rows as a Markdown table."""
    rows = []
    for cell in cells:
        points = f"{100 * cell['difference']:+.1f} {percent(cell['difference_95'], '+.1f')}"
        success = f"{cell['success_rate']:.1%} {percent(cell['interval_95'])}"
        rows.append((cell["row"], success, "" if cell is cells[0] else points))
    return markdown(("", "success", "points"), rows)


if __name__ == "__main__":
    sys.exit(run(main))
