"""A step of a policy's preprocessor, for policies without pictures."""

from dataclasses import dataclass
from typing import Any

from lerobot.processor import ObservationProcessorStep, ProcessorStepRegistry
from lerobot.utils.constants import OBS_ENV_STATE, OBS_STATE


@ProcessorStepRegistry.register(name="hpac_environment_state")
@dataclass
class EnvironmentStateStep(ObservationProcessorStep):
    """Gives what the hand observes also as the environment's state: ACT and diffusion want either
    that or a picture, and a robot of LeRobot cannot give it.
    """

    def observation(self, observation: dict[str, Any]) -> dict[str, Any]:
        """The observation with one more entry."""
        return {**observation, OBS_ENV_STATE: observation[OBS_STATE]}

    def transform_features(self, features: Any) -> Any:
        """Which features there are is the policy's own affair."""
        return features
