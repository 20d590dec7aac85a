"""A small unbalanced feeder with every kind of element, and a day of it."""

from __future__ import annotations

from pathlib import Path

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


def phased_day(circuit: Path) -> Scenario:
    """A scenario of a circuit's file, read back from a folder beside it."""
    folder = circuit.parent / circuit.stem
    options = NewScenarioOptions(add_batteries=True, pv="sized", draw_tiers=True)
    write_new_scenario(import_network(circuit), options, folder)
    return read_scenario(folder)
