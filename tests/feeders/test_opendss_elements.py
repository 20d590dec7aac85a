"""Scripts of OpenDSS with one odd thing each: their voltages are OpenDSS's on the untouched file."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.refusals import refusal
from vppres.core.errors import InputError
from vppres.feeders import ImportedFeeder, import_network
from vppres.feeders.closeness import NO_SOLUTION, NOT_CONVERGED
from vppres.feeders.dss.phases import flow_of_source
from vppres.feeders.dss.recheck import solved_steps
from vppres.feeders.new.options import NewScenarioOptions
from vppres.feeders.new.scenario import new_scenario, write_new_scenario
from vppres.io import read_scenario
from vppres.physics.powerflow import ACPowerFlow

dss: Any = pytest.importorskip("opendssdirect")

CLOSE_PU = 1e-6
HEAD = "new circuit.t basekv=12.47 pu=1.02 bus1=s mvasc3=200 mvasc1=180"
BANK = (
    "new transformer.t phases=3 windings=2 buses=(s m) conns=(delta wye) kvs=(12.47 4.16) "
    "kvas=(1000 1000) xhl=5 %rs=(.5 .5)"
)
LINE = "new line.l bus1=m bus2=b r1=.3 x1=.4 r0=.6 x0=1.2 c1=3 c0=2 length=1"
LOADS = (
    "new load.a bus1=b.1 phases=1 kv=2.4 kw=100 pf=.95",
    "new load.b bus1=b.2.3 phases=1 conn=delta kv=4.16 kw=80 kvar=20 model=5",
)
TAIL = "set voltagebases=[12.47 4.16 0.48]\ncalcvoltagebases\nsolve"
BASE = (HEAD, BANK, LINE, *LOADS)


def written(folder: Path, lines: tuple[str, ...], tail: str = TAIL) -> Path:
    file = folder / "odd.dss"
    file.write_text("\n".join(("clear", *lines, tail, "")))
    return file


def of_opendss(file: Path) -> dict[str, float]:
    """Voltage to ground of each node in pu of OpenDSS on the file as it is."""
    for command in (
        "clear", f'redirect "{file}"', "set tolerance=1e-11 maxiterations=1000 controlmode=off", "solve",
    ):  # fmt: skip
        dss.Text.Command(command)
    return dict(zip(dss.Circuit.AllNodeNames(), dss.Circuit.AllBusMagPu(), strict=True))


def own_voltages(feeder: ImportedFeeder) -> dict[str, float]:
    """The same of the feeder's own power flow: by node, or of a balanced one by bus."""
    if feeder.phased is None:
        v_pu = ACPowerFlow(feeder.network).solve(*feeder.injection).v_pu
        return {str(bus): v for bus, v in zip(feeder.network.buses, v_pu, strict=True)}
    flow, p_kw, q_kvar = flow_of_source(feeder.phased)
    v = np.abs(flow.solve(p_kw, q_kvar).v)
    rows = flow.phases.by_bus
    return {
        f"{bus}.{phase + 1}": float(each) / (rows[bus].kv * 1e3 / 3**0.5)
        for (bus, phase), each in zip(flow.phases.nodes, v, strict=True)
    }


def apart(feeder: ImportedFeeder, file: Path) -> float:
    """Largest difference of the two, of every node that OpenDSS has and is supplied."""
    theirs, own = of_opendss(file), own_voltages(feeder)
    if feeder.phased is None:
        buses = {name.partition(".")[0] for name in theirs} & {*own}
        means = {
            bus: np.mean([v for name, v in theirs.items() if name.partition(".")[0] == bus])
            for bus in buses
        }
        return float(max(abs(own[bus] - v) for bus, v in means.items()))
    return max(abs(own[name] - theirs[name]) for name in own if name in theirs)


