"""PyBullet's engine. Only this folder names PyBullet."""

from hpac_gym.physics.pybullet.world import quiet_output  # noqa: F401  imports PyBullet without its greeting
