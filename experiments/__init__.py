"""The experiments: servo sweeps, accuracy, identification, and the paper's future work."""

from hpac_gym.command import explain_missing_extras

explain_missing_extras()
