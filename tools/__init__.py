"""Development tools: generators, searches and benchmarks, run from a checkout and not part of the
wheel.
"""
