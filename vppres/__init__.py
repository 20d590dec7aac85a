"""Dispatch a virtual power plant through an outage.

The names of the table below are loaded on first use, so that ``import vppres`` and the command line
start without the solver and power-flow libraries.
"""

from __future__ import annotations

import logging
from importlib import import_module
from typing import Any

# pandapower reports at every start that it goes without plotly, which nothing here uses.
logging.getLogger("pandapower.plotting").setLevel(logging.WARNING)

_HOME_OF = {
    "Controller": "vppres.live.controller",
    "ForecastErrors": "vppres.contract.forecast",
    "InputError": "vppres.core.errors",
    "Feed": "vppres.live.feed",
    "LineFault": "vppres.scenario.faults",
    "Measurement": "vppres.live.measurement",
    "NewScenarioOptions": "vppres.feeders.new.options",
    "OutageStatistics": "vppres.scenario.outage_warnings",
    "OutageWarning": "vppres.scenario.outage_warnings",
    "RunOptions": "vppres.day.options",
    "Scenario": "vppres.scenario.scenario",
    "SetPoints": "vppres.live.set_points",
    "SwitchingRules": "vppres.kinds.customer.data",
    "Trajectory": "vppres.day.trajectory",
    "VppresError": "vppres.core.errors",
    "explain_day": "vppres.explain.day",
    "find_scenario": "vppres.io.find",
    "import_network": "vppres.feeders.sources",
    "load_scenario": "vppres.io.find",
    "new_scenario": "vppres.feeders.new.scenario",
    "packaged_scenarios": "vppres.io.find",
    "plot": "vppres.report.plot",
    "read_run": "vppres.day.run_files",
    "read_scenario": "vppres.io.scenario_folder",
    "run_day": "vppres.day.simulate",
    "summarise": "vppres.day.metrics",
    "write_new_scenario": "vppres.feeders.new.scenario",
    "write_run": "vppres.report.run_folder",
    "write_scenario": "vppres.io.scenario_writer",
}
"""Public name to the module that defines it, or is it; a new public name is one row."""

__all__ = ["__version__", *_HOME_OF]


def __getattr__(name: str) -> Any:
    """Load a public name from its module (PEP 562)."""
    if name == "__version__":
        value: Any = _installed_version()
    elif name in _HOME_OF:
        home = import_module(_HOME_OF[name])
        value = home if home.__name__.endswith(f".{name}") else getattr(home, name)
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


def _installed_version() -> str:
    """Version of the installed distribution; a bare checkout has none."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("vppres")
    except PackageNotFoundError:
        return "0+not.installed"
