"""Published OpenDSS feeders, imported as they are and compared with OpenDSS on the untouched files.

``python -m experiments.studies.published_feeders FOLDER --page docs/networks.md`` wants the
repositories of :data:`REPOSITORIES` in FOLDER, each by its own name; ``--where`` prints where each
feeder is from, and ``--fetch`` clones what is not there. Each feeder is copied, and OpenDSS carries
out the copy whole, in a process of its own.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import typer

from benchmarks.frame.seeds import STUDIES
from benchmarks.frame.terminal import plain_errors
from benchmarks.frame.tried import Kept, Only, Page, tried, write_table
from experiments.studies.networks import ACCEPT, CURES, in_pu
from experiments.studies.opendss_itself import Itself
from vppres.core.errors import InputError, VppresError
from vppres.feeders import ImportedFeeder, import_network
from vppres.feeders.dss.phases import flow_of_source
from vppres.feeders.new.options import NewScenarioOptions
from vppres.feeders.new.scenario import write_new_scenario
from vppres.physics.powerflow import ACPowerFlow

REPOSITORIES = {"electricdss-tst": "https://github.com/dss-extensions/electricdss-tst"}
"""Folders, and the repositories whose clones they are."""

WHERE = "electricdss-tst/Version8/Distrib"
LIMIT_S = 900.0
"""For OpenDSS to build and solve the largest, on a machine that does other things too."""

PHASES = (1, 2, 3)
BEGIN, END = "<!-- published: begin -->", "<!-- published: end -->"
HEAD = (
    *("feeder", "buses", "loads kept", "kW kept", "needs"),
    *("difference, pu", "losses, kW", "CPU s"),
)


class Published(NamedTuple):
    """A feeder by its name and master file."""

    label: str
    master: str


FEEDERS = (
    Published("IEEE 13", "IEEETestCases/13Bus/IEEE13Nodeckt.dss"),
    Published("IEEE 34 Mod1", "IEEETestCases/34Bus/ieee34Mod1.dss"),
    Published("IEEE 34 Mod2", "IEEETestCases/34Bus/ieee34Mod2.dss"),
    Published("IEEE 37", "IEEETestCases/37Bus/ieee37.dss"),
    Published("IEEE 123", "IEEETestCases/123Bus/IEEE123Master.dss"),
    Published("4-bus DY-Bal", "IEEETestCases/4Bus-DY-Bal/4Bus-DY-Bal.DSS"),
    Published("4-bus GrdYD-Bal", "IEEETestCases/4Bus-GrdYD-Bal/4Bus-GrdYD-Bal.DSS"),
    Published("4-bus OYOD-Bal", "IEEETestCases/4Bus-OYOD-Bal/4Bus-OYOD-Bal.DSS"),
    Published("4-bus OYOD-UnBal", "IEEETestCases/4Bus-OYOD-UnBal/4bus-OYOD-UnBal.dss"),
    Published("4-bus YD-Bal", "IEEETestCases/4Bus-YD-Bal/4Bus-YD-Bal.DSS"),
    Published("4-bus YY-Bal", "IEEETestCases/4Bus-YY-Bal/4Bus-YY-Bal.DSS"),
    Published("4-bus YYD", "IEEETestCases/4Bus-YYD/YYD-Master-step1.DSS"),
    Published("4-wire delta, lagging", "IEEETestCases/4wire-Delta/Kersting4wire_Lagging.dss"),
    Published("4-wire delta, leading", "IEEETestCases/4wire-Delta/Kersting4wire_Leading.dss"),
    Published("IEEE European LV", "IEEETestCases/LVTestCase/Master.dss"),
    Published("IEEE 342, low voltage", "IEEETestCases/LVTestCaseNorthAmerican/Master.dss"),
    Published("IEEE NEV", "IEEETestCases/NEVTestCase/NEVMASTER.DSS"),
    Published("Secondary circuit", "IEEETestCases/SecondaryTestCircuit_modified/Master.DSS"),
    Published("IEEE 8500", "IEEETestCases/8500-Node/Master.dss"),
    Published("IEEE 8500 unbalanced", "IEEETestCases/8500-Node/Master-unbal.dss"),
    Published("IEEE 9500", "IEEETestCases/ieee9500dss/ieee9500_base.dss"),
    Published("EPRI ckt5", "EPRITestCircuits/ckt5/Master_ckt5.dss"),
    Published("EPRI ckt7", "EPRITestCircuits/ckt7/Master_ckt7.dss"),
    Published("EPRI ckt24", "EPRITestCircuits/ckt24/master_ckt24.dss"),
    Published("EPRI J1", "EPRITestCircuits/epri_dpv/J1/Master_withPV.dss"),
    Published("EPRI K1", "EPRITestCircuits/epri_dpv/K1/Master_NoPV.dss"),
    Published("EPRI M1", "EPRITestCircuits/epri_dpv/M1/Master_NoPV.dss"),
)
"""Five that are old friends, and 22 of other kinds."""


@dataclass(frozen=True)
class Outcome:
    """How a feeder came in."""

    label: str  #: the feeder
    words: str  #: the options that it needed, or why it was refused
    buses: int | None = None  #: buses with supply
    #: Largest difference of a node's voltage from OpenDSS's on the untouched file.
    apart_pu: float | None = None
    losses_kw: float | None = None
    losses_source_kw: float | None = None
    loads: int | None = None
    loads_source: int | None = None
    load_kw: float | None = None
    load_source_kw: float | None = None
    seconds: float = 0.0  #: of processors, to import it


def itself(master: Path) -> Itself:
    """OpenDSS on a copy of the file and of what lies beside it and one level above."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "a" / master.parent.name
        shutil.copytree(master.parent, folder)
        for beside in master.parent.parent.glob("*.[dD][sS][sS]"):
            shutil.copy(beside, folder.parent)
        command = [
            sys.executable,
            "-m",
            "experiments.studies.opendss_itself",
            str(folder / master.name),
        ]
        done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S, check=False)
    if done.returncode != 0:
        return Itself(error=f"OpenDSS ends with status {done.returncode}")
    return Itself(**json.loads(done.stdout.splitlines()[-1]))


