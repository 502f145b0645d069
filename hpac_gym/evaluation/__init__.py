"""Judging policies on held-out episodes: seeds, workers, statistics, the benchmark of the sixteen named grasps, film strips."""
