"""OpenDSS in a process of its own: checked commands in, tables of numbers and names out."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
import opendssdirect as dss

from vppres.core.units import V_PER_KV, W_PER_KW
from vppres.feeders.dss.commands import Commands
from vppres.feeders.dss.elements import (
    PHASES,
    Circuit,
    ServiceTransformer,
    Side,
    TwoPort,
    Winding,
    buses,
    buses_of,
    matrix,
    middle,
    nodes_of,
    power_at_nominal,
    power_drawn,
    shut,
)
from vppres.feeders.dss.nodes import reached
from vppres.feeders.dss.refused import RefusedLine

# Classes that carry no power, and those that have a counterpart here.
_CONTROLS = """
regcontrol capcontrol swtcontrol invcontrol expcontrol storagecontroller gendispatcher relay
recloser fuse upfccontrol espvlcontrol
"""
CONTROLS = frozenset(_CONTROLS.split())
_CARRYING = "vsource line transformer load generator pvsystem storage capacitor reactor"
CARRYING = frozenset(_CARRYING.split())
CONSTANT_POWER, CONSTANT_IMPEDANCE = 1, 2  # OpenDSS's models of a load; 5 is constant current
ADMITTANCE = 2  # option of 'set loadmodel': all loads are impedances
VARIABLE = 0  # status of a load that multipliers change
MOST_NAMED = 6
NO_REACTANCE = 700.0
LOAD_MODELS = {2: "constant impedance", 5: "constant current"}
THREE_PHASES = 3
DEFAULT_AMPS = 400.0
TOLERANCE, GUESSED_TOLERANCE = 0.1, 0.01  # sources and windings are often rated above their level
MOST_TOLD = 200
CURE = "Correct the file until OpenDSS solves it."
SOLVES = ("solve", "calcvoltagebases")
"""Commands that may fail where they stand: a solution is looked for at the end."""

POWERS = ("load", "generator", "pvsystem", "storage")
MOST_KVA = 1e12
"""Of a branch that is not to be opened."""

CONTROLS_OFF = -1
TOLERANCES = (1e-11, 1e-9, 1e-7, 1e-4)
"""From the last digits to OpenDSS's own: what floats, or is stiff, meets only the latter."""

Problems = list[dict[str, Any]]
Table = list[dict[str, Any]]


def answer(job: dict[str, Any]) -> dict[str, Any]:
    """The circuit of the job's commands as tables, or what is wrong with it."""
    circuit, problems = build(job)
    if problems:
        return {"problems": problems}
    solved = settled(circuit) and solved_by_phase()
    state = job.get("state")
    if state is None:
        return _tables(circuit, solved)
    return {"problems": [], **_in_state(circuit, state)}


def settled(circuit: Circuit) -> bool:
    """Let regulators and switched capacitors find their places in the state that is given."""
    if circuit.ends_solved and dss.Solution.Converged():
        return True  # as the script leaves it
    off = dss.Solution.ControlMode() == CONTROLS_OFF
    mode = () if off else ("set controlmode=static", "set maxcontroliter=100")
    return _solved("set mode=snapshot", *mode)


def solved_by_phase() -> bool:
    """Solve with everything that acts as it stands, to the last digits of each node."""
    return any(
        _solved(f"set controlmode=off mode=snap tolerance={each:g} maxiterations=1000")
        for each in TOLERANCES
    )


def _solved(*settings: str) -> bool:
    """Solve the circuit; whether that converged."""
    try:
        for command in (*settings, "solve"):
            dss.Text.Command(command)
    except Exception:  # too many control steps, or no solution
        return False
    return bool(dss.Solution.Converged())


def _in_state(circuit: Circuit, state: dict[str, Any]) -> dict[str, Any]:
    """Voltages and losses with other powers and everything else as it was found.

    Loads give the share ``load`` of their powers. Buses of ``held`` have no element of the circuit
    but inject these kW and kvar, each on its phases.
    """
    held = state["held"]
    there = [f"{kind}.{name}" for kind in POWERS for name in circuit.of(kind) if buses()[0] in held]
    for element in there:
        dss.Circuit.Disable(element)
    for i, (bus, power) in enumerate(held.items()):
        if power is not None and any(power):
            _inject(f"vppres_{i}", bus, *power)
    multiplier = dss.Solution.LoadMult() * state["load"]
    commands = [f"{element}.enabled=no" for element in state["disabled"]]
    if state["v_slack_pu"] is not None:
        dss.Vsources.Name("source")
        share = circuit.base_kv(buses()[0]) / dss.Vsources.BasekV()
        commands.append(f"vsource.source.pu={state['v_slack_pu'] * share!r}")
    for command in (f"set loadmult={multiplier!r}", *commands):
        dss.Text.Command(command)
    return _voltages(circuit, solved_by_phase())


