"""Settings of all tests: the same examples every time, and one thread a process."""

import os

from hypothesis import settings

os.environ.setdefault("OMP_NUM_THREADS", "1")

settings.register_profile("default", deadline=None, derandomize=True)
settings.load_profile("default")


def pytest_configure(config):
    config.addinivalue_line("markers", "processor: what another processor's rounding could change; runs under that rounding too")
