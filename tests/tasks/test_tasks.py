"""Tasks as functions of arrays: many worlds at once are as many single ones, and every term does
what its row says.
"""

from dataclasses import fields, replace
from functools import cache
from itertools import product

import numpy as np
import pytest

from hpac_gym.model import FINGERS, HPAC, elastic_joints_from_servo
from hpac_gym.physics.engine import PARTS, Contacts, SceneState, matrix_from_quaternion
from hpac_gym.tasks.cameras import CameraNoise
from hpac_gym.tasks.gentle import Gentle
from hpac_gym.tasks.grasp import PALM_SURFACE, Grasp, GraspConfig, GraspWeights
from hpac_gym.tasks.grasp_any import GraspAny, GraspAnyConfig
from hpac_gym.tasks.grasp_types import GraspByType, GraspTypeConfig
from hpac_gym.tasks.phases import PickPlaceTimetable
from hpac_gym.tasks.pick_place import PickPlace, PickPlaceConfig
from hpac_gym.tasks.posture import Posture
from hpac_gym.tasks.scripted import ScriptedClosure, ScriptedPickPlace
from hpac_gym.tasks.task import (
    CONTROL_HZ,
    FAILURE,
    RUNNING,
    SUCCESS,
    contact_score,
)
from hpac_gym.tasks.terms import Layout, Moment, Term


def of_any(*config: GraspAnyConfig) -> GraspAny:
    return GraspAny("real", "script", "nominal", *config)


def of_type(*config: GraspTypeConfig) -> GraspByType:
    return GraspByType("tip_pinch", "train", "script", *config)


TASKS = {
    "grasp": Grasp,
    "named": lambda: Grasp(grasp="hook"),
    "any": of_any,
    "type": of_type,
    "place": PickPlace,
    "posture": Posture,
}
DT = 1 / CONTROL_HZ
WORLDS = 5


class Story:
    """States of one world that touch every branch of the tasks, in place of a simulation; `fate`
    says how it goes.

    0: held to the end; 1: never touched; 2: dropped in the lift; 3: knocked away; 4: held, with
        gaps in the contact.
    """

    def __init__(self, task, fate: int) -> None:
        self.rng = np.random.default_rng(fate)
        self.task = task
        self.fate = fate
        self.step = 0
        self.setup = task.setup(self.rng, HPAC)
        steps = np.arange(0, round(task.duration * CONTROL_HZ) + 1)
        self.path = task.wrist_path(self.setup, tuple((steps * DT).tolist()))

    def __call__(self) -> SceneState:
        state = SceneState.empty(1)
        share = self.step * DT / self.task.duration
        state.time[:] = self.step * DT
        state.joint_pos[:], state.joint_vel[:] = self.rng.uniform(0, 1, (2, 15))
        state.horn[:] = self.rng.uniform(0, 1, 6)
        state.tension[:] = self.rng.uniform(0, 20, 5)
        state.palm_offset[:] = offset = self.path[min(self.step, len(self.path) - 1)]
        state.object_rotation[:] = self.setup.hand_rotation.T
        state.object_vel[:], state.object_spin[:] = self.rng.uniform(-1, 1, (2, 3))
        if self.setup.object is not None:
            closed = share > 0.3
            late = share > 0.85
            held = closed and self.fate in (0, 2, 4) and not (self.fate == 2 and share > 0.6)
            held = held and not (isinstance(self.task, PickPlace) and late)
            state.touching[0, [1, 2]] = held and not (self.fate == 4 and self.step % 7 == 0)
            state.contact_force[:] = np.where(state.touching, self.rng.uniform(1, 5, 6), 0.0)
            state.touching[0, 0] = self.fate == 3 and closed  # the palm, as the object passes by
            state.supported[:] = not closed or (late and self.fate != 0)
            state.on_target[:] = late and isinstance(self.task, PickPlace)
            world_to_hand = self.setup.hand_rotation.T @ offset
            grasped = self.setup.position - (
                self.setup.hand_rotation.T @ self.path[round(0.3 * (len(self.path) - 1))]
            )
            state.object_pos[:] = (
                grasped + 0.001 * share if held else self.setup.position - world_to_hand
            )
            if isinstance(self.task, PickPlace) and late and self.fate in (0, 4):
                state.object_pos[:] = self.setup.target - world_to_hand
            if self.fate == 3 and share > 0.15:
                state.object_pos[0, 0] += 0.2
        self.step += 1
        return state