def _inject(name: str, bus: str, p_kw: float, q_kvar: float) -> None:
    """Constant power into the phases of a bus."""
    dss.Circuit.SetActiveBus(bus)
    phases = [node for node in dss.Bus.Nodes() if node in PHASES]
    kv = dss.Bus.kVBase() * (1.0 if len(phases) == 1 else np.sqrt(3))
    dss.Text.Command(
        f"new load.{name} bus1={'.'.join([bus, *map(str, phases)])} phases={len(phases)} "
        f"kv={kv:.17g} kw={-p_kw:.17g} kvar={-q_kvar:.17g} status=fixed vminpu=0.05 vmaxpu=2"
    )


def _voltages(circuit: Circuit, solved: bool) -> dict[str, Any]:
    """Mean voltage of the phases of every bus in pu, and all losses; nothing without a solution."""
    if not solved:
        return {"v_pu": None, "losses_kw": None}
    found = {}
    complete = []
    for bus in dss.Circuit.AllBusNames():
        if bus in circuit.legs:
            found[bus] = circuit.legs_pu(bus)
            continue
        dss.Circuit.SetActiveBus(bus)
        phases = [node in PHASES for node in dss.Bus.Nodes()]
        magnitude = np.asarray(dss.Bus.puVmagAngle()[::2])[: len(phases)]
        if any(phases):
            found[bus] = float(magnitude[phases].mean())
        if sum(phases) == THREE_PHASES:
            complete.append(bus)
    return {"v_pu": found, "losses_kw": _losses_kw(circuit), "complete": complete}


def _losses_kw(circuit: Circuit) -> float:
    """Losses: the source's power beyond the demand, and the share of its own impedance.

    OpenDSS's own figure leaves out the latter, and capacitors and reactors to ground.
    """
    dss.Circuit.SetActiveElement("vsource.source")
    n = dss.CktElement.NumConductors()
    flat = np.asarray(dss.CktElement.Currents())
    i = (flat[::2] + 1j * flat[1::2])[:n]
    z = np.linalg.inv(matrix()[:n, :n])
    inside_kw = float((i.conj() @ z @ i).real) / W_PER_KW
    drawn_kw = sum(power_drawn().real for kind in POWERS for _ in circuit.of(kind))
    dss.Circuit.SetActiveElement("vsource.source")
    given_kw = -float(np.sum(dss.CktElement.Powers()[: 2 * n : 2]))
    return float(inside_kw + given_kw - drawn_kw)


def build(job: dict[str, Any]) -> tuple[Circuit, Problems]:
    """Build the circuit of the job's commands; what is wrong with it."""
    dss.Basic.AllowChangeDir(False)
    dss.Basic.AllowForms(False)
    dss.Basic.AllowEditor(False)
    dss.Basic.AllowDOScmd(False)
    circuit, commands = Circuit(), Commands(job["files"])
    refused: Problems = []
    texts: list[tuple[int, str]] = []
    for i, (verb, target, values) in enumerate(job["commands"]):
        try:
            texts.append((i, commands.text(verb, target, values)))
        except RefusedLine as no:
            refused.append(wrong(no.message, no.cure, i))
    if refused:
        return circuit, refused
    circuit.left_out = tuple(commands.left_out)
    dss.Text.Command("clear")
    for i, text in texts:
        if text and (no_circuit := _carried_out(circuit, text, commands.elements.get(i, ""))):
            return circuit, [wrong(no_circuit, CURE, i)]
    if "calcvoltagebases" not in [text for _, text in texts]:
        for text in ("makebuslist", "calcvoltagebases"):
            if no_circuit := _carried_out(circuit, text):
                return circuit, [wrong(no_circuit, CURE)]
    circuit.find()
    if commands.named_levels:
        _fit_levels(circuit)
    unfit = [p for name in circuit.elements if (p := _problem(circuit, name))]
    banks = [] if job.get("open_deltas") else [*_open_deltas(circuit)]
    return circuit, [*unfit, *banks] or _check_levels(circuit, commands.named_levels)


def _carried_out(circuit: Circuit, text: str, element: str = "") -> str:
    """Carry out a command, of an element if there is one; why there is no circuit with it."""
    circuit.ends_solved = text == "solve"
    try:
        dss.Text.Command(text)
    except Exception as error:  # the engine's own class has no public name
        circuit.ends_solved = False
        if element.partition(".")[0] in CONTROLS:
            circuit.refused[element] = told(error)
            dss.Circuit.Disable(element)
        elif text not in SOLVES:
            return f"OpenDSS refuses the file ({told(error)})"
    return ""


