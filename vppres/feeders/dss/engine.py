"""OpenDSS in a process of its own: checked commands in, tables of numbers and names out."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from functools import cache
from typing import Any

import numpy as np
import opendssdirect as dss

# Classes that carry no power, and those that have a counterpart here.
_CONTROLS = """
regcontrol capcontrol swtcontrol invcontrol expcontrol storagecontroller gendispatcher relay
recloser fuse upfccontrol espvlcontrol
"""
CONTROLS = frozenset(_CONTROLS.split())
_CARRYING = "vsource line transformer load generator pvsystem storage capacitor"
CARRYING = frozenset(_CARRYING.split())
CONSTANT_POWER = 1  # OpenDSS's model of a load; 2 is constant impedance, 5 constant current
LOAD_MODELS = {2: "constant impedance", 5: "constant current"}
THREE_PHASES = 3
W_PER_KW = 1000.0
DEFAULT_AMPS = 400.0
TOLERANCE, GUESSED_TOLERANCE = 0.1, 0.01  # sources and windings are often rated above their level
MOST_TOLD = 200
CURE = "Correct the file until OpenDSS solves it."
SOLVES = ("solve", "calcvoltagebases")
"""Commands that may fail where they stand: a solution is looked for at the end."""

LEFT_OUT: list[str] = []
"""Options of ``set`` that the script has and OpenDSS did not get."""

REFUSED_CONTROLS: dict[str, str] = {}
"""Controls that OpenDSS refuses, and why: without them the circuit is what it is."""

Problems = list[dict[str, Any]]
Table = list[dict[str, Any]]


def answer(job: dict[str, Any]) -> dict[str, Any]:
    """The circuit of the job's commands as tables, or what is wrong with it."""
    problems = build(job)
    if problems:
        return {"problems": problems}
    solved = settled()
    state = job.get("state")
    return _tables(solved) if state is None else {"problems": [], **_in_state(state)}


def settled() -> bool:
    """Let regulators and switched capacitors find their places in the state that is given."""
    return _solved("set mode=snapshot", "set controlmode=static", "set maxcontroliter=100")


def solved_by_phase() -> bool:
    """Solve with regulators and capacitors as they stand, to the last digits of each node."""
    return _solved("set controlmode=off mode=snap tolerance=1e-11 maxiterations=1000")


def _solved(*settings: str) -> bool:
    """Solve the circuit; whether that converged."""
    try:
        for command in (*settings, "solve"):
            dss.Text.Command(command)
    except Exception:  # too many control steps, or no solution
        return False
    return bool(dss.Solution.Converged())


def _in_state(state: dict[str, Any]) -> dict[str, Any]:
    """Voltages and losses with other powers and everything else as it was found."""
    off = [f"{element}.enabled=no" for element in state["disabled"]]
    slack = state["v_slack_pu"]
    source = [] if slack is None else [f"vsource.source.pu={slack!r}"]
    for name in list(_of("generator")):
        dss.Generators.Name(name)
        dss.Generators.kW(dss.Generators.kW() * state["generation"])
    for name in list(_of("pvsystem")):
        dss.PVsystems.Name(name)
        dss.PVsystems.Irradiance(dss.PVsystems.Irradiance() * state["generation"])
    multiplier = dss.Solution.LoadMult() * state["load"]
    settings = ("set controlmode=off", f"set loadmult={multiplier!r}", *source, *off)
    return _voltages(_solved(*settings))


def _voltages(solved: bool) -> dict[str, Any]:
    """Mean voltage of the phases of every bus in pu, and all losses; nothing without a solution."""
    if not solved:
        return {"v_pu": None, "losses_kw": None}
    found = {}
    complete = []
    for bus in dss.Circuit.AllBusNames():
        dss.Circuit.SetActiveBus(bus)
        phases = [node in (1, 2, 3) for node in dss.Bus.Nodes()]
        magnitude = np.asarray(dss.Bus.puVmagAngle()[::2])[: len(phases)]
        if any(phases):
            found[bus] = float(magnitude[phases].mean())
        if sum(phases) == THREE_PHASES:
            complete.append(bus)
    losses_kw = float(dss.Circuit.Losses()[0]) / W_PER_KW
    return {"v_pu": found, "losses_kw": losses_kw, "complete": complete}


