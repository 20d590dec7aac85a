"""Draws ``instances.csv`` from a seed: ``python -m benchmarks.make_instances`` writes it anew."""

from __future__ import annotations

from dataclasses import asdict
from itertools import cycle
from typing import Any

import numpy as np
import pandas as pd
from numpy.random import Generator

from benchmarks.instances import FILE, Instance, packaged
from vppres.io.atomic import atomic_write_text

SEED = 20220719

# Instances by number of steps.
ORDINARY = {1: 8, 2: 8, 3: 10, 4: 4, 6: 32, 9: 4, 12: 8, 18: 3, 24: 5}
STRESSED = {1: 6, 2: 6, 3: 6, 6: 14, 9: 2, 12: 4, 18: 1, 24: 3}

# Half the windows meet the outage: they are the hard ones.
PLACES = ("across", "inside", "before", "across", "after")
STRESSED_PLACES = ("across", "before", "after")
"""Inside the outage energy is short long before the voltages bind."""
BIASES = (-0.2, -0.1, 0.1, 0.2)
ALPHAS_PER_H = (0.01, 0.02, 0.03)
HEAVY_LOAD = (1.35, 1.6)
"""Load factors with which the voltage limit binds."""
LIGHT_LOAD = (0.2, 0.35)
"""Load factors at which full sun is more than customers and full batteries take."""
DAYLIGHT = range(8, 16)


def draw(seed: int = SEED) -> list[Instance]:
    """All instances, the ordinary ones first."""
    rng = np.random.default_rng(seed)
    ordinary = [
        _ordinary(rng, f"o{i + 1:03d}", steps, t0)
        for i, (steps, t0) in enumerate(_windows(rng, ORDINARY, PLACES))
    ]
    stressed = [
        _stressed(rng, i, steps, t0)
        for i, (steps, t0) in enumerate(_windows(rng, STRESSED, STRESSED_PLACES))
    ]
    return ordinary + stressed


def _windows(
    rng: Generator, counts: dict[int, int], places: tuple[str, ...]
) -> list[tuple[int, int]]:
    """Numbers of steps with a first step each, spread over the places around the outage."""
    return [
        (steps, _first_step(rng, steps, place))
        for steps, count in counts.items()
        for place, _ in zip(cycle(places), range(count), strict=False)
    ]


def _first_step(rng: Generator, steps: int, place: str) -> int:
    """A first step that puts a window in its place, or anywhere where it fits in no such place."""
    outage = np.flatnonzero(packaged().outage)
    begin = int(outage[0])
    end = int(outage[-1]) + 1
    first = 6 if steps <= 12 else 0  # the nights alone are easy
    fits = list(range(first, 25 - steps))
    wanted = {
        "before": [t for t in fits if t + steps <= begin],
        "inside": [t for t in fits if t >= begin and t + steps <= end],
        "after": [t for t in fits if t >= end],
        "across": [t for t in fits if t < end < t + steps or t < begin < t + steps],
    }[place]
    return int(rng.choice(wanted or fits))


def _ordinary(rng: Generator, name: str, steps: int, t0: int) -> Instance:
    """The packaged day in a random state; every other one with forecast errors."""
    low = rng.uniform(0.15, 0.7)
    return Instance(
        name,
        "ordinary",
        t0,
        steps,
        **_state(rng, low, low + 0.15),
        load_factor=1.0,
        pv_factor=1.0,
        **_errors(rng, int(name[1:]) % 2 == 0),
        offset=int(rng.integers(2)),
    )


def _stressed(rng: Generator, i: int, steps: int, t0: int) -> Instance:
    """Too much load, or in every fourth one too much sun for full batteries."""
    name = f"s{i + 1:03d}"
    errors = _errors(rng, i % 2 == 1)
    if i % 4 == 3:
        t0 = min(int(rng.choice(DAYLIGHT)), 24 - steps)
        return Instance(
            name,
            "stressed",
            t0,
            steps,
            **_state(rng, 0.8, 0.85),
            load_factor=_rounded(rng, *LIGHT_LOAD),
            pv_factor=1.0,
            **errors,
            offset=int(rng.integers(2)),
        )
    low = rng.uniform(0.15, 0.7)
    return Instance(
        name,
        "stressed",
        t0,
        steps,
        **_state(rng, low, low + 0.15),
        load_factor=_rounded(rng, *HEAVY_LOAD),
        pv_factor=_rounded(rng, 0.3, 1.0),
        **errors,
        offset=int(rng.integers(2)),
    )


def _state(rng: Generator, low: float, high: float) -> dict[str, Any]:
    return {
        "soc_low": round(low, 2),
        "soc_high": round(high, 2),
        "soc_seed": int(rng.integers(1_000_000)),
    }


def _errors(rng: Generator, wrong: bool) -> dict[str, Any]:
    """Forecast errors of load and PV, of the sizes that the reproduction has."""
    levels = {
        "load_bias": BIASES,
        "load_alpha_per_h": ALPHAS_PER_H,
        "pv_bias": BIASES,
        "pv_alpha_per_h": ALPHAS_PER_H,
    }
    drawn = {name: float(rng.choice(choices)) for name, choices in levels.items()}
    seed = int(rng.integers(1_000_000))
    return {**(drawn if wrong else dict.fromkeys(levels, 0.0)), "error_seed": seed}


def _rounded(rng: Generator, low: float, high: float) -> float:
    return round(float(rng.uniform(low, high)), 3)


def write(seed: int = SEED) -> None:
    """Write the table."""
    table = pd.DataFrame([asdict(instance) for instance in draw(seed)])
    atomic_write_text(FILE, table.to_csv(index=False))


if __name__ == "__main__":
    write()
