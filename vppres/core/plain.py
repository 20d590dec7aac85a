"""Typed values as plain ones (numbers, text, lists, dictionaries) and back, to the last bit.

What is written is JSON: numbers that JSON has no word for are written as ``"nan"``, ``"inf"`` and
``"-inf"``. What is read is checked against the type that is expected; nothing that is read decides
on what is made of it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass
from functools import cache
from types import NoneType, UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

import numpy as np
import pandas as pd

from vppres.core.errors import InputError

Given = Mapping[type, Any]  # values that are known by their type, and so are not written


def to_plain(value: Any, given: Given | None = None) -> Any:
    """A value as JSON can hold it.

    It is a number, text, array, dataclass, or tuples and dictionaries of such; values of types that
    are ``given`` are left out.

    Examples
    --------
    >>> to_plain(np.array([0.1, np.inf])), to_plain({3: (True, None)})
    ([0.1, 'inf'], [[3, [True, None]]])
    """
    known = given or {}
    if isinstance(value, np.ndarray):
        return _array_to_plain(value)
    if isinstance(value, (np.generic, float)):
        return _number_to_plain(float(value)) if isinstance(value, float) else value.item()
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, pd.Timestamp):
        return value.isoformat()
    if isinstance(value, (list, tuple)):
        return [to_plain(item, known) for item in value]
    if isinstance(value, dict):
        return [[to_plain(key, known), to_plain(item, known)] for key, item in value.items()]
    if is_dataclass(value) and not isinstance(value, type):
        return {
            f.name: to_plain(getattr(value, f.name), known)
            for f in fields(value)
            if not isinstance(getattr(value, f.name), tuple(known))
        }
    return value


def from_plain(kind: Any, plain: Any, where: str, given: Given | None = None) -> Any:
    """The value of a type that was written as a plain one.

    ``kind`` is a class, an array type of :mod:`vppres.core.arrays`, or a tuple, dictionary or
    optional of such; ``where`` is what is read, as problems name it. Values of the types that were
    left out are ``given``.

    Raises
    ------
    InputError
        If it is not of that type.

    Examples
    --------
    >>> from vppres.core.arrays import Floats
    >>> from_plain(tuple[int, Floats], [3, [0.5, "nan"]], "a state")
    (3, array([0.5, nan]))
    """
    try:
        return _read(kind, plain, where, given or {})
    except (TypeError, ValueError, KeyError, OverflowError) as error:
        raise _unreadable(where, f"cannot be read: {type(error).__name__}") from error


def _read(kind: Any, plain: Any, where: str, given: Given) -> Any:
    """The value of a type."""
    origin = get_origin(kind)
    if origin in (Union, UnionType):
        if plain is None:
            return None
        (kind,) = (arg for arg in get_args(kind) if arg is not NoneType)
        return _read(kind, plain, where, given)
    if origin is np.ndarray:
        return _read_array(get_args(get_args(kind)[1])[0], plain, where)
    if origin is tuple:
        inner = get_args(kind)
        items = _of_type(list, plain, where)
        if inner[-1] is Ellipsis:
            inner = (inner[0],) * len(items)
        if len(items) != len(inner):
            raise _unreadable(where, f"has {len(items)} entries in place of {len(inner)}")
        return tuple(_read(k, item, where, given) for k, item in zip(inner, items, strict=True))
    if origin is dict:
        key, value = get_args(kind)
        pairs = [_of_type(list, pair, where) for pair in _of_type(list, plain, where)]
        return {_read(key, k, where, given): _read(value, v, where, given) for k, v in pairs}
    if is_dataclass(kind):
        return _read_fields(kind, plain, where, given)
    if kind is float:
        return float(plain if isinstance(plain, str) else _of_type((int, float), plain, where))
    if kind is pd.Timestamp:
        return pd.Timestamp(_of_type(str, plain, where))
    if kind is bytes:
        return bytes.fromhex(_of_type(str, plain, where))
    return _of_type(kind, plain, where)


def _read_fields(kind: Any, plain: Any, where: str, given: Given) -> Any:
    """A dataclass, field by field; those of a given type are taken from there."""
    found = _of_type(dict, plain, where)
    values: dict[str, Any] = {}
    for name, hint in _hints(kind).items():
        choices = [hint, *get_args(hint)]
        known = next((k for k in choices if isinstance(k, type) and k in given), None)
        if name in found:
            values[name] = _read(hint, found[name], f"{where}.{name}", given)
        elif known is not None:
            values[name] = given[known]
        elif name in _required_fields(kind):
            raise _unreadable(f"{where}.{name}", "is missing")
    return kind(**values)


@cache
def _hints(kind: Any) -> dict[str, Any]:
    """Types of a dataclass's fields."""
    hints = get_type_hints(kind)
    return {f.name: hints[f.name] for f in fields(kind)}