SPUR = "new line.sp bus1=b bus2=e r1=.3 x1=.4 r0=.6 x0=1.2 c1=3 c0=2 length=1"
AT_E = ("new load.e bus1=e.1 phases=1 kv=2.4 kw=30", "new load.f bus1=e.3 phases=1 kv=2.4 kw=6")
FOUR = (
    "new linecode.c4 nphases=4 rmatrix=[.37|.05 .37|.05 .05 .37|.05 .05 .05 .48] units=km "
    "xmatrix=[.75|.66 .75|.66 .66 .75|.66 .66 .66 .76] cmatrix=[9|0 9|0 0 9|0 0 0 9]"
)
THREE_WINDINGS = (
    "new transformer.t windings=3 buses=(s m d) conns=(delta wye delta) kvs=(12.47 4.16 .48) "
    "kvas=(1000 1000 300) xhl=7.5 xht=36 xlt=28 %rs=(.3 .4 .7)"
)
AT_D = "new load.d bus1=d conn=delta kv=.48 kw=30 pf=.9"
UNITS = tuple(
    f"new transformer.t{i} phases=1 windings=3 buses=(s.{i} m.{i} d.{i}.{i % 3 + 1}) "
    "conns=(wye wye delta) kvs=(7.2 2.4 .48) kvas=(300 300 90) xhl=7 xht=36 xlt=28 "
    "%rs=(.1 .1 .3) %imag=.5"
    for i in (1, 2, 3)
)
EARTHED = BANK.replace("buses=(s m)", "buses=(s m.1.2.3.4)")
ODD: dict[str, tuple[str, ...]] = {
    "three windings": (HEAD, f"{THREE_WINDINGS} wdg=2 tap=1.01 %imag=.7", LINE, *LOADS, AT_D),
    "three windings with a leg below zero": (
        HEAD,
        THREE_WINDINGS.replace("xht=36 xlt=28", "xht=10 xlt=2"),
        LINE,
        *LOADS,
        AT_D,
    ),
    "reactances in an array": (
        HEAD,
        THREE_WINDINGS.replace("xhl=7.5 xht=36 xlt=28", "xscarray=(7.5 36 28)"),
        LINE,
        *LOADS,
        AT_D,
    ),
    "units with three windings": (HEAD, *UNITS, LINE, *LOADS, AT_D),
    "neutral behind a reactor": (
        HEAD,
        EARTHED,
        "new reactor.n phases=1 bus1=m.4 r=.1 x=.5",
        LINE,
        *LOADS,
    ),
    "neutrals of both windings": (
        HEAD,
        EARTHED.replace("(s ", "(s.1.2.3.4 ").replace("delta", "wye"),
        "new reactor.n phases=1 bus1=m.4 r=.1 x=.5",
        "new reactor.p phases=1 bus1=s.4 x=9",
        LINE,
        *LOADS,
    ),
    "neutral of three windings behind two reactors": (
        HEAD,
        THREE_WINDINGS.replace(" m ", " m.1.2.3.4 "),
        "new reactor.n phases=1 bus1=m.4 bus2=m.5 x=.3",
        "new reactor.g phases=1 bus1=m.5 r=2 x=.1",
        LINE,
        *LOADS,
    ),
    "neutral that nothing grounds": (HEAD, EARTHED, LINE, LOADS[1]),
    "one conductor open": (*BASE, SPUR, *AT_E, "open line.sp 1 2"),
    "one conductor open at its end": (*BASE, SPUR, *AT_E, "open line.sp term=2 cond=2"),
    "line that is open at one end": (
        *BASE,
        SPUR.replace("c1=3 c0=2", "c1=3000 c0=1500"),
        "open line.sp 2",
    ),
    "grounded neutral": (*BASE, FOUR, "new line.q b.1.2.3.0 e.1.2.3.0 c4 .3 4 units=km", *AT_E),
    "capacitor by cuf": (*BASE, "new capacitor.f phases=3 bus1=b kv=4.16 cuf=20"),
    "filter": (*BASE, "new capacitor.f bus1=b kv=4.16 kvar=200 xl=3 r=.2"),
    "capacitor in steps": (
        *BASE,
        "new capacitor.f bus1=b kv=4.16 kvar=[90 60] numsteps=2 states=[1 0]",
    ),
    "capacitor in delta": (*BASE, "new capacitor.f bus1=b kv=4.16 kvar=200 conn=delta"),
    "capacitor of one phase": (*BASE, "new capacitor.f bus1=b.2 phases=1 kv=2.4 kvar=90"),
    "capacitor between two phases": (
        *BASE,
        "new capacitor.f bus1=b.1 bus2=b.3 phases=1 kv=4.16 kvar=90",
    ),
    "capacitor with a neutral of its own": (
        *BASE,
        "new capacitor.f bus1=b.1.2.3 bus2=b.4.4.4 kv=4.16 kvar=150",
        "new reactor.g phases=1 bus1=b.4 r=5 x=2",
    ),
    "capacitor in a line": (
        *BASE,
        "new capacitor.c bus1=b bus2=e kv=4.16 kvar=9000",
        *AT_E,
    ),
    "reactor in a line": (*BASE, "new reactor.r bus1=b bus2=e r=.2 x=.5", *AT_E),
    "reactor to ground": (*BASE, "new reactor.r bus1=b kv=4.16 kvar=120"),
    "reactor in delta": (*BASE, "new reactor.r bus1=b kv=4.16 kvar=120 conn=delta rp=900"),
    "reactor by its sequences": (
        *BASE,
        "new reactor.r bus1=b bus2=e z1=[.1 .3] z2=[.1 .3] z0=[.4 .9]",
        *AT_E,
    ),
    "transformer that is open at one end": (
        *BASE,
        BANK.replace("transformer.t", "transformer.u") + " %noloadloss=.6 %imag=3",
        "open transformer.u 1",
    ),
    "core": (HEAD, f"{BANK} %noloadloss=.6 %imag=1.2", LINE, *LOADS),
    "core of single units": (
        *BASE,
        "new transformer.u phases=1 windings=2 buses=(b.1 e.1) kvs=(2.4 .277) kvas=(75 75) "
        "xhl=3 %noloadloss=.5 %imag=.9",
        "new load.e bus1=e.1 phases=1 kv=.277 kw=40",
    ),
    "loads on two phases": (
        *BASE,
        "new load.e phases=2 bus1=b.1.3 kv=4.16 kw=60 kvar=9",
        "new load.f phases=2 conn=delta bus1=b.3.1.2 kv=4.16 kw=60 kvar=9",
    ),
    "load in delta on its own turn": (*BASE, "new load.e conn=delta bus1=b.2.1.3 kv=4.16 kw=90"),
    "exponents": (*BASE, "new load.e bus1=b.3 phases=1 kv=2.4 kw=50 model=4 cvrwatts=.8 cvrvars=3"),
    "loadmult": (*BASE, "set loadmult=.6"),
    "loads that no multiplier changes": (*BASE, "load.a.status=fixed", "set loadmult=.6"),
    "regulator": (
        HEAD,
        BANK,
        LINE,
        *LOADS,
        "new regcontrol.r transformer=t winding=2 vreg=122 band=2 ptratio=20",
    ),
    "controls off": (
        HEAD,
        BANK,
        LINE,
        *LOADS,
        "new regcontrol.r transformer=t winding=2 vreg=126 band=1 ptratio=20",
        "set controlmode=off",
    ),
    "capacitor that a control takes out": (
        *BASE,
        "new capacitor.h phases=3 bus1=b kv=4.16 kvar=900",
        "new capcontrol.h capacitor=h element=line.l terminal=2 type=voltage ptratio=20 on=100 off=110 "
        "delay=1 delayoff=1",
    ),
    "switch": (
        *BASE,
        SPUR,
        *AT_E,
        "new swtcontrol.s switchedobj=line.sp switchedterm=1 action=close",
    ),
    "stiff source": (
        HEAD.replace("mvasc3=200 mvasc1=180", "r1=0 x1=.0001 r0=0 x0=.0001"),
        *BASE[1:],
    ),
    "source above its base": (HEAD.replace("12.47", "12.7"), *BASE[1:]),
    "by any part of a name": (
        "new circuit.t basekv=12.47 1.02 bus1=s mvasc3=200 180",
        BANK,
        "New Line.l(r:m-b) m b len=1 r1=.3 x1=.4 r0=.6 x0=1.2 c1=3 c0=2!on",
        'new "load.a" bus="b.1" ph=1 kv=2.4 kw=(50 2 *), pf=.95',
        *LOADS[1:],
    ),
    "PV": (*BASE, "new pvsystem.p bus1=b kv=4.16 kva=90 pmpp=120 %pmpp=80 irradiance=.9 pf=-.95"),
    "PV with a control": (
        *BASE,
        "new xycurve.vv npts=4 xarray=[.5 .95 1.05 1.5] yarray=[1 1 -1 -1]",
        "new pvsystem.p bus1=b kv=4.16 kva=90 pmpp=60 irradiance=.9",
        "new invcontrol.i mode=voltvar vvc_curve1=vv derlist=[PVSystem.p]",
    ),
    "generator that holds a voltage": (
        *BASE,
        "new generator.g bus1=b kv=4.16 kw=90 model=3 vpu=1 maxkvar=80 minkvar=-80",
    ),
    "battery": (*BASE, "new storage.x bus1=b kv=4.16 kwrated=60 kwhrated=200 state=discharging"),
    "parallel lines": (*BASE, LINE.replace("line.l", "line.k")),
    "units from phase to phase": (
        *BASE,
        *(
            f"new transformer.u{i} phases=1 buses=(b.{i}.{i + 1} e.{i}.{i + 1}) kvs=(4.16 .48) "
            "kvas=(50 50) xhl=2"
            for i in (1, 2)
        ),
        "new load.e bus1=e.3.1 phases=1 kv=.48 kw=9",
    ),
    "generator that is an impedance": (
        *BASE,
        "new generator.g bus1=b kv=4.16 kw=70 pf=.9 model=2",
        "set genmult=.8",
    ),
    "loads that are admittances": (*BASE, "set loadmodel=a"),
    "PV that is an impedance": (
        *BASE,
        "new pvsystem.p bus1=b kv=4.16 kva=90 pmpp=80 irradiance=.9 model=2",
    ),
    "battery that is an impedance": (
        *BASE,
        "new storage.x bus1=b.2 phases=1 kv=2.4 kwrated=60 kwhrated=200 state=discharging model=2",
    ),
    "generator with a reactance of its own": (
        *BASE,
        "new generator.g bus1=b kv=4.16 kw=90 model=5",
    ),
    "switch that is not in its normal state": (
        *BASE,
        SPUR,
        *AT_E,
        "new swtcontrol.s switchedobj=line.sp switchedterm=1 normal=closed state=open delay=0",
    ),
    "names with a space and a dot": (
        *BASE,
        'new "load.my load" bus1=b.3 phases=1 kv=2.4 kw=30',
        "new load.x.y bus1=b.3 phases=1 kv=2.4 kw=10",
    ),
    "capacitor from phase to phase": (
        *BASE,
        "new capacitor.f phases=1 bus1=b.1.2 kv=4.16 kvar=60 conn=delta",
    ),
    "no solution of its own yet": (
        *BASE[:3],
        SPUR,
        *LOADS,
        *AT_E,
        "solve",
        "edit line.sp length=2",
    ),
}


