"""Meanings of the source's words for generators."""

from __future__ import annotations

import re

PV = "pv"
WIND = "wind"
GENSET = "genset"
"""A diesel or standby set: what it is for is to run alone."""

UNKNOWN = "generator"
"""Kind of a generator of which the source says nothing."""

_WORDS = (
    (PV, r"pv|solar|photovolt"),
    (WIND, r"wind|wka|wea\b|wp\b|wt\b|wtg"),
    ("hydro", r"hydro|run.?of.?river|small.?water"),
    ("biomass", r"biomass|biogas|bm\b"),
    ("chp", r"chp|bhkw|co-?gen|combined.heat"),
    (GENSET, r"diesel|gen.?set|stand.?by|back.?up|emergency"),
    (GENSET, r"gas|oil\b|coal|nuclear|turbine|engine|synchronous|machine"),
    ("fuel cell", r"(residential )?fuel.?cell"),
)
# The connection of the windings, which pandapower writes without a type, and the word of OpenDSS.
_NO_WORD = ("", "wye", "delta", "none", "nan", "gen", "generator")
_FUELLED = ("chp", GENSET, "fuel cell")
_ENGINES = ("chp", GENSET)


def kind_of(word: str, name: str = "") -> str:
    """Kind of a generator by the source's word, or by the element's name if there is no word.

    Returns
    -------
    str
        ``pv``, ``wind``, ``hydro``, ``biomass``, ``chp``, ``genset``, ``fuel cell``, the
        source's own word, or ``generator`` where the source says nothing.

    Examples
    --------
    >>> kind_of("WP"), kind_of("wye", "PV 3"), kind_of("CHP diesel"), kind_of("tidal")
    ('wind', 'pv', 'chp', 'tidal')
    """
    own = word.strip()
    if own.lower() in _NO_WORD:
        return _known(name.strip()) or UNKNOWN
    return _known(own) or own.lower()


def burns_fuel(kind: str) -> bool:
    """Whether a generator of this kind has a fuel and a control that the model does not know.

    >>> burns_fuel("chp"), burns_fuel("wind")
    (True, False)
    """
    return kind in _FUELLED


def runs_on_a_tank(kind: str) -> bool:
    """Whether a generator of this kind has an engine, as a set with a tank.

    >>> runs_on_a_tank("chp"), runs_on_a_tank("fuel cell")
    (True, False)
    """
    return kind in _ENGINES


def _known(text: str) -> str | None:
    """The first kind whose words begin the text, or a later word of it."""
    for kind, pattern in _WORDS:
        if re.search(rf"(?<![a-z])({pattern})", text, re.IGNORECASE):
            return kind
    return None
