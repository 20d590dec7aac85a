"""Scenario folders in and out."""

from __future__ import annotations

from vppres.io.atomic import atomic_folder, atomic_write_text
from vppres.io.digest import scenario_digest
from vppres.io.find import find_scenario, packaged_scenarios
from vppres.io.scenario_folder import read_scenario
from vppres.io.scenario_writer import write_scenario

__all__ = [
    "atomic_folder",
    "atomic_write_text",
    "find_scenario",
    "packaged_scenarios",
    "read_scenario",
    "scenario_digest",
    "write_scenario",
]