@pytest.mark.parametrize("name", ODD)
def test_voltages_are_those_of_opendss_on_the_untouched_file(name: str, tmp_path: Path) -> None:
    file = written(tmp_path, ODD[name])
    feeder = import_network(file)
    assert feeder.phased is not None and feeder.phased.difference_pu is not None
    assert feeder.phased.difference_pu < CLOSE_PU
    assert apart(feeder, file) < CLOSE_PU


THREE = "new load.c bus1=b kv=4.16 kw=300 pf=.9"


@pytest.mark.parametrize("more", ["%noloadloss=1 %imag=2 wdg=2 tap=1.05", "xscarray=[3]"])
def test_transformers_of_balanced_feeders_are_those_of_opendss(more: str, tmp_path: Path) -> None:
    file = written(tmp_path, (HEAD, f"{BANK} {more}", LINE, THREE))
    feeder = import_network(file)
    assert feeder.phased is None
    assert apart(feeder, file) < CLOSE_PU


OUT_OF_LIMITS: dict[str, tuple[tuple[str, ...], str]] = {
    "kv between lines at one phase": (
        (*BASE, "new load.e bus1=b.3 phases=1 kv=4.16 kw=30"),
        "draw 10.42 kW instead of 30 kW: load.e (0.580 pu)",
    ),
    "a tap of 1.3": (
        (HEAD, f"{BANK} wdg=2 tap=1.3", LINE, *LOADS),
        "draw 283.8 kW instead of 180 kW: load.a (1.297 pu), load.b (1.313 pu)",
    ),
}


@pytest.mark.daily
@pytest.mark.parametrize("name", OUT_OF_LIMITS)
def test_loads_outside_their_limits_of_voltage_are_all_that_differs(
    name: str, tmp_path: Path
) -> None:
    """OpenDSS makes impedances of them: told with what they draw, and equal without the limits."""
    lines, told = OUT_OF_LIMITS[name]
    phased = import_network(written(tmp_path, lines)).phased
    assert phased is not None and phased.difference_pu is not None
    assert phased.difference_pu > 4e-3
    assert len(phased.causes) == 1 and phased.causes[0].endswith(told)
    for cured in ("model=2", "vminpu=.05 vmaxpu=2"):
        file = written(tmp_path, (*lines, f"batchedit load..* {cured}"))
        feeder = import_network(file)
        assert feeder.phased is not None and not feeder.phased.causes
        assert apart(feeder, file) < CLOSE_PU


