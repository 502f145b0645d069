"""The recipes of ``agents.train``, whose options are made from the fields of one frozen dataclass."""

from argparse import SUPPRESS, ArgumentParser, Namespace
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from math import inf
from typing import Any, get_type_hints

from agents import RecipeError
from hpac_gym.envs.randomization import PRESETS
from hpac_gym.evaluation.options import add_env_options, env_options
from hpac_gym.physics.simulation import SET_UPS
from hpac_gym.policies import Closures
from hpac_gym.registration import GRASP, GRASP_ANY, GRASP_TYPE, PICK_PLACE, row_of

_KINDS = {
    int: "a whole number",
    float: "a number",
    tuple[int, ...]: "comma-separated whole numbers",
    tuple[float, ...]: "comma-separated numbers",
}


def setting(
    default: Any, meaning: str, low: float = 0.0, high: float = inf, **more: str | tuple[str, ...]
) -> Any:
    """Field with a number in `low`…`high` or one of the `choices`, or with a tuple of them; `only`:
    the one environment that has it.
    """
    bounds = {} if "choices" in more else {"low": low, "high": high}
    return field(default=default, metadata={"meaning": meaning, **bounds, **more})


@dataclass(frozen=True, slots=True)
class Recipe:
    """Settings of one training of closures; `agents.learner` explains them.

    Raises:
        RecipeError: A setting is out of bounds or not one of its choices.
    """

    env_id: str = GRASP
    """Any registered id whose task observes a vector."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Options of the environment, as `hpac_gym.evaluation.options.env_options` gives them."""
    set_ups: tuple[str, ...] = setting(
        ("mujoco/twin",),
        "comma-separated engines and bodies with equal shares of worlds",
        choices=SET_UPS,
    )
    randomize: str = setting("nominal", "randomization of the episodes", choices=tuple(PRESETS))
    contacts: str = setting(
        "usual",
        "contacts in training; weak: without torsional friction, and with half to all of the skin's "
        "friction, so that grasps hold in engines whose contacts hold less",
        choices=("usual", "weak"),
    )
    episodes: int = setting(60_000, "total number of trials", 1, 10**8)
    env_steps: int = setting(10**12, "limit of control steps over all worlds", 1)
    seed: int = setting(0, "seed of the run", 0, 2**31 - 1)
    num_envs: int = setting(128, "number of parallel worlds", 1, 65_536)
    random_episodes: int = setting(2_500, "trials of random closures before the first update", 1)
    script_std: float = setting(
        0.0,
        "largest standard deviation of the first trials about the script, whose successes the actor "
        "imitates; 0: uniformly random closures, and critics instead of imitation",
        0,
        1,
        only=GRASP_TYPE,
    )
    updates_per_episode: float = setting(0.15, "updates per trial", 1e-4, 100)
    batch_size: int = setting(256, "batch size of each critic's update, in trials", 1, 65_536)
    actor_batch_size: int = setting(
        128, "batch size of the actor's update, at most that of the critics", 1, 65_536
    )
    learning_rate: float = setting(1e-3, "initial learning rate; it falls to a twentieth", 1e-8, 1)
    weight_decay: float = setting(0.03, "weight decay of the critics", 0, 10)
    dropout: float = setting(0.1, "dropout rate of the critics", 0, 0.9)
    hidden: tuple[int, ...] = setting((256, 256, 256), "widths of the layers", 1, 4_096)
    critics: int = setting(2, "number of critics", 1, 64)
    pessimism: float = setting(
        0.5,
        "standard deviations over the critics that are subtracted from their mean prediction",
        0,
        10,
    )
    auxiliary_coef: float = setting(
        4.0, "weight of the loss on the predicted state at the end of the closing", 0, 1e3
    )
    acceptance: float = setting(
        0.3, "least probability with which a trial of near-certain success is run", 0.01, 1
    )
    target_entropy_first: float = setting(
        0.1, "target entropy of the actor at the beginning, in nats per number", -10, 0.69
    )
    target_entropy_last: float = setting(-1.0, "target entropy of the actor at the end", -10, 0.69)
    begin: tuple[float, ...] = setting(
        (), "range of the control step at which a closure begins; empty: immediately", 0, 1e6
    )
    release: tuple[float, ...] = setting(
        (), "range of the control step at which the hand opens again; empty: never", 0, 1e6
    )
    sizes: tuple[float, ...] = setting(
        (),
        f"range of factors of the objects' sizes in {GRASP_ANY}, so that a policy learns more "
        "than its objects; empty: their own",
        0.5,
        2,
        only=GRASP_ANY,
    )
    hands: str = setting(
        "nominal",
        f"hands of {GRASP_ANY} in training",
        choices=("nominal", "train"),
        only=GRASP_ANY,
    )
    checkpoint_every: int = setting(5_000, "trials between two checkpoints", 1)
    trials_of: tuple[str, ...] = ()
    """Folders of finished runs whose trials the run learns from, instead of new ones."""

    def __post_init__(self) -> None:
        for entry in fields(self):
            value = getattr(self, entry.name)
            told = entry.metadata
            for part in value if isinstance(value, tuple) else (value,):
                if "choices" in told and part not in told["choices"]:
                    raise RecipeError(
                        f"{entry.name} is '{part}': it must be one of {', '.join(told['choices'])}"
                    )
                if "low" in told and not told["low"] <= part <= told["high"]:
                    raise RecipeError(
                        f"{entry.name} is {part}: it must lie in {told['low']:g}…{told['high']:g}"
                    )
            if told.get("only", self.env_id) != self.env_id and value != entry.default:
                raise RecipeError(
                    f"{entry.name} is {value}: only {told['only']} has this setting, not {self.env_id}"
                )
        if not self.hidden or not self.set_ups:
            raise RecipeError("hidden and set_ups need at least one entry each")
        if self.num_envs < len(self.set_ups):
            raise RecipeError(
                f"num_envs is {self.num_envs}: {len(self.set_ups)} set_ups need a world each"
            )
        for name in ("begin", "release", "sizes"):
            bounds = getattr(self, name)
            if bounds and (len(bounds) != 2 or bounds[0] > bounds[1]):
                raise RecipeError(f"{name} is {bounds}: it must be a lower and an upper bound")
        if bool(self.begin) != bool(self.release):
            raise RecipeError("begin and release are given together, or not at all")
        if self.begin and self.begin[1] > self.release[0]:
            raise RecipeError(
                f"begin is up to {self.begin[1]:g} steps, release from {self.release[0]:g} on: it must come later"
            )

    @property
    def closures(self) -> Closures:
        """The family of closures of the recipe."""
        if self.env_id == GRASP_TYPE:
            return Closures(goal=(-1.0, 1.0), wrist=(-1.0, 1.0))
        shift = (-1.0, 1.0) if self.options.get("wrist") == "free" else None
        return Closures(begin=self.begin or None, release=self.release or None, shift=shift)


