"""OpenDSS in a process of its own: checked commands in, tables of numbers and names out."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
import opendssdirect as dss

from vppres.core.units import V_PER_KV, W_PER_KW
from vppres.feeders.dss.commands import Commands
from vppres.feeders.dss.elements import (
    Circuit,
    buses,
    coil_volts,
    matrix,
    middle,
    nodes_of,
    number,
    power_drawn,
    reactances,
    shut,
    text_of,
)
from vppres.feeders.dss.nodes import beside, reached
from vppres.feeders.dss.refused import RefusedLine, cut
from vppres.feeders.dss.tables import (
    ADMITTANCE,
    BRANCHES,
    CONSTANT_IMPEDANCE,
    DEFAULT_AMPS,
    POWERS,
    THREE_PHASES,
    tables,
)
from vppres.feeders.strangers.child import tell

# Classes that carry no power, and those that have a counterpart here.
_CONTROLS = """
regcontrol capcontrol swtcontrol invcontrol expcontrol storagecontroller gendispatcher relay
recloser fuse upfccontrol espvlcontrol
"""
CONTROLS = frozenset(_CONTROLS.split())
_CARRYING = "vsource line transformer load generator pvsystem storage capacitor reactor"
CARRYING = frozenset(_CARRYING.split())
CONSTANT_POWER = 1  # OpenDSS's models of a load
MOST_NAMED = 6
NO_REACTANCE = 700.0
LOAD_MODELS = {2: "constant impedance", 5: "constant current"}
TOLERANCE, GUESSED_TOLERANCE = 0.1, 0.01  # sources and windings are often rated above their level
MOST_TOLD = 200
CURE = "Correct the file until OpenDSS solves it."
SOLVES = ("solve", "calcvoltagebases")
"""Commands that may fail where they stand: a solution is looked for at the end."""

UNLIKE_PU = 1e-3
NO_MATRIX = "(#183)"
"""Of an error after which there is nothing to read."""

CONTROLS_OFF = -1
TOLERANCES = (1e-11, 1e-9, 1e-7, 1e-4)
"""From the last digits to OpenDSS's own: what floats, or is stiff, meets only the latter."""

Problems = list[dict[str, Any]]


def answer(job: dict[str, Any]) -> dict[str, Any]:
    """The circuit of the job's commands as tables, or what is wrong with it.

    Elements that are ``disabled`` in the job are out of service. With ``keep`` those are not that
    join the source to a conductor that nothing else does: ``kept`` in the answer.
    """
    circuit, problems = build(job)
    if problems:
        return {"problems": problems}
    at_rest = settled(circuit)
    disabled = job.get("disabled", [])
    kept = _needed(disabled, circuit) if job.get("keep") else []
    for element in disabled:
        if element not in kept:
            dss.Circuit.Disable(element)
    circuit.find_elements()
    solved = solved_by_phase()
    return {
        "problems": [],
        "kept": kept,
        **_voltages(circuit, solved),
        **tables(circuit, solved),
        "shapes": _shapes(circuit),
        "causes": list(_causes(circuit)),
        "beyond": list(_beyond(circuit)) if solved else [],
        "notes": [*_notes_on_solution(circuit, solved, at_rest), *_notes(circuit)],
    }


def _needed(disabled: list[str], circuit: Circuit) -> list[str]:
    """Elements that close a loop of buses, but of no conductor."""
    joined: dict[str, list[tuple[Any, ...]]] = {}
    for kind in (*BRANCHES, "transformer"):
        for name in circuit.of(kind):
            nodes = [tuple(circuit.admittance()[0])] if kind == "transformer" else []
            joined[f"{kind}.{name}"] = nodes or circuit.joined()
    groups = [group for element, own in joined.items() if element not in disabled for group in own]
    kept = []
    for element in disabled:
        own = joined.get(element, [])
        known = beside(groups)
        if any({*group} - {*reached(group[0], known)} for group in own):
            kept.append(element)
            groups += own
    return kept


def settled(circuit: Circuit) -> bool:
    """Let regulators and switched capacitors find their places in the state that is given."""
    if circuit.ends_solved and dss.Solution.Converged():
        return True  # as the script leaves it
    off = dss.Solution.ControlMode() == CONTROLS_OFF
    controls = () if off else ("set controlmode=static", "set maxcontroliter=100")
    return _solved(*controls) or (_at_rest(circuit) and _solved(*controls))


def _at_rest(circuit: Circuit) -> bool:
    """Leave out what storage draws at rest, which in wye may be no number; whether there is any."""
    if not sum(map(_idle_kw, circuit.names.get("storage", ()))):
        return False
    for command in ("batchedit storage..* %idlingkw=0", "set mode=direct", "solve"):
        dss.Text.Command(command)
    dss.Text.Command("set mode=snapshot")  # starts from there: voltages that are no numbers stay so
    circuit.at_rest = True
    return True


