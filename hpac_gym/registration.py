"""The ids of the environments, registered with Gymnasium."""

from gymnasium.envs.registration import register, registry


def register_all() -> None:
    """Register every id that is not registered yet."""
    if "HPAC-Grasp-v0" in registry:
        return
    register(
        id="HPAC-Grasp-v0",
        entry_point="hpac_gym.envs:grasp",
        vector_entry_point="hpac_gym.envs:grasp_vector",
        max_episode_steps=65,  # episodes terminate after 64 steps, so the limit never truncates one
    )
    register(
        id="HPAC-GraspAny-v1",
        entry_point="hpac_gym.envs:grasp_any",
        vector_entry_point="hpac_gym.envs:grasp_any_vector",
        max_episode_steps=145,
    )
    register(
        id="HPAC-GraspType-v0",
        entry_point="hpac_gym.envs:grasp_type",
        vector_entry_point="hpac_gym.envs:grasp_type_vector",
        max_episode_steps=65,
    )
    register(
        id="HPAC-PickPlace-v0",
        entry_point="hpac_gym.envs:pick_place",
        vector_entry_point="hpac_gym.envs:pick_place_vector",
        max_episode_steps=111,
    )
    register(
        id="HPAC-Posture-v1",
        entry_point="hpac_gym.envs:PostureEnv",
        vector_entry_point="hpac_gym.envs:posture_vector",
        max_episode_steps=40,
        kwargs={"randomize": "hand"},
    )
