from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.support.refusals import refusal
from vppres.io.find import load_scenario
from vppres.outlook.outlook import SeenOutage
from vppres.scenario.outage_warnings import OutageStatistics, OutageWarning
from vppres.studies.estimate_scores import EstimateScores
from vppres.studies.warning_scores import WarnedOutage, WarningScores

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


def of_pairs(*pairs: WarnedOutage) -> WarningScores:
    return WarningScores(pairs, (), EstimateScores.of([], []))


def test_what_came_by_what_was_said() -> None:
    scores = of_pairs(
        pair(0.7, 4.0), pair(0.7, None), pair(0.7, 2.0), pair(0.1, None), pair(None, 3.0)
    )
    table = scores.reliability
    assert table["warnings"].tolist() == [1, 3]
    assert table["said"].tolist() == pytest.approx([0.1, 0.7])
    assert table["came"].tolist() == pytest.approx([0.0, 2 / 3])
    # 1.96 sqrt(.7 .3 / 3) = .519
    assert table["low"].tolist() == pytest.approx([0.0, 0.7 - 0.5186], abs=1e-3)
    assert scores.brier == pytest.approx((2 * 0.09 + 0.49 + 0.01) / 4)


def test_no_warning_says_nothing() -> None:
    assert of_pairs().reliability.empty
    assert np.isnan(of_pairs().brier)
    assert of_pairs(pair(0.5, None)).duration_pit.size == 0


def test_lengths_lie_where_the_quantiles_say() -> None:
    scores = of_pairs(*(pair(1.0, hours) for hours in (2.0, 4.0, 8.0)))
    np.testing.assert_allclose(scores.duration_pit, [0.1, 0.5, 0.9])


def test_what_is_drawn_as_said_is_evenly_spread() -> None:
    rng = np.random.default_rng(1)
    spread = np.log(2.0) / 1.2815515655446004
    lengths = 4.0 * np.exp(spread * rng.standard_normal(2000))
    scores = of_pairs(*(pair(1.0, h) for h in lengths))
    count, _ = np.histogram(scores.duration_pit, 5, (0.0, 1.0))
    assert (np.abs(count / 2000 - 0.2) < 0.04).all()


HOUR = pd.Timedelta(hours=1)


def message(ago_h: float, probability: float, onset: pd.Timestamp = NOON) -> OutageWarning:
    """A message some hours before an onset."""
    return OutageWarning(onset - ago_h * HOUR, onset_likely=onset, probability=probability)


def scored(messages: list[OutageWarning], *outages: tuple[float, float]) -> WarningScores:
    """Messages, and outages from some hour after noon to another one."""
    seen = [SeenOutage(NOON + start * HOUR, NOON + end * HOUR) for start, end in outages]
    return WarningScores.of(messages, seen, 1.0)


def said_and_came(scores: WarningScores) -> list[tuple[float | None, bool]]:
    return [(pair.warning.probability, pair.came is not None) for pair in scores.pairs]


def test_the_last_message_before_the_outage_counts() -> None:
    # The message of the afternoon was issued in the outage: it says nothing of whether it comes.
    scores = scored([message(9, 0.3), message(2, 0.8), message(-1, 1.0)], (0, 3))
    assert said_and_came(scores) == [(0.8, True)]
    assert scores.unannounced == ()


def test_an_outage_far_from_the_announced_time_is_unannounced() -> None:
    scores = scored([message(9, 0.3)], (8, 9))
    assert said_and_came(scores) == [(0.3, False)]
    assert len(scores.unannounced) == 1


def test_an_outage_first_announced_while_it_lasts_scores_nothing_and_is_told() -> None:
    scores = scored([message(-1, 1.0)], (0, 3))
    assert scores.pairs == ()
    assert len(scores.unannounced) == 1
    assert scores.late == 1
    assert scored([message(4, 0.0)]).late == 0  # an all-clear of nothing


def test_an_all_clear_is_believed_and_may_be_wrong() -> None:
    assert said_and_came(scored([message(9, 0.6), message(4, 0.0)])) == [(0.0, False)]
    assert said_and_came(scored([message(9, 0.6), message(4, 0.0)], (0, 2))) == [(0.0, True)]


