"""Beliefs of outages and the value of stored energy, by hand and by linear programmes."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linprog

from vppres.core.arrays import Floats
from vppres.core.errors import InputError
from vppres.outlook import durations
from vppres.outlook.belief import OutageBelief
from vppres.outlook.outlook import HOUR, OutageOutlook, SeenOutage, seen_outages
from vppres.outlook.presets import STATISTICS, WARNINGS, Statistics, completed
from vppres.outlook.value import Ahead, EquivalentBattery, concave_above, stored_value
from vppres.scenario.outage_warnings import (
    STATISTICS_PRESETS,
    WARNING_PRESETS,
    OutageLength,
    OutageStatistics,
    OutageWarning,
)

QUANTILES = ("duration_p10_h", "duration_p50_h", "duration_p90_h")

NOON = pd.Timestamp("2022-07-19T12:00Z")
NEVER = OutageStatistics(saifi_per_year=0.0)


def warned(issued_h: float, **told: object) -> OutageWarning:
    """A message issued some hours from noon; onsets are hours from noon too."""
    times = {
        name: NOON + float(value) * HOUR  # type: ignore[arg-type]
        for name, value in told.items()
        if name.startswith(("onset", "restored"))
    }
    return OutageWarning(NOON + issued_h * HOUR, **(told | times))  # type: ignore[arg-type]


def outlook(*warnings: OutageWarning, statistics: OutageStatistics = NEVER) -> OutageOutlook:
    return OutageOutlook(warnings, statistics, 1.0)


# Lengths.


def test_lengths_are_rounded_to_steps() -> None:
    for found in (
        durations.lognormal(4.0, 0.7, 0.5, 60),
        durations.weibull(58.1, 0.815, 0.5, 60),
        durations.discrete([1.0, 2.6], [1.0, 3.0], 0.5, 60),
        durations.known(0.1, 0.5, 60),
    ):
        assert found.sum() == pytest.approx(1.0)
        assert (found >= 0.0).all()
    below = durations.lognormal(4.0, 0.7, 0.5, 60).cumsum()
    assert below[7] == pytest.approx(0.5, abs=0.05)  # 4 h are eight steps
    assert durations.discrete([1.0, 2.6], [1.0, 3.0], 0.5, 60)[[1, 4]].tolist() == [0.25, 0.75]


def test_lengths_keep_the_quantiles_that_were_said() -> None:
    """Steps of 36 s: the share below each quantile is that of its name."""
    for said in ((2.0, 4.0, 8.0), (1.0, 4.0, 5.0), (3.5, 4.0, 12.0)):
        below = durations.between_quantiles(*said, 0.01, 4000).cumsum()
        shares = [below[round(hours / 0.01) - 1] for hours in said]
        assert shares == pytest.approx([0.1, 0.5, 0.9], abs=0.01)


def test_even_quantiles_are_those_of_a_lognormal_length() -> None:
    sigma = np.log(2.0) / durations.Z90
    np.testing.assert_allclose(
        durations.between_quantiles(2.0, 4.0, 8.0, 1.0, 30),
        durations.lognormal(4.0, sigma, 1.0, 30),
        atol=1e-12,
    )


@pytest.mark.parametrize("said", [(4.0, 4.0, 4.0), (4.0, 4.0, 8.0), (2.0, 4.0, 4.0)])
def test_a_side_may_be_certain(said: tuple[float, float, float]) -> None:
    found = durations.between_quantiles(*said, 1.0, 30)
    assert found.sum() == pytest.approx(1.0)
    assert found[4:].sum() == pytest.approx(0.0 if said[2] == 4.0 else 0.5, abs=0.2)
    assert found[:3].sum() == pytest.approx(0.0 if said[0] == 4.0 else 0.5, abs=0.2)


# Beliefs.


def test_every_step_without_it_makes_an_outage_less_likely() -> None:
    """Equal thirds at 0, 1 and 2 h, p = .6: two of them passed leave .2 of .6 (Bayes)."""
    message = warned(-9, onset_earliest=-1.5, onset_likely=1, onset_latest=2.5, probability=0.6)
    early = outlook(message).at(NOON - 3 * HOUR, 8, [])
    assert early.onset.sum() == pytest.approx(0.6)
    late = outlook(message).at(NOON + 1 * HOUR, 4, [])
    still = early.onset[0, 5:].sum()
    assert late.onset.sum() == pytest.approx(still / (0.4 + still))
    assert outlook(message).at(NOON + 4 * HOUR, 4, []).onset.sum() == 0.0


def test_the_last_message_counts_and_none_before_it_is_issued() -> None:
    first = warned(-6, onset_likely=0, probability=0.5, duration_p50_h=2.0)
    later = warned(-2, onset_likely=1, probability=0.9, duration_p50_h=4.0)
    clear = warned(-1, probability=0.0)
    view = outlook(clear, later, first)
    assert view.at(NOON - 7 * HOUR, 12, []).out_probability.max() == 0.0
    assert view.at(NOON - 5 * HOUR, 12, []).out_probability[5:8].tolist() == [0.5, 0.5, 0.0]
    assert (
        view.at(NOON - 2 * HOUR, 9, []).out_probability.tolist()
        == [0.0] * 3 + [0.9] * 4 + [0.0] * 2
    )
    assert view.at(NOON - 1 * HOUR, 9, []).out_probability.max() == 0.0


def test_the_longer_out_the_longer_still_to_come() -> None:
    """Discrete lengths of 1 and 4 h: an outage that lasts is the long one."""
    belief = OutageBelief(np.zeros((0, 6)), [[0.5, 0, 0, 0.5, 0, 0, 0]], 0.0, True, 0, 1)
    assert belief.out_probability.tolist() == [1.0, 1.0, 1.0, 0.0, 0.0, 0.0]
    assert belief.certain
    fresh = OutageBelief(np.zeros((0, 6)), [[0.5, 0, 0, 0.5, 0, 0, 0]], 0.0, True, 0, 0)
    assert fresh.out_probability.tolist() == [1.0, 0.5, 0.5, 0.5, 0.0, 0.0]
    assert not fresh.certain


def test_an_update_during_the_outage_is_the_length_of_the_whole() -> None:
    start = SeenOutage(NOON)
    told = warned(-5, onset_likely=0, probability=0.6, duration_p50_h=2.0)
    update = warned(1, onset_likely=0, duration_p50_h=5.0)
    view = outlook(told, update)
    assert view.at(NOON, 8, [start]).likely.tolist() == [True] * 2 + [False] * 6
    assert view.at(NOON + HOUR, 8, [start]).likely.tolist() == [True] * 4 + [False] * 4
    # Without onset it speaks of the outage that lasts.
    exact = OutageStatistics(saifi_per_year=0.0, estimate_p10=1.0, estimate_p90=1.0)
    view = outlook(warned(1, duration_p50_h=3.0), statistics=exact)
    assert view.at(NOON + HOUR, 4, [start]).out_probability.tolist() == [1.0, 1.0, 0.0, 0.0]


def test_what_was_not_foreseen() -> None:
    lengths = OutageStatistics(saifi_per_year=0.0, caidi_h=3.0, duration_sigma=0.0)
    # An outage of which nobody spoke.
    alone = outlook(statistics=lengths).at(NOON, 6, [SeenOutage(NOON)])
    assert alone.out_probability.tolist() == [1.0, 1.0, 1.0, 0.0, 0.0, 0.0]
    # One that is longer than was said has the statistics to go by, and these give up too.
    view = outlook(warned(-5, onset_likely=0, duration_p50_h=1.0), statistics=lengths)
    assert view.at(NOON + HOUR, 5, [SeenOutage(NOON)]).out_probability.tolist() == [1, 1, 0, 0, 0]
    assert view.at(NOON + 3 * HOUR, 5, [SeenOutage(NOON)]).out_probability.tolist() == [
        1,
        0,
        0,
        0,
        0,
    ]
    # One that is over is not waited for again.
    over = SeenOutage(NOON, NOON + HOUR)
    assert view.at(NOON + HOUR, 5, [over]).out_probability.max() == 0.0


def test_several_announced_outages_come_in_their_order() -> None:
    blocks = [
        warned(-9, outage="one", onset_likely=1, probability=0.8, duration_p50_h=1.0),
        warned(-9, outage="two", onset_likely=4, probability=0.5, duration_p50_h=2.0),
    ]
    view = outlook(*blocks)
    first = view.at(NOON, 8, [])
    assert first.out_probability.tolist() == pytest.approx([0, 0.8, 0, 0, 0.5, 0.5, 0, 0])
    in_it = view.at(NOON + HOUR, 6, [SeenOutage(NOON + HOUR)])
    assert in_it.out_probability.tolist() == pytest.approx([1, 0, 0, 0.5, 0.5, 0])


STORM = {"onset_earliest": 0, "onset_likely": 3, "onset_latest": 6, "probability": 0.7,
         "duration_p10_h": 2.0, "duration_p50_h": 7.0, "duration_p90_h": 24.0}  # fmt: skip


def test_an_estimate_under_another_name_is_what_it_is_under_the_same() -> None:
    """Before the onset, in the outage and after it; outages that begin outside the window too."""
    rng = np.random.default_rng(43)
    different = []
    for case in range(40):
        begins = int(rng.integers(-3, 8))
        seen = SeenOutage(NOON + begins * HOUR)
        storm = warned(-6, outage="storm", **STORM)
        estimates = [
            warned(
                issued,
                outage="INC-1",
                onset_likely=begins,
                duration_p50_h=float(rng.integers(1, 9)),
                duration_p90_h=float(rng.integers(9, 12)),
            )
            for issued in sorted(rng.integers(begins, begins + 6, 2))
        ]
        for hours in (begins + 1, begins + 5):
            now = NOON + hours * HOUR
            said = [
                outlook(storm, *(replace(one, outage=name) for one in estimates)).at(
                    now, 30, [seen]
                )
                for name in ("storm", "INC-1")
            ]
            alike = [
                np.array_equal(getattr(said[0], name), getattr(said[1], name))
                for name in ("onset", "duration", "out_probability")
            ]
            if not all(alike):
                different.append((case, hours))
            told = any(one.issued_at <= now for one in estimates)
            assert said[1].words == ("INC-1 counts, not storm" if told else "")
    assert not different


def test_messages_of_one_cause_are_one_outage_before_it_begins() -> None:
    storm = warned(-6, outage="storm", **STORM)
    sure = warned(-2, outage="DNO", onset_likely=3, probability=1.0, duration_p50_h=2.0)
    belief = outlook(storm, sure).at(NOON, 8, [])
    assert belief.out_probability.tolist() == [0, 0, 0, 1, 1, 0, 0, 0]
    assert belief.words == "DNO counts, not storm"
    # Of two that are issued at once the narrower one counts, in any order.
    early = replace(sure, issued_at=storm.issued_at)
    for both in ((storm, early), (early, storm)):
        assert outlook(*both).at(NOON, 8, []).words == "DNO counts, not storm"
    # What was taken back leaves what was said before.
    clear = warned(-1, outage="DNO", probability=0.0)
    alone = outlook(storm).at(NOON, 8, []).out_probability
    assert outlook(storm, sure, clear).at(NOON, 8, []).out_probability.tolist() == alone.tolist()


def test_blocks_that_follow_each_other_stay_apart() -> None:
    """A rota of hours that are announced together, the second one an hour after the first."""
    blocks = [
        warned(-9, outage=name, onset_likely=hour, probability=1.0, duration_p50_h=1.0)
        for name, hour in (("one", 1), ("two", 2.5))
    ]
    view = OutageOutlook(blocks, NEVER, 0.5)
    first = SeenOutage(NOON + HOUR)
    assert view.at(first.start, 7, [first]).out_probability.tolist() == [1, 1, 0, 1, 1, 0, 0]
    over = replace(first, end=NOON + 2 * HOUR)
    assert view.at(NOON + 2 * HOUR, 5, [over]).out_probability.tolist() == [0, 1, 1, 0, 0]


def ends(view: OutageOutlook, hours: float) -> list[float]:
    """Probability that an outage since noon ends after each hour from now on."""
    belief = view.at(NOON + hours * HOUR, 12, [SeenOutage(NOON)])
    left = belief.duration[belief.kind, belief.elapsed :]
    return (left / left.sum()).tolist()


def test_a_lone_estimate_has_the_spread_of_estimates() -> None:
    alone = ends(outlook(warned(1, duration_p50_h=5.0)), 1)
    spread = warned(1, duration_p10_h=3.0, duration_p50_h=5.0, duration_p90_h=9.0)
    assert alone == ends(outlook(spread), 1)
    as_time = OutageWarning(NOON + HOUR, restored_likely=NOON + 5 * HOUR)
    assert ends(outlook(as_time), 1) == alone
    # Of an outage that was announced with its onset before it began it is the length.
    assert max(ends(outlook(warned(-1, onset_likely=0, duration_p50_h=5.0)), 1)) == 1.0


def test_an_outage_that_outlasts_what_was_said_follows_the_statistics() -> None:
    """Of 2.4, 3 and 3.75 h nothing is left after four; who says more is not treated worse."""
    known = outlook(statistics=OutageStatistics(saifi_per_year=0.0, caidi_h=4.0))
    said = warned(1, onset_likely=0, duration_p10_h=2.4, duration_p50_h=3.0, duration_p90_h=3.75)
    alone = warned(1, onset_likely=0, duration_p50_h=2.0)
    for message in (said, alone):
        view = replace(known, warnings=(message,))
        assert ends(view, 3) != ends(known, 3)
        for hours in (4, 5, 9):
            assert ends(view, hours) == ends(known, hours)
            belief = view.at(NOON + hours * HOUR, 12, [SeenOutage(NOON)])
            assert belief.words == "the unnamed outage is outlasted, the statistics count"


def test_not_before_a_time_the_grid_is_not_back() -> None:
    known = outlook(statistics=OutageStatistics(saifi_per_year=0.0, caidi_h=3.0))
    crew = OutageWarning(NOON + HOUR, "crew", restored_not_before=NOON + 4 * HOUR)
    belief = replace(known, warnings=(crew,)).at(NOON + HOUR, 12, [SeenOutage(NOON)])
    assert belief.out_probability[:4].tolist() == [1.0, 1.0, 1.0, pytest.approx(0.5, abs=0.25)]
    # Behind it the outage is as long as before, given that it lasts so long.
    later = known.at(NOON + 3 * HOUR, 10, [SeenOutage(NOON)])
    assert belief.out_probability[2:] == pytest.approx(later.out_probability)
    # A length that is said later replaces it; one from before stays.
    estimate = {"duration_p10_h": 2.0, "duration_p50_h": 3.0, "duration_p90_h": 6.0}
    for hours, least in ((0.5, 1), (1.5, 0)):
        both = replace(known, warnings=(crew, warned(hours, outage="INC-1", **estimate)))
        assert ends(both, 2)[:least] == [0.0] * least
        assert ends(both, 2)[least] > 0.0


def test_a_notice_is_believed_as_often_as_it_is_right_and_its_absence_too() -> None:
    """Equal chances of one to six hours; by Bayes' rule."""
    share, false = 0.72, 0.05
    site = OutageStatistics(
        saifi_per_year=0.0, notice_h=1.0, notice_share=share, notice_false_share=false
    )
    even = OutageLength("discrete", hours=(1, 2, 3, 4, 5, 6), probability=(1 / 6,) * 6)
    said = OutageWarning(
        NOON, onset_likely=NOON, length=even, **dict(zip(QUANTILES, (1.0, 3.5, 6.0), strict=True))
    )
    notice = OutageWarning(NOON + 2 * HOUR, "crew", restored_by=NOON + 3 * HOUR)
    silent = np.array([1 - share, *[1 - false] * 3])
    heard = np.array([share, *[false] * 3])
    for messages, likely in (((said,), silent), ((said, notice), heard)):
        found = ends(OutageOutlook(messages, site, 1.0), 2)
        assert found[:4] == pytest.approx(likely / likely.sum())
    # A false notice is one more that was in vain.
    found = ends(OutageOutlook((said, notice), site, 1.0), 3)
    assert found[:3] == pytest.approx(silent[:3] / silent[:3].sum())
    # Where a crew gives none as a rule nothing follows from silence.
    assert ends(outlook(said), 2)[:4] == pytest.approx([0.25] * 4)
    assert ends(outlook(said, notice), 2)[0] == pytest.approx(share / (share + 3 * false))


