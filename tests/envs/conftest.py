"""What tests of environments share."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from typing import Any

import pytest


@pytest.fixture
def opened() -> Iterator[Callable[[Any], Any]]:
    """Takes an environment, or several at once, that the end of the test closes."""
    with ExitStack() as stack:
        yield lambda env: stack.enter_context(closing(env))