def processor_s() -> float:
    """Processor time of this process and of those that it has waited for."""
    return sum(os.times()[:4])


def imported(master: Path) -> tuple[ImportedFeeder | None, str, float]:
    """The feeder with the options that refusals name, those or the refusal, and CPU seconds.

    Options are those of a new folder, the seconds those of the import alone.
    """
    chosen: dict[str, Any] = {}
    words: list[str] = []
    while True:
        start = processor_s()
        try:
            feeder = import_network(master, **chosen)
            seconds = processor_s() - start
            words += accepted(feeder)
            return feeder, ", ".join(words), seconds
        except VppresError as error:
            text = str(error).splitlines()[0]
            cure = next((c for c in CURES if c[0] in text and not c[1].keys() & {*chosen}), None)
            if cure is None or cure[0] == "--balance":
                refusal = text.partition(": ")[2].rstrip(".")
                return None, f"refused: {refusal}", processor_s() - start
            chosen |= cure[1]
            words.append(cure[2])


def accepted(feeder: ImportedFeeder) -> list[str]:
    """The option that accepts the feeder's voltages, if a new folder wants it."""
    with tempfile.TemporaryDirectory() as place:
        try:
            write_new_scenario(feeder, NewScenarioOptions(), Path(place) / "scenario")
        except InputError as error:
            if ACCEPT.strip("`") not in str(error):
                raise
            return [ACCEPT]
    return []


def apart_pu(feeder: ImportedFeeder, theirs: Itself) -> float:
    """Largest difference of a voltage, of every node that both have; of a balanced one by bus."""
    if feeder.phased is None:
        v_pu = ACPowerFlow(feeder.network).solve(*feeder.injection).v_pu
        at = feeder.network.bus_index
        own = {str(bus).lower(): float(v_pu[at[bus]]) for bus in feeder.network.buses}
        means: dict[str, list[float]] = {}
        for name, v in theirs.v_pu.items():
            bus, _, node = name.partition(".")
            if node in map(str, PHASES) and bus in own:
                means.setdefault(bus, []).append(v)
        return max(abs(own[bus] - float(np.mean(v))) for bus, v in means.items())
    flow, p_kw, q_kvar = flow_of_source(feeder.phased)
    rows = flow.phases.by_bus
    apart = []
    for (bus, phase), v in zip(flow.phases.nodes, flow.solve(p_kw, q_kvar).v, strict=True):
        legs = len(rows[bus].phases.split()) == 1 and f"{bus}:12" in theirs.v_pu
        name = f"{bus}:12" if legs else f"{bus}.{phase + 1}"
        if name in theirs.v_pu:
            base_v = rows[bus].kv * 1000.0 / 3**0.5
            # From leg to leg both are shares of their own level, which is twice that of a leg.
            their_v = theirs.v_pu[name] * (base_v if legs else theirs.base_v[bus])
            apart.append(abs(abs(v) - their_v) / base_v)
    return float(max(apart))


