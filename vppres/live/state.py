"""The state of a live controller as a plain value: to be saved, shown, and gone on from.

It holds what decides on the steps to come: what is known of them, the operating point, switching
duties, cold load, the plan, and what the guard has seen. Compiled problems are not in it; they are
made anew and give the same answers to the last bit.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from vppres.contract.decision import Decider
from vppres.control.configurations import InConfiguration
from vppres.control.guard.balance import StepBefore
from vppres.control.remembered import memory_of, put_back
from vppres.core.arrays import Floats
from vppres.core.errors import InputError
from vppres.core.plain import Given, from_plain, to_plain
from vppres.day.options import RunOptions
from vppres.kinds.customer.data import SwitchingRules
from vppres.kinds.table import SERIES as OF_KINDS
from vppres.live.past import Past
from vppres.model.site import Site
from vppres.scenario.configuration import Branches
from vppres.scenario.faults import LineFault
from vppres.scenario.history import History
from vppres.scenario.network import Network
from vppres.scenario.outage_warnings import OutageWarning
from vppres.scenario.scenario import Scenario

KIND = "vppres controller state"

VERSION = 8
"""Of the state's layout. It changes where an older state can no longer be gone on from."""

WHERE = "state"

SERIES = (
    "load_kw",
    "pv_kw",
    "price_gbp_per_kwh",
    "temperature_c",
    "grid_limit_kw",
    "export_limit_kw",
    "export_price_gbp_per_kwh",
    *OF_KINDS,
)

DECISIVE = ("controller", "mode", "guard", "switching")
"""Options without which a memory means nothing."""


@dataclass(frozen=True, eq=False)
class Standing:
    """State of a controller between two steps.

    The first of the known steps has ``forgotten`` ones before it, since the controller's first;
    ``before`` is memory and past before the last step, which may be decided again. Without the
    memory only its rest may be.
    """

    known: Scenario
    forgotten: int
    past: Past
    before: tuple[dict[str, Any] | None, Past] | None = None


def state_of(standing: Standing, decider: Decider, options: RunOptions) -> dict[str, Any]:
    """The state as JSON can hold it; the decider is left as it was."""
    given = given_by(standing.known, options)
    body = {
        **_body(standing, decider, options),
        "history": to_plain(standing.past.history),
        "before": standing.before and _moment(*standing.before, given),
    }
    return {**body, "digest": _digest(_text(body))}


def saved_state(standing: Standing, decider: Decider, options: RunOptions) -> str:
    """State as text, for a caller that saves every step: each number is written once.

    What was measured is not in it, nor the memory that the last step may be decided again from; the
    rest of it may.
    """
    given = given_by(standing.known, options)
    before = standing.before and _moment(None, standing.before[1], given)
    text = _text({**_body(standing, decider, options), "history": None, "before": before})
    return f'{text[:-1]},"digest":"{_digest(text)}"}}'


def _body(standing: Standing, decider: Decider, options: RunOptions) -> dict[str, Any]:
    """Common part of a state in full and as it is saved in steps."""
    known = standing.known
    given = given_by(known, options)
    return {
        "kind": KIND,
        "version": VERSION,
        "site": Site.of(known).key,
        "options": _decisive(options),
        "ids": {name: list(getattr(known, name).id) for name in ("customers", "pv", "batteries")},
        "known": {
            "start": known.grid.start.isoformat(),
            "n_steps": known.grid.n_steps,
            "forgotten": standing.forgotten,
            "series": {name: to_plain(getattr(known, name)) for name in SERIES},
            "warnings": to_plain(known.warnings),
            "faults": to_plain(known.faults),
        },
        "now": _moment(memory_of(decider, given), standing.past, given),
    }


def restored(
    state: Any, scenario: Scenario, decider: Decider, options: RunOptions, start: Past
) -> Standing:
    """Let a new controller stand where another one stood.

    Raises
    ------
    InputError
        If the state is damaged, of another version, of another site or of other options.
    """
    try:
        return _restored(state, scenario, decider, options, start)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise _refused(
            f"cannot be read: {type(error).__name__}", "Give what Controller.state() returned."
        ) from error


