"""Training, evaluation and replay of policies for the H-PAC hand; run from a checkout, not part of the wheel."""