def build(job: dict[str, Any]) -> Problems:
    """Build the circuit of the job's commands; what is wrong with it."""
    words: Any = sys.modules["dss/commands"]
    dss.Basic.AllowChangeDir(False)
    dss.Basic.AllowForms(False)
    dss.Basic.AllowEditor(False)
    dss.Basic.AllowDOScmd(False)
    commands = words.Commands(job["files"])
    refused: Problems = []
    texts: list[tuple[int, str]] = []
    for i, (verb, target, values) in enumerate(job["commands"]):
        try:
            texts.append((i, commands.text(verb, target, values)))
        except words.Refused as no:
            refused.append(_wrong(no.message, no.cure, i))
    if refused:
        return refused
    dss.Text.Command("clear")
    levels = False
    for i, text in texts:
        if not text:
            continue
        levels |= text == "calcvoltagebases"
        try:
            dss.Text.Command(text)
        except Exception as error:  # the engine's own class has no public name
            element = _control(commands.elements.get(i, ""))
            if not element and text not in SOLVES:
                return [_wrong(f"OpenDSS refuses the file ({told(error)})", CURE, i)]
            if element:
                REFUSED_CONTROLS[element] = told(error)
                dss.Circuit.Disable(element)
    try:
        for text in ("makebuslist", *(() if levels else ("calcvoltagebases",))):
            dss.Text.Command(text)
    except Exception as error:
        return [_wrong(f"OpenDSS refuses the file ({told(error)})", CURE)]
    LEFT_OUT[:] = commands.left_out
    unfit = [p for name in _elements() if (p := _problem(name))]
    banks = [] if job.get("open_deltas") else [*_open_deltas()]
    return [*unfit, *banks] or _check_levels(commands.named_levels)


@cache
def _elements() -> tuple[str, ...]:
    """Enabled elements of the finished circuit, as ``class.name`` in lower case."""
    found = []
    for name in dss.Circuit.AllElementNames():
        dss.Circuit.SetActiveElement(name)
        if dss.CktElement.Enabled():
            found.append(name.lower())
    return tuple(found)


def _of(kind: str) -> Iterator[str]:
    """Names of the enabled elements of a class; each is active while it is yielded."""
    for element in _elements():
        if element.startswith(f"{kind}."):
            dss.Circuit.SetActiveElement(element)
            yield element.partition(".")[2]


def _control(element: str) -> str:
    """The element if it is a control."""
    return element if element.partition(".")[0] in CONTROLS else ""


def told(error: Exception) -> str:
    """What the engine says, in a line; without what it says of itself."""
    lines = [line.strip() for line in str(error).splitlines()]
    kept = [line for line in lines if line and not line.endswith(":")]
    return " ".join(kept or lines)[:MOST_TOLD].rstrip(".")


def _wrong(message: str, cure: str, command: int | None = None) -> dict[str, Any]:
    return {"message": message, "cure": cure, "command": command}


def _problem(element: str) -> dict[str, Any] | None:
    """Why an element has no equivalent here; None if it has."""
    kind, _, name = element.partition(".")
    if kind not in CONTROLS | CARRYING:
        return _wrong(
            f"{element} is not supported",
            "Disable it, or replace it by lines, transformers, loads and generators.",
        )
    if kind == "vsource" and element != "vsource.source":
        return _wrong(
            f"{element} is a second source", "Keep the circuit's own source and disable the others."
        )
    if kind == "transformer":
        dss.Transformers.Name(name)
        if dss.Transformers.NumWindings() != 2:
            return _wrong(
                f"{element} has {dss.Transformers.NumWindings()} windings",
                "Replace it by a transformer with two windings.",
            )
    return None


