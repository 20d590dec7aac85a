"""An OpenDSS circuit as a pandapower net: its balanced positive-sequence equivalent.

The script is taken apart (:mod:`vppres.feeders.dss.script`). OpenDSS builds the circuit in a
process of its own (:mod:`vppres.feeders.dss.engine`), in an empty folder that is thrown away, and
only numbers and names come back.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Floats, Names
from vppres.core.errors import InputError, Problem
from vppres.core.text import named
from vppres.core.units import A_PER_KA, V_PER_KV, kw_to_mw
from vppres.feeders.closeness import largest_difference
from vppres.feeders.dss import script as dss_script
from vppres.feeders.dss.by_phase import complexes
from vppres.feeders.dss.nodes import power_at_nominal
from vppres.feeders.feeder import ImportedFeeder, Profile
from vppres.feeders.net.balance import PHASES, PhasePowers
from vppres.feeders.net.elements import label
from vppres.feeders.net.ratings import NO_LIMIT_KA
from vppres.feeders.net.switches import LOCKED
from vppres.feeders.strangers.confined import confined
from vppres.scenario.network import BusId

OWN_SOURCES = ("pvsystem", "generator", "storage")
"""Classes of what a feeder has its own of, so that the circuit's is off."""

PHASE_COUNT = 3
TOGETHER = " + "
MOST_KVA = 1e12
"""Of a branch that is not to be opened."""

STEPS_OF_A_LIMIT = 100.0
"""Steps that OpenDSS is given as much time for as it is to read the file."""

NF_PER_F = 1e9
SHAPE_TOLERANCE = 1e-6
"""By how much the shares of a circuit's loads may differ and still count as one share."""

Contents = tuple[
    Any,
    dict[int, BusId],
    tuple[str, ...],
    PhasePowers | None,
    "OpenDSSFlow",
    tuple[Profile, ...],
]


def read_opendss(path: Path, time_limit_s: float | None = None, by_phase: bool = False) -> Contents:
    """Read the circuit of a master file; what it redirects to lies in its folder.

    With ``by_phase`` the net is only the tree of a feeder with its phases: then open deltas are
    part of it, and notes say nothing of a balanced equivalent.

    Returns
    -------
    net : pandapowerNet
        Lines, two-winding transformers, loads and generators; one external grid.
    bus_ids : dict
        OpenDSS's name of each bus.
    notes : tuple of str
        What the balanced equivalent leaves out.
    phases : PhasePowers, optional
        What is not balanced, if anything has fewer than three phases.
    flow : OpenDSSFlow
        OpenDSS's own solution.
    profiles : tuple of Profile
        Daily shapes of loads and PV systems, by their labels in the net.
    """
    script = dss_script.read_script(path)
    job = script.job()
    time_limit_s = time_limit_s or dss_script.limit_s(job)
    asked = {**job, "open_deltas": by_phase}
    found = confined("dss.engine", asked, path.name, time_limit_s)
    if found["problems"]:
        raise InputError(located(found["problems"], script, path.name))
    net, ids = _build(found)
    few = _single_phases(found)
    on_balance = () if by_phase and few else _notes_on_balance(*few.get("line", (0, 0)))
    notes = (*script.notes, *on_balance, *found["notes"])
    flow = OpenDSSFlow(job, path.name, found, time_limit_s)
    notes += tuple(_told_shapes(found["shapes"]))
    return net, ids, notes, _phase_powers(found, few), flow, tuple(_profiles(net, found, path.name))


def _profiles(net: Any, found: dict[str, Any], where: str) -> Iterator[Profile]:
    """Profiles of loads and PV systems; rows have no times."""
    shapes = found["shapes"]
    for table, kinds in (("load", ("load",)), ("sgen", ("generator", "pvsystem"))):
        powers = [power for power in found["powers"] if power["kind"] in kinds]
        for i, power in enumerate(powers):
            shape = shapes["follows"].get(f"{power['kind']}.{power['name']}")
            if shape is None:
                continue
            own = shapes["values"][shape]
            factor = power.get("sunny_kw", 1.0) / (power.get("p_max_kw") or 1.0)
            values = pd.Series(own["values"], dtype=float)
            yield Profile(where, label(net, table, i), values, own["unit"], factor)


