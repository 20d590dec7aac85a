"""Places in the one-line diagram: no two things on one spot, on any radial network."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vppres.report.tree_layout import TreeLayout, tree_layout
from vppres.scenario.network import Network


def network(parents: list[int]) -> Network:
    """Bus ``i + 1`` hangs on bus ``parents[i]``."""
    ends = list(range(1, len(parents) + 1))
    return Network(parents, ends, [0.1] * len(ends), [0.1] * len(ends), slack_bus=0, base_kv=11.0)


@st.composite
def trees(draw: st.DrawFn) -> Network:
    n_lines = draw(st.integers(1, 40))
    return network([draw(st.integers(0, i)) for i in range(n_lines)])


def points_of(net: Network, layout: TreeLayout, line: int) -> set[tuple[int, int]]:
    """Places that a line touches, its sending end left out."""
    start, end = net.parent[line], line + 1
    rows = sorted((layout.row[start], layout.row[end]))
    column = layout.column[start]
    touched = {(int(column), int(row)) for row in range(rows[0], rows[1] + 1)}
    touched.add((int(layout.column[end]), int(layout.row[end])))
    return touched - {(int(column), int(layout.row[start]))}


def test_a_chain_is_straight() -> None:
    layout = tree_layout(network([0, 1, 2]))
    assert layout.column.tolist() == [0, 1, 2, 3]
    assert layout.row.tolist() == [0, 0, 0, 0]


def test_laterals_go_to_both_sides() -> None:
    # Bus 1 feeds the trunk 2, 3 and the laterals 4 and 5.
    net = network([0, 1, 2, 1, 1])
    row = dict(zip(net.buses.tolist(), tree_layout(net).row.tolist(), strict=True))
    assert row == {0: 1, 1: 1, 2: 1, 3: 1, 4: 2, 5: 0}


def test_houses_along_a_lateral_lie_on_both_sides_of_it() -> None:
    """A lateral of nine buses with a house at each, beside a trunk of twelve: four rows."""
    trunk, lateral = range(12), [1, *range(13, 21)]
    net = network([*trunk, *lateral, *range(13, 22)])
    assert tree_layout(net).row.max() == 3


@settings(max_examples=150)
@given(trees())
def test_no_two_buses_share_a_place_and_no_line_meets_a_strange_bus(net: Network) -> None:
    layout = tree_layout(net)
    places = list(zip(layout.column.tolist(), layout.row.tolist(), strict=True))
    assert len(set(places)) == net.n_buses
    assert min(layout.row) == 0
    assert (layout.column[1:] == layout.column[net.parent] + 1).all()
    for line in range(net.n_lines):
        strangers = points_of(net, layout, line) & set(places)
        assert strangers == {places[line + 1]}


@settings(max_examples=50)
@given(trees())
def test_lines_of_different_buses_do_not_cross(net: Network) -> None:
    layout = tree_layout(net)
    for a, b in combinations(range(net.n_lines), 2):
        if net.parent[a] != net.parent[b]:
            assert not points_of(net, layout, a) & points_of(net, layout, b)


@pytest.mark.parametrize("n_buses", [1500])
def test_a_long_feeder_is_laid_out(n_buses: int) -> None:
    layout = tree_layout(network(list(range(n_buses))))
    assert np.array_equal(layout.column, np.arange(n_buses + 1))
