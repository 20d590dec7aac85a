"""What a person should know of a scenario before its results: dark islands, what was simplified."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from vppres.scenario.scenario import Scenario


def darkness(scenario: Scenario, mode: str | None = None) -> str:
    """Why every island of a scenario is dark, or would be; empty where a battery forms a grid.

    Parameters
    ----------
    scenario : Scenario
        Whose outages.
    mode : {"paper", "physical"}, optional
        How its islands are run; the scenario's own choice if not given.
    """
    if not scenario.outage.any() or scenario.batteries.formers.any():
        return ""
    count = int(scenario.outage.sum())
    steps = "the only step" if count == 1 else f"the {count} steps"
    cause = (
        "No battery has the power to form a grid"
        if len(scenario.batteries)
        else "There is no battery that could form a grid"
    )
    if (mode or scenario.controller.mode) == "physical":
        return f"{cause}: the island is dark, and nobody is served in {steps} without grid."
    return (
        f"{cause}: in truth the island would be dark in {steps} without grid. The "
        "paper's mode takes its voltage for granted and counts whoever the sun supplies as served; "
        "physical mode does not."
    )


def remarks(scenario: Scenario, mode: str | None = None) -> list[str]:
    """Where the feeder comes from and how exact it is, dark islands, and every note of the import.

    Examples
    --------
    >>> from vppres.io.find import load_scenario
    >>> remarks(load_scenario("uk-heatwave-2022"))
    []
    """
    first = [str(scenario.source)] if scenario.source else []
    dark = darkness(scenario, mode)
    return [*first, *([dark] if dark else []), *scenario.source.notes]