def _restored(
    state: Any, scenario: Scenario, decider: Decider, options: RunOptions, start: Past
) -> Standing:
    """Controller state from a saved one, which may still lack something."""
    _check_state(state, scenario, options)
    version = state["version"]
    if version == 3:
        state = _from_version_3(state)
    if "faults" not in state["known"]:
        state = _without_faults(state, scenario.network)
    if version < 6:
        state = _without_switches(state, scenario, decider)
    if version < 7:
        state = _without_moments(state, scenario.grid.dt_h)
        state = _with_empty_tables(state, start, given_by(scenario, options))
    if version < 8:
        state = _with_step_before(state, Site.of(scenario))
    known = _known(state["known"], scenario)
    given = given_by(known, options)
    forgotten = from_plain(int, state["known"]["forgotten"], f"{WHERE}.known.forgotten")
    history = start.history  # the site's own if the state has none
    if history and state["history"]:
        history = from_plain(History, state["history"], f"{WHERE}.history")
    before = None
    if state["before"]:
        # The measurements before the last step are those of its beginning: no copy is kept.
        row = from_plain(int, state["now"]["past"]["t"], f"{WHERE}.now.past.t") - forgotten
        then = history and history.before(known.grid.start + row * known.grid.step)
        past = start.read(state["before"]["past"], then, given, f"{WHERE}.before.past")
        before = state["before"]["memory"], past
    now = start.read(state["now"]["past"], history, given, f"{WHERE}.past")
    put_back(decider, state["now"]["memory"], given, f"{WHERE}.memory")
    return Standing(known, forgotten, now, before)


def _moment(memory: dict[str, Any] | None, past: Past, given: Given) -> dict[str, Any]:
    """State of the site and memory of the controller, between two steps."""
    return {"past": past.as_plain(given), "memory": memory}


def given_by(known: Scenario, options: RunOptions) -> Given:
    """Objects that every controller of the site has by itself."""
    return {Site: Site.of(known), SwitchingRules: options.rules}


def _decisive(options: RunOptions) -> dict[str, Any]:
    found = {
        name: asdict(value) if isinstance(value, SwitchingRules) else value
        for name, value in ((name, getattr(options, name)) for name in DECISIVE)
    }
    # Hours off supply are remembered by controllers that count them.
    return found | {"rotation or minimum_on_h": options.shares_supply}


def _check_state(state: Any, scenario: Scenario, options: RunOptions) -> None:
    """Whether a state is whole, of this version, this site and these options."""
    if not isinstance(state, dict) or state.get("kind") != KIND:
        raise _refused("is not the state of a controller", "Give what Controller.state() returned.")
    if state.get("version") not in (3, 4, 5, 6, 7, VERSION):
        raise _refused(
            f"has another layout than this version's, {VERSION}",
            "Go on with the version that wrote it, or begin without a state.",
            "version",
            state.get("version"),
        )
    body = {name: value for name, value in state.items() if name != "digest"}
    if state.get("digest") != _digest(_text(body)):
        raise _refused("is damaged: it is not as it was written", "Begin from an older one.")
    if state["site"] != Site.of(scenario).key:
        raise _refused(
            "is of another site: network, assets, weights or step differ",
            "Give the scenario of its site, or begin without a state.",
        )
    for name, value in _decisive(options).items():
        if state["options"].get(name) != value:
            raise _refused(
                f"was written with {state['options'].get(name)}",
                "Give the same option, or begin without a state.",
                name,
                value,
            )


def _from_version_3(state: dict[str, Any]) -> dict[str, Any]:
    """A state in which every kind had a field of its own, and the powers of all were one number.

    What each took in its last step is not known then, and no reading is doubted for it.
    """
    fields = {
        "chargers": ("vehicles", "kwh"),
        "thermal_loads": ("rooms", "reckoned_c"),
        "gensets": ("sets", "power_kw"),
    }

    def moment(old: dict[str, Any]) -> dict[str, Any]:
        past = old["past"]
        kinds = {}
        for kind, (name, by_unit) in fields.items():
            one = past.get(name)
            if one is not None and one[by_unit]:
                kinds[kind] = {"taken_kw": ["nan"] * len(one[by_unit]), **one}
        return {**old, "past": {**past, "kinds": kinds}}

    return _with_moments(state, moment)


def _without_faults(state: dict[str, Any], network: Network) -> dict[str, Any]:
    """A state of version 4 or before, in which no line was out."""

    def whole(found: dict[str, Any]) -> dict[str, Any]:
        if "p_flow_kw" in found and "q_injection_kvar" in found:  # an operating point
            return found | {"lines_out": [False] * network.n_lines}
        if "temperature_c" in found and "grid_limit_kw" in found:  # a forecast
            n_steps = len(found["temperature_c"])
            out = {"lines": network.n_lines, "buses": network.n_buses}
            none = {name: [[False] * n] * n_steps for name, n in out.items()}
            return found | {"out": none}
        return found

    known = {**state["known"], "faults": []}
    return {**_with_moments(state, partial(_everywhere, changed=whole)), "known": known}


def _without_switches(
    state: dict[str, Any], scenario: Scenario, decider: Decider
) -> dict[str, Any]:
    """A state of version 5 or before, in which switches stood as in the scenario."""
    closed = to_plain(Branches.of(scenario).closed)

    def moment(old: dict[str, Any]) -> dict[str, Any]:
        memory = old["memory"]
        if isinstance(decider, InConfiguration):
            memory = {"closed": closed, "moved": [], "decider": memory}
        return {"past": {**old["past"], "closed": closed}, "memory": memory}

    return _with_moments(state, moment)


