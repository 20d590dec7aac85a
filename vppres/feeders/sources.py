"""Networks by name or file: pandapower, MATPOWER, SimBench and OpenDSS."""

from __future__ import annotations

import importlib.util
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass, fields, replace
from functools import cache, partial
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from vppres.core.errors import InputError, VppresError, first_line
from vppres.feeders.closeness import given_deviation
from vppres.feeders.dss.circuit import OpenDSSFlow
from vppres.feeders.feeder import ImportedFeeder, Profile, Storages
from vppres.feeders.net.balance import PhasePowers, balance_net, balanced, phase_powers
from vppres.feeders.net.changes import PermittedChanges, changed
from vppres.feeders.net.names import bus_names, name_in
from vppres.feeders.net.numbers import impossible_numbers, missing_numbers, unknown_buses
from vppres.feeders.net.reduce import feeder_of
from vppres.feeders.series.source import control_profiles, controls_in_json, profiles_of
from vppres.io.messages import did_you_mean, folded
from vppres.scenario.network import BusId

Source = Literal["pandapower", "matpower", "opendss", "simbench"]
SUFFIXES: dict[str, Source] = {
    ".json": "pandapower",
    ".m": "matpower",
    ".mat": "matpower",
    ".dss": "opendss",
}
_PICKLE = "may be a pickle, which runs what its author wrote when it is opened"
NEVER = {
    **dict.fromkeys((".p", ".pkl", ".pickle", ".npy", ".npz", ".joblib"), _PICKLE),
    **dict.fromkeys((".xlsx", ".xls", ".xlsm", ".ods"), "is a workbook"),
    **dict.fromkeys((".py", ".pyc", ".ipynb"), "is a program"),
}
"""Files that hold nets for other tools and are not opened here."""


@dataclass(frozen=True)
class _Net:
    """A pandapower net, the identifiers of its buses, and what its reader simplified.

    ``phases`` says where the source is not balanced; None if it is, or the net holds it itself.
    """

    net: Any
    bus_ids: Mapping[int, BusId] | None = None
    notes: tuple[str, ...] = ()
    phases: PhasePowers | None = None
    flow: OpenDSSFlow | None = None
    profiles: tuple[Profile, ...] = ()


def import_network(
    name_or_file: str | Path | Any,
    source: Source | None = None,
    open_branches: Sequence[str] = (),
    *,
    open_loops: bool = False,
    slack: str | None = None,
    balance: bool = False,
    names: bool = False,
) -> ImportedFeeder:
    """Import a network.

    An OpenDSS feeder or a pandapower net that is not balanced keeps its phases, unless ``balance``
    spreads them.

    Parameters
    ----------
    name_or_file : str, Path or pandapowerNet
        A name of ``NAMED``, a file (``.json`` of pandapower, ``.m`` or ``.mat`` of MATPOWER,
        ``.dss`` of OpenDSS), a SimBench code with ``source="simbench"``, or a pandapower net.
    source : str, optional
        Where the network comes from; by the file's suffix if not given.
    open_branches : sequence of str
        Branches to take out of service, as ``line 7`` or by their name.
    open_loops : bool, optional
        Of a meshed network, open the branches with the least current until it is radial.
    slack : str, optional
        The grid connection, where there are several external grids: one by table and index, by its
        name or its bus, or ``all`` for those that hold the same voltage together.
    balance : bool, optional
        Spread loads of single phases over three.
    names : bool, optional
        Call buses, generators and batteries as the source does, and make each of its loads a
        customer with its name; otherwise names follow the buses' numbers, with a customer a bus.

    Returns
    -------
    ImportedFeeder

    Raises
    ------
    InputError
        If there is no such network, its library is missing, or it cannot be a radial feeder.
    """
    changes = PermittedChanges(tuple(open_branches), open_loops, slack, balance, names)
    if not isinstance(name_or_file, (str, Path)):
        with _quiet():
            return _feeder(_Net(_of_today(name_or_file)), "pandapower net", changes)
    text = str(name_or_file)
    with _quiet():
        if source is None and text in NAMED:
            return _feeder(_named(text), text, changes)
        found = _read(text, source, not balance)
        with _to_blame(Path(text), "a network"):
            return _feeder(found, Path(text).name, changes)


