"""Random windows over all forms beside the monolith.

Each window has the paper's problem, or one or two things beyond it. Both methods solve it, and no
answer may break a row or lie above the other's bound.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.random import Generator

from benchmarks.frame.random_feeders import Window, random_state, random_window
from vppres.contract.stored_value import PIECES, StoredValue
from vppres.contract.terminal import Terminal
from vppres.control.converged import physics_of
from vppres.kinds.export.physics import Export
from vppres.model.data import WindowData
from vppres.model.linearise import Drawn
from vppres.model.site import Site

LIMIT_S = 30.0
"""Time limit of a method, in s of CPU time."""

ROUNDING = 1e-6
"""By how much an objective may exceed a bound: tolerance of the solvers."""


def with_rules(case: Window, seed: int, rng: Generator) -> WindowData:
    """Switching rules and a past."""
    state = random_state(seed, case.scenario)
    return replace(case.data, switching=state.window(case.data.n_steps))


def with_physics(case: Window, seed: int, rng: Generator) -> WindowData:
    """Losses, headroom and an island's reference."""
    physics = physics_of(Site.of(case.scenario), case.data, headroom=0.1)
    loss_kw = rng.uniform(0.0, 0.5, (case.data.n_steps, case.scenario.network.n_lines))
    return replace(case.data, physics=replace(physics, loss_kw=loss_kw, loss_kvar=0.5 * loss_kw))


def with_export(case: Window, seed: int, rng: Generator) -> WindowData:
    """A connection that exports, at a price below or above that of import."""
    data = case.data
    limit_kw = rng.choice([0.0, 50.0, np.inf], data.n_steps)
    export = Export(limit_kw, data.price_gbp_per_kwh + rng.uniform(-0.3, 0.2, data.n_steps))
    return replace(data, export=export.within(data.grid_limit_kw))


def with_draws(case: Window, seed: int, rng: Generator) -> WindowData:
    """Draws of the network; none in an outage."""
    data = case.data
    shape = (data.n_steps, case.scenario.network.n_buses)
    drawn = Drawn(rng.uniform(-1.0, 2.0, shape), rng.uniform(-1.0, 1.0, shape))
    return replace(data, drawn=drawn.at(data.grid_limit_kw[:, None] > 0.0))


def with_target(case: Window, seed: int, rng: Generator) -> WindowData:
    """A state of charge at the end."""
    ends = Terminal(float(rng.uniform(0.2, 0.8)), float(rng.uniform(0.1, 1.0)))
    return replace(case.data, terminal=ends if len(case.data.soc) else None)


def with_value(case: Window, seed: int, rng: Generator) -> WindowData:
    """A value of what is stored at the end."""
    if not len(case.data.soc):
        return case.data
    most_kwh = float(case.scenario.batteries.energy_kwh.sum())
    slope = np.sort(rng.uniform(0.0, 2.0 / most_kwh, PIECES))[::-1]
    energy_kwh = np.linspace(0.0, most_kwh, PIECES + 1)
    service = np.append(0.0, np.cumsum(slope * np.diff(energy_kwh)))
    value = StoredValue(energy_kwh, service, 1000.0, as_service=bool(rng.random() < 0.5))
    return replace(case.data, stored_value=value)


Change = Callable[[Window, int, Generator], WindowData]
CHANGES: dict[str, Change] = {
    "rules": with_rules,
    "physical": with_physics,
    "export": with_export,
    "drawn": with_draws,
    "target": with_target,
    "value": with_value,
}
FORMS: tuple[tuple[str, ...], ...] = (
    (), ("rules",), ("physical",), ("export",), ("drawn",), ("target",), ("value",),
    ("rules", "export"), ("physical", "drawn"), ("export", "value"), ("rules", "target"),
    ("physical", "export"),
)  # fmt: skip


def window_of(number: int) -> tuple[str, Site, WindowData]:
    """Form, site and data of a random window."""
    form = FORMS[number % len(FORMS)]
    seed = 1000 + number
    case = random_window(seed, stressed=bool(number // len(FORMS) % 2))
    rng = np.random.default_rng([seed, 11])
    for name in form:
        case = Window(case.scenario, CHANGES[name](case, seed, rng))
    return "+".join(form) or "paper", Site.of(case.scenario), case.data