def _without_moments(state: dict[str, Any], dt_h: float) -> dict[str, Any]:
    """A state of version 6 or before, in which vehicles and rooms were those after their step."""

    def moment(old: dict[str, Any]) -> dict[str, Any]:
        kinds, at_h = old["past"]["kinds"], (old["past"]["t"] + 1) * dt_h
        after = {"chargers": ("end_kwh", "kwh"), "thermal_loads": ("rests_at_c", "reckoned_c")}
        kinds = kinds | {
            kind: {**kinds[kind], "at_h": at_h, name: kinds[kind][same]}
            for kind, (name, same) in after.items()
            if kind in kinds
        }
        return {**old, "past": {**old["past"], "kinds": kinds}}

    return _with_moments(state, moment)


def _with_empty_tables(state: dict[str, Any], start: Past, given: Given) -> dict[str, Any]:
    """A state of version 6 or before, which had no table of duties or limits where there are none.

    The past of a site and a remembered observation had both tables.
    """
    switching, owed = (to_plain(each, given) for each in (start.switching, start.owed))

    def filled(found: dict[str, Any]) -> dict[str, Any]:
        if "switching" not in found:
            return found
        duties = found["switching"] or switching
        limits = duties.get("longest_off_h") or switching["longest_off_h"]
        duties = {**duties, "longest_off_h": limits}
        found = found | {"switching": duties, "owed": found.get("owed") or owed}
        if "soc" in found:  # an observation
            found["online"] = found["online"] or [True] * len(found["soc"])
        return found

    return _with_moments(state, partial(_everywhere, changed=filled))


def _with_step_before(state: dict[str, Any], site: Site) -> dict[str, Any]:
    """A state of version 7 or before, whose guard remembered the step before in five pieces."""
    nothing = to_plain(StepBefore.nothing(site))

    def joined(found: dict[str, Any]) -> dict[str, Any]:
        if "_commanded" not in found:  # no estimator
            return found
        series, said = found["series"], found.pop("_commanded") or {}
        before = series["_before"] or {}
        if said.get("share"):
            pairs = zip(said["served"], said["share"], strict=True)
            said["share"] = [share if on else 1.0 for on, share in pairs]
        expected, frozen = before.pop("expected", {}), series["_frozen"]
        renamed = {f"expected_{name}": kw for name, kw in expected.items()}
        renamed |= {f"frozen_{name}": flags for name, flags in frozen.items()}
        pieces = before | before.pop("seen", {}) | series["_usual"] | said | renamed
        known = {name: each for name, each in pieces.items() if each is not None}
        return found | {"series": {"before": nothing | known | {"far": series["_far"]}}}

    return _with_moments(state, partial(_everywhere, changed=joined))


def _everywhere(value: Any, changed: Callable[[dict[str, Any]], dict[str, Any]]) -> Any:
    """A plain value of which every dictionary is changed, the inner ones first."""
    if isinstance(value, list):
        return [_everywhere(each, changed) for each in value]
    if not isinstance(value, dict):
        return value
    return changed({name: _everywhere(each, changed) for name, each in value.items()})


def _with_moments(
    state: dict[str, Any], changed: Callable[[dict[str, Any]], Any]
) -> dict[str, Any]:
    """A state whose moments, of which that before the last step may be missing, are changed."""
    return {**state, **{name: state[name] and changed(state[name]) for name in ("now", "before")}}


def _known(plain: dict[str, Any], scenario: Scenario) -> Scenario:
    """The steps that were known."""
    n_steps = from_plain(int, plain["n_steps"], f"{WHERE}.known.n_steps")
    series: dict[str, Any] = {
        name: from_plain(Floats, values, f"{WHERE}.known.series.{name}")
        if isinstance(values, list)
        else np.array(from_plain(float, values, f"{WHERE}.known.series.{name}"))
        for name, values in plain["series"].items()
    }
    grid = replace(scenario.grid, start=pd.Timestamp(plain["start"]), n_steps=n_steps)
    kind, where = tuple[OutageWarning, ...], f"{WHERE}.known.warnings"
    warnings = from_plain(kind, plain["warnings"], where)
    faults = tuple(
        LineFault(pd.Timestamp(one.pop("start")), pd.Timestamp(one.pop("end")), **one)
        for one in [dict(each) for each in plain["faults"]]
    )
    return replace(scenario, grid=grid, warnings=warnings, faults=faults, **series)


def _text(body: dict[str, Any]) -> str:
    """A state without its digest, as text that is the same wherever it is written."""
    return json.dumps(body, sort_keys=True, allow_nan=False, separators=(",", ":"))


def _digest(text: str) -> str:
    """SHA-256 of that text."""
    return hashlib.sha256(text.encode()).hexdigest()


def _refused(message: str, cure: str, field: str | None = None, value: object = None) -> InputError:
    return InputError.of(WHERE, message, cure, field=field, value=value)
