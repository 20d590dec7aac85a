"""Small unbalanced feeders, one with every kind of element and one with a customer a phase."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from vppres.core.arrays import Floats
from vppres.day.trajectory import Trajectory
from vppres.feeders.new.options import NewScenarioOptions
from vppres.feeders.new.scenario import write_new_scenario
from vppres.feeders.sources import import_network
from vppres.io import read_scenario
from vppres.scenario.scenario import Scenario

CIRCUIT = """clear
new circuit.small basekv=69 pu=1.02 mvasc3=20000 mvasc1=21000
new transformer.sub phases=3 windings=2 xhl=8
~ wdg=1 bus=sourcebus conn=delta kv=69 kva=5000 %r=0.5
~ wdg=2 bus=s conn=wye kv=4.16 kva=5000 %r=0.5
new transformer.rega phases=1 xhl=0.1 kvas=[1600 1600] buses=[s.1 r.1] kvs=[2.4 2.4] %r=0.01
new transformer.regb phases=1 xhl=0.1 kvas=[1600 1600] buses=[s.2 r.2] kvs=[2.4 2.4] %r=0.01
~ wdg=2 tap=1.025
new transformer.regc phases=1 xhl=0.1 kvas=[1600 1600] buses=[s.3 r.3] kvs=[2.4 2.4] %r=0.01
~ wdg=2 tap=1.0125
new linecode.three nphases=3 rmatrix=[0.4|0.15 0.41|0.15 0.15 0.4] basefreq=60
~ xmatrix=[1.0|0.5 1.05|0.4 0.4 1.0] cmatrix=[9|-2 9|-1 -1 9] units=km
new linecode.two nphases=2 rmatrix=[0.8|0.15 0.8] xmatrix=[0.9|0.3 0.9] cmatrix=[3|0 3] units=km
new capacitor.c bus1=e phases=3 kvar=150 kv=4.16
new line.l1 bus1=r bus2=m linecode=three length=0.5 units=km
new line.l2 bus1=m.2.3 bus2=n.2.3 phases=2 linecode=two length=0.3 units=km
new line.l3 bus1=m bus2=e linecode=three length=0.6 units=km
new transformer.low phases=3 windings=2 xhl=2.7
~ wdg=1 bus=e conn=delta kv=4.16 kva=300 %r=0.6
~ wdg=2 bus=d conn=delta kv=0.48 kva=300 %r=0.6
new load.a bus1=m.1 phases=1 kv=2.4 kw=260 kvar=90 model=5
new load.b bus1=n.2 phases=1 kv=2.4 kw=90 kvar=30 model=2
new load.bc bus1=n.2.3 phases=1 conn=delta kv=4.16 kw=120 kvar=50 model=1
new load.e bus1=e phases=3 kv=4.16 kw=600 kvar=200 model=1
new load.d bus1=d phases=3 conn=delta kv=0.48 kw=90 kvar=30 model=1
set voltagebases=[69 4.16 0.48]
calcvoltagebases
"""


def _regulators(stage: str, first: str, second: str) -> str:
    """A regulator of each phase between two buses."""
    return "".join(
        f"new transformer.{stage}{phase} phases=1 xhl=0.1 kvas=[1600 1600] %r=0.01 "
        f"buses=[{first}.{node} {second}.{node}] kvs=[2.4 2.4]\n"
        f"new regcontrol.{stage}{phase} transformer={stage}{phase} winding=2 vreg=125 band=2 "
        "ptratio=20\n"
        for node, phase in enumerate("abc", 1)
    )


REGULATED = f"""clear
new circuit.long basekv=4.16 pu=1.03 mvasc3=200 mvasc1=200
new linecode.three nphases=3 rmatrix=[0.4|0.15 0.41|0.15 0.15 0.4] basefreq=60
~ xmatrix=[1.0|0.5 1.05|0.4 0.4 1.0] units=km
new line.l1 bus1=sourcebus bus2=r linecode=three length=1.5 units=km
{_regulators("first", "r", "t")}new line.l2 bus1=t bus2=u linecode=three length=1.5 units=km
{_regulators("second", "u", "v")}new line.l3 bus1=v bus2=e linecode=three length=0.5 units=km
new load.near bus1=sourcebus phases=3 kv=4.16 kw=300 kvar=90 model=1
new load.a bus1=e.1 phases=1 kv=2.4 kw=340 kvar=90 model=1
new load.b bus1=e.2 phases=1 kv=2.4 kw=330 kvar=90 model=1
new load.c bus1=e.3 phases=1 kv=2.4 kw=320 kvar=90 model=1
new load.far bus1=e phases=3 kv=4.16 kw=300 kvar=90 model=1
set voltagebases=[4.16]
calcvoltagebases
"""
"""Its regulators raise the far end by up to 17%, which no limit allows without the demand there."""


def day_of(text: str, folder: Path) -> Scenario:
    """The scenario of a circuit's text, written into a folder."""
    file = folder / "circuit.dss"
    file.write_text(text)
    return phased_day(file)


