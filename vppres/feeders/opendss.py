"""An OpenDSS circuit as a pandapower net: its balanced positive-sequence equivalent.

The script is checked and written anew (:mod:`vppres.feeders.dss_text`). OpenDSS builds the circuit
in a process of its own (:mod:`vppres.feeders.dss_engine`), in an empty folder that is thrown away,
and only numbers and names come back.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Floats
from vppres.core.errors import InputError, Problem
from vppres.core.units import kw_to_mw
from vppres.feeders import dss_text
from vppres.feeders.balance import PHASES, PhasePowers
from vppres.feeders.confined import TIME_LIMIT_S, confined
from vppres.scenario.network import BusId

A_PER_KA = 1000.0
Contents = tuple[Any, dict[int, BusId], tuple[str, ...], PhasePowers | None]


def read_opendss(path: Path, time_limit_s: float = TIME_LIMIT_S) -> Contents:
    """Read a circuit.

    Parameters
    ----------
    path : Path
        The master file; what it redirects to lies in its folder.
    time_limit_s : float, optional
        For OpenDSS to build the circuit.

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

    Raises
    ------
    InputError
        If a line is not one that a network needs, OpenDSS refuses the file or takes too long, or
        an element has no balanced equivalent here.
    """
    script = dss_text.read_script(path)
    job = {"commands": [command.text for command in script.commands]}
    found = confined("dss_engine", job, path.name, time_limit_s)
    if found["problems"]:
        raise InputError([located(problem, script, path.name) for problem in found["problems"]])
    net, ids = _build(found)
    return net, ids, (*script.notes, *found["notes"]), _phase_powers(found)


def _phase_powers(found: dict[str, Any]) -> PhasePowers | None:
    """Power of the loads less that of generators on each phase, by bus."""
    counts = found["single_phases"]
    if not counts:
        return None
    words = [f"{few} of {count} {kind}s" for kind, (few, count) in counts.items()]
    rows = []
    for power in found["powers"]:
        sign = 1.0 if power["kind"] == "load" else -1.0
        share_kw = sign * power["p_kw"] / max(len(power["nodes"]), 1)
        at = [share_kw if phase in power["nodes"] else 0.0 for phase in (1, 2, 3)]
        rows.append(pd.Series(at, list(PHASES), name=power["bus"]))
    p_kw = pd.DataFrame(rows, columns=list(PHASES), dtype=float)
    return PhasePowers(f"fewer than three phases have {', '.join(words)}", p_kw)


def located(problem: dict[str, Any], script: dss_text.Script, name: str) -> Problem:
    """A problem of the engine, at the file and row of its command if it has one."""
    at = problem["command"]
    if at is None:
        return Problem(name, problem["message"], problem["cure"])
    command = script.commands[at]
    return Problem(command.file, problem["message"], problem["cure"], row=command.row)


def _build(found: dict[str, Any]) -> tuple[Any, dict[int, BusId]]:
    """The pandapower net of the circuit, and its buses' names."""
    import pandapower as pp

    names = [bus["name"] for bus in found["buses"]]
    net = pp.create_empty_network(name=found["name"])
    pp.create_buses(net, len(names), vn_kv=[bus["kv"] for bus in found["buses"]], name=names)
    at = {name: i for i, name in enumerate(names)}
    for source in found["sources"]:
        pp.create_ext_grid(net, at[source["bus"]], vm_pu=source["v_pu"], name=source["name"])
    for line in found["lines"]:
        _add_line(net, line, at)
    for transformer in found["transformers"]:
        _add_transformer(net, transformer, at)
    _add_powers(net, found["powers"], at)
    # Scenario folders read buses as whole numbers where all of them are.
    whole = all(name.isdecimal() and str(int(name)) == name for name in names)
    return net, {i: int(name) if whole else name for i, name in enumerate(names)}


def _add_line(net: Any, line: dict[str, Any], at: dict[str, int]) -> None:
    """A line with its positive-sequence impedance."""
    import pandapower as pp

    pp.create_line_from_parameters(
        net,
        at[line["start"]],
        at[line["end"]],
        length_km=line["length"],
        max_i_ka=line["amps"] / A_PER_KA,
        r_ohm_per_km=_positive_sequence(line["r"], line["phases"]),
        x_ohm_per_km=_positive_sequence(line["x"], line["phases"]),
        c_nf_per_km=0.0,
        name=line["name"],
        in_service=line["closed"],
    )


def _positive_sequence(matrix: list[float], n_phases: int) -> float:
    """Mean self impedance less mean mutual impedance.

    >>> _positive_sequence([5.0, 2.0, 2.0, 2.0, 5.0, 2.0, 2.0, 2.0, 5.0], 3)
    3.0
    """
    z: Floats = np.asarray(matrix, dtype=float).reshape(n_phases, n_phases)
    own = np.trace(z) / n_phases
    mutual = (z.sum() - np.trace(z)) / max(n_phases * (n_phases - 1), 1)
    return float(own - mutual)


def _add_transformer(net: Any, transformer: dict[str, Any], at: dict[str, int]) -> None:
    """A transformer at the nominal ratio of its buses; units of a bank are parallel ones."""
    import pandapower as pp

    ends = (at[transformer["start"]], at[transformer["end"]])
    high, low = sorted(ends, key=lambda bus: -net.bus.at[bus, "vn_kv"])
    r_percent = transformer["r_percent"]
    pp.create_transformer_from_parameters(
        net,
        high,
        low,
        sn_mva=float(kw_to_mw(transformer["kva"])),
        vn_hv_kv=net.bus.at[high, "vn_kv"],
        vn_lv_kv=net.bus.at[low, "vn_kv"],
        vkr_percent=r_percent,
        vk_percent=float(np.hypot(r_percent, transformer["x_percent"])),
        pfe_kw=0.0,
        i0_percent=0.0,
        name=transformer["name"],
        in_service=transformer["closed"],
    )


def _add_powers(net: Any, powers: list[dict[str, Any]], at: dict[str, int]) -> None:
    """Loads and generators, all phases of a bus together."""
    import pandapower as pp

    for power in powers:
        values = {
            "p_mw": float(kw_to_mw(power["p_kw"])),
            "q_mvar": float(kw_to_mw(power["q_kvar"])),
        }
        if power["kind"] == "load":
            pp.create_load(net, at[power["bus"]], name=power["name"], **values)
        else:
            kind = "PV" if power["kind"] == "pvsystem" else power["kind"]
            pp.create_sgen(net, at[power["bus"]], name=power["name"], type=kind, **values)
