"""A page in the browser that shows a hand in three dimensions."""

from hpac_gym.command import stopped_later

with stopped_later():
    import trimesh.creation  # noqa: F401
    import viser  # noqa: F401
