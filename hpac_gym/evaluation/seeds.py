"""Seeds of evaluations, which count up from these numbers; training uses smaller seeds."""

HELD_OUT_SEED = 1_000_000
BENCHMARK_SEED = 2_000_000
"""First seed of the benchmark: no setting of this repository was chosen on the seeds from here on."""