def _idle_kw(storage: str) -> float:
    """Power that a battery draws at rest."""
    element = f"storage.{storage}"
    return number(element, "kwrated") * number(element, "%idlingkw") / 100.0


def solved_by_phase() -> bool:
    """Solve with everything that acts as it stands, to the last digits of each node.

    To set the mode anew would put switches, fuses and relays back to their normal state.
    """
    return any(
        _solved(f"set controlmode=off tolerance={each:g} maxiterations=1000") for each in TOLERANCES
    )


def _solved(*settings: str) -> bool:
    """Solve the circuit; whether that converged."""
    try:
        for command in (*settings, "solve"):
            dss.Text.Command(command)
    except Exception:  # too many control steps, or no solution
        return False
    return bool(dss.Solution.Converged())


def _voltages(circuit: Circuit, solved: bool) -> dict[str, Any]:
    """Voltage to ground of each node in pu, of legs from one to the other, and all losses.

    Nothing without a solution.
    """
    if not solved:
        return {"v_pu": {}, "losses_kw": None}
    found = {
        node: abs(v) / (circuit.base_kv(node.rpartition(".")[0]) * V_PER_KV / np.sqrt(3))
        for node, v in circuit.volts().items()
    }
    return {"v_pu": found, "losses_kw": _losses_kw(circuit)}


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
        tell(cut(text))
        if text and (no_circuit := _carried_out(circuit, text, commands.elements.get(i, ""))):
            return circuit, [wrong(no_circuit, CURE, i)]
    if "calcvoltagebases" not in [text for _, text in texts]:
        for text in ("makebuslist", "calcvoltagebases"):
            if no_circuit := _carried_out(circuit, text):
                return circuit, [wrong(no_circuit, CURE)]
    tell("the finished circuit")
    circuit.find()
    if commands.named_levels:
        _fit_levels(circuit)
    unfit = [
        wrong(f"{element} stands {count} times", "Give each a name of its own.")
        for element, count in Counter(circuit.elements).items()
        if count > 1  # ('set allowduplicates'): by its name only the first can be read
    ]
    faults = (next(_faults(circuit, element), None) for element in circuit.elements)
    unfit += [wrong(*fault) for fault in faults if fault]
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
        elif text not in SOLVES or told(error).startswith(NO_MATRIX):
            return f"OpenDSS refuses the file ({told(error)})"
        else:
            circuit.said = told(error)
    return ""


def told(error: Exception) -> str:
    """Message of the engine in a line, without its name and version."""
    lines = [line.strip() for line in str(error).splitlines()]
    kept = [line for line in lines if line and not line.endswith(":")]
    return " ".join(kept or lines)[:MOST_TOLD].rstrip(".")


def wrong(message: str, cure: str, command: int | None = None) -> dict[str, Any]:
    """A problem of the circuit, and the number of its command if it has one."""
    return {"message": message, "cure": cure, "command": command}


Faults = Iterator[tuple[str, str]]
"""Why an element has no equivalent here, each with a cure; the first says enough."""


def _faults(circuit: Circuit, element: str) -> Faults:
    """Faults of an element of any class."""
    kind, _, name = element.partition(".")
    dss.Circuit.SetActiveElement(element)
    if kind not in CONTROLS | CARRYING:
        cure = f"Write 'disable {element}' at the end of the script."
        if len({bus for bus in buses() if bus}) > 1:  # without it, others lose their supply
            cure = "Replace it by lines, reactors, or transformers with two windings."
        yield f"{element} is not supported", cure
    if kind == "vsource" and element != "vsource.source":
        cure = "Keep the circuit's own source and disable the others."
        yield f"{element} is a second source", cure
    for bus, node in nodes_of():
        if node and bus in circuit.legs and node not in circuit.legs[bus][1]:
            yield (
                f"{element} is at node {node} of bus {bus}, behind a transformer whose middle is "
                "at ground, where there are two legs alone",
                "Put it at the legs or at ground (node 0).",
            )
    if kind == "vsource":
        yield from _faults_of_source()
    if kind in BRANCHES and _joins_phases(circuit):
        cure = "Give each a node of its own at both ends."
        yield f"{element} joins conductors at one node", cure
    if kind in ("vsource", "transformer", *POWERS) and _partly_open():
        cure = "Write it with those that are closed instead."
        yield f"{element} has an open conductor", cure
    if kind == "load" and dss.Solution.Year() and (shape := text_of(element, "growth").lower()):
        yield (
            f"{element} grows by growthshape.{shape} to year {dss.Solution.Year()}",
            "Write its power of that year, and leave out 'set year'.",
        )
    if kind == "transformer":
        yield from _faults_of_transformer(name, name in circuit.stars)