def _told_shapes(shapes: dict[str, Any]) -> Iterator[str]:
    """Sentence on load shapes and how they are followed."""
    minutes = sorted({own["minutes"] for own in shapes["values"].values()})
    if minutes:
        yield (
            f"Daily shapes of {len(shapes['follows'])} loads and PV systems are followed with "
            f"--profiles source --profile-step {minutes[0]:g}, and not without."
        )


class OpenDSSFlow:
    """OpenDSS's own solution of the circuit as it is, with its controls as they leave it.

    Its loads keep their phases, so that only their sum can follow the powers of a feeder. Buses
    with anything else have the power of the feeder.

    ``job`` has the checked commands that build the circuit, ``found`` what the engine answered.
    """

    def __init__(
        self, job: dict[str, Any], name: str, found: dict[str, Any], time_limit_s: float
    ) -> None:
        self.job = job
        self.name = name
        self.time_limit_s = time_limit_s
        self.found = found
        self.index = {bus["name"]: i for i, bus in enumerate(found["buses"])}
        self.given: dict[int, float] | None = self._by_index(found["v_pu"])
        causes = sorted(found["causes"] + found["beyond"], key=lambda cause: -cause[0])
        self.causes = tuple(words for _, words in causes)
        self.closed = [branch["element"] for branch in found["branches"] if branch["pairs"]]
        self.closed += [each["element"] for each in found["transformers"] if each["closed"]]
        three = (i for i, bus in enumerate(found["buses"]) if {1, 2, 3} <= {*bus["nodes"]})
        self.complete = {*three}
        self.giving = {power["bus"] for power in found["powers"] if power["kind"] != "load"}
        self.disabled: list[str] = []
        self.opened: dict[str, Any] | None = None
        self.load_kw: dict[BusId, float] = {}
        self.groups: dict[BusId, list[str]] = {}
        self.known: dict[tuple[Any, ...], dict[int, float] | None] = {}

    def of(self, net: Any, feeder: ImportedFeeder) -> OpenDSSFlow:
        """The flow for a feeder of the circuit's net, with what was opened in the net."""
        kept = {
            element
            for table in ("line", "trafo")
            for elements in net[table].loc[net[table]["in_service"], "element"]
            for element in str(elements).split(TOGETHER)
        }
        self.disabled, self.opened = sorted({*self.closed} - kept), None
        at = {bus: feeder.bus_of[i] for bus, i in self.index.items() if i in feeder.bus_of}
        giving = {at[bus] for bus in self.giving if bus in at}
        self.groups = {own: [bus for bus in at if at[bus] == own] for own in giving}
        loads = zip(feeder.network.buses, feeder.p_load_kw, strict=True)
        self.load_kw = {bus: kw for bus, kw in loads if kw > 0 and bus not in giving}
        return self

    def v_pu(
        self, buses: Names, p_kw: Floats, q_kvar: Floats, v_slack_pu: float | None = None
    ) -> dict[int, float] | None:
        """See :class:`vppres.feeders.feeder.SourceFlow`; None for powers of another shape."""
        drawn = dict(zip(buses, -p_kw, strict=True))
        shares = [drawn[bus] / kw for bus, kw in self.load_kw.items()]
        if np.ptp(shares or [0.0]) > SHAPE_TOLERANCE:
            return None
        share = float(np.mean(shares or [0.0]))
        powers = dict(zip(buses, zip(p_kw.tolist(), q_kvar.tolist(), strict=True), strict=True))
        held = {
            bus: [*powers[own]] if bus == group[0] else None
            for own, group in self.groups.items()
            for bus in group
        }
        key = (share, v_slack_pu, str(held))
        if key not in self.known:
            self.known[key] = self._solved(share, held, v_slack_pu)
        return self.known[key]

    def told(self, feeder: ImportedFeeder) -> tuple[str, ...]:
        """Causes of a difference, with what is left of it where all phases are."""
        source = self.as_given()
        if source is None:
            return self.causes
        three = {bus: v for bus, v in source.items() if bus in self.complete}
        left_pu = largest_difference(feeder, three)
        if left_pu is None or not self.causes:
            return self.causes
        first = f"{self.causes[0]} (buses with three phases differ by at most {left_pu:.2g} pu)"
        return (first, *self.causes[1:])

    def opened_pu(self) -> float | None:
        """Largest change of a bus's mean voltage by what is out of service here alone."""
        if not self.disabled:
            return None
        opened, whole = self.as_given() or {}, self.given or {}
        apart = (abs(opened[bus] - v) for bus, v in whole.items() if bus in opened)
        return max(apart, default=None)

    def told_opening(self, opened_pu: float | None) -> Iterator[str]:
        """Sentence on the effect of opening elements that are in service in the source."""
        if not self.disabled:
            return
        if opened_pu is None:
            yield f"OpenDSS finds no solution without {named(self.disabled)}."
            return
        yield (
            f"Against OpenDSS's solution with {named(self.disabled)}, the mean voltage of a bus "
            f"moves by at most {opened_pu:.2g} pu."
        )

    def as_given(self) -> dict[int, float] | None:
        """Voltages with the circuit's own powers."""
        return self._by_index(self.tables()["v_pu"])

    def tables(self, by_phase: bool = False) -> dict[str, Any]:
        """Tables of the circuit without what was opened.

        ``by_phase`` keeps what joins the source to a conductor that nothing else does.
        """
        if not self.disabled:
            return self.found
        if self.opened is None:
            job = {**self.job, "disabled": self.disabled, "keep": by_phase, "open_deltas": True}
            self.opened = confined("dss.engine", job, self.name, self.time_limit_s)
            kept = self.opened["kept"]
            self.disabled = [each for each in self.disabled if each not in kept]
        return self.opened

    def _solved(
        self, share: float, held: dict[str, Any], v_slack_pu: float | None
    ) -> dict[int, float] | None:
        """Voltages with a share of all loads, but for buses with powers of their own."""
        loads = [row for row in self.found["powers"] if row["kind"] == "load"]
        shares = [0.0 if row["bus"] in held else share for row in loads]
        own = {bus: power for bus, power in held.items() if power is not None}
        drawn = {
            name: [each * row[name] for each, row in zip(shares, loads, strict=True)]
            + [-power[i] for power in own.values()]
            for i, name in enumerate(("p_kw", "q_kvar"))
        }
        job = {
            **self.job,
            "open_deltas": True,
            "disabled": self.disabled,
            "off": OWN_SOURCES,
            "assets": [{"load": row["name"]} for row in loads] + [{"bus": bus} for bus in own],
            "steps": [{**drawn, "held_v": None}],
            "v_slack_pu": v_slack_pu,
        }
        found = solved_job(job, self.name, self.time_limit_s)
        if found["steps"][0]["v"] is None:
            return None
        volts = np.hypot(found["v"][0].real, found["v"][0].imag)
        base_v = {row["name"]: V_PER_KV * row["kv"] / np.sqrt(3) for row in self.found["buses"]}
        return self._by_index(
            {
                node: v / base_v[node.rpartition(".")[0]]
                for node, v in zip(found["nodes"], volts, strict=True)
            }
        )

    def _by_index(self, v_pu: dict[str, float]) -> dict[int, float] | None:
        """Mean voltage of a bus's phases by its index in the net; None without a solution."""
        if not v_pu:
            return None
        at: dict[int, list[float]] = {}
        for node, v in v_pu.items():
            bus, _, number = node.rpartition(".")
            if bus in self.index and number in ("1", "2", "3"):
                at.setdefault(self.index[bus], []).append(v)
        return {i: float(np.mean(values)) for i, values in at.items()}