def told(error: Exception) -> str:
    """Message of the engine in a line, without its name and version."""
    lines = [line.strip() for line in str(error).splitlines()]
    kept = [line for line in lines if line and not line.endswith(":")]
    return " ".join(kept or lines)[:MOST_TOLD].rstrip(".")


def wrong(message: str, cure: str, command: int | None = None) -> dict[str, Any]:
    """A problem of the circuit, and the number of its command if it has one."""
    return {"message": message, "cure": cure, "command": command}


def _problem(circuit: Circuit, element: str) -> dict[str, Any] | None:
    """Why an element has no equivalent here; None if it has."""
    kind, _, name = element.partition(".")
    if kind not in CONTROLS | CARRYING:
        return wrong(
            f"{element} is not supported", f"Write 'disable {element}' at the end of the script."
        )
    if kind == "vsource" and element != "vsource.source":
        return wrong(
            f"{element} is a second source", "Keep the circuit's own source and disable the others."
        )
    dss.Circuit.SetActiveElement(element)
    if kind == "vsource" and any(node for _, node in nodes_of()[dss.CktElement.NumConductors() :]):
        return wrong(
            f"{element} stands between bus {buses()[0]} and bus {buses()[1]}",
            "Leave its second bus out: the source holds its bus against ground.",
        )
    if kind == "load" and dss.Solution.Year() and (shape := text_of(f"{element}.growth")):
        return wrong(
            f"{element} grows by growthshape.{shape} to year {dss.Solution.Year()}",
            "Write its power of that year, and leave out 'set year'.",
        )
    if kind == "transformer":
        service = middle() is not None
        dss.Transformers.Name(name)
        count = dss.Transformers.NumWindings()
        if count != 2 and not service and name not in circuit.stars:
            where = f" at {named_once(buses())}" if count == 3 else ""
            return wrong(
                f"{element} has {count} windings{where}",
                "Replace it by transformers with two windings, or with three at three buses.",
            )
        reactances = (dss.Transformers.Xhl(), dss.Transformers.Xht(), dss.Transformers.Xlt())
        if NO_REACTANCE in reactances[: 3 if name in circuit.stars else 1]:
            return wrong(
                f"{element} has no reactance: OpenDSS takes xhl=0 as {NO_REACTANCE:g} %",
                "Give it one, such as xhl=0.01.",
            )
    return None


def text_of(of: str) -> str:
    """Value of a property, ``class.name.property``, in lower case."""
    dss.Text.Command(f"? {of}")
    return str(dss.Text.Result()).strip().lower()


def named_once(words: list[str]) -> str:
    """Words, each once."""
    return " and ".join(dict.fromkeys(words))


def _open_deltas(circuit: Circuit) -> Iterator[dict[str, Any]]:
    """Pairs of single units between phases that carry all three: they have no balanced equivalent.

    The two differ in their taps, and turn and unbalance the voltages even of balanced loads.
    """
    units: dict[frozenset[str], dict[str, set[int]]] = {}
    for name in circuit.of("transformer"):
        ends = frozenset(buses())
        nodes = set(circuit.phases())
        if dss.CktElement.NumPhases() == 1 and len(nodes) == 2:
            units.setdefault(ends, {})[name] = nodes
    for bank in units.values():
        if len(bank) == 2 and len(set.union(*bank.values())) == THREE_PHASES:
            names = " and ".join(f"transformer.{name}" for name in bank)
            yield wrong(
                f"{names} are an open delta: two units between phases that carry all three",
                "A balanced model has no such bank: replace both by one transformer of three "
                "phases at the mean of their taps.",
            )


def _fit_levels(circuit: Circuit) -> None:
    """Give buses the level of ``voltagebases`` that fits the ratings of their transformers.

    OpenDSS takes that which is next to their voltage without load, and where nothing holds a
    floating bus that may be any.
    """
    levels = [float(kv) for kv in dss.Settings.VoltageBases()]
    beside = circuit.beside()
    for element, bus, rated_kv, _ in list(_ratings(circuit)):
        own = [kv for kv in levels if _fits(rated_kv, kv, TOLERANCE)]
        if element.startswith("transformer.") and own and not _fits(rated_kv, circuit.base_kv(bus)):
            for each in reached(bus, beside):
                dss.Text.Command(f'setkvbase bus="{each}" kvll={own[0]:.17g}')
                circuit.moved[each] = own[0]


def _fits(rated_kv: float, base_kv: float, tolerance: float = TOLERANCE) -> bool:
    """Whether a rating is that of a level; that of a single phase may be to neutral."""
    apart = min(abs(rated_kv * f - base_kv) for f in (1.0, np.sqrt(3)))
    return bool(apart <= tolerance * rated_kv)


