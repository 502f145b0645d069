"""The PyBullet engine. In this package, only this folder imports PyBullet."""

from hpac_gym.physics.pybullet.world import quiet_output  # noqa: F401  imports PyBullet without its greeting