def solved_job(job: dict[str, Any], name: str, limit_s: float | None = None) -> dict[str, Any]:
    """The steps of a job that has the circuit's commands, or its problems.

    ``v`` (T, nodes) are volts, NaN where there is no solution.
    """
    limit_s = limit_s or dss_script.limit_s(job) * (1.0 + len(job["steps"]) / STEPS_OF_A_LIMIT)
    found = confined("dss.day", job, name, limit_s)
    if found["problems"]:
        return found
    lost = [np.nan] * 2 * len(found["nodes"])
    parts = np.array([lost if step["v"] is None else step["v"] for step in found["steps"]])
    return {**found, "v": parts[:, ::2] + 1j * parts[:, 1::2]}


def _single_phases(found: dict[str, Any]) -> dict[str, tuple[int, int]]:
    """Of each kind, how many elements have fewer than three phases, and how many there are.

    A line that is open as a whole has all of its phases.
    """
    counts: dict[str, list[int]] = {"line": [], "transformer": []}
    for row in found["branches"]:
        if row["element"].startswith("line."):
            own = row["pairs"] or (row["z"] and row["z"]["re"]) or row["nodes"]
            counts["line"].append(len(own))
    for row in found["transformers"]:
        counts["transformer"].append(min(row["phases"], len(row["nodes"]) or PHASE_COUNT))
    for row in found["powers"]:
        own = min(len(row["coils"]), len(row["nodes"]) or PHASE_COUNT)
        counts.setdefault(row["kind"], []).append(own)
    few = {kind: sum(count < PHASE_COUNT for count in own) for kind, own in counts.items()}
    return {kind: (few[kind], len(own)) for kind, own in counts.items() if few[kind]}


