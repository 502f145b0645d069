"""The experiments: servo sweeps, accuracy, identification, and what the paper leaves to future work."""
