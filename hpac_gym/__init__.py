"""Reinforcement learning and control of the H-PAC tendon hand, from simulation to the servo."""
