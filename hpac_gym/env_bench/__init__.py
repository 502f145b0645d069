"""The environments' part of ``python -m hpac_gym.bench``.

Every figure is taken at 20 commands a second. Rates are medians over rounds, so that what else the machine does weighs
less. A line says what mark its figure has to keep, and whether it does.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import Any

from hpac_gym.env_bench.motion import Motion, measure_motion, measure_renders
from hpac_gym.env_bench.peers import PEERS, Peer, measure_peers
from hpac_gym.env_bench.scaling import Scaling, Vector, measure_scaling, measure_vectors
from hpac_gym.envs import Grasp, HandEnv
from hpac_gym.envs.hand_env import CONTROL_HZ

MOST_RESET_MS = 5.0
MOST_OUTSIDE_SHARE = 0.40
LEAST_SHARE_OF_ARITHMETIC = 0.90
MARKED_PEER = "PandaPickAndPlace-v3"
"""This library has to make more steps a second; the other peers are there to be compared with."""


def mark(bound: str, kept: bool) -> str:
    """A mark behind its figure."""
    return f"({bound} {'✓' if kept else '✗'})"


@dataclass(frozen=True, slots=True)
class Report:
    """All the figures of one run."""

    physics_hz: int
    control_hz: int
    free: Motion
    contact: Motion
    renders_per_second: float
    scaling: tuple[Scaling, ...]
    vector: tuple[Vector, ...]
    peers: tuple[Peer, ...]
    """In the same rounds as this library's two motions; without those that are not installed."""

    def lines(self) -> list[str]:
        """The report as text."""
        return [
            f"  physics at {self.physics_hz} Hz, {self.control_hz} commands a second; "
            "behind a figure its mark, ✓ where it is kept and ✗ where not",
            *(self._motion_line(name) for name in ("free", "contact")),
            f"  pictures {self.renders_per_second:7.1f} a second, 480 × 360",
            *map(_scaling_line, self.scaling),
            *(
                f"  vector of {row.num_envs} {row.env_steps_per_second:6.0f} env steps/s   "
                f"AsyncVectorEnv {row.async_env_steps_per_second:6.0f}   × {row.ratio:.2f}"
                for row in self.vector
            ),
            *map(_peer_line, self.peers),
            *(
                f"  {name}: not installed (pip install 'hpac_gym[bench]')"
                for name in PEERS
                if name not in {peer.id for peer in self.peers}
            ),
        ]

    def _motion_line(self, name: str) -> str:
        found: Motion = getattr(self, name)
        share = found.outside_physics_share
        return (
            f"  {name:<8} {found.env_steps_per_second:7.0f} env steps/s   {found.real_time_factor:6.1f} × real time   "
            f"reset {found.reset_ms:5.2f} ms {mark(f'≤ {MOST_RESET_MS:g}', found.reset_ms <= MOST_RESET_MS)}   "
            f"outside physics {share:5.1%} {mark(f'≤ {MOST_OUTSIDE_SHARE:.0%}', share <= MOST_OUTSIDE_SHARE)}"
        )

    def as_json(self) -> dict[str, Any]:
        """The report as one JSON object."""
        return json.loads(json.dumps(asdict(self)))


def _scaling_line(row: Scaling) -> str:
    share, least = row.share_of_arithmetic, LEAST_SHARE_OF_ARITHMETIC
    return (
        f"  {row.processes} processes {row.env_steps_per_second:6.0f} env steps/s   × {row.speed_up:.2f}   "
        f"plain arithmetic × {row.arithmetic_speed_up:.2f}   {share:.0%} of it {mark(f'≥ {least:.0%}', share >= least)}"
    )


def _peer_line(peer: Peer) -> str:
    marks = {name: mark("> 1", ratio > 1) if peer.id == MARKED_PEER else "" for name, ratio in peer.ratio.items()}
    ratios = "   ".join(f"{name} × {ratio:.2f} {marks[name]}".rstrip() for name, ratio in peer.ratio.items())
    return f"  {peer.id} {peer.env_steps_per_second:.0f} env steps/s, {peer.control_hz:g} commands a second: {ratios}"


def report() -> Report:
    """Measure everything."""
    env = HandEnv(Grasp())
    physics_hz = env.scene.world.settings.physics_hz
    env.close()
    return Report(
        physics_hz,
        CONTROL_HZ,
        free=measure_motion("free"),
        contact=measure_motion("contact"),
        renders_per_second=measure_renders(),
        scaling=measure_scaling(),
        vector=measure_vectors(),
        peers=measure_peers(),
    )