def _faults_of_source() -> Faults:
    """Faults of the circuit's source, the active element."""
    if any(node for _, node in nodes_of()[dss.CktElement.NumConductors() :]):
        yield (
            f"vsource.source stands between bus {buses()[0]} and bus {buses()[1]}",
            "Leave its second bus out: the source holds its bus against ground.",
        )
    if dss.CktElement.NumPhases() != THREE_PHASES:
        yield (
            f"vsource.source has {dss.CktElement.NumPhases()} of three phases",
            "Give it three, and leave those out of the circuit that are not used.",
        )


def _faults_of_transformer(name: str, has_star: bool) -> Faults:
    """Faults of the active element, a transformer."""
    service = middle() is not None
    dss.Transformers.Name(name)
    count = dss.Transformers.NumWindings()
    if count != 2 and not service and not has_star:
        at = " and ".join(dict.fromkeys(buses()))
        where = f" at {at}" if count == 3 else ""
        yield (
            f"transformer.{name} has {count} windings{where}",
            "Replace it by transformers with two windings, or with three at three buses.",
        )
    if NO_REACTANCE in reactances()[: 3 if has_star else 1]:
        yield (
            f"transformer.{name} has no reactance: OpenDSS takes xhl=0 as {NO_REACTANCE:g} %",
            "Give it one, such as xhl=0.01.",
        )


def _joins_phases(circuit: Circuit) -> bool:
    """Whether conductors of the active element between two buses end at one node."""
    pairs = [pair for pair in circuit.joined() if pair[0][0] != pair[1][0]]
    return any(len({*ends}) < len(ends) for ends in zip(*pairs, strict=True))