def _check_levels(circuit: Circuit, levels_named: bool) -> Problems:
    """Ratings that do not fit their bus: without ``voltagebases`` OpenDSS guesses the levels."""
    problems = []
    for element, bus, rated_kv, guessed in list(_ratings(circuit)):
        tolerance = TOLERANCE if levels_named else guessed
        base_kv = circuit.base_kv(bus)
        if not _fits(rated_kv, base_kv, tolerance):
            problems.append(
                wrong(
                    f"{element} has {rated_kv:g} kV at bus {bus}, whose nominal voltage is "
                    f"{base_kv:.4g} kV",
                    "Name the levels with 'set voltagebases=[...]'.",
                )
            )
    return problems


def _ratings(circuit: Circuit) -> Iterator[tuple[str, str, float, float]]:
    """Element, bus, rated voltage in kV, and by which share a bus may differ that is guessed."""
    for name in circuit.of("vsource"):
        bus = buses()[0]
        dss.Vsources.Name(name)
        yield f"vsource.{name}", bus, dss.Vsources.BasekV(), GUESSED_TOLERANCE
    for name in list(circuit.of("transformer")):
        dss.Circuit.SetActiveElement(f"transformer.{name}")
        for winding, bus in enumerate(buses(), start=1):
            dss.Transformers.Name(name)
            dss.Transformers.Wdg(winding)
            legs = 2.0 if bus in circuit.legs else 1.0
            yield f"transformer.{name}", bus, legs * dss.Transformers.kV(), TOLERANCE


def _tables(circuit: Circuit, solved: bool) -> dict[str, Any]:
    """Tables from which the reader makes a pandapower net."""
    branches, shunts = _branches(circuit)
    return {
        "problems": [],
        **_voltages(circuit, solved),
        "name": dss.Circuit.Name(),
        "frequency_hz": dss.Solution.Frequency(),
        "buses": [
            *({"name": bus, "kv": circuit.base_kv(bus)} for bus in dss.Circuit.AllBusNames()),
            *({"name": star, "kv": kv} for star, kv in stars_kv(circuit).items()),
        ],
        "sources": list(_sources(circuit)),
        "lines": branches,
        "transformers": list(_transformers(circuit)),
        "shunts": [*shunts, *_cores(circuit)],
        "powers": [*_powers(circuit, solved)],
        "shapes": _shapes(circuit),
        "causes": list(_causes(circuit, solved)),
        "single_phases": _single_phases(circuit),
        "balanced_notes": list(_notes_on_balance(circuit)),
        "notes": list(_notes(circuit, solved)),
    }


def _sources(circuit: Circuit) -> Iterator[dict[str, Any]]:
    for name in circuit.of("vsource"):
        bus = buses()[0]
        dss.Vsources.Name(name)
        v_kv = dss.Vsources.PU() * dss.Vsources.BasekV()
        yield {
            "name": name,
            "bus": bus,
            "v_pu": v_kv / circuit.base_kv(bus),
            "r_ohm": number(f"vsource.{name}.r1"),
            "x_ohm": number(f"vsource.{name}.x1"),
        }


def number(query: str) -> float:
    """A property that OpenDSS only tells as text."""
    return float(text_of(query))


def _branches(circuit: Circuit) -> tuple[Table, Table]:
    """Lines, reactors and capacitors between two buses, and what is at one bus only."""
    branches: Table = []
    shunts: Table = []
    switches = _switches(circuit)
    for kind in ("line", "reactor", "capacitor"):
        for name in circuit.of(kind):
            own = name if kind == "line" else f"{kind}.{name}"
            ends = buses()
            amps = rated_amps(dss.CktElement.NormalAmps())
            nodes, y = circuit.admittance()
            joined = buses_of(nodes)
            if len(joined) == 2:
                port = TwoPort(circuit, nodes, y)
                if port.phases:
                    told = {"switch": own in switches, "locked": switches.get(own, False)}
                    branches.append({**_branch(circuit, own, kind, port, amps), **told})
                    continue
            if kind == "line" and len(set(ends)) == 2:  # open, but there
                branches.append(
                    {"name": own, "element": f"{kind}.{name}", "start": ends[0], "end": ends[1],
                     "closed": False, "amps": amps, **_own_impedance(name), "carried_kva": 0.0,
                     "switch": True, "locked": switches.get(own, False)}
                )  # fmt: skip
            for bus in joined:
                at = [i for i, node in enumerate(nodes) if node[0] == bus]
                ends_here = [nodes[i] for i in at]
                power = power_at_nominal(ends_here, y[np.ix_(at, at)], circuit.base_kv(bus))
                shunts.append({"name": own, "bus": bus, "p_kw": power.real, "q_kvar": power.imag})
    return branches, shunts