def _open_deltas() -> Iterator[dict[str, Any]]:
    """Pairs of single units between phases that carry all three: they have no balanced equivalent.

    The two differ in their taps, and turn and unbalance the voltages even of balanced loads.
    """
    units: dict[frozenset[str], dict[str, set[int]]] = {}
    for name in _of("transformer"):
        ends = frozenset(_buses())
        nodes = set(_phases_of_active())
        if dss.CktElement.NumPhases() == 1 and len(nodes) == 2:
            units.setdefault(ends, {})[name] = nodes
    for bank in units.values():
        if len(bank) == 2 and len(set.union(*bank.values())) == THREE_PHASES:
            names = " and ".join(f"transformer.{name}" for name in bank)
            yield _wrong(
                f"{names} are an open delta: two units between phases that carry all three",
                "A balanced model has no such bank: replace both by one transformer of three "
                "phases at the mean of their taps.",
            )


def _check_levels(levels_named: bool) -> Problems:
    """Ratings that do not fit their bus: without ``voltagebases`` OpenDSS guesses the levels."""
    problems = []
    for element, bus, rated_kv, guessed in list(_ratings()):
        tolerance = TOLERANCE if levels_named else guessed
        base_kv = _base_kv(bus)
        # The rating of a single phase may be that between line and neutral.
        if min(abs(rated_kv * f - base_kv) for f in (1.0, np.sqrt(3))) > tolerance * rated_kv:
            problems.append(
                _wrong(
                    f"{element} has {rated_kv:g} kV at bus {bus}, whose nominal voltage is "
                    f"{base_kv:.4g} kV",
                    "Name the levels with 'set voltagebases=[...]'.",
                )
            )
    return problems


def _ratings() -> Iterator[tuple[str, str, float, float]]:
    """Element, bus, rated voltage in kV, and by which share a bus may differ that is guessed."""
    for name in _of("vsource"):
        bus = _buses()[0]
        dss.Vsources.Name(name)
        yield f"vsource.{name}", bus, dss.Vsources.BasekV(), GUESSED_TOLERANCE
    for name in list(_of("transformer")):
        dss.Circuit.SetActiveElement(f"transformer.{name}")
        buses = _buses()
        for winding, bus in enumerate(buses, start=1):
            dss.Transformers.Name(name)
            dss.Transformers.Wdg(winding)
            yield f"transformer.{name}", bus, dss.Transformers.kV(), TOLERANCE


def _base_kv(bus: str) -> float:
    """Nominal line-to-line voltage of a bus."""
    dss.Circuit.SetActiveBus(bus)
    return float(dss.Bus.kVBase() * np.sqrt(3))


def _buses() -> list[str]:
    """Buses of the active element, without their phases."""
    return [bus.partition(".")[0].lower() for bus in dss.CktElement.BusNames()]


def _closed() -> bool:
    """Whether no terminal of the active element is open."""
    return not any(
        dss.CktElement.IsOpen(end, 0) for end in range(1, dss.CktElement.NumTerminals() + 1)
    )


def _tables(solved: bool) -> dict[str, Any]:
    """What the reader makes a pandapower net of."""
    return {
        "problems": [],
        **_voltages(solved),
        "name": dss.Circuit.Name(),
        "frequency_hz": dss.Solution.Frequency(),
        "buses": [{"name": bus, "kv": _base_kv(bus)} for bus in dss.Circuit.AllBusNames()],
        "sources": list(_sources()),
        "lines": list(_lines()),
        "transformers": list(_transformers()),
        "capacitors": list(_capacitors()),
        "powers": list(_powers()),
        "causes": list(_causes()),
        "single_phases": _single_phases(),
        "balanced_notes": list(_notes_on_balance()),
        "notes": list(_notes()),
    }


