"""What is seen of n worlds: the vector of a task's terms, goals and what is not a vector; pictures, and
the page of `render_mode="human"`.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium import Space, spaces
from numpy.typing import NDArray

from hpac_gym.errors import EpisodeError
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import HAND_POSITION, SceneSetup, Viewpoint
from hpac_gym.tasks.senses import POINTS, POINTS_BOUND, VIEW_TARGET
from hpac_gym.tasks.task import OUTCOMES, Task
from hpac_gym.tasks.terms import Layout, Moment

if TYPE_CHECKING:
    from hpac_gym.view.page import HandPage

IMAGE_SIZE = 84
"""Width and height of an observed picture [px]."""
Observation = NDArray[np.float32] | dict[str, NDArray]


def of_world(seen: Observation, world: int) -> Observation:
    """The observation of one of n worlds."""
    if isinstance(seen, dict):
        return {name: part[world] for name, part in seen.items()}
    return seen[world]


class Observations:
    """The observations of n worlds.

    Args:
        task: has the terms.
        obs: kind of observation, as the option of that name.
        num_worlds: n.
        pictures: take what is observed as an image.
        camera: the task's, which sees what is observed as points.

    Attributes:
        space: observation space of one world.
        slices: slices of the observation vector, by field name.
    """

    changing = ("_layout", "_goals", "_achieved", "_desired")

    def __init__(
        self,
        task: Task,
        obs: str,
        num_worlds: int,
        pictures: "Pictures",
        camera: Any,
    ) -> None:
        self._task = task
        more = {"privileged": task.privileged_terms, **task.sensed_terms}
        self._layout = Layout((*task.terms, *more.get(obs, ())), num_worlds)
        self._goals = Layout(task.goal_terms, num_worlds) if task.goal_terms else None
        self._achieved = self._desired = np.zeros(0)
        self.slices = dict(self._layout.slices)
        parts: dict[str, tuple[Space, Callable[[Moment], NDArray]]] = {}  # space and value of each
        parts["observation" if self._goals else "deploy"] = self._layout.space, self._layout.see
        if self._goals:
            parts["achieved_goal"] = self._goals.space, lambda now: self._achieved
            parts["desired_goal"] = self._goals.space, lambda now: self._desired
        if obs == "image":
            space = spaces.Box(0, 255, (IMAGE_SIZE, IMAGE_SIZE, 3), np.uint8)
            size = {"width": IMAGE_SIZE, "height": IMAGE_SIZE}
            parts["image"] = space, lambda now: np.stack(pictures.all(**size))
        if obs == "points":
            space = spaces.Box(-POINTS_BOUND, POINTS_BOUND, (POINTS, 4), np.float32)
            parts["points"] = space, lambda now: camera.points(now.state)
        self._parts = parts
        together = spaces.Dict({name: space for name, (space, _) in parts.items()})
        self.space = self._layout.space if set(parts) == {"deploy"} else together

    def start(self, worlds: Sequence[int], setups: Sequence[SceneSetup]) -> None:
        """Begin episodes in some worlds."""
        for layout in filter(None, (self._layout, self._goals)):
            layout.start(worlds, setups)

    def measure(self, now: Moment) -> None:
        """Tell a task with goals how far the hands are from them."""
        if self._goals:
            box = self._goals.space
            self._achieved = self._goals.see(now)
            self._desired = np.minimum(
                np.maximum(self._task.goal, box.low), box.high, dtype=np.float32
            )
            self._task.measure(self._achieved, self._desired)

    def see(self, now: Moment) -> Observation:
        """Observations after a control step, with a leading axis n."""
        if isinstance(self.space, spaces.Box):
            return self._layout.see(now)
        return {name: value(now) for name, (_, value) in self._parts.items()}


class Pictures:
    """Pictures of the worlds of episodes, from a viewpoint that follows the wrist.

    Args:
        episodes: the `Episodes`, of which these are a part.
        render_mode: None, "rgb_array" or "human".
    """

    def __init__(self, episodes: Any, render_mode: str | None) -> None:
        self._episodes = episodes
        self._mode = render_mode
        self._page: HandPage | None = None
        self._placed: SceneSetup | None = None

    def take(
        self, world: int, viewpoint: Viewpoint, centre: Array = VIEW_TARGET
    ) -> NDArray[np.uint8]:
        """RGB image of a world, shape (height, width, 3), centred on a point of the hand frame,
        shape (3,) [m].
        """
        episodes = self._episodes
        place = episodes.now.state.palm_offset[world]
        place = HAND_POSITION + place + episodes.setups[world].hand_rotation @ centre
        return episodes.simulation.engine.picture(world, viewpoint, place)

    def all(self, **size: int) -> list[NDArray[np.uint8]]:
        """An image of every world, with another `width` and `height` [px] if given."""
        viewpoint = replace(self._episodes.task.viewpoint, **size)
        return [self.take(world, viewpoint) for world in range(len(self._episodes.setups))]

    def render(self) -> list[NDArray[np.uint8]] | None:
        """What `render` returns: an image of every world; None without a render mode, and with
        "human", which shows every step by itself.

        Raises:
            EpisodeError: Before the first `reset`.
        """
        if self._mode is not None and self._episodes.now is None:
            raise EpisodeError("nothing to render: call reset() first")
        return self.all() if self._mode == "rgb_array" else None

    @property
    def page(self) -> "HandPage":
        """The page, which begins with the first one who asks for it; its address is printed."""
        if self._page is None:
            from hpac_gym.view.page import HandPage

            self._page = HandPage(SceneSetup(None), "", driven=True)
        return self._page

    def show(self) -> None:
        """With "human", show world 0 on the page, in real time."""
        if self._mode != "human":
            return
        from hpac_gym.view.page import Shown

        episodes = self._episodes
        now = episodes.now
        setup = episodes.setups[0]
        if setup is not self._placed:
            self._placed = setup
            self.page.place(setup)
        text = f"{now.state.time[0]:.2f} s, {episodes.task.phases[now.phase[0]]}; {OUTCOMES[episodes.outcome[0]]}"
        goal = getattr(setup, "goal", None)
        self.page.wait()
        self.page.show(Shown.of_state(now.state, episodes.commands.servo[0], text, goal))

    def close(self) -> None:
        """Close the page. Closing twice is allowed."""
        if self._page is not None:
            self._page.close()
        self._page = None
