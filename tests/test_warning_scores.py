from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from vppres.outlook.outlook import SeenOutage
from vppres.scenario.outage_warnings import OutageWarning
from vppres.studies.warning_scores import WarnedOutage, brier, duration_pit, reliability

NOON = pd.Timestamp("2022-07-19T12:00Z")


def pair(probability: float | None, hours: float | None) -> WarnedOutage:
    """A warning of 2, 4 or 8 h, and an outage of some hours or none."""
    warning = OutageWarning(
        NOON - pd.Timedelta(hours=6),
        onset_likely=NOON,
        probability=probability,
        duration_p10_h=2.0,
        duration_p50_h=4.0,
        duration_p90_h=8.0,
    )
    came = None if hours is None else SeenOutage(NOON, NOON + pd.Timedelta(hours=hours))
    return WarnedOutage(warning, came)


def test_what_came_by_what_was_said() -> None:
    pairs = [pair(0.7, 4.0), pair(0.7, None), pair(0.7, 2.0), pair(0.1, None), pair(None, 3.0)]
    table = reliability(pairs)
    assert table["warnings"].tolist() == [1, 3]
    assert table["said"].tolist() == pytest.approx([0.1, 0.7])
    assert table["came"].tolist() == pytest.approx([0.0, 2 / 3])
    # 1.96 sqrt(.7 .3 / 3) = .519
    assert table["low"].tolist() == pytest.approx([0.0, 0.7 - 0.5186], abs=1e-3)
    assert brier(pairs) == pytest.approx((2 * 0.09 + 0.49 + 0.01) / 4)


def test_no_warning_says_nothing() -> None:
    assert reliability([]).empty
    assert np.isnan(brier([]))
    assert duration_pit([pair(0.5, None)]).size == 0


def test_lengths_lie_where_the_quantiles_say() -> None:
    pairs = [pair(1.0, hours) for hours in (2.0, 4.0, 8.0)]
    np.testing.assert_allclose(duration_pit(pairs), [0.1, 0.5, 0.9])


def test_what_is_drawn_as_said_is_evenly_spread() -> None:
    rng = np.random.default_rng(1)
    spread = np.log(2.0) / 1.2815515655446004
    lengths = 4.0 * np.exp(spread * rng.standard_normal(2000))
    count, _ = np.histogram(duration_pit([pair(1.0, h) for h in lengths]), 5, (0.0, 1.0))
    assert (np.abs(count / 2000 - 0.2) < 0.04).all()
