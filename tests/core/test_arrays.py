"""Keys of frozen tables: equal content and nothing else has an equal key."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from vppres.core.arrays import content_key
from vppres.scenario.assets import Customers


def customers(count: int) -> Customers:
    """Customers at buses of their own."""
    return Customers(
        id=[f"c{i}" for i in range(count)],
        bus=list(range(count)),
        tier=["critical"] * count,
        weight=np.ones(count),
        power_factor=np.ones(count),
    )


@pytest.mark.parametrize("count", [5, 1200, 5000])
def test_one_item_of_many_changes_the_key(count: int) -> None:
    table = customers(count)
    bus = table.bus.copy()
    bus[count // 2] = -1
    assert content_key(table) == content_key(customers(count))
    assert content_key(table) != content_key(replace(table, bus=bus))
