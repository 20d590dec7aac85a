"""Least-loss radial configurations of a feeder with ties."""

from vppres.reconfiguration.loops import SwitchedNetwork
from vppres.reconfiguration.search import Configuration, LeastLoss, Limits, least_loss

__all__ = ["Configuration", "LeastLoss", "Limits", "SwitchedNetwork", "least_loss"]
