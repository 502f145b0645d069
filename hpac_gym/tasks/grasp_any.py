"""HPAC-GraspAny: any object in any of its stable poses. Unobserved properties make feedback
useful.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from hpac_gym.body.object_sets import SPLITS
from hpac_gym.body.objects import ObjectSpec
from hpac_gym.model import HPAC, Hand
from hpac_gym.model.checks import Array, as_unit_vector
from hpac_gym.physics.engine import SceneSetup, SceneState, Viewpoint
from hpac_gym.physics.settings import GRAVITY
from hpac_gym.settings import check_choice, settings_from
from hpac_gym.tasks import placing
from hpac_gym.tasks.cameras import CameraNoise
from hpac_gym.tasks.grasp_any_setups import (
    CLOSE,
    DOWN,
    HIDDEN_TERMS,
    PHASES,
    RAMP,
    SHAKE,
    SIDE_DIRECTIONS,
    SIDES,
    GraspAnyConfig,
    Setups,
    pull_of,
)
from hpac_gym.tasks.grip import Grip, lengths
from hpac_gym.tasks.phases import wrist_table
from hpac_gym.tasks.privileged import PRIVILEGED_TERMS
from hpac_gym.tasks.scripted import ScriptedGraspAny
from hpac_gym.tasks.senses import LOAD_TERMS, Senses, ServoSenses
from hpac_gym.tasks.task import (
    FAILURE,
    RUNNING,
    SUCCESS,
    Option,
    Task,
    carry_term,
    config_option,
    contact_score,
    effort_term,
    outcome_term,
)
from hpac_gym.tasks.terms import (
    COMMAND_TERMS,
    GRASP_CENTRE,
    OBJECT_TERMS,
    Moment,
    RewardTerm,
    Term,
    column,
    progress_terms,
)

WRISTS = ("script", "free")
HANDS = ("nominal", "train", "test")
WRIST_ACTIONS = ("wrist_x", "wrist_y", "wrist_z", "wrist_yaw")
WRIST_REACH = np.array([0.03, 0.03, 0.03, 0.5])
"""Wrist motion for an action of 1: along the world's axes [m], and about the vertical [rad]."""
SEEN_TERM = Term(
    "object_seen",
    ("seen",),
    "0/1",
    0.0,
    1.0,
    "whether the camera sees the object now; if not, the fields above hold its last measurement",
    lambda now: column(now.seen["visible"]),
)
OBJECTS_OPTION = Option(
    "split from which objects are drawn; the last two must not be used in training", SPLITS
)
WRIST_OPTION = Option(
    "*script* leaves the wrist where the sampler put it; *free* lets the first action of an "
    "episode move it, by four numbers more",
    WRISTS,
)
OBJECT_OPTION = Option(
    "object of every episode instead of a split's, in the stable poses that drops find; a dictionary "
    "has the arguments of `own_object`",
    (None,),
    "`hpac_gym.body.objects.ObjectSpec`, dictionary",
)
HANDS_OPTION = Option(
    "*nominal* is `hand`; *train* draws one of 32 hands of other lengths, tendons and servos "
    "for every episode, *test* one of 8 others; no policy is told which, and nothing may be trained on the latter",
    HANDS,
)


