"""Tests of vppres. Test modules import helpers from ``tests.support`` and never each other."""

import pytest

# Before the helpers are imported: their assertions then say what they compared.
pytest.register_assert_rewrite("tests.support")
