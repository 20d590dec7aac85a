"""OpenDSS's own solution of a file that it carries out whole, as a line of JSON.

``python -m experiments.studies.opendss_itself FILE`` does what the file says: use a copy that you
trust.
"""

from __future__ import annotations

import json
import sys
from dataclasses import asdict, dataclass, field

import numpy as np
import opendssdirect as dss

SOLVED_TO = (1e-11, 1e-9, 1e-7, 1e-4)
"""Tolerances of the last solution: of what floats or is stiff OpenDSS meets only the latter."""

FIXED = 1  # status of a load that no multiplier changes
DRAWING = ("load.", "generator.", "pvsystem.", "storage.")


@dataclass(frozen=True)
class Itself:
    """Voltage of each node in pu of its bus's level, losses with all shunts, loads."""

    v_pu: dict[str, float] = field(default_factory=dict)
    base_v: dict[str, float] = field(default_factory=dict)
    losses_kw: float = 0.0
    loads: int = 0
    load_kw: float = 0.0
    error: str = ""


def of_opendss(file: str) -> Itself:
    """OpenDSS on the whole file, with its controls where its own solution leaves them."""
    dss.Basic.AllowForms(False)
    dss.Basic.AllowEditor(False)
    dss.Basic.AllowDOScmd(False)
    try:
        dss.Text.Command(f'compile "{file}"')
        for command in ("set mode=snapshot maxcontroliter=100", "solve"):
            dss.Text.Command(command)
        if not _solved():
            return Itself(error="OpenDSS finds no solution of it")
    except Exception as error:  # the engine's own class has no public name
        return Itself(error=" ".join(str(error).split())[:200])
    names = [name.lower() for name in dss.Circuit.AllNodeNames()]
    v_pu = dict(zip(names, map(float, dss.Circuit.AllBusMagPu()), strict=True))
    v_pu |= _between_legs()
    base_v = {}
    for bus in dss.Circuit.AllBusNames():
        dss.Circuit.SetActiveBus(bus)
        base_v[bus.lower()] = 1000.0 * dss.Bus.kVBase()
    loads, load_kw = 0, 0.0
    for name in dss.Loads.AllNames() or ():
        dss.Circuit.SetActiveElement(f"load.{name}")
        if dss.CktElement.Enabled():
            dss.Loads.Name(name)
            loads += 1
            load_kw += dss.Loads.kW() * (
                1.0 if dss.Loads.Status() == FIXED else dss.Solution.LoadMult()
            )
    return Itself(v_pu, base_v, _losses_kw(), loads, load_kw)


def _solved() -> bool:
    """Solve to the last digits with everything where it stands; whether that converged."""
    for tolerance in SOLVED_TO:
        dss.Text.Command(
            f"set mode=snap controlmode=off tolerance={tolerance:g} maxiterations=1000"
        )
        dss.Text.Command("solve")
        if dss.Solution.Converged():
            return True
    return False


def _between_legs() -> dict[str, float]:
    """Half the voltage from node 1 to node 2 of buses that have these alone, as ``bus:12``."""
    found = {}
    for bus in dss.Circuit.AllBusNames():
        dss.Circuit.SetActiveBus(bus)
        if sorted(dss.Bus.Nodes()) == [1, 2]:
            flat = np.asarray(dss.Bus.PuVoltage())
            found[f"{bus.lower()}:12"] = float(abs(complex(*flat[:2]) - complex(*flat[2:4]))) / 2.0
    return found


def _losses_kw() -> float:
    """What the source gives, and takes itself, less what loads and others draw."""
    dss.Circuit.SetActiveElement("vsource.source")
    n = dss.CktElement.NumConductors()
    flat = np.asarray(dss.CktElement.YPrim())
    size = round((len(flat) / 2) ** 0.5)
    y = (flat[::2] + 1j * flat[1::2]).reshape(size, size).T[:n, :n]
    flat = np.asarray(dss.CktElement.Currents())
    i = (flat[::2] + 1j * flat[1::2])[:n]
    lost_kw = float((i.conj() @ np.linalg.inv(y) @ i).real) / 1000.0
    lost_kw -= float(np.sum(dss.CktElement.Powers()[: 2 * n : 2]))
    for name in dss.Circuit.AllElementNames():
        if name.lower().startswith(DRAWING):
            dss.Circuit.SetActiveElement(name)
            if dss.CktElement.Enabled():
                lost_kw -= float(np.sum(dss.CktElement.Powers()[::2]))
    return lost_kw


if __name__ == "__main__":
    sys.stdout.write(json.dumps(asdict(of_opendss(sys.argv[1]))) + "\n")