@pytest.mark.daily
def test_a_feeder_without_a_solution_of_its_own_is_refused(tmp_path: Path) -> None:
    """2 MW at one phase: OpenDSS makes an impedance of it below ``vminpu``."""
    file = written(tmp_path, (*BASE, "new load.e bus1=b.3 phases=1 kv=2.4 kw=2000"))
    feeder = import_network(file)
    assert feeder.phased is not None and feeder.phased.difference_pu is None
    with pytest.raises(InputError, match=r"has no solution .* load\.e .* --accept-deviation"):
        write_new_scenario(feeder, NewScenarioOptions(), tmp_path / "refused")
    assert not (tmp_path / "refused").exists()
    notes = write_new_scenario(
        feeder, NewScenarioOptions(accept_deviation=True), tmp_path / "accepted"
    )
    assert NO_SOLUTION in notes


EVEN: dict[str, tuple[str, ...]] = {
    "three windings": (
        f"{THREE_WINDINGS} wdg=2 tap=1.01 %imag=.7 %noloadloss=.2",
        "new line.m bus1=m bus2=e r1=.3 x1=.4 r0=.6 x0=1.2 length=1",
        "new load.a bus1=e kv=4.16 kw=300 pf=.95", AT_D,
    ),
    "PV beside another load": (
        THREE,
        "new line.n bus1=b bus2=e r1=.3 x1=.4 r0=.6 x0=1.2 length=4 units=km",
        "new load.e bus1=e kv=4.16 kw=500 pf=.95",
        "new pvsystem.p bus1=e kv=4.16 kva=1100 pmpp=1000 irradiance=1",
    ),
    "generation": (THREE, "new generator.g bus1=b kv=4.16 kw=200 pf=.9"),
    "PV and load in one place": (THREE, "new pvsystem.p bus1=b kv=4.16 kva=210 pmpp=200 irradiance=1"),
    "battery": (THREE, "new storage.x bus1=b kv=4.16 kwrated=60 kwhrated=200 state=charging"),
    "filter": (THREE, "new capacitor.f bus1=b kv=4.16 cuf=30 xl=3 r=.2"),
    "reactors": (THREE, "new reactor.r bus1=b kv=4.16 kvar=99", "new reactor.q bus1=b bus2=e r=.1 x=.9",
                 "new load.e bus1=e kv=4.16 kw=90"),
    "loadmult": (THREE, "set loadmult=.5"),
}  # fmt: skip


@pytest.mark.nightly
@pytest.mark.parametrize("name", EVEN)
def test_balanced_feeders_agree_in_all_states_and_in_their_losses(
    name: str, tmp_path: Path
) -> None:
    """By day and by night, with what the scenario has there; losses with the source's impedance."""
    file = written(
        tmp_path, (HEAD, LINE.replace("=m", "=s"), *EVEN[name]), TAIL.replace(" 4.16", "")
    )
    text = file.read_text().replace("4.16", "12.47")
    file.write_text(text)
    feeder = import_network(file)
    assert feeder.phased is None and feeder.deviation is not None
    assert apart(feeder, file) < CLOSE_PU
    assert feeder.deviation.losses_kw == pytest.approx(feeder.deviation.losses_source_kw, abs=1e-5)
    folder = tmp_path / "new"
    write_new_scenario(feeder, NewScenarioOptions(), folder)
    worst_hour_pu = read_scenario(folder).source.deviation.worst_hour_pu
    assert worst_hour_pu is not None and worst_hour_pu < CLOSE_PU
    assert "Causes" not in (folder / "notes.md").read_text()


def test_conductors_without_supply_are_named_and_their_customers_alone_are_gone(
    tmp_path: Path,
) -> None:
    file = written(
        tmp_path, (*ODD["one conductor open"], "new load.g bus1=e.2 phases=1 kv=2.4 kw=7")
    )
    feeder = import_network(file)
    assert "Without supply, and left out: load.g at bus e, 7 kW." in feeder.notes
    customers = [str(each) for each in new_scenario(feeder).customers.id]
    assert customers == ["ca", "cb", "ce", "cf"]


@pytest.mark.daily
def test_a_loop_of_buses_that_is_none_of_conductors_loses_no_load(tmp_path: Path) -> None:
    """Phases a and c go from b to e by two ways; a true loop beside them is opened and told."""
    way = "new line.{0} phases=1 bus1={1} bus2={2} r1=.3 x1=.4 r0=.3 x0=.4 c1=0 c0=0 length=1"
    ways = [way.format(*each.split()) for each in ("a b.1 x.1", "a2 x.1 e.1", "c b.3 e.3")]
    ways.append("new capacitor.d bus1=b kv=4.16 kvar=20 conn=delta")
    feeder = import_network(written(tmp_path, (*BASE, *ways, *AT_E)), open_loops=True)
    assert feeder.phased is not None and feeder.phased.difference_pu is not None
    assert feeder.phased.difference_pu < CLOSE_PU
    kept = [note for note in feeder.notes if note.startswith("In service by phase")]
    assert len(kept) == 1 and not any("Without supply" in note for note in feeder.notes)
    assert apart(feeder, tmp_path / "odd.dss") < CLOSE_PU
    ring = [way.format(*each.split()) for each in ("r b.2 y.2", "s y.2 z.2", "t z.2 m.2")]
    feeder = import_network(written(tmp_path, (*BASE, *ways, *ring, *AT_E)), open_loops=True)
    told = [
        note for note in feeder.notes if note.startswith("Against OpenDSS's solution with line.")
    ]
    assert len(told) == 1
    assert not any("Without supply" in note for note in feeder.notes)