def _notes_on_balance(few: int, lines: int) -> Iterator[str]:
    """Notes on the simplifications of the balanced equivalent."""
    yield (
        "The circuit is taken as balanced: lines have their positive-sequence impedance, loads "
        "of single phases count as spread over three. Voltages are compared with the mean of the "
        "phases in OpenDSS's own solution of the circuit as it is."
    )
    if few:
        yield (
            f"{few} of {lines} lines have fewer than three phases; their impedance is "
            "raised so that drop and losses are those of the phases that they have."
        )


def _phase_powers(found: dict[str, Any], counts: dict[str, tuple[int, int]]) -> PhasePowers | None:
    """Power of the loads less that of generators on each phase, by bus."""
    if not counts:
        return None
    words = [f"{few} of {count} {kind}s" for kind, (few, count) in counts.items()]
    rows = []
    for power in found["powers"]:
        sign = 1.0 if power["kind"] in ("load", "storage") else -1.0
        share_kw = sign * power["p_kw"] / max(len(power["nodes"]), 1)
        at = [share_kw if phase in power["nodes"] else 0.0 for phase in (1, 2, 3)]
        rows.append(pd.Series(at, list(PHASES), name=power["bus"]))
    p_kw = pd.DataFrame(rows, columns=list(PHASES), dtype=float)
    return PhasePowers(f"fewer than three phases have {', '.join(words)}", p_kw)


def located(problems: list[dict[str, Any]], script: dss_script.Script, name: str) -> list[Problem]:
    """Problems of the engine, each at the file and row of its command if it has one."""
    found = []
    for problem in problems:
        at = problem["command"]
        place = None if at is None else script.commands[at]
        file, row = (name, None) if place is None else (place.file, place.row)
        found.append(Problem(file, problem["message"], problem["cure"], row=row))
    return dss_script.folded_lines(found, name)


