"""Which seeds judge: an evaluation counts up from here, and a training draws its seeds below."""

HELD_OUT_SEED = 1_000_000