def test_a_transformer_is_opened_beside_a_line_of_its_name(tmp_path: Path) -> None:
    """Bus m2 is fed from m, and by a transformer of high impedance, called as a line is."""
    ways = (
        f"{BANK.replace('transformer.t', 'transformer.l').replace(' m)', ' m2)')} xhl=60",
        "new line.x bus1=m bus2=m2 r1=.03 x1=.04 r0=.06 x0=.12 c1=0 c0=0 length=1",
        "new load.m2 bus1=m2 kv=4.16 kw=300",
    )
    file = written(tmp_path, (*BASE, *ways))
    feeder = import_network(file, open_loops=True)
    assert feeder.phased is not None
    assert len(feeder.phased.phases.transformers) == 1
    assert any("solution with transformer.l, the mean" in note for note in feeder.notes)
    file.write_text(file.read_text().replace("\nsolve", "\ndisable transformer.l\nsolve"))
    assert apart(feeder, file) < CLOSE_PU


def test_of_single_phases_the_least_current_is_that_of_the_source(tmp_path: Path) -> None:
    """Line yz carries opposite powers of two phases, which are next to none as balanced."""
    way = "new line.{0} bus1={1} bus2={2} r1={3} x1={3} r0={3} x0={3} c1=0 c0=0 length=1"
    ring = [way.format(*each.split()) for each in ("by b y .1", "yz y z .1", "bz b z .7")]
    rest = (
        "new line.w phases=1 bus1=b.1 bus2=w.1 r1=.3 x1=.4 r0=.3 x0=.4 c1=0 c0=0 length=1",
        "new load.y bus1=y.1 phases=1 kv=2.4 kw=350",
        "new load.z bus1=z.2 phases=1 kv=2.4 kw=45",
        "new load.w bus1=w.1 phases=1 kv=2.4 kw=5",
    )
    feeder = import_network(written(tmp_path, (*BASE, *ring, *rest)), open_loops=True)
    assert any(note.endswith("the least current: line 3 (bz).") for note in feeder.notes)


FLOATING = (
    "new circuit.t basekv=12.47 bus1=s mvasc3=2000 mvasc1=1800",
    "new transformer.u phases=1 xhl=6 wdg=1 bus=s.1 kv=7.2 kva=2000 wdg=2 bus=m.1.2 "
    "conn=delta kv=4.16 kva=2000",
    "new transformer.v phases=1 xhl=6 wdg=1 bus=s.2 kv=7.2 kva=2000 wdg=2 bus=m.2.3 "
    "conn=delta kv=4.16 kva=2000",
    LINE,
    "new load.b bus1=b conn=delta kv=4.16 kw=900 vminpu=.5",
)


def test_a_floating_bus_has_the_level_of_its_transformer(tmp_path: Path) -> None:
    """OpenDSS takes 12.47 kV for what nothing holds against ground."""
    file = written(tmp_path, FLOATING)
    feeder = import_network(file)
    theirs = of_opendss(file)
    assert feeder.phased is not None
    assert {row.bus: row.kv for row in feeder.phased.phases.buses}["b"] == pytest.approx(4.16)
    dss.Circuit.SetActiveBus("b")
    factor = dss.Bus.kVBase() / (4.16 / 3**0.5)
    own = own_voltages(feeder)
    assert factor > 2.0
    assert max(abs(own[f"b.{i}"] - theirs[f"b.{i}"] * factor) for i in (1, 2, 3)) < CLOSE_PU


def test_batteries_of_a_script_are_batteries_with_their_phases(tmp_path: Path) -> None:
    file = written(
        tmp_path,
        (
            *BASE,
            "new storage.bess bus1=b kv=4.16 kva=400 kwrated=350 kwhrated=1200 kwhstored=900 "
            "%reserve=10 %effcharge=92 %effdischarge=94 state=idling",
            "new storage.home bus1=b.2 phases=1 kv=2.4 kva=30 kwrated=25 kwhrated=60 %stored=50",
        ),
    )
    scenario = new_scenario(import_network(file))
    own = scenario.batteries
    assert own.id.tolist() == ["bbess", "bhome"]
    assert own.energy_kwh.tolist() == [1200.0, 60.0]
    assert own.p_max_kw.tolist() == [350.0, 25.0]
    assert own.s_max_kva.tolist() == [400.0, 30.0]
    assert own.soc_initial.tolist() == [0.75, 0.5]
    assert own.soc_min.tolist() == pytest.approx([0.1, 0.2])
    assert own.eta_charge.tolist() == pytest.approx([0.92, 0.9])
    assert own.eta_discharge.tolist() == pytest.approx([0.94, 0.9])
    assert own.grid_forming.tolist() == [True, False]
    assert scenario.phases
    assert [scenario.phases.connection(each).coils for each in own.id] == ["a b c", "b"]


def test_an_inverter_limits_what_its_panels_give(tmp_path: Path) -> None:
    line = "new pvsystem.p bus1=b kv=4.16 kva=500 irradiance=.8 pmpp=1000 %pmpp=60"
    pv = new_scenario(import_network(written(tmp_path, (*BASE, line)))).pv
    assert (pv.p_max_kw.tolist(), pv.s_max_kva.tolist()) == ([500.0], [500.0])