def test_probabilities_are_those_of_all_futures_drawn() -> None:
    """The chain against all its paths, counted one by one."""
    belief = OutageBelief(
        [[0, 0.2, 0.3, 0, 0], [0, 0, 0, 0.4, 0.1]],
        [[0.5, 0.5, 0, 0, 0], [0.25, 0.75, 0, 0, 0], [0, 1, 0, 0, 0]],
        hazard=0.1,
    )
    total = np.zeros(5)
    for path in product([0, 1], repeat=4):
        total += _weight(belief, (0, *path)) * np.array([0, *path])
    assert belief.out_probability == pytest.approx(total)


STRETCH = st.tuples(st.integers(1, 6), st.integers(1, 6), st.integers(0, 4))
"""Of an outage the step of its beginning, its length, and four times its probability."""


@given(st.lists(STRETCH, min_size=1, max_size=4))
def test_a_step_is_out_if_any_of_all_outages_touches_it(spans: list[tuple[int, int, int]]) -> None:
    spans = sorted(spans)
    onset, duration = np.zeros((len(spans), 9)), np.zeros((len(spans) + 1, 9))
    quiet = np.ones(9)
    for row, (begin, length, quarters) in enumerate(spans):
        onset[row, begin] = quarters / 4.0
        duration[row + 1, length - 1] = 1.0
        quiet[begin : begin + length] *= 1.0 - quarters / 4.0
    belief = OutageBelief(onset, duration, hazard=0.0)
    assert belief.out_probability == pytest.approx(1.0 - quiet)


