"""A power flow of MATPOWER's tables, written apart from the package: Newton's method in numpy."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Table = npt.NDArray[np.float64]


def voltages(base_mva: float, bus: Table, gen: Table, branch: Table) -> Table:
    """Voltage magnitude of every bus in pu, in the order of the bus table, shape (N,).

    Branches are pi sections behind an ideal transformer at their beginning (MATPOWER's manual,
    section 3.2); the Jacobian comes from differences, as cases are small.
    """
    row = {int(number): i for i, number in enumerate(bus[:, 0])}
    y = np.diag((bus[:, 4] + 1j * bus[:, 5]) / base_mva).astype(complex)
    for part in branch[branch[:, 10] > 0]:
        start, end = row[int(part[0])], row[int(part[1])]
        series = 1 / (part[2] + 1j * part[3])
        whole = series + 1j * part[4] / 2
        tap = (part[8] or 1.0) * np.exp(1j * np.deg2rad(part[9]))
        y[start, start] += whole / abs(tap) ** 2
        y[end, end] += whole
        y[start, end] -= series / np.conj(tap)
        y[end, start] -= series / tap
    s = -(bus[:, 2] + 1j * bus[:, 3]) / base_mva
    v = np.ones(len(bus))
    for part in gen[gen[:, 7] > 0]:
        at = row[int(part[0])]
        s[at] += (part[1] + 1j * part[2]) / base_mva
        if bus[at, 1] in (2, 3):
            v[at] = part[5]
    angle_free = np.flatnonzero(np.isin(bus[:, 1], (1, 2)))
    v_free = np.flatnonzero(bus[:, 1] == 1)
    isolated = bus[:, 1] == 4

    def unpacked(x: Table) -> npt.NDArray[np.complex128]:
        angle, magnitude = np.zeros(len(bus)), v.copy()
        angle[angle_free] = x[: len(angle_free)]
        magnitude[v_free] = x[len(angle_free) :]
        return magnitude * np.exp(1j * angle)

    def mismatch(x: Table) -> Table:
        u = unpacked(x)
        missing = u * np.conj(y @ u) - s
        return np.concatenate([missing.real[angle_free], missing.imag[v_free]])

    x = np.concatenate([np.zeros(len(angle_free)), np.ones(len(v_free))])
    for _ in range(20):
        f = mismatch(x)
        if np.abs(f).max(initial=0.0) < 1e-11:
            break
        step = 1e-7
        slopes = [(mismatch(x + step * e) - f) / step for e in np.eye(len(x))]
        x = x - np.linalg.solve(np.array(slopes).T, f)
    else:
        raise AssertionError("the case has no solution")
    found = np.abs(unpacked(x))
    found[isolated] = np.nan
    return found