def _build(found: dict[str, Any]) -> tuple[Any, dict[int, BusId]]:
    """The pandapower net of the circuit, and its buses' names."""
    import pandapower as pp

    from vppres.feeders.net.empty_net import empty_net

    names = [bus["name"] for bus in found["buses"]]
    net = empty_net(name=found["name"], f_hz=found["frequency_hz"])
    pp.create_buses(net, len(names), vn_kv=[bus["kv"] for bus in found["buses"]], name=names)
    at = {name: i for i, name in enumerate(names)}
    kv = {bus["name"]: bus["kv"] for bus in found["buses"]}
    lines = [_line(branch, kv) for branch in found["branches"] if branch["z"]]
    _add_lines(net, lines, at)
    _add_switches(net, lines)
    pairs = (pair for each in found["transformers"] for pair in _of_two_windings(each, kv))
    transformers = [*_banks([*pairs])]
    for transformer in transformers:
        _add_transformer(net, transformer, at)
    for table, rows in (("line", lines), ("trafo", transformers)):
        net[table]["element"] = [row["element"] for row in rows]
        for column in ("phases", "carried_kva"):
            net[table][column] = [float(row[column]) for row in rows]
    for name, bus, power in (*_shunts(found, kv), *_cores(found, kv)):
        p_mw, q_mvar = (float(kw_to_mw(part)) for part in (power.real, power.imag))
        pp.create_shunt(net, at[bus], p_mw=p_mw, q_mvar=q_mvar, name=name)
    _add_powers(net, found["powers"], at)
    _add_source(net, found["source"], at[found["source"]["bus"]])
    # Scenario folders read buses as whole numbers where all of them are.
    whole = all(name.isdecimal() and str(int(name)) == name for name in names)
    ids: dict[int, BusId] = {i: int(name) if whole else name for i, name in enumerate(names)}
    for extra in net.bus.index[len(names) :]:
        ids[int(extra)] = max(int(name) for name in names) + 1 if whole else "vsource"
    return net, ids


def _line(branch: dict[str, Any], kv: dict[str, float]) -> dict[str, Any]:
    """A branch between two buses with the impedance and charging of a balanced line.

    One that is open charges nothing.
    """
    z, closed = complexes(branch["z"]), bool(branch["pairs"])
    n = len(z)
    rest = [complexes(y) for _, _, y in branch["rest"]] if closed else []
    b = sum((y[:n, :n].imag for y in rest if len(y) == n), np.zeros((n, n)))
    return {
        **branch,
        "closed": closed,
        "phases": n,
        "r_ohm": _of_three(n) * _positive_sequence(z.real),
        "x_ohm": _of_three(n) * _positive_sequence(z.imag),
        "b_s": _positive_sequence(b) / _of_three(n),
        "carried_kva": branch["carried_a"] * kv[branch["from_bus"]] / np.sqrt(3) if closed else 0.0,
    }


def _shunts(found: dict[str, Any], kv: dict[str, float]) -> Iterator[tuple[str, str, complex]]:
    """Name, bus, and power at nominal voltage of what is at one bus alone."""
    for branch in found["branches"]:
        for bus, nodes, y in branch["rest"] if not branch["pairs"] else ():
            yield branch["name"], bus, power_at_nominal(nodes, complexes(y), kv[bus])


def _cores(found: dict[str, Any], kv: dict[str, float]) -> Iterator[tuple[str, str, complex]]:
    """Cores of transformers, which OpenDSS has at the second winding."""
    for one in found["transformers"]:
        first, own = one["windings"][:2]
        percent = complex(one["no_load_percent"], one["magnetising_percent"])
        if one["closed"] and percent:
            share = first["kva"] * (kv[own["bus"]] / _in_use_kv(own, kv)) ** 2 / 100.0
            yield f"core of {one['name']}", own["bus"], share * percent


def _in_use_kv(winding: dict[str, Any], kv: dict[str, float]) -> float:
    """Voltage between lines of the turns of a winding that are in use.

    A rated voltage of a single phase may be to neutral.
    """
    rated = winding["rated_kv"], winding["rated_kv"] * np.sqrt(3)
    return float(min(rated, key=lambda each: abs(each - kv[winding["bus"]])) * winding["tap"])