def _partly_open() -> bool:
    """Whether a conductor of the active element is open; of transformers whole ends may be."""
    ends = [end[: dss.CktElement.NumPhases()] for end in shut()]
    whole = dss.CktElement.Name().lower().startswith("transformer.")
    return any(not all(end) and (any(end) or not whole) for end in ends)


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

    OpenDSS takes that which is next to their voltage without load, and where nothing holds a bus,
    as it floats or is switched off there, that may be any. Buses along lines have one level.
    """
    levels = [float(kv) for kv in dss.Settings.VoltageBases()]
    beside = circuit.beside()
    for element, bus, rated_kv, _ in list(_ratings(circuit)):
        legs = 2.0 if bus in circuit.legs else 1.0
        own = [legs * kv for kv in levels if _fits(rated_kv, legs * kv, TOLERANCE)]
        level = circuit.base_kv(bus)
        if element.startswith("transformer.") and own and not _fits(rated_kv, level):
            level = own[0]
        for each in reached(bus, beside):
            if abs(circuit.base_kv(each) - level) > TOLERANCE * level:
                dss.Text.Command(f'setkvbase bus="{each}" kvll={level / legs:.17g}')
                circuit.moved[each] = level


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


def _causes(circuit: Circuit) -> Iterator[list[Any]]:
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


def _beyond(circuit: Circuit) -> Iterator[list[Any]]:
    """Causes of differences that the solution has, with the power that they affect in kW."""
    where = "outside their vminpu and vmaxpu in the source's solution"
    if found := _outside(circuit, ("load",)):
        kw = sum(number(element, "kw") for element in found)
        drawn_kw = sum(drawn for _, drawn in found.values())
        yield [
            kw,
            f"loads {where}, where OpenDSS gives them a constant impedance, so that they draw "
            f"{drawn_kw:.4g} kW instead of {kw:.4g} kW: {_at_voltage(found)}",
        ]
    if found := _outside(circuit, POWERS[1:]):
        kw = sum(abs(drawn) for _, drawn in found.values())
        yield [
            kw,
            f"generation and batteries {where}, where OpenDSS gives them a constant impedance: "
            f"{_at_voltage(found)}",
        ]
    yield from _unlike_legs(circuit)


def _outside(circuit: Circuit, kinds: Iterable[str]) -> dict[str, tuple[float, float]]:
    """Lowest voltage in pu, and power in kW, of what OpenDSS makes an impedance at its voltage.

    An impedance stays one.
    """
    found = {}
    for kind in kinds:
        for name in circuit.of(kind):
            element = f"{kind}.{name}"
            of_all = kind == "load" and dss.Solution.LoadModel() == ADMITTANCE
            if of_all or number(element, "model") == CONSTANT_IMPEDANCE:
                continue
            delta = text_of(element, "conn").lower() in ("delta", "ll")
            kv, least, most = (number(element, each) for each in ("kv", "vminpu", "vmaxpu"))
            kv /= 1.0 if delta or dss.CktElement.NumPhases() == 1 else np.sqrt(3)
            pu = [v / (kv * V_PER_KV) for v in coil_volts(delta)]
            if min(pu) < least or max(pu) > most:
                found[element] = min(pu), power_drawn().real
    return found


def _at_voltage(found: dict[str, tuple[float, float]]) -> str:
    """The first of some elements with their voltages."""
    return _first(f"{element} ({pu:.3f} pu)" for element, (pu, _) in found.items())


def _unlike_legs(circuit: Circuit) -> Iterator[list[Any]]:
    """Service transformers whose legs have voltages of their own, which are one here."""
    found = {}
    for bus, (_, signs) in circuit.legs.items():
        dss.Circuit.SetActiveBus(bus)
        v = dict(zip(dss.Bus.Nodes(), dss.Bus.puVmagAngle()[::2], strict=True))
        legs = [v[node] for node in signs if node in v]
        if max(legs) - min(legs) > UNLIKE_PU:
            found[bus] = max(legs) - min(legs)
    if found:
        worst = max(found, key=lambda bus: found[bus])
        yield [
            0.0,
            f"both legs behind a service transformer count as one, but differ at {len(found)} "
            f"buses, by up to {found[worst]:.2g} pu at bus {worst}",
        ]


def _first(names: Iterable[str]) -> str:
    """The first of some names, and how many there are beyond."""
    kept = list(names)
    more = f" and {len(kept) - MOST_NAMED} more" if len(kept) > MOST_NAMED else ""
    return ", ".join(kept[:MOST_NAMED]) + more


def _shapes(circuit: Circuit) -> dict[str, Any]:
    """Daily shapes that loads and PV follow over time: whose, and their values."""
    follows: dict[str, str] = {}
    for kind in ("load", "pvsystem"):
        for name in circuit.of(kind):
            shape = text_of(f"{kind}.{name}", "daily").lower()
            if shape and shape != "default":
                follows[f"{kind}.{name}"] = shape
    values = {}
    for shape in dict.fromkeys(follows.values()):
        dss.LoadShape.Name(shape)
        minutes = _minutes()
        if minutes:
            values[shape] = {
                "values": [float(each) for each in dss.LoadShape.PMult()],
                "minutes": minutes,
                "unit": "kw" if dss.LoadShape.UseActual() else "pu",
            }
    follows = {element: shape for element, shape in follows.items() if shape in values}
    return {"follows": follows, "values": values}


def _minutes() -> float:
    """Step of the active shape, from its hours where it has them; 0 if its steps are not alike."""
    minutes = float(dss.LoadShape.MinInterval())
    if minutes:
        return minutes
    apart = 60.0 * np.diff(np.asarray(dss.LoadShape.TimeArray(), dtype=float))
    return float(apart[0]) if len(apart) and np.allclose(apart, apart[0]) else 0.0


def _notes_on_solution(circuit: Circuit, solved: bool, at_rest: bool) -> Iterator[str]:
    """Why there is no solution, or none in which controls have found their places."""
    if solved and not at_rest:
        yield "OpenDSS's controls do not come to rest: they stay where its last solution has them."
    if not solved and circuit.said:
        yield f"OpenDSS does not solve the circuit ({circuit.said})."


def _notes(circuit: Circuit) -> Iterator[str]:
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
    yield from _notes_on_controls(circuit)


def _notes_on_legs(circuit: Circuit) -> Iterator[str]:
    """Note that both legs behind a service transformer count as one voltage."""
    count = sum(middle() is not None for _ in circuit.of("transformer"))
    if count:
        yield (
            f"{count} transformers have the middle of their secondary at ground: both legs behind "
            "them are one node with the voltage from leg to leg, and a load at one leg counts at "
            "both. Voltages are compared from leg to leg."
        )


def _notes_on_controls(circuit: Circuit) -> Iterator[str]:
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
    if circuit.at_rest:
        yield (
            "OpenDSS finds no solution with what storage in wye draws at rest: its solution is the "
            "one with '%idlingkw=0'."
        )
    if idle_kw := sum(map(_idle_kw, circuit.names.get("storage", ()))):
        yield (
            f"What batteries draw while they rest is left out, {idle_kw:.3g} kW in all; "
            "efficiencies of inverters at partial load too."
        )


def _set_point(name: str) -> str:
    """A regulator's transformer, where it stands, and the voltage that it holds."""
    dss.RegControls.Name(name)
    volts = dss.RegControls.ForwardVreg()
    transformer = dss.RegControls.Transformer()
    winding = int(dss.RegControls.TapWinding())
    dss.Transformers.Name(transformer)
    dss.Transformers.Wdg(winding)
    return f"{transformer} at {dss.Transformers.Tap():.5g} (set to {volts:g} V)"
