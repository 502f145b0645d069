"""Evidence: tests of the guarantees of hand and host. Nothing here is needed to drive a hand."""
