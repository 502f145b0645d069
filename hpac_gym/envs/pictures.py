"""Pictures of the worlds of `Episodes`, and the page of `render_mode="human"`."""

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hpac_gym.errors import EpisodeError
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import HAND_POSITION, SceneSetup, Viewpoint
from hpac_gym.tasks.senses import VIEW_TARGET
from hpac_gym.tasks.task import OUTCOMES

if TYPE_CHECKING:
    from hpac_gym.view.page import HandPage


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
