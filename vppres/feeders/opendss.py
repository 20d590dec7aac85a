"""An OpenDSS circuit as a pandapower net: its balanced positive-sequence equivalent.

OpenDSS itself reads the file and builds the circuit; this module only asks it for the elements.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import opendssdirect as dss
import pandas as pd

from vppres.core.arrays import Floats
from vppres.core.errors import InputError, Problem
from vppres.core.units import kw_to_mw
from vppres.scenario.network import BusId

# Classes that carry no power in steady state, or only shape it over time.
PASSIVE = {"vsource", "line", "transformer", "load", "generator", "pvsystem", "storage",
           "capacitor", "regcontrol", "capcontrol", "energymeter", "monitor", "fuse", "relay",
           "recloser", "swtcontrol", "invcontrol", "storagecontroller", "sensor"}
LEFT_OUT = {"capacitor": "Capacitors are left out", "storage": "Batteries of the source are left "
            "out", "regcontrol": "Regulators are taken at their nominal ratio"}
THREE_PHASES = 3
A_PER_KA = 1000.0
DEFAULT_AMPS = 400.0
SOURCE_TOLERANCE, WINDING_TOLERANCE = 0.01, 0.1  # windings are often rated above their level

Contents = tuple[Any, dict[int, BusId], tuple[str, ...]]


def read_opendss(path: Path) -> Contents:
    """Read a circuit.

    Returns
    -------
    net : pandapowerNet
        Lines, two-winding transformers, loads and generators; one external grid.
    bus_ids : dict
        OpenDSS's name of each bus.
    notes : tuple of str
        What the balanced equivalent leaves out.

    Raises
    ------
    InputError
        If OpenDSS refuses the file, or an element has no balanced equivalent here.
    """
    try:
        _compile(path)
        problems = [p for name in _elements() if (p := _problem(path.name, name))]
        problems = problems or _check_levels(path.name)
        if problems:
            raise InputError(problems)
        net, ids = _build()
        return net, ids, tuple(_notes())
    finally:
        dss.Text.Command("clear")


def _compile(path: Path) -> None:
    """Let OpenDSS read the file, without its changing the working directory."""
    dss.Basic.AllowChangeDir(False)
    dss.Basic.AllowForms(False)
    try:
        dss.Text.Command("clear")
        dss.Text.Command(f'redirect "{path.absolute()}"')
        dss.Text.Command("makebuslist")
        dss.Text.Command("calcvoltagebases")
    except Exception as error:  # the engine's own class has no public name
        raise InputError(Problem(path.name, f"OpenDSS refuses the file ({str(error).strip()})",
                                 "Correct the file until OpenDSS solves it.")) from None


def _elements() -> list[str]:
    """Enabled elements, as ``class.name`` in lower case."""
    found = []
    for name in dss.Circuit.AllElementNames():
        dss.Circuit.SetActiveElement(name)
        if dss.CktElement.Enabled():
            found.append(name.lower())
    return found


def _of(kind: str) -> Iterator[str]:
    """Names of the enabled elements of a class; each is active while it is yielded."""
    for element in _elements():
        if element.startswith(f"{kind}."):
            dss.Circuit.SetActiveElement(element)
            yield element.partition(".")[2]


def _problem(file: str, element: str) -> Problem | None:
    """Why an element has no equivalent here; None if it has."""
    kind, _, name = element.partition(".")
    if kind not in PASSIVE:
        return Problem(file, f"{element} is not supported",
                       "Disable it, or replace it by lines, transformers, loads and generators.")
    if kind == "vsource" and element != "vsource.source":
        return Problem(file, f"{element} is a second source",
                       "Keep the circuit's own source and disable the others.")
    if kind == "transformer":
        dss.Transformers.Name(name)
        if dss.Transformers.NumWindings() != 2:
            return Problem(file, f"{element} has {dss.Transformers.NumWindings()} windings",
                           "Replace it by a transformer with two windings.")
    return None


def _check_levels(file: str) -> list[Problem]:
    """Ratings that do not fit their bus: without ``voltagebases`` OpenDSS guesses the levels."""
    problems = []
    for element, bus, rated_kv, tolerance in list(_ratings()):
        base_kv = _base_kv(bus)
        # The rating of a single phase may be that between line and neutral.
        if min(abs(rated_kv * f - base_kv) for f in (1.0, np.sqrt(3))) > tolerance * rated_kv:
            problems.append(Problem(
                file, f"{element} has {rated_kv:g} kV at bus {bus}, whose nominal voltage is "
                f"{base_kv:.4g} kV", "Name the levels with 'set voltagebases=[...]'."))
    return problems


def _ratings() -> Iterator[tuple[str, str, float, float]]:
    """Element, bus, rated voltage in kV, and by which share the bus may differ."""
    for name in _of("vsource"):
        bus = _buses()[0]
        dss.Vsources.Name(name)
        yield f"vsource.{name}", bus, dss.Vsources.BasekV(), SOURCE_TOLERANCE
    for name in list(_of("transformer")):
        dss.Circuit.SetActiveElement(f"transformer.{name}")
        buses = _buses()
        for winding, bus in enumerate(buses, start=1):
            dss.Transformers.Name(name)
            dss.Transformers.Wdg(winding)
            yield f"transformer.{name}", bus, dss.Transformers.kV(), WINDING_TOLERANCE


def _base_kv(bus: str) -> float:
    """Nominal line-to-line voltage of a bus."""
    dss.Circuit.SetActiveBus(bus)
    return float(dss.Bus.kVBase() * np.sqrt(3))


def _build() -> tuple[Any, dict[int, BusId]]:
    """The pandapower net of the active circuit, and its buses' names."""
    import pandapower as pp

    names = dss.Circuit.AllBusNames()
    net = pp.create_empty_network(name=dss.Circuit.Name())
    pp.create_buses(net, len(names), vn_kv=[_base_kv(bus) for bus in names], name=names)
    at = {name: i for i, name in enumerate(names)}
    for source in _of("vsource"):
        bus = at[_buses()[0]]
        dss.Vsources.Name(source)
        pp.create_ext_grid(net, bus, vm_pu=dss.Vsources.PU(), name=source)
    for name in _of("line"):
        _add_line(net, name, at)
    for name in _of("transformer"):
        _add_transformer(net, name, at)
    _add_powers(net, at)
    # Scenario folders read buses as whole numbers where all of them are.
    whole = all(name.isdecimal() and str(int(name)) == name for name in names)
    return net, {i: int(name) if whole else name for i, name in enumerate(names)}


