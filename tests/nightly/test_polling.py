"""A few seconds of ``experiments.studies.polling``: the client, and that everybody is answered."""

from __future__ import annotations

import pytest

from experiments.studies import polling


@pytest.mark.nightly
def test_all_are_answered_beside_steps() -> None:
    # Longer than the pace of those who post, of whom each begins at a random moment.
    found = polling.study(clients=8, posting=2, seconds=6.0)
    assert set(found["ms"]) == {*polling.LOOKING, "POST /v1/telemetry", "POST /v1/steps"}
    assert all(each["count"] > 0 for each in found["ms"].values())
    assert 0.0 < found["service_processor_share"] < 2.0
