"""The experiments: servo sweeps, accuracy, identification, and the paper's future work."""