SERVICE = (
    *BASE,
    "new transformer.tr(b-h) phases=1 windings=3 xhl=2.04 xht=2.04 xlt=1.36 %noloadloss=.2 %imag=.5",
    "~ wdg=1 conn=wye bus=b.3 kv=2.4 kva=25 %r=.6",
    "~ wdg=2 conn=wye bus=h.1.0 kv=.12 kva=25 %r=1.2",
    "~ wdg=3 conn=wye bus=h.0.2 kv=.12 kva=25 %r=1.2",
    "new linecode.tplx nphases=2 units=km rmatrix=(.9|.05 .9) xmatrix=(.3|.08 .3) cmatrix=(9|0 9)",
    "new line.drop bus1=h.1.2 bus2=home.1.2 phases=2 linecode=tplx length=30 units=m",
    "new load.oven bus1=home.1.2 phases=2 kv=.208 kw=6 pf=.95",
    "new load.left bus1=home.1 phases=1 kv=.12 kw={left}",
    "new load.right bus1=home.2 phases=1 kv=.12 kw=3",
    "set voltagebases=[12.47 4.16 .208]",
    "calcvoltagebases",
    "solve",
)


@pytest.mark.parametrize(("left", "close_pu"), [("3", CLOSE_PU), ("1", 1e-4)])
def test_both_legs_of_a_service_transformer_are_one_node(
    left: str, close_pu: float, tmp_path: Path
) -> None:
    file = written(tmp_path, tuple(line.replace("{left}", left) for line in SERVICE), "")
    feeder = import_network(file)
    theirs, own = of_opendss(file), own_voltages(feeder)
    assert own["home.3"] == pytest.approx((theirs["home.1"] + theirs["home.2"]) / 2, abs=close_pu)
    assert own["b.3"] == pytest.approx(theirs["b.3"], abs=close_pu)
    assert feeder.phased is not None and feeder.phased.difference_pu is not None
    assert feeder.phased.difference_pu < close_pu
    assert any(note.startswith("1 transformers have the middle") for note in feeder.notes)
    assert {"coven", "cleft", "cright"} < {str(each) for each in new_scenario(feeder).customers.id}


def test_a_service_transformer_that_is_open(tmp_path: Path) -> None:
    """What is behind it has no voltage that says its level."""
    lines = tuple(line.replace("{left}", "3") for line in SERVICE)
    file = written(tmp_path, (*lines[:-3], "open transformer.tr(b-h) 1", *lines[-3:]), "")
    feeder = import_network(file)
    assert apart(feeder, file) < CLOSE_PU
    assert "Without supply or out of service, and left out: bus h, home." in feeder.notes


CAUSES = {
    "legs that are not alike": (
        tuple(line.replace("{left}", "0").replace("wdg=3", "wdg=3 %r=9") for line in SERVICE),
        "both legs behind a service transformer count as one, but differ at 2 buses",
    ),
    "PV below its limit": (
        (*BASE, "new pvsystem.p bus1=b kv=5 kva=90 pmpp=80 vminpu=.95", *TAIL.split("\n")),
        "generation and batteries outside their vminpu and vmaxpu in the source's solution",
    ),
}


@pytest.mark.parametrize("name", CAUSES)
def test_what_the_feeder_has_not_is_named_as_the_cause(name: str, tmp_path: Path) -> None:
    lines, cause = CAUSES[name]
    phased = import_network(written(tmp_path, lines, "")).phased
    assert phased is not None and phased.difference_pu is not None
    assert phased.difference_pu > CLOSE_PU
    assert [each for each in phased.causes if each.startswith(cause)]


UNSOLVED = {
    "controls": (
        "new capacitor.h bus1=b kv=4.16 kvar=100",
        "new capcontrol.h capacitor=h element=line.l terminal=1 type=pf on=.98 off=-.98",
        "OpenDSS's controls do not come to rest",
    ),
    "a model of one's own": (
        "new generator.x bus1=b kv=4.16 kw=60 model=6",
        "OpenDSS does not solve the circuit ((#567) Generator.x model designated to use user-",
    ),
}


@pytest.mark.parametrize("name", UNSOLVED)
def test_what_opendss_says_of_its_solution_is_told(name: str, tmp_path: Path) -> None:
    *lines, told = UNSOLVED[name]
    notes = import_network(written(tmp_path, (*BASE, *lines))).notes
    assert [note for note in notes if note.startswith(told)]


def test_shapes_in_files_are_series_of_the_source(tmp_path: Path) -> None:
    """Of a feeder with phases and of a balanced one; PV gives what its panels do at the shape."""
    (tmp_path / "Day.csv").write_text("\n".join(f"{hour / 100}" for hour in range(24)))
    shape = "new loadshape.s npts=24 interval=1 mult=(file=day.csv)"
    pv = "new pvsystem.p bus1=b kv=4.16 kva=90 pmpp=100 irradiance=.8 daily=s"
    for loads, name, kw in ((LOADS[1:], "ca", 100.0), ((), "cb", 40.0)):
        own = (
            "new load.a bus1=b.1 phases=1 kv=2.4 kw=100" if loads else "new load.a bus1=b kw=40",
        )
        lines = (HEAD, BANK, LINE, shape, f"{own[0]} daily=s", *loads, pv)
        feeder = import_network(written(tmp_path, lines))
        told = "Daily shapes of 2 loads and PV systems are followed with --profiles source --profile-step 60, "
        assert any(note.startswith(told) for note in feeder.notes)
        scenario = new_scenario(
            feeder, NewScenarioOptions(profiles="source", profile_step_minutes=60.0)
        )
        customers = [str(each) for each in scenario.customers.id]
        load_kw = scenario.load_kw[:, customers.index(name)]
        assert load_kw == pytest.approx([kw * hour / 100 for hour in range(24)])
        assert scenario.pv_kw[:, 0] == pytest.approx([80.0 * hour / 100 for hour in range(24)])


