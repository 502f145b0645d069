"""The workshop: generators, searches and benchmarks that are run from a checkout and are no part of the wheel."""