def _switches(circuit: Circuit) -> dict[str, bool]:
    """Lines that are switches, or have a control of one, and whether this is locked."""
    found = {
        name: False
        for name in circuit.of("line")
        if dss.Lines.Name(name) is None and dss.Lines.IsSwitch()
    }
    for name in circuit.of("swtcontrol"):
        dss.SwtControls.Name(name)
        kind, _, line = dss.SwtControls.SwitchedObj().lower().partition(".")
        if kind == "line":
            found[line] = bool(dss.SwtControls.IsLocked())
    return found


def _own_impedance(line: str) -> dict[str, Any]:
    """Phases of an open line, with its series impedance as if it were closed; it charges nothing.

    Its own admittances are those of no line.
    """
    element = dss.CktElement.Name()
    dss.Lines.Name(line)
    n, length = dss.Lines.Phases(), dss.Lines.Length()
    z = [
        (np.asarray(matrix, dtype=float) * length).tolist()
        for matrix in (dss.Lines.RMatrix(), dss.Lines.XMatrix())
    ]
    dss.Circuit.SetActiveElement(element)
    return {"phases": n, "z": z, "b": [0.0] * n**2}


def _branch(
    circuit: Circuit, name: str, kind: str, port: TwoPort, amps: float | None
) -> dict[str, Any]:
    """A branch with the impedance of its phases in ohm, and its charging in siemens."""
    n = len(port.phases)
    half = [rest[:n, :n] if len(rest) == n else np.zeros((n, n)) for rest in port.rest]
    return {
        "name": name,
        "element": name if kind != "line" else f"line.{name}",
        "start": port.start,
        "end": port.end,
        "closed": n > 0,
        "amps": amps if kind == "line" else None,
        "carried_kva": _carried_kva(circuit),
        "phases": n,
        "z": [port.z.real.ravel().tolist(), port.z.imag.ravel().tolist()],
        "b": (half[0] + half[1]).imag.ravel().tolist(),
    }


def _carried_kva(circuit: Circuit) -> float:
    """Current into the active element in the last solution, all phases, at nominal voltage."""
    element = dss.CktElement.Name()
    flat = np.asarray(dss.CktElement.CurrentsMagAng()[::2])
    amps = float(flat[: dss.CktElement.NumPhases()].sum())
    kv = circuit.base_kv(buses()[0]) / np.sqrt(3)
    dss.Circuit.SetActiveElement(element)
    return float(amps * kv)


def rated_amps(amps: float) -> float | None:
    """The rating of a line, None where it is what OpenDSS gives to lines without one."""
    return None if amps == DEFAULT_AMPS else float(amps)


def _transformers(circuit: Circuit) -> Iterator[dict[str, Any]]:
    for name in circuit.of("transformer"):
        if middle() is not None:
            dss.Circuit.SetActiveElement(f"transformer.{name}")
            yield _service(circuit, name)
            continue
        if name in circuit.stars:
            yield from _legs_of_star(circuit, name)
            continue
        dss.Circuit.SetActiveElement(f"transformer.{name}")
        first, second = windings = [Winding(number) for number in (1, 2)]
        kv = [_in_use_kv(circuit, own, own.rated_kv) for own in windings]
        phases = dss.CktElement.NumPhases()
        percent = first.percent + second.r_pct
        yield {
            **_between(circuit, name, first, second.bus, kv, phases, circuit.phases(), percent),
            **_core_percent(name),
            "closed": len(buses_of(circuit.admittance()[0])) == 2,
        }


def _between(
    circuit: Circuit,
    name: str,
    first: Side,
    end: str,
    kv: list[float],
    phases: int,
    nodes: list[int],
    percent: complex,
) -> dict[str, Any]:
    """The active transformer between two buses, without its core."""
    return {
        "name": name,
        "element": f"transformer.{name}",
        "start": first.bus,
        "end": end,
        "closed": True,
        "phases": phases,
        "nodes": nodes,
        "kv": kv,
        "carried_kva": _carried_kva(circuit),
        "r_percent": percent.real,
        "kva": first.kva,
        "x_percent": percent.imag,
        "no_load_percent": 0.0,
        "magnetising_percent": 0.0,
    }


def _core_percent(name: str) -> dict[str, float]:
    """Losses and current of a transformer's core, in percent of its rating."""
    return {
        "no_load_percent": number(f"transformer.{name}.%noloadloss"),
        "magnetising_percent": number(f"transformer.{name}.%imag"),
    }


def _in_use_kv(circuit: Circuit, own: Side, rated_kv: float) -> float:
    """Voltage between lines of the turns of a winding that are in use."""
    element = dss.CktElement.Name()
    kv = _between_lines(rated_kv, circuit.base_kv(own.bus)) * own.tap
    dss.Circuit.SetActiveElement(element)
    return kv


