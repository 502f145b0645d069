"""Judging policies on held-out episodes: seeds, workers, statistics, and the benchmark of the sixteen named grasps."""