def losses_kw(feeder: ImportedFeeder) -> float:
    """Losses of the feeder with the powers of its source."""
    if feeder.phased is None:
        return float(ACPowerFlow(feeder.network).solve(*feeder.injection).losses_kw)
    flow, p_kw, q_kvar = flow_of_source(feeder.phased)
    return float(flow.solve(p_kw, q_kvar).losses_kw)


def attempt(published: Published, folder: Path) -> Outcome:
    """Import a feeder, and compare it."""
    master = folder / WHERE / published.master
    if not master.is_file():
        return Outcome(published.label, "is not in the folder")
    feeder, words, seconds = imported(master)
    if feeder is None:
        return Outcome(published.label, words, seconds=seconds)
    theirs = itself(master)
    if feeder.phased is None:
        loads, load_kw = len(feeder.loads.id), float(feeder.loads.p_kw.sum())
    else:
        own = [load.p_kw for load in feeder.phased.loads if load.kind == "load"]
        loads, load_kw = len(own), sum(own)
    known = Outcome(
        published.label,
        words,
        feeder.network.n_buses if feeder.phased is None else len(feeder.phased.phases.buses) - 1,
        losses_kw=losses_kw(feeder),
        loads=loads,
        load_kw=load_kw,
        seconds=seconds,
    )
    if theirs.error:
        told = "; ".join([*filter(None, [words]), f"not compared: {theirs.error}"])
        return Outcome(**{**asdict(known), "words": told})
    compared = {
        "apart_pu": apart_pu(feeder, theirs),
        "losses_source_kw": theirs.losses_kw,
        "loads_source": theirs.loads,
        "load_source_kw": theirs.load_kw,
    }
    return Outcome(**{**asdict(known), **compared})


def row_of(outcome: Outcome) -> tuple[str, ...]:
    """An outcome as cells of the table."""
    pairs = (
        (outcome.loads, outcome.loads_source, "{:,}"),
        (outcome.load_kw, outcome.load_source_kw, "{:,.1f}"),
        (outcome.losses_kw, outcome.losses_source_kw, "{:,.2f}"),
    )
    loads, kw, losses = (
        "" if own is None else f"{form.format(own)} of {form.format(all_)}" if all_ is not None
        else form.format(own) for own, all_, form in pairs
    )  # fmt: skip
    return (
        outcome.label,
        "" if outcome.buses is None else f"{outcome.buses:,}",
        loads,
        kw,
        outcome.words.replace("|", "/"),
        "" if outcome.apart_pu is None else in_pu(outcome.apart_pu),
        losses.replace(" of ", ", "),
        f"{outcome.seconds:.0f}",
    )


def fetch(folder: Path) -> None:
    """Clone the repositories that are not there."""
    for name, address in REPOSITORIES.items():
        if (folder / name).exists():
            continue
        command = ["git", "clone", "--depth", "1", address, str(folder / name)]
        try:
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            why = "" if done.returncode == 0 else (done.stderr.strip().splitlines() or ["?"])[-1]
        except OSError as error:
            why = str(error)
        if why:
            raise InputError.of(
                str(folder / name),
                f"is not cloned from {address} ({why})",
                f"Clone it there where the network allows it, and name the folder that has it: "
                f"its feeders are in {WHERE}.",
            )


def main(
    folder: Annotated[Path, typer.Argument(help="Folder with the clones of the repositories.")],
    page: Page = None,
    results: Kept = STUDIES,
    only: Only = "",
    where: Annotated[bool, typer.Option("--where", help="Print where each is from.")] = False,
    clone: Annotated[bool, typer.Option("--fetch", help="Clone what is not there.")] = False,
) -> None:
    """Import all feeders, compare them, and write the table."""
    if where:
        for each in FEEDERS:
            typer.echo(f"{each.label}: {WHERE}/{each.master}")
        for name, address in REPOSITORIES.items():
            typer.echo(f"{name} is a clone of {address}")
        return
    if clone:
        with plain_errors("What was cloned before"):
            fetch(folder)
    kept = results / "published_feeders"
    outcomes = tried(FEEDERS, lambda each: attempt(each, folder), Outcome, row_of, kept, only)
    rows = map(row_of, outcomes)
    write_table(HEAD, rows, outcomes, kept, "Published OpenDSS feeders", page, (BEGIN, END))


if __name__ == "__main__":
    typer.run(main)
