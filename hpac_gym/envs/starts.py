"""How an episode starts: drawn by the task, changed by the options and by the randomization."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from hpac_gym.envs.commands import LinkFaults
from hpac_gym.envs.options import Options
from hpac_gym.envs.randomization import Randomization, changed_setup, stream
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import SceneSetup
from hpac_gym.physics.settings import BODIES, HandSettings
from hpac_gym.tasks.task import GoalSetup, Task

_NO_CHOICE = HandSettings()


@dataclass(frozen=True, slots=True)
class Start:
    """The start of one episode."""

    setup: SceneSetup
    drawn: Mapping[str, Array]
    """Values drawn by the randomization, by name."""
    noise: tuple[float, np.random.Generator]
    """Factor of the camera's noise, and its generator."""
    faults: LinkFaults | None
    """What is wrong with the link to the hand."""


def start_of(
    task: Task,
    options: Options,
    ranges: Randomization,
    generator: np.random.Generator,
    given: SceneSetup | None,
) -> Start:
    """Draw the start of an episode, or only what a given setup leaves open."""
    setup_rng, camera_rng = generator.spawn(2)
    drawn = ranges.draw(setup_rng)
    drawn_here = given is None or isinstance(given, GoalSetup)
    setup = _with_options(given or task.setup(setup_rng, options.hand), options, drawn_here)
    lost, late = (float(drawn.get(name, [0.0])[0]) for name in ("dropped_frames", "late_frames"))
    return Start(
        changed_setup(setup, drawn),
        drawn,
        (float(drawn.get("sensor_noise", [1.0])[0]), camera_rng),
        LinkFaults(lost, late, stream(setup_rng, "losses")) if lost or late else None,
    )


def _with_options(setup: SceneSetup, options: Options, drawn: bool) -> SceneSetup:
    """The setup with the servo zeros and the body of the options; a given one keeps its own."""
    settings = setup.hand_settings
    if drawn and any(zero := options.hand.calibration.servo_zero):
        zero = tuple(np.add(settings.servo_zero, zero).tolist())
        settings = replace(settings, servo_zero=zero)
    body = BODIES[options.body]
    if body != _NO_CHOICE and (drawn or settings == _NO_CHOICE):
        settings = replace(settings, armature=body.armature, hub_inertia=body.hub_inertia)
    return setup if settings is setup.hand_settings else replace(setup, hand_settings=settings)