def _of_today(net: Any) -> Any:
    """A net of an older pandapower with the columns of today's, as its files are read."""
    from pandapower import __format_version__
    from pandapower.convert_format import convert_format

    if str(net.format_version) == __format_version__:
        return net
    return convert_format(deepcopy(net), donot_open_newer=False)


@contextmanager
def _to_blame(path: Path, what: str) -> Iterator[None]:
    """Whatever the reader stumbles over, the file is the cause."""
    try:
        yield
    except VppresError:
        raise
    except Exception as error:
        raise _unreadable(path, what, first_line(error)) from error


def _feeder(found: _Net, name: str, changes: PermittedChanges) -> ImportedFeeder:
    """The feeder of a net, after the changes that were asked for."""
    checks = (unknown_buses, missing_numbers, impossible_numbers)
    problems = folded([problem for check in checks for problem in check(found.net, name)])
    if problems:
        raise InputError(problems)
    notes = found.notes
    phases = found.phases or phase_powers(found.net)
    keeps_phases = phases is not None and not changes.balance
    if phases is not None and not keeps_phases:
        notes += (balanced(phases),)
    ids = found.bus_ids
    if ids is None and changes.names:
        ids = bus_names(found.net)
    net, (made, opened_pu) = changed(found.net, name, changes, ids)
    if keeps_phases and found.flow is None:
        feeder = _with_phases_of_net(found, net, name, ids, notes + made)
        return replace(feeder, opened_pu=opened_pu)
    feeder = replace(feeder_of(net, name, bus_ids=ids), named=changes.names, opened_pu=opened_pu)
    if keeps_phases:
        # Its customers are the loads by name in any case; other notes are of the balanced tree.
        told = notes + made + feeder.left_out
        return _with_phases(found, net, replace(feeder, notes=told, named=False))
    if phases is not None:
        feeder = replace(feeder, unbalanced=phases.what)
    if found.flow is not None:
        flow = found.flow.of(net, feeder)
        feeder = replace(feeder, source_flow=flow, causes=flow.told(feeder) + feeder.causes)
        v_pu = flow.as_given()
        given = given_deviation(feeder, v_pu, flow.tables()["losses_kw"])
        feeder = replace(feeder, deviation=given, source_solves=v_pu is not None)
    profiles = found.profiles or profiles_of(net)
    known = {*feeder.loads.id, *feeder.generators.id, *feeder.storages.id}
    feeder = replace(feeder, profiles=tuple(p for p in profiles if p.name in known))
    return replace(feeder, notes=notes + made + feeder.notes)


def _with_phases(found: _Net, net: Any, feeder: ImportedFeeder) -> ImportedFeeder:
    """The tree of a feeder with the phases of its source."""
    from vppres.feeders.dss.phases import phased_source
    from vppres.feeders.new.connections import customer_of

    assert found.flow is not None
    flow = found.flow.of(net, feeder)
    feeder = replace(feeder, source_flow=flow, causes=(), deviation=None)
    phased = phased_source(flow, feeder)
    opened_pu = flow.opened_pu()
    names = {(load.kind, load.connection.id) for load in phased.loads}
    storages = feeder.storages
    supplied = np.array([("storage", name_in(str(each))) in names for each in storages.id], bool)
    storages = Storages(**{f.name: getattr(storages, f.name)[supplied] for f in fields(storages)})
    feeder = replace(feeder, phased=phased, storages=storages, causes=phased.causes)
    profiles = tuple(
        replace(each, name=customer_of(name_in(each.name)))
        if each.name in feeder.loads.id
        else each
        for each in found.profiles
    )
    notes = (*feeder.notes, *flow.told_opening(opened_pu), *phased.notes)
    return replace(feeder, profiles=profiles, notes=notes, opened_pu=opened_pu)


def _with_phases_of_net(
    found: _Net, net: Any, name: str, ids: Mapping[int, BusId] | None, notes: tuple[str, ...]
) -> ImportedFeeder:
    """The tree of a pandapower net with the phases of its loads."""
    from vppres.feeders.net.by_phase import phased_net

    tree = deepcopy(net)
    for _ in balance_net(tree):
        pass  # the phases are kept beside it
    feeder = replace(feeder_of(tree, name, bus_ids=ids), causes=(), deviation=None)
    feeder = replace(feeder, source_flow=None)
    phased = phased_net(net, name, feeder)
    if found.profiles or profiles_of(net):
        notes += ("Series of the source are left out: they name no phases.",)
    return replace(feeder, phased=phased, notes=(*notes, *feeder.notes, *phased.notes))


