"""Processor time of a test: unlike the clock's, it does not grow on a busy machine."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def processor_s_below(limit: float) -> Iterator[None]:
    """The block needs fewer seconds of the processor, with those of the processes that ended in it."""
    begin = sum(os.times()[:4])
    yield
    assert sum(os.times()[:4]) - begin < limit