def _sources() -> Iterator[dict[str, Any]]:
    for name in _of("vsource"):
        bus = _buses()[0]
        dss.Vsources.Name(name)
        v_kv = dss.Vsources.PU() * dss.Vsources.BasekV()
        yield {
            "name": name,
            "bus": bus,
            "v_pu": v_kv / _base_kv(bus),
            "r_ohm": _number(f"vsource.{name}.r1"),
            "x_ohm": _number(f"vsource.{name}.x1"),
        }


def _number(query: str) -> float:
    """A property that OpenDSS only tells as text."""
    dss.Text.Command(f"? {query}")
    return float(dss.Text.Result())


def _lines() -> Iterator[dict[str, Any]]:
    """Lines, with their impedance matrices per unit of length."""
    for name in _of("line"):
        (start, end) = _buses()
        closed = _closed()
        dss.Lines.Name(name)
        yield {
            "name": name,
            "start": start,
            "end": end,
            "closed": closed,
            "length": dss.Lines.Length(),
            "amps": rated_amps(dss.Lines.NormAmps()),
            "phases": dss.Lines.Phases(),
            "r": [float(r) for r in dss.Lines.RMatrix()],
            "x": [float(x) for x in dss.Lines.XMatrix()],
            "c": [float(c) for c in dss.Lines.CMatrix()],
        }


def rated_amps(amps: float) -> float | None:
    """The rating of a line, None where it is what OpenDSS gives to lines without one."""
    return None if amps == DEFAULT_AMPS else float(amps)


def _transformers() -> Iterator[dict[str, Any]]:
    for name in _of("transformer"):
        (start, end) = _buses()
        closed = _closed()
        nodes = _phases_of_active()
        phases = dss.CktElement.NumPhases()
        base_kv = [_base_kv(bus) for bus in (start, end)]
        dss.Transformers.Name(name)
        percent = []
        kv = []
        for winding, level in enumerate(base_kv, start=1):
            dss.Transformers.Wdg(winding)
            percent.append(dss.Transformers.R())
            kv.append(_between_lines(dss.Transformers.kV(), level) * dss.Transformers.Tap())
        yield {
            "name": name,
            "start": start,
            "end": end,
            "closed": closed,
            "phases": phases,
            "nodes": nodes,
            "kv": kv,
            "r_percent": sum(percent),
            "kva": dss.Transformers.kVA(),
            "x_percent": dss.Transformers.Xhl(),
            "no_load_percent": _number(f"transformer.{name}.%noloadloss"),
            "magnetising_percent": _number(f"transformer.{name}.%imag"),
        }


def _between_lines(rated_kv: float, base_kv: float) -> float:
    """A rated voltage between lines; that of a single phase may be to neutral."""
    return float(min((rated_kv, rated_kv * np.sqrt(3)), key=lambda kv: abs(kv - base_kv)))


def _capacitors() -> Iterator[dict[str, Any]]:
    """Capacitors to earth with what they feed at the nominal voltage of their bus."""
    for name in _of("capacitor"):
        buses = _buses()
        dss.Capacitors.Name(name)
        base_kv = _base_kv(buses[0])
        states = dss.Capacitors.States()
        share = sum(states) / max(len(states), 1)
        rated_kv = _between_lines(dss.Capacitors.kV(), base_kv)
        yield {
            "name": name,
            "bus": buses[0],
            "kvar": float(dss.Capacitors.kvar() * share * (base_kv / rated_kv) ** 2),
        }


def _causes() -> Iterator[list[Any]]:
    """What the balanced equivalent of constant powers does not have, with its size in kW."""
    drawn_kw: dict[str, float] = {}
    single_kw = 0.0
    for name in _of("load"):
        few = dss.CktElement.NumPhases() < THREE_PHASES
        dss.Loads.Name(name)
        model, kw = int(dss.Loads.Model()), float(dss.Loads.kW())
        single_kw += kw if few else 0.0
        if model != CONSTANT_POWER:
            kind = LOAD_MODELS.get(model, f"model {model}")
            drawn_kw[kind] = drawn_kw.get(kind, 0.0) + kw
    for kind, kw in drawn_kw.items():
        yield [kw, f"loads of {kind} in the source, {kw:.4g} kW"]
    if single_kw:
        yield [single_kw, f"unbalance: loads of fewer than three phases, {single_kw:.4g} kW"]