def contacts(state: SceneState, world: int) -> Contacts:
    """Thumb and index touch with their last links, wherever the state says that they touch."""
    parts = np.flatnonzero(state.touching[world])
    links = tuple(
        "thumb_ip_link" if PARTS[part] == "thumb" else f"{PARTS[part]}_dip_link" for part in parts
    )
    normals = np.tile([1.0, 0.0, 0.0], (len(parts), 1))
    return Contacts(
        np.zeros((len(parts), 3)),
        normals,
        state.contact_force[world, parts],
        links,
        np.zeros(3),
        0.5,
    )


def joined(states: list[SceneState]) -> SceneState:
    """One state of as many worlds."""
    return SceneState(
        **{
            f.name: np.concatenate([getattr(state, f.name) for state in states])
            for f in fields(SceneState)
        }
    )


class Played:
    """A task that follows stories, and everything that it makes of them."""

    def __init__(self, task, stories: list[Story]) -> None:
        n = len(stories)
        self.task = task
        self.n = n
        self.camera = task.prepare(n, CameraNoise())
        self.layout = Layout((*task.terms, *task.privileged_terms), n)
        self.goals = Layout(task.goal_terms, n) if task.goal_terms else None
        self.servo = np.zeros((n, 6))
        self.predicted = elastic_joints_from_servo(self.servo)
        self.start(range(n), stories)

    def start(self, worlds, stories: list[Story]) -> None:
        setups = [story.setup for story in stories]
        self.task.start(worlds, setups)
        self.layout.start(worlds, setups)
        for world, story in zip(worlds, stories, strict=True):
            self.camera.start(world, story.setup, 1.0, np.random.default_rng(story.fate))

    def step(self, state: SceneState, look: bool = True) -> dict[str, np.ndarray]:
        """All that a control step gives, each with a leading axis n; with a look, what is seen, too."""
        task = self.task
        task.watch(state, DT, lambda world: contacts(state, world))
        outcome = task.judge(state, DT)
        phase = task.phase(state.time)
        change = np.tile(np.linspace(-0.1, 0.2, 6), (self.n, 1))
        down = np.tile([0.0, -1.0, 0.0], (self.n, 1))
        seen = self.camera.look(state, range(self.n)) if look else {}
        now = Moment(
            *(state, self.servo, self.predicted, down, phase, change, change, seen),
            *(task.grip, outcome, phase),
        )
        found = {"observation": self.layout.see(now)} if look else {}
        if self.goals:
            task.measure(self.goals.see(now), task.goal.astype(np.float32))
        found |= {"judged": outcome, "phase": phase, "sparse": task.sparse_reward(now)}
        found |= {term.name: term.value(now) for term in task.reward_terms}
        return found | {f"info {name}": value for name, value in task.report(now).items()}


