"""Infos of a vector environment, as arrays with masks, and the checks of its arguments."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpac_gym.envs.episodes import Episodes, quality
from hpac_gym.envs.observations import of_world
from hpac_gym.envs.options import check_count, check_number
from hpac_gym.errors import ParameterError

Mask = NDArray[np.bool_]
Add = Callable[[dict[str, Any], dict[str, Any], int], dict[str, Any]]
"""`gymnasium.vector.VectorEnv._add_info`: adds the info of one environment."""


def masked(columns: Mapping[str, NDArray], mask: Mask) -> dict[str, Any]:
    """Arrays by name with their masks; entries outside the mask are zero, or None in object
    arrays.
    """
    found: dict[str, Any] = {}
    for name, values in columns.items():
        empty = None if values.dtype == object else values.dtype.type(0)
        found |= {name: _chosen(mask, values, empty), f"_{name}": mask.copy()}
    return found


def _chosen(mask: Mask, values: NDArray, others: Any) -> NDArray:
    """`values` in the worlds of a mask, `others` in the others."""
    return np.where(mask.reshape(-1, *[1] * (values.ndim - 1)), values, others)


def begin(
    infos: dict[str, Any],
    episodes: Episodes,
    worlds: Sequence[int],
    drawn: Sequence[dict[str, list[float]]],
    add: Add,
) -> None:
    """Add the infos of episodes that begin in some worlds, with the values drawn for them."""
    begun = np.zeros(len(episodes.setups), dtype=bool)
    begun[worlds] = True
    for name, column in masked(episodes.task.report(episodes.now), begun).items():
        infos[name] = _chosen(begun, column, infos[name]) if name in infos else column
    terms: dict[str, Any] = {} if episodes.task.goal_terms else {"reward_terms": {}}
    for world, randomized in zip(worlds, drawn, strict=True):
        add(infos, terms | {"randomized": randomized}, world)


def of_step(episodes: Episodes, stepped: Mask, terminated: Mask, add: Add) -> dict[str, Any]:
    """Infos of the environments that were stepped."""
    infos = masked(episodes.task.report(episodes.now), stepped)
    if not episodes.task.goal_terms:
        terms = masked(episodes.terms, stepped) if stepped.any() else {}
        infos |= {"reward_terms": terms, "_reward_terms": stepped.copy()}
    for world in np.flatnonzero(terminated):
        add(infos, {"epsilon": quality(episodes, world)}, world)
    return infos


def of_last_step(episodes: Episodes, over: Mask, terminated: Mask, add: Add) -> dict[str, Any]:
    """Infos of a step in which episodes end and are reset (autoreset in the same step)."""
    last = episodes.observe()
    ended: dict[str, Any] = {}
    for world in np.flatnonzero(over):
        add(ended, {"final_obs": of_world(last, world)}, world)
    final = of_step(episodes, over.copy(), terminated, add)
    ended |= {"final_info": final, "_final_info": over.copy()}
    return ended | of_step(episodes, ~over, np.zeros_like(terminated), add)


def check_lengths(num_envs: int, max_episode_steps: int | None) -> None:
    """Refuse the numbers of environments and of steps of a vector environment.

    Raises:
        ParameterError: One is no whole number from 1 on; `max_episode_steps` may be None.
    """
    check_number("num_envs", num_envs)
    if max_episode_steps is not None:
        check_number("max_episode_steps", max_episode_steps)


def mask_of(
    options: dict[str, Any] | None, num_envs: int, running: bool
) -> tuple[Mask, dict[str, Any] | None]:
    """The environments that a reset with these options resets, and its other options.

    Raises:
        ParameterError: An invalid mask.
    """
    if not isinstance(options, dict) or "reset_mask" not in options:
        return np.ones(num_envs, dtype=bool), options
    mask = np.asarray(options["reset_mask"])
    if mask.dtype != bool or mask.shape != (num_envs,) or not mask.any():
        raise ParameterError(
            f"reset_mask {mask!r} must be {num_envs} booleans, at least one of them True"
        )
    if not running and not mask.all():
        raise ParameterError("reset_mask must be True everywhere: no episode is running yet")
    return mask, {name: value for name, value in options.items() if name != "reset_mask"}


def seeds_of(seed: int | Sequence[int | None] | None, num_envs: int) -> Sequence[int | None]:
    """One seed per environment, given by the first of consecutive seeds or one by one.

    Raises:
        ParameterError: Wrong number of seeds, or one that is no whole number from 0 on.
    """
    if seed is None:
        return [None] * num_envs
    if isinstance(seed, int | np.integer):
        seed = range(seed, seed + num_envs)
    seeds = seed if np.ndim(seed) else [seed]
    for one in seeds:
        if one is not None and not (isinstance(one, int | np.integer) and one >= 0):
            raise ParameterError(f"seed {one!r} must be a whole number of at least 0, or None")
    check_count("seeds", seeds, num_envs)
    return seeds
