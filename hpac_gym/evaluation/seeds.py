"""Which seeds judge: an evaluation counts up from here, and a training draws its seeds below."""

HELD_OUT_SEED = 1_000_000
BENCHMARK_SEED = 2_000_000
"""First seed of the benchmark: no setting of this repository was chosen on the seeds from here on."""