@given(
    st.lists(STRETCH, min_size=1, max_size=4),
    st.permutations(range(4)),
    st.permutations(["a", "b", "c", "d"]),
)
def test_sure_outages_are_all_there_before_and_in_them(
    spans: list[tuple[int, int, int]], order: list[int], names: list[str]
) -> None:
    """Whatever their names, order and lengths; those that leave no step between them are one."""
    messages = [
        warned(-9 + issued, outage=name, onset_likely=begin, probability=1.0, duration_p50_h=length)
        for (begin, length, _), issued, name in zip(spans, order, names, strict=False)
    ]
    dark = np.zeros(13, dtype=bool)
    for begin, length, _ in spans:
        dark[begin : begin + length] = True
    times = pd.date_range(NOON, periods=13, freq="h")
    for t, now in enumerate(times):
        seen = seen_outages(times[: t + 1], [*dark[: t + 1]])
        believed = outlook(*messages).at(now, 13 - t, seen).out_probability
        assert believed == pytest.approx(dark[t:].astype(float))


def _weight(belief: OutageBelief, out: tuple[int, ...]) -> float:
    """Probability of a path of outages, over all that may have caused it."""

    def onwards(t: int, kind: int | None, lasted: int, come: int) -> float:
        if t == len(out):
            return 1.0
        if kind is None:
            begins = belief.onsets_from(come, t)
            if not out[t]:
                return (1.0 - begins.sum()) * onwards(t + 1, None, 0, come)
            return sum(p * onwards(t + 1, k, 1, come) for k, p in enumerate(begins) if p)
        ends = belief.restored[kind, lasted - 1]
        lasts = (1.0 - ends) * out[t] * onwards(t + 1, kind, lasted + 1, come)
        found, left = 0.0, ends
        for other, began in belief.behind(kind, t):
            gone_on = sum(p * onwards(t + 1, other, k + 1, other) for k, p in enumerate(began) if p)
            found += left * out[t] * gone_on
            left *= 1.0 - began.sum()
        return lasts + found + left * (1 - out[t]) * onwards(t + 1, None, 0, kind)

    return onwards(1, None, 0, 0)


