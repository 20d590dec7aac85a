"""Networks of other tools, read by their libraries and reduced to a radial feeder.

Every source becomes a pandapower net first; one reduction (:mod:`vppres.feeders.net.reduce`) makes
the feeder of it. The libraries are loaded when a network is imported, not before.
"""

from __future__ import annotations

from vppres.feeders.feeder import Deviation, Generators, ImportedFeeder
from vppres.feeders.net.reduce import feeder_of
from vppres.feeders.sources import NAMED, import_network

__all__ = ["NAMED", "Deviation", "Generators", "ImportedFeeder", "feeder_of", "import_network"]
