"""A policy on a hand: observations without an engine, poses of the object, the arm, and the episode."""