def test_messages_of_one_name_speak_of_one_outage_after_the_other() -> None:
    tomorrow = NOON + 24 * HOUR
    messages = [message(6, 0.7), message(6, 0.4, tomorrow), message(1, 0.5, tomorrow)]
    scores = scored(messages, (0, 2))
    assert said_and_came(scores) == [(0.7, True), (0.5, False)]
    # Said .7 and .5, came 1 and 0: (.09 + .25) / 2 against .5 each time: .25.
    assert scores.brier == pytest.approx(0.17)
    assert scores.brier_of_share == pytest.approx(0.25)


def test_a_scenario_with_warnings_scores_its_own() -> None:
    assert WarningScores.of_scenario(load_scenario("uk-heatwave-2022")) is None


def test_files_of_warnings_and_outages(tmp_path: Path) -> None:
    warnings, outages = tmp_path / "warnings.csv", tmp_path / "outages.csv"
    warnings.write_text(
        "issued_at,outage,onset_likely,probability,duration_p10_h,duration_p50_h,duration_p90_h\n"
        "2022-07-19T06:00Z,a,2022-07-19T12:00Z,0.7,2,4,8\n"
    )
    outages.write_text("start,end\n2022-07-19T12:00Z,2022-07-19T20:00Z\n")
    scores = WarningScores.of_files(warnings, outages)
    assert said_and_came(scores) == [(0.7, True)]
    assert scores.summary()["duration_pit"] == pytest.approx([0.9])


@pytest.mark.parametrize(("rows", "words"), [
    ("2022-07-19T12:00Z,2022-07-19T11:00Z\n", "outages.csv, row 2, end"),
    ("noon,2022-07-19T11:00Z\n", "outages.csv, row 2, start"),
    ("2022-07-19T12:00Z,2022-07-19T15:00Z\n2022-07-19T14:00Z,2022-07-19T16:00Z\n",
        "outages.csv, row 3, start"),
])  # fmt: skip
def test_outages_that_cannot_be(tmp_path: Path, rows: str, words: str) -> None:
    warnings, outages = tmp_path / "warnings.csv", tmp_path / "outages.csv"
    warnings.write_text("issued_at,onset_likely\n2022-07-19T06:00Z,2022-07-19T12:00Z\n")
    outages.write_text("start,end\n" + rows)
    assert words in refusal(WarningScores.of_files, warnings, outages)


def test_estimates_of_restoration_are_learned_from_what_came() -> None:
    """Ten outages of four hours; of each an early estimate of 2 h, later one, and a notice."""
    hour = pd.Timedelta(hours=1)
    outages, messages = [], []
    for day in range(10):
        start = NOON + pd.Timedelta(days=day)
        outages.append(SeenOutage(start, start + 4 * hour))
        name = f"INC-{day}"
        later_h = 4.0 if day < 8 else 8.0
        messages += [
            OutageWarning(start + 0.5 * hour, name, duration_p50_h=2.0),
            OutageWarning(start + 2 * hour, name, restored_likely=start + later_h * hour),
            OutageWarning(start + hour, name, restored_by=start + 2 * hour),
        ]
        if day < 7:
            messages.append(OutageWarning(start + 3 * hour, name, restored_by=start + 4 * hour))
    scores = WarningScores.of(messages, outages, 1.0).restoration
    table = scores.table.set_index("said")
    assert table.loc["up to 1 h", ["outages", "estimate_p50", "wrong"]].tolist() == [10, 2.0, 1.0]
    assert table.loc["up to 4 h", "wrong"] == table.loc["all", "wrong"] == pytest.approx(0.2)
    assert table.loc["all", ["estimate_p10", "estimate_p50", "estimate_p90"]].tolist() == [
        pytest.approx(0.5),
        1.0,
        1.0,
    ]
    # Of thirty other hours ten had a notice in vain.
    expected = {"notice_h": 1.0, "notice_share": 0.7, "notice_false_share": 0.33}
    assert {name: scores.learned[name] for name in expected} == expected
    OutageStatistics(**scores.learned)  # as it may be written
    assert EstimateScores.of(messages, outages[:3]).learned == {}