def _buses() -> list[str]:
    """Buses of the active element, without their phases."""
    return [bus.partition(".")[0].lower() for bus in dss.CktElement.BusNames()]


def _closed() -> bool:
    """Whether no terminal of the active element is open."""
    return not any(dss.CktElement.IsOpen(end, 0)
                   for end in range(1, dss.CktElement.NumTerminals() + 1))


def _add_line(net: Any, name: str, at: dict[str, int]) -> None:
    """A line with its positive-sequence impedance."""
    import pandapower as pp

    (start, end) = _buses()
    closed = _closed()
    dss.Lines.Name(name)
    pp.create_line_from_parameters(
        net, at[start], at[end], length_km=dss.Lines.Length(),
        max_i_ka=dss.Lines.NormAmps() / A_PER_KA,
        r_ohm_per_km=_positive_sequence(dss.Lines.RMatrix(), dss.Lines.Phases()),
        x_ohm_per_km=_positive_sequence(dss.Lines.XMatrix(), dss.Lines.Phases()),
        c_nf_per_km=0.0, name=name, in_service=closed)


def _positive_sequence(matrix: list[float], n_phases: int) -> float:
    """Mean self impedance less mean mutual impedance.

    >>> _positive_sequence([5.0, 2.0, 2.0, 2.0, 5.0, 2.0, 2.0, 2.0, 5.0], 3)
    3.0
    """
    z: Floats = np.asarray(matrix, dtype=float).reshape(n_phases, n_phases)
    own = np.trace(z) / n_phases
    mutual = (z.sum() - np.trace(z)) / max(n_phases * (n_phases - 1), 1)
    return float(own - mutual)


def _add_transformer(net: Any, name: str, at: dict[str, int]) -> None:
    """A transformer at the nominal ratio of its buses; units of a bank are parallel ones."""
    import pandapower as pp

    (start, end) = _buses()
    closed = _closed()
    dss.Transformers.Name(name)
    percent = []
    for winding in (1, 2):
        dss.Transformers.Wdg(winding)
        percent.append(dss.Transformers.R())
    rating_kva = dss.Transformers.kVA()
    x_percent = dss.Transformers.Xhl()
    high, low = sorted((at[start], at[end]), key=lambda bus: -net.bus.at[bus, "vn_kv"])
    pp.create_transformer_from_parameters(
        net, high, low, sn_mva=float(kw_to_mw(rating_kva)), vn_hv_kv=net.bus.at[high, "vn_kv"],
        vn_lv_kv=net.bus.at[low, "vn_kv"], vkr_percent=sum(percent),
        vk_percent=float(np.hypot(sum(percent), x_percent)), pfe_kw=0.0, i0_percent=0.0,
        name=name, in_service=closed)


def _add_powers(net: Any, at: dict[str, int]) -> None:
    """Loads and generators, all phases of a bus together."""
    import pandapower as pp

    for kind, create in (("load", pp.create_load), ("generator", pp.create_sgen),
                         ("pvsystem", pp.create_sgen)):
        for name in _of(kind):
            bus = at[_buses()[0]]
            p_kw, q_kvar = _power(kind, name)
            extra = {"type": "PV" if kind == "pvsystem" else kind} if kind != "load" else {}
            create(net, bus, p_mw=float(kw_to_mw(p_kw)), q_mvar=float(kw_to_mw(q_kvar)), name=name,
                   **extra)


def _power(kind: str, name: str) -> tuple[float, float]:
    """Nominal active and reactive power of an element; PV at its peak and without reactive."""
    if kind == "pvsystem":
        dss.PVsystems.Name(name)
        return float(dss.PVsystems.Pmpp()), 0.0
    table = dss.Loads if kind == "load" else dss.Generators
    table.Name(name)
    return float(table.kW()), float(table.kvar())


def _notes() -> Iterator[str]:
    """What the balanced equivalent leaves out."""
    yield ("The circuit is taken as balanced: lines have their positive-sequence impedance, loads "
           "of single phases count as spread over three. Voltages of single phases, line charging, "
           "off-nominal ratios, the source's impedance and voltage-dependent loads are left out.")
    phases = pd.Series({name: dss.CktElement.NumPhases() for name in _of("line")}, dtype=float)
    few = phases.index[phases < THREE_PHASES]
    if len(few):
        yield (f"{len(few)} of {len(phases)} lines have fewer than three phases; the equivalent "
               "understates their voltage drop and losses.")
    unrated = [name for name in _of("line") if dss.CktElement.NormalAmps() == DEFAULT_AMPS]
    if unrated:
        yield (f"{len(unrated)} of {len(phases)} lines are rated at {DEFAULT_AMPS:g} A, which "
               "OpenDSS also gives to lines without a rating.")
    for kind, words in LEFT_OUT.items():
        names = list(_of(kind))
        if names:
            yield f"{words}: {', '.join(names)}."
