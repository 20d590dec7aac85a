"""Least-loss radial configurations of a feeder with ties."""

from vppres.feeders.reconfiguration.loops import SwitchedNetwork
from vppres.feeders.reconfiguration.search import (
    Configuration,
    ConfigurationLimits,
    LeastLoss,
    least_loss,
)

__all__ = ["Configuration", "ConfigurationLimits", "LeastLoss", "SwitchedNetwork", "least_loss"]