def stars_kv(circuit: Circuit) -> dict[str, float]:
    """Nominal voltage between lines of each star: that of the first winding."""
    found = {}
    for name, (star, _) in circuit.stars.items():
        dss.Circuit.SetActiveElement(f"transformer.{name}")
        dss.Transformers.Name(name)
        own = Winding(1)
        found[star] = _between_lines(own.rated_kv, circuit.base_kv(own.bus))
    return found


def _legs_of_star(circuit: Circuit, name: str) -> Iterator[dict[str, Any]]:
    """A transformer with three windings as one with two for each of them, to their star."""
    star, phases = circuit.stars[name]
    star_kv = stars_kv(circuit)[star]
    dss.Circuit.SetActiveElement(f"transformer.{name}")
    dss.Transformers.Name(name)
    for number in (1, 2, 3):
        own = Winding(number)
        kv = [_in_use_kv(circuit, own, own.rated_kv), star_kv]
        yield {
            **_between(circuit, name, own, star, kv, len(phases), [*phases], own.percent),
            "name": f"{name} winding {number}",
            "carried_kva": MOST_KVA,
        }


def _cores(circuit: Circuit) -> Table:
    """Cores of transformers with three windings, which OpenDSS has at the second."""
    found: Table = []
    for name in circuit.stars:
        element = f"transformer.{name}"
        dss.Circuit.SetActiveElement(element)
        dss.Transformers.Name(name)
        own = Winding(2)
        base_kv = circuit.base_kv(own.bus)
        kv = own.tap * _between_lines(own.rated_kv, base_kv)
        share = own.kva * (base_kv / kv) ** 2 / 100.0
        p_kw = share * number(f"{element}.%noloadloss")
        q_kvar = share * number(f"{element}.%imag")
        if p_kw or q_kvar:
            found.append(
                {"name": f"core of {name}", "bus": own.bus, "p_kw": p_kw, "q_kvar": q_kvar}
            )
    return found


def _service(circuit: Circuit, name: str) -> dict[str, Any]:
    """A transformer with its middle at ground, as one with two windings."""
    own = ServiceTransformer(circuit)
    first, second = own.windings
    kv = [_in_use_kv(circuit, each, each.kv) for each in own.windings]
    nodes = sorted({node for _, node in own.ends[:2]} & set(PHASES))
    row = _between(circuit, name, first, second.bus, kv, 1, nodes, own.percent)
    return {**row, **_core_percent(name)}


def _between_lines(rated_kv: float, base_kv: float) -> float:
    """A rated voltage between lines; that of a single phase may be to neutral."""
    return float(min((rated_kv, rated_kv * np.sqrt(3)), key=lambda kv: abs(kv - base_kv)))


def _causes(circuit: Circuit, solved: bool) -> Iterator[list[Any]]:
    """Causes of differences that the balanced equivalent of constant powers has, in kW."""
    drawn_kw: dict[str, float] = {}
    single_kw = 0.0
    for name in circuit.of("load"):
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
    if solved:
        yield from beyond(circuit)


def beyond(circuit: Circuit) -> Iterator[list[Any]]:
    """Loads whose voltage in the solution is one at which OpenDSS takes another model for them.

    An impedance stays one.
    """
    found: dict[str, tuple[float, float]] = {}
    for name in circuit.of("load"):
        dss.Loads.Name(name)
        if dss.Loads.Model() == CONSTANT_IMPEDANCE or dss.Solution.LoadModel() == ADMITTANCE:
            continue
        flat = np.asarray(dss.CktElement.Voltages())
        volts = flat[::2] + 1j * flat[1::2]
        n = dss.CktElement.NumPhases()
        delta = bool(dss.Loads.IsDelta())
        kv = float(dss.Loads.kV()) / (1.0 if delta or n == 1 else np.sqrt(3))
        other = [volts[(i + 1) % len(volts)] if delta else volts[-1] for i in range(n)]
        pu = [abs(volts[i] - other[i]) / (kv * V_PER_KV) for i in range(n)]
        if min(pu) < dss.Loads.Vminpu() or max(pu) > dss.Loads.Vmaxpu():
            found[f"load.{name} ({min(pu):.3f} pu)"] = dss.Loads.kW(), power_drawn().real
    if found:
        kw, drawn_kw = map(sum, zip(*found.values(), strict=True))
        yield [
            kw,
            "loads outside their vminpu and vmaxpu in the source's solution, where OpenDSS gives "
            f"them a constant impedance, so that they draw {drawn_kw:.4g} kW instead of "
            f"{kw:.4g} kW: {_first(found)}",
        ]