def _of_two_windings(one: dict[str, Any], kv: dict[str, float]) -> Iterator[dict[str, Any]]:
    """A transformer as one with two windings; with three, one for each of them, to their star."""
    windings = one["windings"]
    row = {
        **one,
        "start": windings[0]["bus"],
        "end": windings[1]["bus"],
        "kv": [_in_use_kv(each, kv) for each in windings[:2]],
        "kva": windings[0]["kva"],
        "r_percent": sum(each["r_percent"] for each in windings),
        "x_percent": windings[0]["x_percent"],
        "carried_kva": one["carried_a"] * kv[windings[0]["bus"]] / np.sqrt(3),
    }
    if not one["star"]:
        yield row
    for number, own in enumerate(windings if one["star"] else (), start=1):
        yield row | {
            "name": f"{one['name']} winding {number}",
            "start": own["bus"],
            "end": one["star"],
            "phases": len(one["on_star"]),
            "nodes": [*one["on_star"]],
            "kv": [_in_use_kv(own, kv), kv[one["star"]]],
            "r_percent": own["r_percent"],
            "x_percent": own["x_percent"],
            "carried_kva": MOST_KVA,
        }


def _add_source(net: Any, source: dict[str, Any], bus: int) -> None:
    """The source's voltage behind its impedance."""
    import pandapower as pp

    kv = float(net.bus.at[bus, "vn_kv"])
    behind = pp.create_bus(net, vn_kv=kv, name="vsource")
    pp.create_ext_grid(net, behind, vm_pu=source["v_pu"], name="source")
    pp.create_line_from_parameters(
        net,
        behind,
        bus,
        length_km=1.0,
        r_ohm_per_km=source["r_ohm"],
        x_ohm_per_km=source["x_ohm"],
        c_nf_per_km=0.0,
        max_i_ka=NO_LIMIT_KA,
        name="vsource",
    )


def _add_lines(net: Any, lines: list[dict[str, Any]], at: dict[str, int]) -> None:
    """Lines with their positive-sequence impedances, all at once: one by one takes 4 ms each."""
    import pandapower as pp

    if not lines:
        return

    farad = 1.0 / (2.0 * np.pi * net.f_hz)
    pp.create_lines_from_parameters(
        net,
        [at[line["from_bus"]] for line in lines],
        [at[line["to_bus"]] for line in lines],
        length_km=1.0,
        max_i_ka=[
            NO_LIMIT_KA if line["amps"] is None else line["amps"] / A_PER_KA for line in lines
        ],
        r_ohm_per_km=[line["r_ohm"] for line in lines],
        x_ohm_per_km=[line["x_ohm"] for line in lines],
        c_nf_per_km=[NF_PER_F * farad * line["b_s"] for line in lines],
        name=[line["name"] for line in lines],
        in_service=[line["closed"] for line in lines],
    )


def _add_switches(net: Any, lines: list[dict[str, Any]]) -> None:
    """Switches on the lines that are one; those that a control locks say so."""
    import pandapower as pp

    found = [(i, line) for i, line in enumerate(lines) if line["switch"]]
    for i, line in found:
        start = int(net.line.at[i, "from_bus"])
        pp.create_switch(net, start, i, "l", closed=line["closed"], type="LBS", name=line["name"])
    net.switch[LOCKED] = ["locked in the source" if line["locked"] else "" for _, line in found]


def _of_three(n_phases: int) -> float:
    """How much more current a phase carries than if its power were spread over three."""
    return 3.0 / min(n_phases, 3)


def _positive_sequence(matrix: Floats) -> float:
    """Mean self impedance less what the currents of the other phases induce.

    Currents of three phases cancel but for one, those of two phases but for half.

    >>> _positive_sequence(np.array([[5.0, 2.0, 2.0], [2.0, 5.0, 2.0], [2.0, 2.0, 5.0]]))
    3.0
    >>> _positive_sequence(np.array([[5.0, 2.0], [2.0, 5.0]]))
    4.0
    """
    n = len(matrix)
    own = np.trace(matrix) / n
    mutual = (matrix.sum() - np.trace(matrix)) / max(n * (n - 1), 1)
    return float(own - 0.5 * (min(n, 3) - 1) * mutual)


