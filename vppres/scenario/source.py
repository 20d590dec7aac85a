"""Source of a scenario's feeder: its name, what was simplified, and how exact it is."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from vppres.core.text import visible

MAX_NOTES = 1000
MAX_NOTE_LENGTH = 4000
MAX_SOURCE_LENGTH = 300
IDENTICAL_PU = 1e-6
"""Difference of a voltage up to which two power flows found the same."""
EXACT_PU = 0.005
"""Largest difference of a voltage from its source that counts as the source's voltage."""


WITHIN = " (within 1e-6 pu)"


def difference_words(value_pu: float) -> str:
    """A difference of voltages; no digits of a solver's rounding.

    >>> difference_words(6.7e-16), difference_words(0.00123)
    ('1e-6 pu', '0.0012 pu')
    """
    return "1e-6 pu" if value_pu <= IDENTICAL_PU else f"{value_pu:.2g} pu"


@dataclass(frozen=True)
class SourceDeviation:
    """Largest difference of a bus voltage from the AC power flow of the source, by its origin."""

    no_load_pu: float | None = None  #: without loads and generators; None where it is not known
    as_given_pu: float | None = None  #: with the loads and generators that the source gives
    #: In the hour of the series in which the voltages differ most.
    worst_hour_pu: float | None = None
    opened_pu: float | None = None  #: what opening its loops changes, as the source gives it

    @property
    def largest_pu(self) -> float | None:
        """Largest of the differences that are known; None where none is."""
        known = [value for _, value in self._states() if value is not None]
        return max(known, default=None)

    def __str__(self) -> str:
        known = [(state, value) for state, value in self._states() if value is not None]
        if not known:
            return "The voltages were not compared with the source's power flow."
        if max(value for _, value in known) <= IDENTICAL_PU:
            return f"Voltages are identical to the source's power flow{WITHIN}."
        parts = ", ".join(f"{difference_words(value)} {state}" for state, value in known)
        return f"Voltages differ from the source's power flow by at most {parts}."

    def _states(self) -> tuple[tuple[str, float | None], ...]:
        """The states in words, with their differences."""
        return (
            ("at no load", self.no_load_pu),
            ("as given", self.as_given_pu),
            ("in the worst hour", self.worst_hour_pu),
            ("by opening its loops", self.opened_pu),
        )


@dataclass(frozen=True)
class Source:
    """The network that a scenario was made from; empty for one that was written by hand.

    Examples
    --------
    >>> Source("case33bw", "pandapower").heading
    'Made from case33bw (pandapower).'
    """

    name: str = ""  #: name of the network or its file
    kind: str = ""  #: which tool's it is, for example ``pandapower`` or ``OpenDSS``
    notes: tuple[str, ...] = ()  #: what was simplified, left out or drawn, one sentence each
    deviation: SourceDeviation = SourceDeviation()  #: how far its voltages are from the source's
    #: What of the source is not balanced, and is spread over three phases here; empty if nothing.
    unbalanced: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "notes", tuple(self.notes))

    @classmethod
    def of(
        cls,
        name: str,
        kind: str = "",
        notes: Iterable[str] = (),
        deviation: SourceDeviation | None = None,
        unbalanced: str = "",
    ) -> Source:
        """A source whose words come from files of others: made such that a scenario may hold them.

        Hidden characters are written out, and what is too long or too much is cut, with a word
        that says so.
        """
        return cls(
            _fitting(name, MAX_SOURCE_LENGTH),
            _fitting(kind, MAX_SOURCE_LENGTH),
            tuple(_fitting_notes(notes)),
            deviation or SourceDeviation(),
            _fitting(unbalanced, MAX_SOURCE_LENGTH),
        )

    def __bool__(self) -> bool:
        """Whether anything is known of the source."""
        return self != Source()

    @property
    def told(self) -> tuple[str, ...]:
        """The notes as what was so at the import: the folder may have been edited since.

        >>> Source("case33bw", notes=("No battery.",)).told
        ('At import: No battery.',)
        """
        return tuple(f"At import: {note}" for note in self.notes)

    @property
    def heading(self) -> str:
        """Name and kind as a sentence; empty where nothing is known."""
        kind = f" ({self.kind})" if self.kind else ""
        return f"Made from {self.name or 'another network'}{kind}." if self else ""

    def __str__(self) -> str:
        return f"{self.heading} {self.deviation}" if self else "Not made from another network."


def _fitting(text: str, longest: int) -> str:
    """A text of others that can be shown, and is cut where it is too long."""
    text = visible(" ".join(text.split()))
    return text if len(text) <= longest else f"{text[: longest - 2]} …"


def _fitting_notes(notes: Iterable[str]) -> Iterator[str]:
    """Notes that can be shown; of very many the last says how many are left out."""
    kept = [_fitting(note, MAX_NOTE_LENGTH) for note in notes]
    if len(kept) <= MAX_NOTES:
        yield from kept
        return
    yield from kept[: MAX_NOTES - 1]
    yield f"{len(kept) - MAX_NOTES + 1} more notes are left out."