def _first(names: Iterable[str]) -> str:
    """The first of some names, and how many there are beyond."""
    kept = list(names)
    more = f" and {len(kept) - MOST_NAMED} more" if len(kept) > MOST_NAMED else ""
    return ", ".join(kept[:MOST_NAMED]) + more


def _powers(circuit: Circuit, solved: bool) -> Iterator[dict[str, Any]]:
    """Loads, generators and batteries with their powers."""
    for kind in POWERS:
        for name in circuit.of(kind):
            bus = buses()[0]
            nodes = circuit.phases()
            yield {
                "kind": kind,
                "name": name,
                "bus": bus,
                "nodes": nodes,
                **nominal(kind, name, solved),
            }


def _shapes(circuit: Circuit) -> dict[str, Any]:
    """Daily shapes that loads and PV follow over time: whose, and their values."""
    follows: dict[str, str] = {}
    for kind in ("load", "pvsystem"):
        for name in circuit.of(kind):
            shape = text_of(f"{kind}.{name}.daily")
            if shape and shape != "default":
                follows[f"{kind}.{name}"] = shape
    values = {}
    for shape in dict.fromkeys(follows.values()):
        dss.LoadShape.Name(shape)
        values[shape] = {
            "values": [float(each) for each in dss.LoadShape.PMult()],
            "minutes": float(dss.LoadShape.MinInterval()),
            "unit": "kw" if dss.LoadShape.UseActual() else "pu",
        }
    return {"follows": follows, "values": values}


def _growth() -> float:
    """Factor by which loads have grown in the year that the script sets."""
    years = dss.Solution.Year() - 1
    dss.Text.Command("get %growth")
    return float((1.0 + float(dss.Text.Result()) / 100.0) ** years) if years >= 0 else 1.0


def nominal(kind: str, name: str, solved: bool) -> dict[str, float]:
    """Nominal power of a load, and what anything else gives or draws in the solution.

    Generation is positive of generators, drawn power of loads and batteries. ``p_max_kw`` and
    ``s_kva`` are the largest power and the rating, as far as the source says so.
    """
    if kind == "load":
        dss.Loads.Name(name)
        factor = dss.Solution.LoadMult() if int(dss.Loads.Status()) == VARIABLE else 1.0
        factor *= _growth()
        return {"p_kw": float(dss.Loads.kW() * factor), "q_kvar": float(dss.Loads.kvar() * factor)}
    element = f"{kind}.{name}"
    dss.Circuit.SetActiveElement(element)
    drawn = power_drawn() if solved else 0j
    if kind == "generator":
        dss.Generators.Name(name)
        p_kw = float(dss.Generators.kW())
        given = -drawn if solved else complex(p_kw, dss.Generators.kvar())
        return {"p_kw": given.real, "q_kvar": given.imag, "p_max_kw": max(p_kw, given.real)}
    if kind == "pvsystem":
        s_kva = number(f"{element}.kva")
        panel_kw = number(f"{element}.pmpp") * number(f"{element}.%pmpp") / 100.0
        return {
            "p_kw": -drawn.real,
            "q_kvar": -drawn.imag,
            "p_max_kw": min(s_kva, panel_kw),
            "s_kva": s_kva,
            "sunny_kw": number(f"{element}.pmpp") * number(f"{element}.irradiance"),
        }
    return {"p_kw": drawn.real, "q_kvar": drawn.imag, **_battery(element)}


def _battery(element: str) -> dict[str, float]:
    """Energy, powers and efficiencies of a battery."""
    rated_kw = number(f"{element}.kwrated")
    share = min(number(f"{element}.%charge"), number(f"{element}.%discharge"), 100.0) / 100.0
    return {
        "energy_kwh": number(f"{element}.kwhrated"),
        "p_max_kw": rated_kw * share,
        "s_kva": number(f"{element}.kva"),
        "soc": number(f"{element}.%stored") / 100.0,
        "soc_min": number(f"{element}.%reserve") / 100.0,
        "eta_charge": number(f"{element}.%effcharge") / 100.0,
        "eta_discharge": number(f"{element}.%effdischarge") / 100.0,
        "idle_kw": rated_kw * number(f"{element}.%idlingkw") / 100.0,
    }


def _single_phases(circuit: Circuit) -> dict[str, list[int]]:
    """Of each kind, how many elements have fewer than three phases, and how many there are."""
    found = {}
    for kind in ("line", "transformer", *POWERS):
        phases = [_live_phases(circuit, kind) for _ in circuit.of(kind)]
        few = sum(count < THREE_PHASES for count in phases)
        if few:
            found[kind] = [few, len(phases)]
    return found


