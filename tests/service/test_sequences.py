"""Sequences of requests, each with its answer: ``tests/service/sequences/*.txt``."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.sequences import Sequence, cases, play


@pytest.mark.parametrize("sequence", cases())
def test_a_sequence_of_requests(sequence: Sequence, tmp_path: Path) -> None:
    play(sequence, tmp_path)
