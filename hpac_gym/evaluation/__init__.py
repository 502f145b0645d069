"""Evaluation of policies on held-out seeds: workers, statistics, the benchmark of the sixteen named
grasps, film strips.
"""
