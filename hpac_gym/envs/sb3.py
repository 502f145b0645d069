"""The environments as Stable-Baselines3's `VecEnv`. Needs Stable-Baselines3, which the extra
`train` installs.
"""

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from hpac_gym.envs.randomization import randomization
from hpac_gym.envs.vector_env import ATTRIBUTES, HandVectorEnv, require
from hpac_gym.errors import ParameterError, install
from hpac_gym.tasks.task import CONTROL_HZ

try:
    from stable_baselines3.common.vec_env import VecEnv
except ModuleNotFoundError as error:
    needs = f"HandVecEnv needs Stable-Baselines3: {install('train')}"
    raise ModuleNotFoundError(needs, name=error.name) from None


class HandVecEnv(VecEnv):
    """n environments of an id for Stable-Baselines3: with `engine="mujoco"` one batch of arrays,
    without processes.

    `env_id` and `options` are those of `gymnasium.make_vec`. An observation, a reward (float32) and
    a done are, to the bit, what `DummyVecEnv` gives. The info of an environment whose episode ends
    is complete: `terminal_observation`, `TimeLimit.truncated` and all entries of its last step. The
    info of a running one has only `TimeLimit.truncated`, since a full dictionary for each of them
    would cost more than the batch saves; `infos` has the rest.

    Args:
        env_id: id of the environment, such as "HPAC-Grasp-v0".
        num_envs: n.
        options: options of the id, and `max_episode_steps`.

    Attributes:
        envs: underlying Gymnasium vector environment, with autoreset in the step that ends an
            episode.
        infos: its infos of the last step in Gymnasium's format: arrays by name with their masks.

    Raises:
        ParameterError: An option that the id refuses.
    """

    def __init__(self, env_id: str, num_envs: int, **options: Any) -> None:
        self.envs = gymnasium.make_vec(
            env_id, num_envs, autoreset_mode=AutoresetMode.SAME_STEP, **options
        )
        self.infos: dict[str, Any] = {}
        super().__init__(
            num_envs, self.envs.single_observation_space, self.envs.single_action_space
        )
        self.metadata["render_fps"] = CONTROL_HZ

    def reset(self) -> Any:
        """Start an episode in every environment, with the seeds and options that `seed` and
        `set_options` gave.

        Raises:
            ParameterError: The environments were given options of different names, or on PyBullet
                different options.
        """
        options, *others = self._options
        if any(other is not options for other in others):
            names = {", ".join(sorted(own)) or "none" for own in self._options}
            if len(names) > 1 or (options and not isinstance(self.envs, HandVectorEnv)):
                raise ParameterError(
                    f"set_options: one for all, or on MuJoCo one for each with the same names; given: {'; '.join(sorted(names))}"
                )
            options = {name: [own[name] for own in self._options] for name in options}
        seen, self.infos = self.envs.reset(seed=self._seeds, options=options or None)
        self.reset_infos = [_info(self.infos, world) for world in range(self.num_envs)]
        self._reset_seeds()
        self._reset_options()
        return seen

    def step_async(self, actions: NDArray) -> None:
        """Take the actions of the next step, shape (n, 6)."""
        self._actions = actions

    def step_wait(self) -> tuple[Any, NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Carry out the step: observations, rewards, dones and infos."""
        seen, rewards, terminated, truncated, self.infos = self.envs.step(self._actions)
        done = terminated | truncated
        infos: list[dict[str, Any]] = [{"TimeLimit.truncated": False} for _ in range(self.num_envs)]
        for world in np.flatnonzero(done).tolist():
            infos[world] = _info(self.infos["final_info"], world)
            infos[world]["TimeLimit.truncated"] = bool(truncated[world] and not terminated[world])
            infos[world]["terminal_observation"] = self.infos["final_obs"][world]
            told = {
                name: value
                for name, value in self.infos.items()
                if not name.endswith(("final_obs", "final_info"))
            }
            self.reset_infos[world] = _info(told, world)
        return seen, rewards.astype(np.float32), done, infos

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Attribute of some environments, by default of all; see `HandVectorEnv.get_attr`."""
        require("get_attr", attr_name, *ATTRIBUTES)  # a process of PyBullet would end
        return self._chosen(self.envs.get_attr(attr_name), indices)

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set an attribute of some environments, by default of all, to one value; see
        `HandVectorEnv.set_attr`.
        """
        require("set_attr", attr_name, "randomization")  # as there, and so for its value
        value = randomization(value)
        values = list(self.envs.get_attr(attr_name))
        for world in self._get_indices(indices):
            values[world] = value
        self.envs.set_attr(attr_name, values)

    def env_method(
        self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any
    ) -> list[Any]:
        """Results of a method in some environments, by default in all; see `HandVectorEnv.call`."""
        return self._chosen(self.envs.call(method_name, *method_args, **method_kwargs), indices)

    def _chosen(self, values: Sequence[Any], indices: Any) -> list[Any]:
        return [values[world] for world in self._get_indices(indices)]

    def env_is_wrapped(
        self, wrapper_class: type[gymnasium.Wrapper], indices: Any = None
    ) -> list[bool]:
        """Always False: single environments are not wrapped."""
        return [False for _ in self._get_indices(indices)]

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """A picture of every environment, or None for each without a render mode."""
        return self.envs.render() or [None] * self.num_envs

    def close(self) -> None:
        """Release the physics. Closing twice is allowed."""
        self.envs.close()


def _info(infos: dict[str, Any], world: int) -> dict[str, Any]:
    """Info of one environment, extracted from arrays with masks."""
    own = {}
    for name, values in infos.items():
        mask = infos.get(f"_{name}")
        if mask is None or not mask[world]:
            continue
        if isinstance(values, dict):
            own[name] = _info(values, world)
        else:
            own[name] = (
                values[world].item() if isinstance(values[world], np.generic) else values[world]
            )
    return own
