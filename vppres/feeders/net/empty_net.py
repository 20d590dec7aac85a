"""pandapower's empty net, made once: a copy of its tables takes a tenth of the time."""

from __future__ import annotations

from copy import deepcopy
from functools import cache
from typing import Any

import pandapower as pp


def empty_net(**values: object) -> Any:
    """A new pandapower net without elements; ``name``, ``f_hz`` (50) and ``sn_mva`` (1) as given.

    Examples
    --------
    >>> net = empty_net(sn_mva=100.0)
    >>> len(net.bus), net.sn_mva
    (0, 100.0)
    """
    net = deepcopy(_empty())
    net.update(values)
    return net


@cache
def _empty() -> Any:
    return pp.create_empty_network()
