"""Episodes of the sixteen named grasps: what holds the object, and the scripted closure against
random actions.
"""

from itertools import pairwise

import gymnasium
import numpy as np
import pytest

from hpac_gym.envs import GRASPS
from hpac_gym.evaluation.evaluate import run_block
from hpac_gym.physics.engine import PARTS
from tests.envs.episodes import run, steps

ID = "HPAC-Grasp-v0"
NAMES = list(GRASPS)
POWER = [name for name in NAMES if GRASPS[name].family == "power"]
FINGERS_AND_THUMB = {"thumb", "index", "middle", "ring", "pinky"}
HOLDING = {
    "large_cylinder": FINGERS_AND_THUMB,
    "small_cylinder": FINGERS_AND_THUMB,
    "rod": {"pinky", "palm"},
    "large_sphere": FINGERS_AND_THUMB,
    "small_sphere": {"thumb", "middle", "palm"},
    "disk": {"thumb", "index", "middle", "ring"},
    "hook": FINGERS_AND_THUMB - {"thumb"},
    "three_finger_pinch": {"thumb", "index", "middle"},
    "tip_pinch": {"thumb", "index"},
    "lateral_pinch": {"thumb", "index"},
    "precision_box": FINGERS_AND_THUMB,
    "scissors": {"thumb", "index", "middle"},
    "screwdriver": {"middle", "ring", "pinky", "palm"},
    "tape_roll": {"thumb", "index", "middle"},
    "tweezers": {"thumb", "index", "middle"},
    "press": {"thumb", "pinky", "palm"},
}
"""What the texts of the grasps say that holds the object."""


def held_by(env, seed: int) -> tuple[set[str], float]:
    """What touches the object in at least half of the last phase, and the largest force since the
    lift [N].
    """
    played = steps(env, env.unwrapped.task.script(), seed=seed)
    rows = [(env.unwrapped.phase, env.unwrapped.state) for _ in played]
    # A step belongs to the phase in which it began.
    begun = [(phase, state) for (phase, _), (_, state) in pairwise(rows)]
    last = [state.touching[0] for phase, state in begun if phase == "place"]
    carried = [state.contact_force.sum() for phase, state in begun if phase in ("shake", "place")]
    often = np.mean(last, axis=0) >= 0.5 if last else np.zeros(len(PARTS), dtype=bool)
    return {part for part, held in zip(PARTS, often, strict=True) if held}, max(
        carried, default=0.0
    )


@pytest.mark.pybullet  # most closures were found in PyBullet
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[] if place % 4 == 0 else pytest.mark.slow)
        for place, name in enumerate(NAMES)
    ],
)
def test_what_the_text_names_holds_the_object_and_crushes_nothing(name: str):
    """In most of three episodes each of `HOLDING` touches it, and the forces add up to less than 80
    N.
    """
    with gymnasium.make(ID, grasp=name, engine="pybullet") as env:
        seen = [held_by(env, seed) for seed in range(300, 303)]
    for part in HOLDING[name]:
        assert sum(part in parts for parts, _ in seen) >= 2, part
    assert sum(force < 80 for _, force in seen) >= 2


@pytest.mark.pybullet  # most closures were found in PyBullet
@pytest.mark.parametrize(
    ("name", "seeds", "least"),
    [
        ("tip_pinch", range(6), 4),
        *(pytest.param(name, range(200, 220), 12, marks=pytest.mark.slow) for name in NAMES),
    ],
)
def test_scripted_closure_beats_random_actions(name: str, seeds: range, least: int):
    played = run_block(["scripted", "random"], ID, {"grasp": name, "engine": "pybullet"}, seeds)
    scripted, wild = (sum(one.success for one in each) for each in zip(*played, strict=True))
    assert scripted >= least
    assert scripted > wild + 2


@pytest.mark.parametrize("name", ["press", "scissors", "tape_roll"])
def test_closures_searched_in_both_engines_hold_in_mujoco(name: str):
    episodes = run_block(["scripted"], ID, {"grasp": name}, range(200, 210))
    assert sum(episode.success for (episode,) in episodes) >= 9


@pytest.mark.slow
@pytest.mark.pybullet
@pytest.mark.parametrize("name", NAMES)
def test_a_closed_grasp_creeps_little_in_ten_seconds(name: str):
    """Less than 2 mm for a power grasp and 5 mm for any other, from one second after the hold
    begins.
    """
    with gymnasium.make(ID, grasp=name, engine="pybullet") as env:
        script = env.unwrapped.task.script()
        assert any(run(env, script, seed=seed)[0][-1]["is_success"] for seed in range(10))
        simulation = env.unwrapped.episodes.simulation
        places = []
        for seconds in (1.0, 10.0):
            simulation.rest(seconds)
            state = simulation.state()
            places.append(state.object_pos[0])
        assert np.linalg.norm(places[1] - places[0]) < (0.002 if name in POWER else 0.005)
