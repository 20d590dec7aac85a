"""Names that others wrote, as a message shows them; counts and amounts in words."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable
from datetime import datetime

# Control, surrogate, unassigned and format characters and line separators steer terminals, break
# XML, or make a name look like another one. The two joiners of Persian and Indic writing do not.
_HIDDEN = {"Cc", "Cf", "Cs", "Cn", "Zl", "Zp"}
_JOINERS = "\u200c\u200d"
# A spreadsheet takes a cell that begins with one of these for a formula, and runs it.
_FORMULA = "=+@-"
LONGEST_WORD = 300  # characters of a message; paths are seldom longer
_LONG_WORD = re.compile(rf"\S{{{LONGEST_WORD + 1},}}")


def is_hidden(character: str) -> bool:
    r"""Whether a character has no shape of its own.

    >>> [is_hidden(c) for c in "a$ \x1b\u202e"]
    [False, False, False, True, True]
    """
    return unicodedata.category(character) in _HIDDEN and character not in _JOINERS


def visible(text: str) -> str:
    r"""A text with its hidden characters written as escapes, safe to print.

    >>> print(visible("a\x1b[2Jb"))
    a\x1b[2Jb
    """
    if text.isprintable():
        return text
    return "".join(repr(c)[1:-1] if is_hidden(c) else c for c in text)


def counted(count: int, one: str, many: str = "") -> str:
    """A number of things by their name.

    >>> counted(1, "step"), counted(6, "step"), counted(2, "battery", "batteries")
    ('1 step', '6 steps', '2 batteries')
    """
    return f"{count} {one}" if count == 1 else f"{count} {many or one + 's'}"


def named(names: Iterable[object], most: int = 12) -> str:
    """Names in a row; many are cut, and those with commas are kept apart by semicolons.

    >>> named(["a", "b", "c"], most=2), named(["north, old", "south"])
    ('a, b and 1 more', 'north, old; south')
    """
    words = [str(name) for name in names]
    more = f" and {len(words) - most} more" if len(words) > most else ""
    between = "; " if any("," in word for word in words[:most]) else ", "
    return between.join(words[:most]) + more


def in_pounds(gbp: float, form: str) -> str:
    """An amount of money in the form of a number.

    >>> in_pounds(20321.4, ",.2f"), in_pounds(-0.05, ".3f")
    ('£20,321.40', '-£0.050')
    """
    return f"{'-' if gbp < 0.0 else ''}£{abs(gbp):{form}}"


def brief(text: str) -> str:
    """A text with its long words cut: names that others wrote may have thousands of characters.

    >>> len(brief("x" * 5000))
    303
    """
    return _LONG_WORD.sub(lambda word: f"{word[0][:LONGEST_WORD]}...", text)


def flaw_of_name(text: str, longest: int) -> tuple[str, str] | None:
    """Fault of a name that ends up in files, tables and figures, and its cure.

    Dollar signs, brackets, slashes and markup are allowed: a name is shown as it is.

    Returns
    -------
    tuple of str, or None
        Message and cure; None for a sound name.

    Examples
    --------
    >>> flaw_of_name("C7 [north] $2", 100) is None
    True
    >>> flaw_of_name("=1+1", 100)[0]
    "begins with '='"
    """
    if len(text) > longest:
        return f"is longer than {longest} characters", "Shorten it."
    hidden = next((c for c in text if is_hidden(c)), None)
    if hidden is not None:
        return (
            f"holds the character U+{ord(hidden):04X}, which cannot be shown",
            "Write it with characters that can be seen.",
        )
    if text != text.strip():
        return "begins or ends with a space", "Leave it out: files are read without it."
    is_number = text[1:].isdecimal() and text[0] == "-"
    if text[:1] and text[0] in _FORMULA and not is_number:
        return (
            f"begins with '{text[0]}'",
            "Begin it with another character: spreadsheets take such a cell for a formula.",
        )
    return None


def iso(time: datetime) -> str:
    """A time as the files write it.

    >>> iso(datetime.fromisoformat("2022-07-19T12:00:00Z"))
    '2022-07-19T12:00:00Z'
    """
    return time.isoformat().replace("+00:00", "Z")