def _live_phases(circuit: Circuit, kind: str) -> int:
    """Phases that the active element has, less those with an open conductor at either end.

    One that is open as a whole has all of them.
    """
    own = int(min(dss.CktElement.NumPhases(), len(circuit.phases()) or THREE_PHASES))
    if kind != "line":
        return own
    if own < min(dss.CktElement.NumPhases(), THREE_PHASES):
        return own
    through = [all(ends) for ends in zip(*shut(), strict=True)]
    return min(own, sum(through)) if any(through) else own


def _notes_on_balance(circuit: Circuit) -> Iterator[str]:
    """Notes on the simplifications of the balanced equivalent."""
    yield (
        "The circuit is taken as balanced: lines have their positive-sequence impedance, loads "
        "of single phases count as spread over three. Voltages are compared with the mean of the "
        "phases in OpenDSS's own solution of the circuit as it is."
    )
    few, count = _single_phases(circuit).get("line", (0, 0))
    if few:
        yield (
            f"{few} of {count} lines have fewer than three phases; their impedance is "
            "raised so that drop and losses are those of the phases that they have."
        )


def _notes(circuit: Circuit, solved: bool) -> Iterator[str]:
    """Notes on elements that are modelled as something else, balanced or by phase."""
    if circuit.left_out:
        yield f"Options of 'set' are left out: {', '.join(circuit.left_out)}."
    for control, why in circuit.refused.items():
        yield f"{control} is left out, as OpenDSS refuses it ({why})."
    for bus, kv in circuit.moved.items():
        yield (
            f"Bus {bus} has {kv:g} kV, by the rating of its transformer: OpenDSS takes another "
            "level of 'voltagebases' for it."
        )
    unrated = [dss.CktElement.NormalAmps() == DEFAULT_AMPS for _ in circuit.of("line")]
    if any(unrated):
        yield (
            f"{sum(unrated)} of {len(unrated)} lines have {DEFAULT_AMPS:g} A, which OpenDSS gives "
            "to lines without a rating: they have none here."
        )
    held = [_set_point(name) for name in list(circuit.of("regcontrol"))]
    if held:
        yield (
            "Regulators are controlled in the source, and stay at the taps of its solution, "
            f"by phase in islands at nominal ones: {', '.join(held)}."
        )
    yield from _notes_on_legs(circuit)
    yield from _notes_on_controls(circuit, solved)


def _notes_on_legs(circuit: Circuit) -> Iterator[str]:
    """Note that both legs behind a service transformer count as one voltage."""
    count = sum(middle() is not None for _ in circuit.of("transformer"))
    if count:
        yield (
            f"{count} transformers have the middle of their secondary at ground: both legs behind "
            "them are one node with the voltage from leg to leg, and a load at one leg counts at "
            "both. Voltages are compared from leg to leg."
        )


def _notes_on_controls(circuit: Circuit, solved: bool) -> Iterator[str]:
    """Notes on controls of the source, which stay in their last state."""
    acting = [
        element for element in circuit.elements
        if element.partition(".")[0] in CONTROLS - {"regcontrol", "swtcontrol"}
    ]  # fmt: skip
    if acting:
        states = [
            f"capacitor.{name} {'in' if sum(dss.Capacitors.States()) else 'out'}"
            for name in circuit.of("capacitor")
            if dss.Capacitors.Name(name) is None
        ]
        left = f": {_first(states)}" if states else ""
        yield (
            f"Controls act in the source's solution, and what they switch or set stays so"
            f"{left} ({_first(acting)})."
        )
    idle_kw = [
        number(f"storage.{name}.kwrated") * number(f"storage.{name}.%idlingkw") / 100.0
        for name in circuit.of("storage")
    ]
    if idle_kw:
        yield (
            f"What batteries draw while they rest is left out, {sum(idle_kw):.3g} kW in all; "
            "efficiencies of inverters at partial load too."
        )
        if not solved:
            yield (
                "OpenDSS finds no solution. What storage in wye draws at rest may be why: it may "
                "find one with '%idlingkw=0'."
            )


def regulated(circuit: Circuit) -> dict[str, int]:
    """Transformers with a regulator, and the winding whose taps it moves."""
    found = {}
    for name in circuit.of("regcontrol"):
        dss.RegControls.Name(name)
        found[dss.RegControls.Transformer().lower()] = int(dss.RegControls.TapWinding())
    return found


def _set_point(name: str) -> str:
    """A regulator's transformer, where it stands, and the voltage that it holds."""
    dss.RegControls.Name(name)
    volts = dss.RegControls.ForwardVreg()
    transformer = dss.RegControls.Transformer()
    winding = int(dss.RegControls.TapWinding())
    dss.Transformers.Name(transformer)
    dss.Transformers.Wdg(winding)
    return f"{transformer} at {dss.Transformers.Tap():.5g} (set to {volts:g} V)"