RECIPES: Mapping[str, Recipe] = {
    "grasp": Recipe(),
    "grasp-robust": Recipe(set_ups=("mujoco/light",), contacts="weak"),
    "grasp-any": Recipe(
        env_id=GRASP_ANY, env_steps=1_000_000, random_episodes=1_500, sizes=(0.6, 1.6)
    ),
    "grasp-any-wrist": Recipe(
        env_id=GRASP_ANY,
        options={"objects": "wide", "wrist": "free", "config": {"mass": [0.7, 1.8]}},
        episodes=150_000,
        env_steps=6_000_000,
        random_episodes=2_500,
        updates_per_episode=0.5,
        sizes=(0.5, 1.8),
    ),
    "grasp-type": Recipe(
        env_id=GRASP_TYPE,
        episodes=3_000,
        random_episodes=1_000,
        script_std=0.1,
        updates_per_episode=0.6,
    ),
    "pick-place": Recipe(env_id=PICK_PLACE, episodes=8_000, begin=(6, 18), release=(70, 95)),
}


def given_settings(args: Namespace) -> dict[str, str]:
    """The settings given on the command line, as text."""
    return {
        entry.name: getattr(args, entry.name)
        for entry in fields(Recipe)
        if entry.metadata and hasattr(args, entry.name)
    }