@pytest.mark.daily
def test_shapes_with_hours_have_their_step(tmp_path: Path) -> None:
    even = "new loadshape.s npts=3 interval=0 hour=(0 .5 1) mult=(.5 .6 .7)"
    for shape, told in ((even, True), (even.replace(".5 1)", ".5 3)"), False)):
        file = written(tmp_path, (HEAD, BANK, LINE, shape, f"{LOADS[0]} daily=s"))
        notes = import_network(file).notes
        assert any("--profile-step 30, " in note for note in notes) is told
        assert not any("--profile-step 0" in note for note in notes)


def test_levels_follow_the_lines(tmp_path: Path) -> None:
    """What is switched off where levels are found has no voltage that says which."""
    lines = ("open line.sp 1", TAIL, "close line.sp 1")
    feeder = import_network(written(tmp_path, (*BASE, SPUR, *AT_E, *lines), "solve"))
    assert feeder.phased is not None
    assert {row.bus: row.kv for row in feeder.phased.phases.buses}["e"] == pytest.approx(4.16)


def test_a_fuse_stays_as_the_solution_leaves_it(tmp_path: Path) -> None:
    """To set the mode of solution anew would put it back to its normal state."""
    fuse = "new fuse.f monitoredobj=line.sp monitoredterm=1 state=[open closed closed]"
    file = written(tmp_path, (*BASE, SPUR, *AT_E, TAIL, fuse), "solve")
    assert apart(import_network(file), file) < CLOSE_PU


@pytest.mark.parametrize("action", ["open", "close"])
def test_an_action_of_a_fuse_is_its_state(action: str, tmp_path: Path) -> None:
    """OpenDSS itself writes past the end of an array for it, and may end."""
    fuse = "new fuse.f monitoredobj=line.sp ratedcurrent=99 state=[open closed closed] {}"
    feeder, state = (
        import_network(written(tmp_path, (*BASE, SPUR, *AT_E, fuse.format(each))))
        for each in (f"action={action}", f"state=[{' '.join([action] * 3)}]")
    )
    assert own_voltages(feeder) == own_voltages(state)
    assert ("e.1" in own_voltages(state)) == (action == "close")


def test_an_end_of_opendss_is_told_with_its_place(tmp_path: Path) -> None:
    lines = (*BASE, "new line.x phases=1000000 bus1=b bus2=e")
    assert refusal(import_network, written(tmp_path, lines)).startswith(
        'odd.dss: OpenDSS itself ends by signal 11 at \'new "line.x" phases=1000000'
    )


@pytest.mark.daily
def test_a_battery_in_wye_where_nothing_is_grounded(tmp_path: Path) -> None:
    """OpenDSS finds no number for what it draws at rest: that of IEEE 9500."""
    lines = (
        *BASE,
        BANK.replace("transformer.t", "transformer.u").replace("(s m)", "(b e)")
        .replace("delta wye", "delta delta").replace("12.47 4.16", "4.16 .48"),
        "new storage.x bus1=e kv=.48 kva=50 kwrated=50 kwhrated=90 state=idling",
    )  # fmt: skip
    feeder = import_network(written(tmp_path, lines))
    assert any("'%idlingkw=0'" in note for note in feeder.notes)
    assert apart(feeder, written(tmp_path, (*lines, "storage.x.%idlingkw=0"))) < CLOSE_PU


def test_a_load_at_ground_is_named(tmp_path: Path) -> None:
    feeder = import_network(written(tmp_path, (*BASE, "new load.e bus1=b.0 phases=1 kv=2.4 kw=40")))
    assert "Without supply, and left out: load.e at bus b, 40 kW." in feeder.notes


@pytest.mark.daily
def test_a_balanced_feeder_without_a_solution_of_its_own_is_refused(tmp_path: Path) -> None:
    """OpenDSS makes an impedance of 20 MW below ``vminpu``: the source is solved, the feeder not."""
    file = written(tmp_path, (*BASE[:3], "new load.e bus1=b kv=4.16 kw=20000"))
    feeder = import_network(file)
    assert feeder.phased is None and feeder.deviation is None
    with pytest.raises(InputError, match=r"has no solution of its own .* --accept-deviation"):
        write_new_scenario(feeder, NewScenarioOptions(), tmp_path / "refused")
    notes = write_new_scenario(
        feeder, NewScenarioOptions(accept_deviation=True), tmp_path / "accepted"
    )
    assert NO_SOLUTION in notes and NOT_CONVERGED not in notes


def test_steps_are_solved_where_neutrals_float_and_where_nothing_is_left(tmp_path: Path) -> None:
    """An asset at a bus with a neutral of its own is between the phases."""
    four = (
        "new transformer.u phases=3 windings=2 buses=[b e.1.2.3.4] conns=[delta wye] kvs=[4.16 .48] "
        "kvas=[75 75] xhl=4",
        "new load.e bus1=e.1.4 phases=1 kv=.277 kw=8",
        "new load.g bus1=gone.1 phases=1 kv=.277 kw=8",
    )
    job = {
        "off": ("load",),
        "open_deltas": True,
        "assets": [{"bus": "e"}],
        "steps": [{"p_kw": [5.0], "q_kvar": [1.0], "held_v": None}],
        "island_bus": None,
        "open": [],
    }
    found = solved_steps(job, written(tmp_path, (*BASE, *four)))
    v = dict(zip(found["nodes"], found["v"][0], strict=True))
    assert abs(v["e.1"] - v["e.2"]) == pytest.approx(480.0, rel=0.05)
    assert np.isnan(v["gone.1"])


