"""Development tools: generators, searches and benchmarks, run from a checkout and not part of the
wheel.
"""

from hpac_gym.command import explain_missing_extras

explain_missing_extras()