def with_settings(recipe: Recipe, texts: Mapping[str, str]) -> Recipe:
    """The recipe with some settings replaced by values given as text.

    Raises:
        RecipeError: A text is not a valid value of its setting.
    """
    types = get_type_hints(Recipe)
    changes = {}
    for name, text in texts.items():
        kind = types[name]
        try:
            if kind in (str, int, float):
                changes[name] = kind(text)
            else:
                changes[name] = tuple(
                    kind.__args__[0](word.strip()) for word in text.split(",") if word.strip()
                )
        except ValueError:
            raise RecipeError(f"{name} is '{text}': it must be {_KINDS[kind]}") from None
    return replace(recipe, **changes)


def add_recipe(parser: ArgumentParser) -> None:
    """Add the options of the environment and one for each setting of a recipe, for `recipe_of`."""
    add_env_options(
        parser,
        "id, also module:My-v0 (default: the recipe's)",
        but=("obs", "reward", "randomize", "hands"),
    )
    group = parser.add_argument_group("settings of the recipe, with the defaults of 'grasp'")
    for entry in fields(Recipe):
        if not entry.metadata:
            continue
        choices = entry.metadata.get("choices")
        text = entry.metadata["meaning"] + (f": {', '.join(choices)}" if choices else "")
        value = getattr(RECIPES["grasp"], entry.name)
        default = ",".join(map(str, value)) if isinstance(value, tuple) else value
        group.add_argument(
            f"--{entry.name.replace('_', '-')}",
            metavar="VALUE",
            default=SUPPRESS,
            help=f"{text} (default: {default})".replace("%", "%%"),
        )


def recipe_of(args: Namespace) -> Recipe:
    """The recipe named on the command line, with the settings and the environment given there.

    Raises:
        RecipeError: The name is unknown, or a setting is invalid.
        ParameterError: An option of the environment has another form.
    """
    if args.recipe not in RECIPES:
        raise RecipeError(f"unknown recipe '{args.recipe}': known are {', '.join(sorted(RECIPES))}")
    recipe = RECIPES[args.recipe]
    given = given_settings(args)
    env_id = (args.env or recipe.env_id).removeprefix("hpac_gym:")
    options = env_options(args, env_id)
    own = ("obs", "reward", "render_mode", "max_episode_steps")
    if fixed := [name for name in own if name in options]:
        raise RecipeError(
            f"{fixed[0]} is {options[fixed[0]]!r}: a training of closures has its own"
        )
    chosen = {name: options.pop(name) for name in ("engine", "body") if name in options}
    if chosen and "set_ups" in given:
        raise RecipeError("--engine and --body name one set-up: give them or --set-ups")
    usual = dict(row_of(env_id).defaults)  # of the id, where nothing is given
    for name in ("randomize", "hands"):  # settings of the recipe
        if name in options or name in usual:
            given.setdefault(name, options.pop(name, usual.get(name)))
    if {"engine", "body"} & (usual | chosen).keys():
        engine, body = recipe.set_ups[0].split("/")
        set_up = {"engine": engine, "body": body} | usual | chosen
        given.setdefault("set_ups", f"{set_up['engine']}/{set_up['body']}")
    return with_settings(replace(recipe, env_id=env_id, options=recipe.options | options), given)


def settings_of(saved: Mapping[str, Any]) -> Recipe:
    """Reconstruct the recipe of a run from JSON.

    Raises:
        TypeError: A setting is missing or unknown, as in a file of another version.
        RecipeError: A setting is out of bounds.
    """
    if differing := {entry.name for entry in fields(Recipe)} ^ set(saved):
        raise TypeError(
            f"it is of another version, whose settings differ in {', '.join(sorted(differing))}"
        )
    return Recipe(
        **{
            name: tuple(value) if isinstance(value, list) else value
            for name, value in saved.items()
        }
    )
