"""The one-line diagram of a run: where everything is drawn, and how it looks in each step.

The drawing is fixed; what changes from step to step are classes of its elements, one digit each,
so that the whole day is a few strings per step.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Flags, Floats, Wholes
from vppres.day.configured import configurations_of
from vppres.day.metrics import line_current_a, line_loading, service_by_tier
from vppres.day.trajectory import LINES_OUT, Trajectory, supplied
from vppres.kinds.table import KINDS
from vppres.report.clock import Clock
from vppres.report.plots.drawing import CIVIDIS, coloured, shortened
from vppres.report.tree_layout import tree_layout
from vppres.scenario.configuration import Branches, blocks_of, out_of_branches
from vppres.scenario.formers import formers_within
from vppres.scenario.phases import PHASES
from vppres.scenario.scenario import Scenario

MARGIN_PX, TOP_PX, GRID_PX = 24, 20, 42
WIDTH_PX, COLUMN_PX = 1000, (52, 172)
"""Width that a small feeder is spread over, and least and most px from a bus to the next."""

CORNER_PX = 25
"""Distance of a tie from the buses of its row or column, less than half of a column."""

SLOT_PX = 20
"""Height of a row of symbols below a bus, two side by side."""

LETTER_PX, MOST_LETTERS, LEAN = 6.2, 26, 0.5
"""Width of a letter, most letters of a name, and the sine of the angle of leaning names."""

MAX_VOLTAGE_CLASSES = 8
CLASS_WIDTHS_PU = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5)
OUT_OF_LIMITS = 9  # the class of voltages outside the AC limits
OUT_OF_SERVICE = 9  # the class of lines that a fault takes out
OPEN = 8  # the class of lines and ties that are open
# Classes of buses by their part; the last are parts without grid beside that of the grid's bus.
WITH_GRID, WITHOUT_GRID, NO_VOLTAGE, FORMER, APART = range(5)
NOT_KNOWN = "n"  # where a digit is not known: there was no step
LOADING_EDGES = (0.2, 0.4, 0.6, 0.8, 1.0)
SERVED = 0
PARTLY = 1
NOT_SERVED = 2
HALF_ULP = 1e-9


@dataclass(frozen=True)
class BusMark:
    """A bus in the drawing, with the symbols of what is connected to it, two in a row.

    ``customers`` and the others are numbers of the scenario's items.
    """

    name: str
    short: str
    x: int
    y: int
    slack: bool
    critical: bool
    connected: Mapping[str, list[int]]

    @property
    def symbols(self) -> list[tuple[str, int, int]]:
        """Kind and place of each symbol from the bus, beside its vertical line."""
        kinds = [kind for kind, items in self.connected.items() if items]
        return [(kind, (-18, 4)[k % 2], 14 + SLOT_PX * (k // 2)) for k, kind in enumerate(kinds)]


@dataclass(frozen=True)
class SwitchMark:
    """A switch in the drawing: what it is, its branch, the places of its two buses, and its path.

    ``below`` is the height of the symbols in the row of the first.
    """

    words: str
    closed: bool
    branch: int
    ends: tuple[int, int, int, int]
    below: int

    @property
    def path(self) -> tuple[tuple[int, int], ...]:
        """Corners of a tie's path: beside the buses of its row or column, else bent a little."""
        x1, y1, x2, y2 = self.ends
        if y1 == y2:
            side = CORNER_PX if x1 < x2 else -CORNER_PX
            return (x1, y1), (x1 + side, y1 + self.below), (x2 - side, y2 + self.below), (x2, y2)
        if x1 == x2:
            side = CORNER_PX if y1 < y2 else -CORNER_PX
            return (x1, y1), (x1 + CORNER_PX, y1 + side), (x2 + CORNER_PX, y2 - side), (x2, y2)
        return (x1, y1), self.middle, (x2, y2)

    @property
    def middle(self) -> tuple[int, int]:
        """Place of the mark of an open switch."""
        x1, y1, x2, y2 = self.ends
        x, y = (x1 + x2) // 2, (y1 + y2) // 2
        if y1 == y2:
            return x, y + self.below
        return (x + CORNER_PX, y) if x1 == x2 else (x, y + 14)


@dataclass(frozen=True)
class FaultMark:
    """A line or bus with a fault in the drawing: what and when in words, and where."""

    words: str
    x: int
    y: int


@dataclass(frozen=True)
class Drawing:
    """Everything that no step changes; names lean where they would reach the next one."""

    width: int
    height: int
    buses: tuple[BusMark, ...]
    lines: tuple[tuple[int, int, int, int], ...]
    switches: tuple[SwitchMark, ...]
    faults: tuple[FaultMark, ...]
    leaning: bool