@pytest.mark.parametrize("make", TASKS.values(), ids=TASKS)
def test_many_worlds_at_once_are_as_many_single_ones(make):
    """To the bit, over whole episodes, with worlds that begin again while the others go on; what is
    seen, in every fifth step.
    """
    stories = [Story(make(), fate) for fate in range(WORLDS)]
    many = Played(make(), stories)
    single = [Played(make(), [story]) for story in stories]
    seen = []
    steps = round(make().duration * CONTROL_HZ)
    for step in range(steps):
        if (step + 1) % (steps // 4) == 0:
            world = step // (steps // 4) % WORLDS
            stories[world] = Story(make(), world)
            many.start([world], [stories[world]])
            single[world].start([0], [stories[world]])
        states = [story() for story in stories]
        look = step % 5 == 0 or make is Posture
        together = many.step(joined(states), look)
        for world, (alone, state) in enumerate(zip(single, states, strict=True)):
            for name, value in alone.step(state, look).items():
                np.testing.assert_array_equal(
                    together[name][world],
                    value[0],
                    err_msg=f"{name} of world {world} in step {step}",
                )
        seen.append(together)
    assert len(np.unique([found["phase"] for found in seen])) == len(make().phases)


@cache
def fates_of(kind) -> tuple[list[Story], list[SceneState]]:
    """The five fates of a task, and the states of each step, with a world for each."""
    stories = [Story(kind(), fate) for fate in range(WORLDS)]
    steps = range(round(kind().duration * CONTROL_HZ) + 1)
    return stories, [joined([story() for story in stories]) for _ in steps]


def told(kind, *config) -> dict[str, np.ndarray]:
    """All that a task makes of the five fates, with axes of steps and worlds."""
    stories, states = fates_of(kind)
    played = Played(kind(*config), stories)
    steps = [played.step(state, look=False) for state in states]
    return {name: np.array([step[name] for step in steps]) for name in steps[0]}


@pytest.mark.parametrize("kind", [Grasp, of_any, of_type, PickPlace])
def test_the_fates_end_as_they_should(kind):
    judged = told(kind)["judged"]
    assert (judged[0] == RUNNING).all()
    ends = (judged != RUNNING).argmax(axis=0)
    np.testing.assert_array_equal(judged[ends, range(WORLDS)][[0, 1]], [SUCCESS, FAILURE])
    failed = (judged == FAILURE).argmax(axis=0) / (len(judged) - 1)  # share of the episode
    assert 0.6 <= failed[2] <= 0.63, "as soon as it is dropped"
    assert 0.15 <= failed[3] <= 0.18, "as soon as it is knocked away"
    assert kind is of_any or judged[-1, 3] == FAILURE, "although the episode is over"


@pytest.mark.parametrize(
    ("kind", "config"),
    [
        (Grasp, GraspConfig()),
        (of_any, GraspAnyConfig()),
        (of_type, GraspTypeConfig()),
        (PickPlace, PickPlaceConfig()),
    ],
)
def test_a_weight_is_one_number_that_its_term_and_the_documentation_follow(kind, config):
    usual = told(kind)
    for weight in fields(config.weights):
        other = replace(config, weights=replace(config.weights, **{weight.name: 7.75}))
        terms = kind(other).reward_terms
        changed = told(kind, other)
        differs = [t.name for t in terms if not np.array_equal(usual[t.name], changed[t.name])]
        described = [term.name for term in terms if "7.75" in term.meaning]
        assert len(differs) == 1, f"{weight.name} acts on {differs}"
        assert differs == described


def test_every_set_of_touching_parts_has_its_score():
    weights = GraspWeights(thumb=1.0, finger=0.1, opposed=10.0)
    sets = np.array(list(product([False, True], repeat=len(PARTS))))
    _, thumb, *fingers = sets[:, [PARTS.index(name) for name in ("palm", "thumb", *FINGERS)]].T
    count = np.sum(fingers, axis=0)
    expected = 1.0 * thumb + 0.1 * count + 10.0 * (thumb & (count > 0))
    np.testing.assert_array_equal(contact_score(weights, sets), expected)


@pytest.mark.parametrize("make", [Grasp, Gentle])
@pytest.mark.parametrize("yaw", [-np.pi, -2.0, 0.3, 1.8, np.pi])
def test_a_turned_box_keeps_its_gap_from_the_palm(make, yaw):
    task = make({"box_yaw": (yaw, yaw), "gap": (0.01, 0.01)})
    draws = (task.setup(np.random.default_rng(seed)) for seed in range(8))
    boxes = [setup for setup in draws if setup.object.shape == "box"]
    assert boxes
    for setup in boxes:
        turned = setup.hand_rotation.T @ matrix_from_quaternion(setup.object_turn[0])
        nearest = setup.position[0] - np.abs(turned[0]) @ setup.object.half_extents
        assert nearest == pytest.approx(PALM_SURFACE + 0.01)


def test_an_observation_stays_within_its_bounds_and_keeps_the_rest_as_it_is():
    fixed = Term("b", ("z",), "m", 0.0, 1.0, "", lambda setup: [setup], fixed=True)
    layout = Layout((Term("a", ("x", "y"), "m", -1.0, 1.0, "", lambda now: now), fixed), 2)
    layout.start([1], [0.75])
    np.testing.assert_array_equal(
        layout.see(np.array([[0.25, 3.0], [-7.0, 0.5]])), [[0.25, 1.0, 0.0], [-1.0, 0.5, 0.75]]
    )
    assert layout.slices == {"a": slice(0, 2), "b": slice(2, 3)}


def test_a_script_that_was_made_begins_an_episode():
    for script in (ScriptedClosure(), ScriptedPickPlace(PickPlaceTimetable())):
        first = script.act(np.zeros(0))
        script.reset()
        np.testing.assert_array_equal(script.act(np.zeros(0)), first)