def test_presets_say_where_they_come_from() -> None:
    assert tuple(STATISTICS) == STATISTICS_PRESETS
    assert ("", *WARNINGS) == WARNING_PRESETS
    assert all(len(p.source) > 10 for p in (*STATISTICS.values(), *WARNINGS.values()))
    mean = Statistics.of(OutageStatistics(caidi_h=4.0, duration_sigma=0.8))
    assert mean.median_h * np.exp(0.8**2 / 2) == pytest.approx(4.0)
    heat = completed(warned(-5, onset_likely=0, preset="heat"))
    assert heat.probability == 0.005  # a weather warning says little of one feeder
    assert heat.duration_p90_h == pytest.approx(7.0 * np.exp(1.2816 * 1.33), rel=1e-3)
    own = completed(warned(-5, onset_likely=0, preset="heat", probability=0.4))
    assert own.probability == 0.4


@pytest.mark.parametrize(("told", "message"), [
    ({"onset_likely": 0, "onset_earliest": 1}, "comes before"),
    ({"onset_latest": 1}, "onset_likely.*is missing"),
    ({"probability": 1.2}, "must lie between 0 and 1"),
    ({"duration_p50_h": 0.0}, "must be above 0"),
    ({"duration_p50_h": 3.0, "duration_p90_h": 2.0}, "is below duration_p50_h"),
    ({"onset_likely": 2, "restored_likely": 2}, "restored_likely.*does not come after the onset"),
    ({"onset_earliest": 1, "onset_likely": 3, "restored_by": 1}, "restored_by.*after the onset"),
])  # fmt: skip
def test_contradictions_are_refused(told: dict[str, float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        warned(-5, **told)


# Values.

PRICE, VOLL = 0.3, 10.0


def fleet(power_kw: float = 50.0) -> EquivalentBattery:
    return EquivalentBattery(10.0, 110.0, power_kw, power_kw, 0.9, 0.8)


def ahead(load_kw: Floats, pv_kw: Floats, **other: object) -> Ahead:
    """Two customers, of which the first counts ten times as much per kW."""
    no_limit = np.full(len(pv_kw), np.inf)
    values = {"import_kw": no_limit, "export": None, "lambda_curt": 0.1, "dt_h": 1.0} | other
    values.setdefault("delivered_kwh", np.zeros(len(pv_kw)))
    price = values.pop("price", np.full(len(pv_kw), PRICE))
    return Ahead(load_kw, pv_kw, price, weight=np.array([1.0, 0.1]), **values)  # type: ignore[arg-type]


def nothing(energy_kwh: Floats) -> Floats:
    return np.zeros_like(energy_kwh)


def test_value_by_hand() -> None:
    """One step: an outage with p = .25, in which 12.5 kWh serve the first and 12.5 the second."""
    known = ahead(np.array([[10.0, 10.0]] * 2), np.zeros(2))
    belief = OutageBelief([[0, 0.25]], [[1, 0, 0], [1, 0, 0]], 0.0)
    value = stored_value(belief, fleet(), known, VOLL, nothing)
    per_service = VOLL * 20.0 / 1.1
    assert value.gbp_per_service == pytest.approx(per_service)
    saved = 0.75 * 0.8 * PRICE / per_service  # a stored kWh gives .8, and saves the import of it
    assert not value.as_service
    assert value.at(10.0) == pytest.approx(0.0, abs=1e-12)
    assert value.at(22.5) == pytest.approx(0.25 * 1.0 + 12.5 * saved, rel=0.05)
    assert value.at(35.0) == pytest.approx(0.25 * 1.1 + 25.0 * saved, rel=0.01)
    assert value.at(110.0) == pytest.approx(value.at(35.0), rel=0.01)
    assert value.marginal_gbp_per_kwh(11.0) == pytest.approx(
        per_service * (0.25 * 0.1 * 0.8 + saved), rel=0.05
    )
    # A power of 5 kW serves half of the first, whatever is stored.
    weak = stored_value(belief, fleet(5.0), known, VOLL, nothing)
    assert weak.at(110.0) == pytest.approx(0.25 * 0.5 + 0.75 * 5.0 * PRICE / per_service, rel=0.01)


def test_a_limit_that_is_announced_for_a_step_is_worth_what_it_denies() -> None:
    """Of 20 kW the grid gives 10 in one step, all of them to the first; 12.5 kWh bring the others.

    The second customer counts a tenth. For a limit a step later they can still be bought.
    """
    load = np.array([[10.0, 10.0]] * 3)
    never = OutageBelief(np.empty((0, 3)), [[1.0, 0.0, 0.0, 0.0]], 0.0)
    worth = {}
    for place in (None, 1, 2):
        limit = np.full(3, np.inf)
        if place is not None:
            limit[place] = 10.0
        known = ahead(load, np.zeros(3), import_kw=limit, price=np.full(3, 1e-6))
        worth[place] = stored_value(never, fleet(), known, VOLL, nothing).at(110.0)
    assert worth[None] == pytest.approx(0.0, abs=1e-3)
    assert [worth[1], worth[2]] == pytest.approx([0.1, 0.0], abs=1e-3)


def _optimum(
    energy: float, out: list[bool], known: Ahead, one: EquivalentBattery, end_gbp: float
) -> float:
    """Best of a known future by a linear programme: service less cost and curtailment."""
    T = len(out)
    per_service = VOLL * known.kwh_per_service
    # Columns of a step: charge, discharge, import, curtailed, shares of two customers.
    k = 6
    cost = np.zeros(T * k + 1)
    rows, right = np.zeros((2 * T + 1, T * k + 1)), np.zeros(2 * T + 1)
    bounds: list[tuple[float, float | None]] = []
    for t in range(T):
        at = t * k
        cost[at + 2] = known.price_gbp_per_kwh[t] / per_service
        cost[at + 3] = known.lambda_curt
        cost[at + 4 : at + 6] = -known.weight if out[t] else 0.0
        rows[t, at : at + 6] = [1, -1, -1, 1, *known.load_kw[t]]
        right[t] = known.pv_kw[t]
        shares = (0.0, 1.0) if out[t] else (1.0, 1.0)
        limit = 0.0 if out[t] else None
        bounds += [(0, one.p_max_kw), (0, one.p_max_kw), (0, limit), (0, None), shares, shares]
    store = np.zeros((T, T * k + 1))
    for t in range(T):
        store[t:, t * k] = one.eta_charge
        store[t:, t * k + 1] = -1.0 / one.eta_discharge
    cost[: T * k] -= end_gbp / per_service * store[-1, : T * k]
    upper = np.vstack([store, -store])
    room = np.concatenate([np.full(T, one.most_kwh - energy), np.full(T, energy - one.least_kwh)])
    found = linprog(
        cost, upper, room, rows[:T], right[:T], bounds=[*bounds, (0, 0)], method="highs"
    )
    assert found.status == 0
    return -float(found.fun) + end_gbp * (energy - one.least_kwh) / per_service


@pytest.mark.parametrize("seed", range(4))
def test_a_known_future_is_worth_what_a_linear_programme_says(seed: int) -> None:
    rng = np.random.default_rng(seed)
    T = 7
    out = [False, *(rng.random(T - 1) < 0.5)]
    load = rng.uniform(5.0, 20.0, (T, 2))
    pv = rng.uniform(0.0, 30.0, T) * (rng.random(T) < 0.5)
    # Without a price on curtailment: the programme could burn a surplus in the battery.
    known = ahead(load, pv, price=rng.uniform(0.1, 0.6, T), lambda_curt=0.0)
    one = fleet(20.0)
    belief = _of_path(out)
    assert belief.certain
    value = stored_value(belief, one, known, VOLL, lambda e: 0.2 * (e - one.least_kwh))
    behind = ahead(load[1:], pv[1:], price=known.price_gbp_per_kwh[1:], lambda_curt=0.0)
    scale = known.kwh_per_service / behind.kwh_per_service
    behind_gbp = replace_prices(behind, scale)
    best = [
        _optimum(e, out[1:], behind_gbp, one, 0.2 / scale)
        for e in np.linspace(one.least_kwh, one.most_kwh, 6)
    ]
    found = [value.at(e) for e in np.linspace(one.least_kwh, one.most_kwh, 6)]
    assert np.array(found) == pytest.approx(
        np.array(best) - best[0], abs=0.02 * np.ptp(best) + 0.01
    )


def replace_prices(known: Ahead, scale: float) -> Ahead:
    """The same with prices such that a weighted customer hour costs what it did."""
    price = known.price_gbp_per_kwh / scale
    return ahead(known.load_kw, known.pv_kw, price=price, lambda_curt=known.lambda_curt)


def _of_path(out: list[bool]) -> OutageBelief:
    """A belief of zeros and ones: announced outages at their steps."""
    edges = np.flatnonzero(np.diff([*map(int, out), 0]))
    begins = [i + 1 for i in edges if not out[i]]
    ends = [i + 1 for i in edges if out[i]]
    onset = np.zeros((len(begins), len(out)))
    duration = np.zeros((len(begins) + 1, len(out) + 1))
    duration[0, 0] = 1.0
    for row, (begin, end) in enumerate(zip(begins, ends, strict=True)):
        onset[row, begin] = 1.0
        duration[row + 1, end - begin - 1] = 1.0
    return OutageBelief(onset, duration, 0.0)


def test_steps_of_any_length_agree() -> None:
    """Quarter hours and hours of an outage that lasts are worth the same from one o'clock on."""
    load = np.array([[10.0, 12.0]] * 12)
    update = warned(0, onset_likely=0, duration_p10_h=2, duration_p50_h=4, duration_p90_h=8)
    found = []
    for dt_h in (1.0, 0.25):
        now = NOON + (1.0 - dt_h) * HOUR
        n_steps = round(11 / dt_h) + 1
        belief = OutageOutlook([update], NEVER, dt_h).at(now, n_steps, [SeenOutage(NOON)])
        loads = np.repeat(load, round(1 / dt_h), axis=0)[:n_steps]
        known = ahead(loads, np.zeros(n_steps), dt_h=dt_h)
        value = stored_value(belief, fleet(), known, VOLL, nothing)
        found.append([value.at(e) for e in (30.0, 60.0, 90.0)])
    assert found[0] == pytest.approx(found[1], rel=0.06)


def test_outages_that_overlap_are_worth_what_one_that_spans_them_is() -> None:
    known = ahead(np.full((6, 2), 10.0), np.zeros(6))
    worth = []
    for spans in ([(1, 2), (2, 3)], [(1, 3), (1, 4)], [(1, 1), (2, 3)], [(1, 4)]):
        onset, duration = np.zeros((len(spans), 6)), np.zeros((len(spans) + 1, 6))
        for row, (begin, length) in enumerate(spans):
            onset[row, begin] = duration[row + 1, length - 1] = 1.0
        belief = OutageBelief(onset, duration, hazard=0.0)
        assert belief.out_probability.tolist() == [0, 1, 1, 1, 1, 0]
        worth.append(stored_value(belief, fleet(), known, 20.0, nothing).service)
    for other in worth[:-1]:
        assert other == pytest.approx(worth[-1])


def test_functions_are_made_concave() -> None:
    rng = np.random.default_rng(0)
    values = np.cumsum(rng.normal(0.3, 1.0, 40))
    above = concave_above(values)
    assert (above >= values - 1e-12).all()
    assert (np.diff(above, 2) <= 1e-9).all()
    assert concave_above(above) == pytest.approx(above)