def drawing(run: Trajectory) -> Drawing:
    """Places of buses and lines, and the marks of what is connected."""
    day = run.scenario
    net, layout, connected = day.network, tree_layout(day.network), _connected(day)
    names = [shortened(str(bus), MOST_LETTERS) for bus in net.buses]
    name_px = LETTER_PX * max(map(len, names))
    column_px = int(np.clip(WIDTH_PX / max(layout.column.max(), 1), *COLUMN_PX))
    leaning = name_px + 8 > column_px
    deep = np.array([-(-sum(map(bool, kinds.values())) // 2) for kinds in connected])
    # A row is as high as the symbols of its buses.
    below = 14 + SLOT_PX * np.array([deep[layout.row == row].max() for row in layout.row])
    above = int(TOP_PX + (LEAN * name_px if leaning else 0.0))
    row_px = above + below[np.unique(layout.row, return_index=True)[1]] + 6
    x = GRID_PX + column_px * layout.column
    y = above + MARGIN_PX + (row_px.cumsum() - row_px)[layout.row]
    at = [*zip(map(int, x), map(int, y), strict=True)]
    customers = day.customers
    critical = {net.bus_index[bus] for bus in customers.bus[customers.tier == day.tiers[0]]}
    buses = tuple(
        BusMark(str(bus), names[i], *at[i], i == 0, i in critical, connected[i])
        for i, bus in enumerate(net.buses)
    )
    lines = tuple((*at[a], *at[b]) for b, a in enumerate(net.parent, 1))
    switches = tuple(
        SwitchMark(words, closed, branch, (*at[a], *at[b]), int(below[a]))
        for words, closed, branch, a, b in _told_switches(Branches.of(day))
    )
    # On the last piece of a line, which no other line has.
    faults = tuple(
        FaultMark(words, int(x[i] if of_bus else (x[net.parent[i - 1]] + x[i]) / 2), at[i][1])
        for words, i, of_bus in _told_faults(day, Clock.of(run))
    )
    beside = name_px if leaning else max(name_px / 2, MARGIN_PX)
    width, height = int(x.max() + beside + MARGIN_PX), int(MARGIN_PX + row_px.sum())
    return Drawing(width, height, buses, lines, switches, faults, leaning)


def _connected(day: Scenario) -> list[dict[str, list[int]]]:
    """Positions of what is connected to each bus, by what it is."""
    net, c = day.network, day.customers
    at = {
        "customers": c.bus,
        "batteries": day.batteries.bus,
        "pv": day.pv.buses(c),
        **{kind: getattr(day, kind).buses(c) for kind in KINDS},
    }
    found = {kind: np.array([net.bus_index[b] for b in buses]) for kind, buses in at.items()}
    return [
        {kind: np.flatnonzero(places == i).tolist() for kind, places in found.items()}
        for i in range(net.n_buses)
    ]


def _told_faults(day: Scenario, clock: Clock) -> Iterator[tuple[str, int, bool]]:
    """Each line or bus with faults, and when, in words; its bus, and whether that is out itself."""
    spans: dict[tuple[int, bool], list[str]] = {}
    for fault in sorted(day.faults, key=lambda fault: fault.start):
        place = fault.at(day.network), fault.line is None
        span = f"from {clock.words(fault.start)} to {clock.words(fault.end)}"
        spans.setdefault(place, [fault.name(day.network)]).append(span)
    for place, (name, *times) in spans.items():
        yield f"{name} out of service {' and '.join(times)}", *place


def _told_switches(branches: Branches) -> Iterator[tuple[str, bool, int, int, int]]:
    """Kind and state of each switch in words, whether it is closed, its branch, and its buses."""
    switches, at = branches.switches, branches.network.bus_index
    branch_of = {int(row): branch for branch, row in enumerate(branches.switch) if row >= 0}
    for i, name in enumerate(switches.id):
        state = "closed" if switches.closed[i] else "open"
        locked = f", locked: {switches.locked[i]}" if switches.locked[i] else ""
        first, last = sorted((at[switches.from_bus[i]], at[switches.to_bus[i]]))
        words = f"{name}: {switches.kind[i]}, {state}{locked}"
        yield words, bool(switches.closed[i]), branch_of[i], first, last


@dataclass(frozen=True, eq=False)
class BranchStates:
    """Which lines and ties are closed in the steps of a run, and which are out, (T, E) each."""

    run: Trajectory
    branches: Branches
    closed: Flags
    out: Flags
    _blocks: dict[bytes, Wholes] = field(default_factory=dict, init=False)

    @classmethod
    def of(cls, run: Trajectory) -> BranchStates:
        """States of the branches of a run."""
        branches, n_steps = Branches.of(run.scenario), len(run.steps)
        closed = configurations_of(run) or [branches.closed] * n_steps
        out = out_of_branches(run.scenario.out_of_service(range(n_steps)), branches.ends)
        return cls(run, branches, np.array(closed), out)

    @property
    def opens(self) -> list[bool]:
        """Whether each branch is open in some step."""
        return [not each.all() for each in self.closed.T]

    def before(self, t: int) -> Flags:
        """Branches that are closed before a step, (E,)."""
        return self.closed[t - 1] if t else self.branches.closed

    def parts_at(self, closed: Flags, t: int) -> tuple[Wholes, Wholes]:
        """Block of each bus over closed branches in a step, and its class, (N,) each."""
        key = closed.tobytes()
        if key not in self._blocks:
            found = blocks_of(self.branches.ends, closed, self.branches.network.n_buses)
            assert found is not None  # a configuration has no loop
            self._blocks[key] = found
        blocks = self._blocks[key]
        here, others = (WITH_GRID, WITHOUT_GRID)
        if self.run.steps["outage"].iloc[t]:
            here, others = (WITHOUT_GRID, APART)
        return blocks, np.where(blocks == 0, here, others)

    def parts(self, v: Floats) -> Wholes:
        """Class of each bus by its part, (T, N): with grid, without, without voltage, or former."""
        run, day = self.run, self.run.scenario
        index = day.network.bus_index
        at = np.array([index[bus] for bus in day.batteries.bus], dtype=int)
        soc = np.vstack([day.batteries.soc_initial, run.by_step("batteries", "soc_end")])
        alone = run.options.get("mode") == "physical"
        found = np.full(v.shape, WITH_GRID)
        for t in range(len(found)):
            blocks, found[t] = self.parts_at(self.closed[t] & ~self.out[t], t)
            without = found[t] != WITH_GRID
            if not without.any():
                continue
            live = np.nan_to_num(v[t]) > 0
            found[t, without & ~live] = NO_VOLTAGE
            charged = day.batteries.holds_energy(soc[t])
            for block in np.unique(blocks[without & live]):
                if block or alone:
                    forms = formers_within(day, blocks[at] == block) & charged
                    found[t, at[forms]] = FORMER
            for kind, forms in run.forms(t).items():
                buses = getattr(day, kind).buses(day.customers)[forms]
                found[t, [i for bus in buses if without[i := index[bus]]]] = FORMER
        return found


def voltage_edges(run: Trajectory) -> Floats:
    """Ends of the voltage classes, shape (classes + 1,), in pu: round numbers around what occurs.

    Voltages outside the AC limits are in a class of their own and do not count here.
    """
    net = run.scenario.network
    v = run.buses["v_ac_pu"].to_numpy(float)
    inside = v[(v >= net.v_min_ac_pu) & (v <= net.v_max_ac_pu)]
    low, high = (inside.min(), inside.max()) if len(inside) else (net.v_min_ac_pu, net.v_max_ac_pu)
    for width in CLASS_WIDTHS_PU:
        first = np.floor(low / width + HALF_ULP)
        last = np.ceil(high / width - HALF_ULP)
        if last - first <= MAX_VOLTAGE_CLASSES:
            break
    return np.asarray(width * np.arange(first, max(last, first + 1) + 1))


def voltage_colours(n_classes: int) -> list[str]:
    """A colour for each voltage class, lowest first; dark to light in a grey print too."""
    return [coloured(CIVIDIS, share) for share in np.linspace(0.0, 1.0, n_classes)]


def worst_step(run: Trajectory) -> int:
    """The outage step with the least weighted service, of equals the one with the lowest voltage.

    Without an outage, the step with the lowest voltage.
    """
    c = run.customers
    weighted = (c["weight"] * supplied(c)).groupby(c["time"]).sum()
    steps = run.steps.assign(service=weighted.reindex(run.steps["time"]).to_numpy())
    steps["service"] = steps["service"].round(9)
    if not steps["outage"].any():
        return int(steps["v_min_ac_pu"].argmin())
    island = steps[steps["outage"].astype(bool)]
    return int(island.sort_values(["service", "v_min_ac_pu"], kind="stable").index[0])


def step_states(run: Trajectory) -> dict[str, Any]:
    """How everything looks in each step, as JSON can hold it.

    Returns
    -------
    dict
        One entry per step in each: ``bus``, ``tile``, ``line`` and ``part``, a digit for the class
        of each bus's voltage and service, each line's loading and each bus's part; ``v``, voltages
        in 0.0001 pu (None where there is none); ``served``, a digit, and ``kw``, the demand of each
        customer; ``amps``; ``soc``, per cent per battery; ``time`` and ``info`` in words;
        ``outage``. And once:
        ``start``, the step to show first.
    """
    v = run.by_step("buses", "v_ac_pu")
    served = run.by_step("customers", "served")
    soc = run.by_step("batteries", "soc_end")
    clock = Clock.of(run)
    at = run.scenario.network.place(run.scenario.customers.bus)
    total = np.asarray(at.sum(axis=1)).ravel()
    got = (at @ served.T.astype(float)).T
    return {
        "start": worst_step(run),
        "time": [clock.full(time) for time in run.steps["time"]],
        "outage": run.steps["outage"].astype(int).tolist(),
        "info": _info(run),
        "bus": _digits(voltage_classes(run, v)),
        "tile": _digits(np.where(got >= total, SERVED, np.where(got > 0, PARTLY, NOT_SERVED))),
        "line": _digits(loading_classes(run)),
        "part": _digits(BranchStates.of(run).parts(v)),
        "served": _digits(served.astype(int)),
        "kw": run.by_step("customers", "p_load_kw").round(1).tolist(),
        "v": [[round(1e4 * pu) if pu > 0 else None for pu in row] for row in v.tolist()],
        "amps": _of_branches(run, line_current_a(run)).round(1).tolist(),
        "soc": np.rint(100.0 * soc).astype(int).tolist(),
    }


def loading_classes(run: Trajectory) -> Wholes:
    """Class of each branch's loading, shape (T, E): the number of edges that it has reached.

    Without any ratings the current is taken as a share of the largest of the run. Branches that are
    open or out of service have classes of their own.
    """
    if run.scenario.network.has_ratings:
        loading = np.nan_to_num(line_loading(run))
    else:
        current = line_current_a(run)
        # The largest current itself stays below the class of overloads.
        loading = 0.999 * current / max(float(current.max()), 1e-9)
    states = BranchStates.of(run)
    classes = np.digitize(_of_branches(run, loading), LOADING_EDGES)
    return np.where(states.out, OUT_OF_SERVICE, np.where(states.closed, classes, OPEN))


def _of_branches(run: Trajectory, values: Floats) -> Floats:
    """Values of lines, (T, L), with nothing on the ties of a run that moves no switches, (T, E)."""
    missing = len(Branches.of(run.scenario)) - values.shape[1]
    return np.pad(values, ((0, 0), (0, missing)))


def voltage_classes(run: Trajectory, v: Floats) -> Wholes:
    """Class of each voltage, shape (T, N)."""
    net = run.scenario.network
    edges = voltage_edges(run)
    classes = np.clip(np.digitize(v, edges) - 1, 0, len(edges) - 2)
    inside = (v >= net.v_min_ac_pu) & (v <= net.v_max_ac_pu)
    return np.where(inside, classes, OUT_OF_LIMITS)


def _info(run: Trajectory) -> list[str]:
    """Line of text for each step."""
    shares = service_by_tier(run)
    lines = []
    for (_, row), (_, step) in zip(shares.iterrows(), run.steps.iterrows(), strict=True):
        grid = "outage" if step["outage"] else _exchange(float(step["p_grid_kw"]))
        tiers = ", ".join(f"{tier} {share:.0%}" for tier, share in row.items())
        v_pu = step["v_min_ac_pu"]
        voltage = f"lowest voltage {v_pu:.4f} pu" if v_pu > 0 else "no voltage"
        out = f"; out of service: {step[LINES_OUT]}" if step.get(LINES_OUT) else ""
        lines.append(f"{grid}; supplied: {tiers}; {voltage}{_phases(run, step)}{out}")
    return lines


def _phases(run: Trajectory, step: pd.Series[Any]) -> str:
    """Source power on each phase of a phased feeder, in words."""
    if not run.scenario.phases:
        return ""
    name = "former" if step["outage"] else "import"
    kva = [step[f"{name}_{phase}_kva"] for phase in PHASES]
    if any(np.isnan(each) for each in kva):
        return ""
    a, b, c = (f"{each:,.0f}" for each in kva)
    return f"; phases a, b and c: {a}, {b} and {c} kVA"


def _exchange(p_grid_kw: float) -> str:
    """Import or export in words."""
    if p_grid_kw < -0.5:
        return f"export {-p_grid_kw:,.0f} kW"
    return f"import {p_grid_kw:,.0f} kW"


def _digits(classes: Wholes) -> list[str]:
    """One string per step, a digit per element."""
    return ["".join(map(str, row)) for row in classes.tolist()]
