"""Read-only arrays, since inputs are never overwritten, and the names of array types."""

from __future__ import annotations

import hashlib
import sys
from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Any, Self, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
Wholes = NDArray[np.int64]
Names = NDArray[np.object_]
Complexes = NDArray[np.complex128]

_DTYPES: dict[Any, Any] = {
    "Floats": float,
    "Flags": bool,
    "Wholes": int,
    "Names": object,
    "Complexes": complex,
}


def freeze(values: ArrayLike, dtype: Any = None) -> NDArray[Any]:
    """A read-only copy as an array.

    >>> freeze([1.0, 2.0]).flags.writeable
    False
    """
    array = np.array(values, dtype=dtype)
    array.setflags(write=False)
    return array


@lru_cache(maxsize=64)
def content_key(*tables: Any) -> str:
    """Digest of the fields of frozen dataclasses: equal content, equal key.

    That of the same tables is reckoned once: a live controller asks for it in every step.
    """
    digest = hashlib.sha256()
    for table in tables:
        for f in fields(table):
            value = getattr(table, f.name)
            numeric = isinstance(value, np.ndarray) and value.dtype != object
            digest.update(value.tobytes() if numeric else _whole_repr(value).encode())
    return digest.hexdigest()


def _whole_repr(value: object) -> str:
    """The representation in full: numpy leaves out the middle of more than a thousand items."""
    with np.printoptions(threshold=sys.maxsize):
        return repr(value)


def freeze_arrays(record: Any) -> None:
    """Replace the arrays of a frozen dataclass by read-only ones of the types they are declared as.

    Its module needs ``from __future__ import annotations``: the types are named.
    """
    for f in fields(record):
        if f.type in _DTYPES:
            array = freeze(getattr(record, f.name), _DTYPES[f.type])
            object.__setattr__(record, f.name, array)


class Items:
    """A frozen dataclass of equally long arrays, one for each attribute of its items."""

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def __len__(self) -> int:
        return len(next(iter(vars(self).values())))

    @classmethod
    def none(cls) -> Self:
        """No item."""
        items: Any = cls
        return cls(**{f.name: no_items() for f in fields(items)})

    def rows(self, which: Flags | Wholes | slice) -> Self:
        """Some of the items."""
        items: Any = self
        return type(self)(**{f.name: getattr(self, f.name)[which] for f in fields(items)})


@dataclass(frozen=True, eq=False)
class ByStep:
    """Fields of arrays with a row for each of W steps.

    What a window has nothing of is absent: arrays of length 0, which count as false.
    """

    @classmethod
    def absent(cls) -> Self:
        """Arrays of length 0."""
        return cls(*(np.empty((0, 0)) for _ in fields(cast(Any, cls))))

    def __bool__(self) -> bool:
        return len(getattr(self, fields(self)[0].name)) > 0

    def part(self, steps: slice) -> Self:
        """The first steps of the window, by a slice."""
        return type(self)(*(each[steps] for each in self._arrays()))

    def _arrays(self) -> list[Any]:
        return [getattr(self, field.name) for field in fields(self)]


def no_items() -> NDArray[Any]:
    """The column of a table of length 0; :func:`freeze_arrays` gives it its type."""
    return np.empty(0)


def given_or(values: Any, others: Any) -> Any:
    """Numbers, those that are not given (NaN) from others."""
    return np.where(np.isnan(values), others, values)


def mean_of_known(values: Floats) -> Floats:
    """Means along the first axis of what is not NaN; NaN where nothing is known.

    >>> mean_of_known(np.array([[1.0, np.nan], [3.0, np.nan]]))
    array([ 2., nan])
    """
    known = ~np.isnan(values)
    total = np.where(known, values, 0.0).sum(axis=0)
    count = known.sum(axis=0)
    return np.asarray(np.divide(total, count, out=np.full(count.shape, np.nan), where=count > 0))


def spans_of(flags: Flags) -> list[tuple[int, int]]:
    """Half-open ranges of what is true.

    >>> spans_of(np.array([True, False, True, True]))
    [(0, 1), (2, 4)]
    """
    edges = np.flatnonzero(np.diff(flags, prepend=False, append=False)).tolist()
    return list(zip(edges[::2], edges[1::2], strict=True))