def _banks(transformers: list[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """Units of single phases between the same buses as one, with the mean of their taps.

    Units on the same phase are parallel, and stay apart.
    """
    rest = list(transformers)
    while rest:
        first = rest.pop(0)
        bank = [first]
        taken = set(first["nodes"])
        ends = (first["start"], first["end"], first["closed"])
        for other in list(rest):
            like = (other["start"], other["end"], other["closed"]) == ends
            single = max(first["phases"], other["phases"]) < PHASE_COUNT
            if like and single and not taken & set(other["nodes"]):
                taken |= set(other["nodes"])
                bank.append(other)
                rest.remove(other)
        yield first if len(bank) == 1 else _bank(bank)


def _bank(units: list[dict[str, Any]]) -> dict[str, Any]:
    """A transformer with the rating of its units, and the mean of everything else."""
    mean = {
        name: float(np.mean([unit[name] for unit in units])) for name in ("r_percent", "x_percent")
    }
    return {
        **units[0],
        **mean,
        **{key: TOGETHER.join(unit[key] for unit in units) for key in ("name", "element")},
        "kva": sum(unit["kva"] for unit in units),
        "carried_kva": sum(unit["carried_kva"] for unit in units),
        "phases": sum(unit["phases"] for unit in units),
        "kv": np.mean([unit["kv"] for unit in units], axis=0).tolist(),
    }


def _add_transformer(net: Any, transformer: dict[str, Any], at: dict[str, int]) -> None:
    """A transformer at its taps: rated voltages are those of the turns that are in use."""
    import pandapower as pp

    ends = (at[transformer["start"]], at[transformer["end"]])
    kv = dict(zip(ends, transformer["kv"], strict=True))
    high, low = sorted(ends, key=lambda bus: -net.bus.at[bus, "vn_kv"])
    r_percent, x_percent = transformer["r_percent"], transformer["x_percent"]
    pp.create_transformer_from_parameters(
        net,
        high,
        low,
        sn_mva=float(kw_to_mw(transformer["kva"])),
        vn_hv_kv=kv[high],
        vn_lv_kv=kv[low],
        vkr_percent=r_percent,
        vk_percent=float(np.copysign(np.hypot(r_percent, x_percent), x_percent)),
        pfe_kw=0.0,
        i0_percent=0.0,
        name=transformer["name"],
        in_service=transformer["closed"],
    )


def _add_powers(net: Any, powers: list[dict[str, Any]], at: dict[str, int]) -> None:
    """Loads, generators and batteries, all phases of a bus together."""
    import pandapower as pp

    loads = [power for power in powers if power["kind"] == "load"]
    batteries = [power for power in powers if power["kind"] == "storage"]
    others = [power for power in powers if power["kind"] in ("generator", "pvsystem")]

    def mega(of: list[dict[str, Any]], name: str) -> Floats:
        return np.asarray(kw_to_mw(np.array([power.get(name, np.nan) for power in of])))

    def values(of: list[dict[str, Any]]) -> dict[str, Any]:
        return {
            "buses": [at[power["bus"]] for power in of],
            "p_mw": mega(of, "p_kw"),
            "q_mvar": mega(of, "q_kvar"),
            "name": [power["name"] for power in of],
        }

    if loads:
        pp.create_loads(net, **values(loads))
    if others:
        kinds = ["PV" if power["kind"] == "pvsystem" else power["kind"] for power in others]
        pp.create_sgens(net, **values(others), type=kinds, sn_mva=mega(others, "s_kva"))
        net.sgen["max_p_mw"] = mega(others, "p_max_kw")
    if batteries:
        energy_mwh = mega(batteries, "energy_kwh")
        pp.create_storages(
            net,
            **values(batteries),
            max_e_mwh=energy_mwh,
            min_e_mwh=energy_mwh * [power["soc_min"] for power in batteries],
            soc_percent=[100.0 * power["soc"] for power in batteries],
            sn_mva=mega(batteries, "s_kva"),
            max_p_mw=mega(batteries, "p_max_kw"),
            min_p_mw=-mega(batteries, "p_max_kw"),
        )
        for column in ("eta_charge", "eta_discharge"):
            net.storage[column] = [power[column] for power in batteries]