def phased_day(circuit: Path) -> Scenario:
    """A scenario of a circuit's file, read back from a folder beside it."""
    folder = circuit.parent / circuit.stem
    options = NewScenarioOptions(add_batteries=True, pv="sized", draw_tiers=True)
    write_new_scenario(import_network(circuit), options, folder)
    return read_scenario(folder)


STREET = """clear
new circuit.street basekv=0.4 pu=1.0 mvasc3=100 mvasc1=100
new linecode.three nphases=3 rmatrix=[0.4|0.15 0.41|0.15 0.15 0.4] basefreq=50
~ xmatrix=[0.3|0.1 0.3|0.1 0.1 0.3] units=km
new line.l1 bus1=sourcebus bus2=m linecode=three length=0.1 units=km
new line.l2 bus1=m bus2=n linecode=three length=0.1 units=km
new load.a bus1=m.1 phases=1 kv=0.2309 kw=3 kvar=0.5 model=1
new load.b bus1=n.2 phases=1 kv=0.2309 kw=3 kvar=0.5 model=1
new load.c bus1=n.3 phases=1 kv=0.2309 kw=3 kvar=0.5 model=1
new load.d bus1=n phases=3 kv=0.4 kw=3 kvar=0.5 model=1
set voltagebases=[0.4]
calcvoltagebases
"""
"""A customer on each phase and one on all three, whose battery forms the grid."""

NONE_KW = 1e-3
DARK, OPEN = 0.0, np.inf


def street_day(
    street: Scenario,
    load_kw: Floats,
    limits_kw: Sequence[float],
    first: Sequence[int],
    soc: float = 0.85,
    p_max_kw: float = 10.0,
    sun_kw: Sequence[float] = (),
) -> Scenario:
    """Hours of the street, ``first`` its customers of the highest tier; one battery of 10 kWh."""
    steps = len(load_kw)
    day = street.between(0, steps)
    b, pv = day.batteries, day.pv
    forms = b.id == "bd"
    batteries = replace(
        b,
        energy_kwh=np.where(forms, 10.0, 0.1),
        p_max_kw=np.where(forms, p_max_kw, 0.05),
        s_max_kva=np.where(forms, 36.0, 0.1),
        soc_initial=np.where(forms, soc, 0.15),
        grid_forming=forms,
    )
    pv_kw = np.zeros((steps, len(pv)))
    if len(sun_kw):
        pv_kw[:, 0] = sun_kw
    highest = np.isin(np.arange(4), first)
    customers = replace(
        day.customers,
        tier=np.where(highest, "critical", "low").astype(object),
        weight=np.where(highest, 1.0, 0.02),
    )
    return replace(
        day,
        customers=customers,
        batteries=batteries,
        pv=replace(pv, p_max_kw=np.full(len(pv), 50.0), s_max_kva=np.full(len(pv), 60.0)),
        load_kw=np.asarray(load_kw, dtype=float),
        pv_kw=pv_kw,
        grid_limit_kw=np.asarray(limits_kw, dtype=float),
        export_limit_kw=np.zeros(steps),
    )


def served(run: Trajectory) -> Floats:
    """Who is supplied, (T, C)."""
    return run.customers.pivot(index="time", columns="id", values="served").to_numpy(dtype=int)