REFUSED = {
    "two of one name": (
        (*BASE, "set allowduplicates=yes", "new load.a bus1=b.2 phases=1 kv=2.4 kw=70"),
        "load.a stands 2 times. Give each a name of its own",
    ),
    "an autotransformer, which is no element to disable": (
        (HEAD, "new autotrans.t phases=3 windings=2 buses=(s m) kvs=(12.47 4.16) kvas=(1000 1000)",
         LINE, *LOADS),
        "autotrans.t is not supported. Replace it by lines, reactors, or transformers",
    ),
    "growth of its own": (
        (*BASE, "new growthshape.g npts=2 year=(1 10) mult=(1.1 1.05)",
         "new load.f bus1=b.3 phases=1 kv=2.4 kw=30 growth=g", "set year=3"),
        "load.f grows by growthshape.g to year 3",
    ),
    "phases that turn the other way": (
        (HEAD + " sequence=neg", *BASE[1:]),
        "vsource.source has sequence=Negative: its phases turn the other way",
    ),
    "source between two buses": (
        (HEAD + " bus2=z", "new reactor.z phases=3 bus1=z r=.5 x=0", *BASE[1:]),
        "vsource.source stands between bus s and bus z",
    ),
    "source of two phases": (
        (HEAD.replace("bus1=s", "bus1=s.1.2 phases=2"), *BASE[1:]),
        "vsource.source has 2 of three phases",
    ),
    "legs that are not alike": (
        tuple(line.replace("{left}", "1").replace("wdg=3", "wdg=3 tap=1.05") for line in SERVICE),
        "transformer.tr(b-h) has 3 windings at b and h",
    ),
    "a phase beside two legs": (
        (*(line.replace("{left}", "1") for line in SERVICE[:-3]),
         "new transformer.v phases=1 windings=2 buses=(b.2 h.2.3) conns=(wye delta) kvs=(2.4 .24)",
         *SERVICE[-3:]),
        "transformer.v is at node 3 of bus h, behind a transformer whose middle is at ground",
    ),
    "line of no length": (
        (*BASE, "new line.g bus1=b bus2=e r1=.3 x1=.5 length=0", *AT_E),
        "OpenDSS refuses the file ((#183) Y matrix build aborted",
    ),
    "phases that one node joins": (
        (*BASE, "new line.g bus1=b bus2=e.1.1.1 length=1", AT_E[0]),
        "line.g joins conductors at one node",
    ),
    "load with an open conductor": (
        (*BASE, "new load.e bus1=b kv=4.16 kw=90", "open load.e 1 2"),
        "load.e has an open conductor",
    ),
    "transformer with an open conductor": (
        (*BASE, "new transformer.u buses=(b e) kvs=(4.16 .48) kvas=(75 75)",
         "new load.e bus1=e.1 phases=1 kv=.277 kw=8", "open transformer.u 1 2"),
        "transformer.u has an open conductor",
    ),
    "neutral that stays": (
        (*BASE, FOUR, "new line.q b.1.2.3.0 e.1.2.3.4 c4 .3 4 units=km",
         "new load.e bus1=e.1.4 phases=1 kv=2.4 kw=30"),
        "bus e has node 4: conductors beside the phases are not held. Ground the neutral (node 0)",
    ),
    "no reactance": (
        (HEAD, BANK.replace("xhl=5", "xhl=0"), LINE, *LOADS),
        "transformer.t has no reactance: OpenDSS takes xhl=0 as 700 %",
    ),
    "a phase at ground": (
        (*BASE, "new transformer.u phases=3 windings=2 buses=[b.2.3 e] conns=[delta wye] "
         "kvs=[4.16 .48] kvas=[75 75]", "new load.e bus1=e kv=.48 kw=3"),
        "transformer.u does not follow from its coils",
    ),
    "phases that cross": (
        (*BASE, "new line.x bus1=b.1.2.3 bus2=e.2.3.1", "new load.e bus1=e.1 phases=1 kv=2.4 kw=3"),
        "line.x connects a phase with another one",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_has_no_counterpart_is_refused_by_name(name: str, tmp_path: Path) -> None:
    lines, message = REFUSED[name]
    assert re.match(
        rf"odd\.dss(, row \d+)?: {re.escape(message)}",
        refusal(import_network, written(tmp_path, lines)),
    )


@pytest.mark.daily
def test_hours_of_most_and_least_demand_are_compared_by_phase(tmp_path: Path) -> None:
    """OpenDSS has its own loads there: one of constant impedance where its voltage is low."""
    found = []
    for i, more in enumerate(("", " vminpu=1.2")):
        feeder = import_network(written(tmp_path, (*BASE[:3], LOADS[0] + more, LOADS[1])))
        assert feeder.phased is not None
        options = NewScenarioOptions(add_batteries=True, pv="sized", accept_deviation=True)
        write_new_scenario(feeder, options, tmp_path / str(i))
        source = read_scenario(tmp_path / str(i)).source
        assert source.deviation is not None
        assert source.deviation.worst_hour_pu is not None
        found.append(source.deviation.worst_hour_pu)
    assert found[0] < CLOSE_PU
    assert found[1] > 1e-4


GROWN = {
    "a year": (*BASE, "set year=4"),
    "a growth of its own": (*BASE, "set %growth=6", "set year=3",
        "new load.f bus1=b.3 phases=1 kv=2.4 kw=30 status=fixed"),
    "a load that no factor changes": (*BASE, "set loadmult=.5",
        "new load.e bus1=b.3 phases=1 kv=2.4 kw=30 status=exempt"),
    "an allocation": (*BASE, "new load.e bus1=b.3 phases=1 kv=2.4 xfkva=75 pf=.9",
        "set allocationfactors=.7"),
}  # fmt: skip


@pytest.mark.parametrize("name", GROWN)
def test_options_that_change_what_loads_draw_act(name: str, tmp_path: Path) -> None:
    file = written(tmp_path, GROWN[name])
    feeder = import_network(file)
    assert apart(feeder, file) < CLOSE_PU
    assert not any("'set'" in note for note in feeder.notes)