@contextmanager
def _quiet() -> Iterator[None]:
    """Without the warnings of the libraries: what they simplify, the reduction states itself."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def _read(text: str, source: Source | None, by_phase: bool) -> _Net:
    """The net of a file or code; of OpenDSS with its phases, or as a balanced equivalent."""
    if source not in (None, *get_args(Source)):
        raise InputError.of(
            "options",
            f"must be one of {', '.join(get_args(Source))}",
            "Correct the source.",
            field="from",
            value=source,
        )
    never = NEVER.get(Path(text).suffix.lower())
    if never and source != "simbench":
        raise InputError.of(
            f"network {Path(text).name}",
            never,
            "Write the net with pandapower.to_json, and import that file.",
        )
    kind = source or SUFFIXES.get(Path(text).suffix.lower())
    if kind is None:
        raise InputError.of(
            f"network {text}",
            "is neither a named network nor a file that can be imported",
            did_you_mean(
                text,
                sorted(NAMED),
                f"Give a file ending in {', '.join(SUFFIXES)}, or a "
                "SimBench code with --from simbench.",
            ),
        )
    if kind == "simbench":
        return _simbench(text)
    path = Path(text)
    if not path.is_file():
        raise InputError.of(f"network {text}", "there is no such file", "Correct the path.")
    if kind == "opendss":
        # OpenDSS is loaded in a process of its own, never in this one.
        _needs("opendssdirect", "opendss")
        from vppres.feeders.dss.circuit import read_opendss

        return _Net(*read_opendss(path, by_phase=by_phase))
    return _pandapower(path) if kind == "pandapower" else _matpower(path)


def _needs(module: str, extra: str) -> None:
    """Refuse an import whose library is not installed."""
    if importlib.util.find_spec(module) is None:
        raise InputError.of(
            "network",
            f"needs the library {module}, which is not installed",
            f"Install it with: pip install 'vppres[{extra}]'",
        )


def _pandapower(path: Path) -> _Net:
    from vppres.feeders.net.json_file import read_pandapower

    with _to_blame(path, "pandapower JSON"):
        net, notes, constants = read_pandapower(path)
        profiles = control_profiles(net, controls_in_json(constants))
    return _Net(net, notes=notes, profiles=profiles)


def _matpower(path: Path) -> _Net:
    from vppres.feeders.matpower.case import read_m, read_mat

    what = "a MATPOWER case of version 2"
    readers = {".m": read_m, ".mat": read_mat}
    read = readers.get(path.suffix.lower())
    if read is None:
        raise _unreadable(path, what, "its name ends in neither .m nor .mat")
    with _to_blame(path, what):
        net, notes = read(path)
    return _Net(net, notes=notes)


def _simbench(code: str) -> _Net:
    _needs("simbench", "simbench")
    simbench: Any = importlib.import_module("simbench")
    codes = simbench.collect_all_simbench_codes()
    if code not in codes:
        raise InputError.of(
            f"network {code}",
            "is not a SimBench code",
            did_you_mean(code, sorted(codes), "Correct the code."),
        )
    return _Net(simbench.get_simbench_net(code))


def _unreadable(path: Path, what: str, reason: object) -> InputError:
    return InputError.of(
        path.name,
        f"cannot be read as {what} ({reason})",
        "Correct the file, or choose another format with --from.",
    )


@cache
def _made(name: str) -> _Net:
    """A network by name; published feeders are numbered from 1, as their authors do."""
    import pandapower.networks as networks

    from vppres.feeders import published

    make, first = {
        "case16": (published.case16, 0),
        "case33bw": (networks.case33bw, 1),
        "case69": (published.case69, 0),
        "cigre-mv": (networks.create_cigre_network_mv, None),
        "cigre-mv-der": (partial(networks.create_cigre_network_mv, with_der="pv_wind"), None),
    }[name]
    net = make()
    return _Net(net, None if first is None else {int(i): int(i) + first for i in net.bus.index})


def _named(name: str) -> _Net:
    """A network by name: a copy takes a twentieth of the time that its first reading takes."""
    return deepcopy(_made(name))


NAMED = ("case16", "case33bw", "case69", "cigre-mv", "cigre-mv-der")
"""Networks that can be imported by name."""
