"""The phase of each step: normal, preparation, island or recovery."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pandas as pd

from vppres.core.arrays import Flags

Phase = Literal["normal", "preparation", "island", "recovery"]

CHARGING_KW = 1.0
"""Net charging of the fleet above which it counts as being filled again after an outage."""


def phases(outage: Flags, returning: Flags, n_seen: int) -> list[Phase]:
    """Phase of every step.

    An outage's steps are ``island``. A step with grid is ``preparation`` if an outage lies within
    its window, ``recovery`` if it follows an outage, directly or after other steps of recovery, and
    customers or stored energy return in it, otherwise ``normal``.

    ``returning`` are steps in which a customer is off supply or restored, or the batteries are
    filled, (T,); a window has ``n_seen`` steps, the current one included.

    Examples
    --------
    >>> outage = np.array([0, 0, 0, 1, 0, 0], bool)
    >>> phases(outage, np.array([0, 0, 0, 1, 1, 0], bool), n_seen=2)
    ['normal', 'normal', 'preparation', 'island', 'recovery', 'normal']
    """
    named: list[Phase] = []
    for t, dead in enumerate(outage):
        if dead:
            named.append("island")
        elif outage[t : t + n_seen].any():
            named.append("preparation")
        elif named and named[-1] in ("island", "recovery") and returning[t]:
            named.append("recovery")
        else:
            named.append("normal")
    return named


def returning_steps(customers: pd.DataFrame, batteries: pd.DataFrame, n_steps: int) -> Flags:
    """Steps in which a customer is off supply or restored, or the fleet charges, shape (T,)."""
    served = customers["served"].to_numpy(bool)
    everyone = np.asarray(served.reshape(n_steps, -1).all(axis=1))
    before = np.concatenate([[True], everyone[:-1]])
    net = (batteries["charge_kw"] - batteries["discharge_kw"]).to_numpy(float)
    filling = net.reshape(n_steps, -1).sum(axis=1) > CHARGING_KW
    return np.asarray(~everyone | ~before | filling)