def _powers() -> Iterator[dict[str, Any]]:
    """Loads and generators with their nominal powers."""
    for kind in ("load", "generator", "pvsystem"):
        for name in _of(kind):
            bus = _buses()[0]
            nodes = _phases_of_active()
            yield {"kind": kind, "name": name, "bus": bus, "nodes": nodes, **nominal(kind, name)}


def nominal(kind: str, name: str) -> dict[str, float]:
    """Nominal power of a load or generator; of PV its peak, without reactive power."""
    if kind == "pvsystem":
        dss.PVsystems.Name(name)
        return {"p_kw": float(dss.PVsystems.Pmpp()), "q_kvar": 0.0}
    table = dss.Loads if kind == "load" else dss.Generators
    table.Name(name)
    factor = dss.Solution.LoadMult() if kind == "load" else 1.0
    return {"p_kw": float(table.kW() * factor), "q_kvar": float(table.kvar() * factor)}


def _phases_of_active() -> list[int]:
    """Phases that the active element's first terminal is at, from 1 to 3."""
    nodes = dss.CktElement.NodeOrder()[: dss.CktElement.NumConductors()]
    return sorted({int(node) for node in nodes} & {1, 2, 3})


def _single_phases() -> dict[str, list[int]]:
    """Of each kind, how many elements have fewer than three phases, and how many there are."""
    found = {}
    for kind in ("line", "transformer", "load", "generator", "pvsystem"):
        phases = [dss.CktElement.NumPhases() for _ in _of(kind)]
        few = sum(count < THREE_PHASES for count in phases)
        if few:
            found[kind] = [few, len(phases)]
    return found


def _notes_on_balance() -> Iterator[str]:
    """What the balanced equivalent leaves out."""
    yield (
        "The circuit is taken as balanced: lines have their positive-sequence impedance, loads "
        "of single phases count as spread over three. Voltages are compared with the mean of the "
        "phases in OpenDSS's own solution of the circuit as it is."
    )
    few, count = _single_phases().get("line", (0, 0))
    if few:
        yield (
            f"{few} of {count} lines have fewer than three phases; their impedance is "
            "raised so that drop and losses are those of the phases that they have."
        )


def _notes() -> Iterator[str]:
    """What is taken as something else, whether the feeder is balanced or not."""
    if LEFT_OUT:
        yield f"Options of 'set' are left out: {', '.join(LEFT_OUT)}."
    for control, why in REFUSED_CONTROLS.items():
        yield f"{control} is left out, as OpenDSS refuses it ({why})."
    unrated = [dss.CktElement.NormalAmps() == DEFAULT_AMPS for _ in _of("line")]
    if any(unrated):
        yield (
            f"{sum(unrated)} of {len(unrated)} lines have {DEFAULT_AMPS:g} A, which OpenDSS gives "
            "to lines without a rating: they have none here."
        )
    held = [_set_point(name) for name in list(_of("regcontrol"))]
    if held:
        yield (
            "Regulators are controlled in the source, and stay at the taps of its solution: "
            f"{', '.join(held)}."
        )
    batteries = list(_of("storage"))
    if batteries:
        yield f"Batteries of the source are left out: {', '.join(batteries)}."


def _set_point(name: str) -> str:
    """A regulator's transformer, where it stands, and the voltage that it holds."""
    dss.RegControls.Name(name)
    volts = dss.RegControls.ForwardVreg()
    transformer = dss.RegControls.Transformer()
    winding = int(dss.RegControls.TapWinding())
    dss.Transformers.Name(transformer)
    dss.Transformers.Wdg(winding)
    return f"{transformer} at {dss.Transformers.Tap():.5g} (set to {volts:g} V)"