@cache
def _required_fields(kind: Any) -> frozenset[str]:
    """Fields without a default: what is added with one later is absent from what is older."""
    return frozenset(
        f.name for f in fields(kind) if f.default is MISSING and f.default_factory is MISSING
    )


def _read_array(dtype: Any, plain: Any, where: str) -> Any:
    """An array of a type; numbers of another type are no numbers of this one."""
    if dtype is np.complex128:
        parts = _of_type(dict, plain, where)
        real, imag = (_read_array(np.float64, parts[name], where) for name in ("real", "imag"))
        array = np.empty(real.shape, dtype)
        array.real = real
        array.imag = imag
        return array
    if isinstance(plain, dict):
        return np.empty([0, *plain["shape"][1:]], dtype=dtype)
    array = np.array(_of_type(list, plain, where), dtype=dtype)
    if dtype is not np.float64 and array.size and np.array(plain).dtype.kind != array.dtype.kind:
        raise _unreadable(where, "holds other values than expected")
    return array


def _of_type(kind: Any, plain: Any, where: str) -> Any:
    """A plain value of a type; true and false are no numbers."""
    wanted_bool = kind is bool
    if not isinstance(plain, kind) or (isinstance(plain, bool) and not wanted_bool):
        raise _unreadable(where, f"is of the type {type(plain).__name__}")
    return plain


def _unreadable(where: str, message: str) -> InputError:
    return InputError.of(where, message, "Give it as it was written, unchanged.")


def _array_to_plain(array: Any) -> Any:
    """Nested lists; of no rows their width, which lists do not show."""
    if array.ndim > 1 and len(array) == 0:
        return {"shape": list(array.shape)}
    if array.dtype.kind == "c":
        return {"real": _array_to_plain(array.real), "imag": _array_to_plain(array.imag)}
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        return _numbers_to_plain(array.tolist())
    return array.tolist()


def _numbers_to_plain(values: Any) -> Any:
    if isinstance(values, list):
        return [_numbers_to_plain(value) for value in values]
    return _number_to_plain(values)


def _number_to_plain(value: float) -> float | str:
    """A number that JSON has, or the word for one that it has not."""
    if math.isfinite(value):
        return value
    return "nan" if math.isnan(value) else ("inf" if value > 0 else "-inf")


def number_or_none(value: Any) -> float | None:
    """A finite number, or None.

    >>> number_or_none(1), number_or_none(np.nan)
    (1.0, None)
    """
    number = float(value)
    return number if math.isfinite(number) else None


def flattened(record: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested tables as one, the names joined by dots.

    >>> flattened({"seed": 1, "solve_s": {"total": 2.5}})
    {'seed': 1, 'solve_s.total': 2.5}
    """
    flat: dict[str, Any] = {}
    for name, value in record.items():
        flat |= (
            flattened(value, f"{prefix}{name}.")
            if isinstance(value, Mapping)
            else {f"{prefix}{name}": value}
        )
    return flat


def json_safe(value: Any) -> Any:
    """A copy that strict JSON can hold: numpy scalars as Python's, NaN and infinities as None.

    >>> json_safe({"gap": np.float64("nan"), "seed": np.int64(3), "errors": (0.1, float("inf"))})
    {'gap': None, 'seed': 3, 'errors': [0.1, None]}
    """
    if isinstance(value, Mapping):
        return {str(key): json_safe(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [json_safe(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value