class GraspAny(Task):
    """Draws episodes, judges them, and shapes the reward: a `hpac_gym.tasks.task.Task`.

    Args:
        objects: split from which objects are drawn.
        wrist: "script" keeps the wrist where the sampler puts it; "free" lets an episode's first
            action move it.
        hands: "nominal" keeps the given hand; "train" and "test" draw one from that set of hands,
            without telling the policy.
        config: sampling ranges, success criteria and reward weights, or a mapping of some of them.
        object: the object of every episode instead of a split's, in stable poses that are found by
            dropping it; a dictionary holds the arguments of `own_object`.

    Raises:
        ParameterError: Invalid config or object, or unknown split, wrist or set of hands.
    """

    phases = PHASES
    changing = ("grip", "holding_force", "turn", "sides", "_closed", "_gained", "_grasped")
    viewpoint = Viewpoint(yaw_deg=120.0)
    sensed_terms: ClassVar = {"load": LOAD_TERMS, "points": ()}

    def __init__(
        self,
        objects: Annotated[str, OBJECTS_OPTION] = "train",
        wrist: Annotated[str, WRIST_OPTION] = "script",
        hands: Annotated[str, HANDS_OPTION] = "nominal",
        config: Annotated[
            GraspAnyConfig | Mapping[str, Any] | None, config_option(GraspAnyConfig)
        ] = None,
        object: Annotated[ObjectSpec | Mapping[str, Any] | None, OBJECT_OPTION] = None,
    ) -> None:
        check_choice("objects", objects, SPLITS)
        check_choice("wrist", wrist, WRISTS)
        check_choice("hands", hands, HANDS)
        config = settings_from(GraspAnyConfig(), config, "config")
        self.hands = hands
        self.config = config
        self.setups = Setups(objects, hands, config, object)
        self.wrist_actions = WRIST_ACTIONS if wrist == "free" else ()
        self.ends = config.ends
        self.duration = self.ends[-1]
        self.terms = (
            *COMMAND_TERMS,
            *OBJECT_TERMS,
            SEEN_TERM,
            *progress_terms(PHASES, self.duration),
        )
        self.privileged_terms = (*PRIVILEGED_TERMS, *HIDDEN_TERMS)
        weights = config.weights
        self.reward_terms = (
            RewardTerm(
                "contact",
                f"while closing, change of the contact score in this step: {weights.thumb:g} for the thumb, "
                f"{weights.finger:g} for each finger, {weights.opposed:g} when they oppose each other",
                lambda now: np.where(now.began == CLOSE, self._gained[0], 0.0),
            ),
            RewardTerm(
                "push",
                f"while closing: {weights.push:g} · growth of the object's displacement as a fraction of `reach`",
                lambda now: np.where(now.began == CLOSE, weights.push * self._gained[1], 0.0),
            ),
            carry_term(weights, CLOSE),
            RewardTerm(
                "force",
                f"{weights.force:g} · holding force / {config.ramp_force:g} N, once, at the end of a successful episode",
                lambda now: np.where(
                    now.outcome == SUCCESS,
                    weights.force * (self.holding_force / config.ramp_force),
                    0.0,
                ),
            ),
            effort_term(weights),
            outcome_term(weights),
        )

    def prepare(self, num_worlds: int, noise: CameraNoise) -> Senses:
        self.grip = Grip(num_worlds)
        self._mass = np.zeros((num_worlds, 1))
        self._pull = np.zeros((num_worlds, 3))
        # The contact score, and the object's displacement as a fraction of `reach`; and their growth.
        self._closed, self._gained = np.zeros((2, 2, num_worlds))
        self._grasped = np.zeros((num_worlds, 3, 3))
        self._names = np.full(num_worlds, "", dtype=object)
        self.holding_force = np.zeros(num_worlds)
        self.turn = np.zeros(num_worlds)
        self.sides = np.zeros(num_worlds, dtype=int)
        servos = ServoSenses() if self.obs == "load" else None
        return Senses(num_worlds, noise, self.viewpoint, servos, self.obs == "points")

    def setup(self, rng: np.random.Generator, hand: Hand = HPAC) -> SceneSetup:
        return self.setups.draw(rng, hand)

    def check(self, setup: SceneSetup) -> None:
        """Refuse a pull that is no direction."""
        as_unit_vector(pull_of(setup), 3, "setup pull")

    def chosen(self, setup: SceneSetup, action: Array) -> SceneSetup:
        """The setup with the wrist moved by the last four numbers of an episode's first action."""
        way = WRIST_REACH * action[-len(WRIST_REACH) :]
        return (
            placing.moved(setup, way[:3], float(way[3]), self.setups.reach_of(setup))
            if way.any()
            else setup
        )

    def start(self, worlds: Sequence[int], setups: Sequence[SceneSetup]) -> None:
        super().start(worlds, setups)
        index = np.asarray(worlds)
        self._mass[index, 0] = [setup.object.mass for setup in setups]
        self._pull[index] = [pull_of(setup) for setup in setups]
        self._closed[:, index] = 0.0
        self._names[index] = [
            spec.model.name if spec.model else spec.shape
            for spec in (setup.object for setup in setups)
        ]
        self.holding_force[index] = self.turn[index] = 0.0
        self.sides[index] = 0

    def wrist_path(self, setup: SceneSetup, times: tuple[float, ...]) -> Array:
        table = self.config.timetable
        return wrist_table(replace(table, clearance=table.lift_height), times)

    def push(self, times: Array) -> Array | None:
        begin = self.ends[SHAKE]
        middle = self.ends[SIDES]
        if times.max() <= begin:
            return None
        side = np.clip(
            (times - begin) / self.config.side_time - 1e-9, 0, len(SIDE_DIRECTIONS) - 1
        ).astype(int)
        weight = (self._mass * GRAVITY)[:, :, None] * (SIDE_DIRECTIONS[side] - DOWN)
        pull = self._ramp(times)[:, :, None] * self._pull[:, None]
        return np.where(
            times[:, :, None] > middle, pull, np.where(times[:, :, None] > begin, weight, 0.0)
        )

    def _ramp(self, time: Array) -> Array:
        """Magnitude of the final force ramp [N] at times [s]."""
        share = (time - self.ends[SIDES]) / self.config.ramp_time
        return self.config.ramp_force * np.minimum(np.maximum(share, 0.0), 1.0)

    def judge(self, state: SceneState, dt: float) -> NDArray[np.int_]:
        """Advance by one control step and judge the episodes.

        An episode fails as soon as the object is out of reach while the hand closes, or the hand
        does not hold it (`Grip`) between the end of the lift and the end of the shake. An episode
        in which the object is held through the shake succeeds, and ends when the object slips or
        the force ramp ends. Knocking an object over is no failure."""
        grip = self.grip
        ran = self.phase(state.time - dt / 2)
        grip.follow(state.object_pos, state.touching.any(axis=1), state.supported, dt)
        phase = self.phase(state.time + dt / 2)  # of the next step
        begins = phase != ran
        grip.settle(begins & (phase == SHAKE), state.object_pos)
        held = grip.holds
        grip.settle(begins & (phase > SHAKE), state.object_pos)
        closing = phase == CLOSE
        self._grasped[closing] = state.object_rotation[closing]
        pushed = np.minimum(grip.moved / self.config.reach, 1.0)
        closed = np.array([contact_score(self.config.weights, state.touching), pushed])
        self._gained = closed - self._closed
        self._closed = closed
        shaken = ran > SHAKE
        if not shaken.all():
            cosine = (np.einsum("nij,nij->n", self._grasped, state.object_rotation) - 1) / 2
            turn = np.arccos(np.minimum(np.maximum(cosine, -1.0), 1.0))
            self.turn = np.where(shaken, self.turn, turn)
        if shaken.any():
            side = np.round((state.time - self.ends[SHAKE]) / self.config.side_time, 6)
            self.sides += (ran == SIDES) & held & (side == np.floor(side))
            pulled = (ran == RAMP) & held
            self.holding_force = np.where(pulled, self._ramp(state.time), self.holding_force)
        beyond = lengths(state.object_pos - GRASP_CENTRE) > self.config.reach
        failed = (closing & beyond) | ((phase >= SHAKE) & ~(shaken | held))
        over = shaken & (~held | (state.time >= self.duration - dt / 2))
        return np.where(failed, FAILURE, np.where(over, SUCCESS, RUNNING))

    def report(self, now: Moment) -> dict[str, Any]:
        return super().report(now) | {
            "holding_force": np.where(now.outcome == FAILURE, 0.0, self.holding_force),
            "sides": self.sides.copy(),
            "turn": self.turn.copy(),
            "object": self._names.copy(),
        }

    def script(self) -> ScriptedGraspAny:
        return ScriptedGraspAny(self.terms, len(self.wrist_actions))
