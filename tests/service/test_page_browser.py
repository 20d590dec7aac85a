"""The page to watch in a real browser: what it says, by whom it can be used, what it asks for."""

from __future__ import annotations

import json
import pickle
import subprocess
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from tests.support import live_service, switching_service
from tests.support.browser import listening
from tests.support.live_service import decide
from tests.support.tiny_day import tiny_scenario
from vppres.day.options import RunOptions
from vppres.service.access import Access, new_token
from vppres.service.clock import SetClock
from vppres.service.http.app import make_app
from vppres.service.http.serve import opened
from vppres.service.operation.runner import Runner
from vppres.service.operation.site import Service
from vppres.service.replay import explainer
from vppres.service.replay.explanations import explained
from vppres.service.storage.records import Reading, seconds

HOUR = pd.Timedelta("1h")
NIGHT = pd.Timestamp("2026-10-25T00:00Z")
"""One in the morning of British Summer Time: in an hour it is one o'clock again."""
DESKTOP = {"width": 1440, "height": 900}
PHONE = {"width": 390, "height": 844}
DARK = {"type": "outage", "source": "operator", "start": "2026-10-25T01:00:00Z", "end": None}


def site() -> Any:
    """A day of hours in London, with names that a page must not take for its own."""
    day = live_service.site(tiny_scenario())
    london = replace(day.grid, zone="Europe/London")
    return replace(day, grid=london, title="Docks & <b>Harbour</b>")


@pytest.fixture(scope="module")
def watched(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Runner, str]]:
    """A service after three quiet hours, an outage announced for the next one."""
    options = RunOptions(horizon_h=3.0, isolate=False)
    folder = tmp_path_factory.mktemp("watched")
    with opened(Service(site(), options), folder, SetClock(NIGHT - 2 * HOUR)) as runner:
        runner.store.put_events({"storm": DARK}, NIGHT, "test")
        for hour in (-2, -1, 0):
            decide(runner, NIGHT + hour * HOUR)
        with listening(make_app(runner, Access())) as address:
            yield runner, address


class Watcher:
    """An open page, with what it said to the console and every address it asked for."""

    def __init__(self, browser: Any, address: str, size: Any = DESKTOP, scheme: str = "light"):
        self.page = browser.new_page(viewport=size, color_scheme=scheme, reduced_motion="reduce")
        self.messages: list[str] = []
        self.addresses: list[str] = []
        self.page.on("console", lambda message: self.messages.append(message.text))
        self.page.on("pageerror", lambda error: self.messages.append(str(error)))
        self.page.on("request", lambda request: self.addresses.append(request.url))
        self.page.goto(address)
        self.address = address

    def __enter__(self) -> Watcher:
        return self

    def __exit__(self, *_: object) -> None:
        self.page.close()

    def text(self, selector: str) -> str:
        return " ".join(self.page.locator(selector).inner_text().replace("\u00a0", " ").split())

    def wait_for(self, selector: str, words: str) -> None:
        self.page.locator(selector, has_text=words).wait_for(timeout=40_000)


@pytest.fixture(scope="module")
def calm(browser: Any, watched: tuple[Runner, str]) -> Iterator[Watcher]:
    with Watcher(browser, watched[1]) as watcher:
        watcher.page.wait_for_selector("#chart svg")
        yield watcher


def test_the_first_thing_to_see_is_how_it_stands(calm: Watcher) -> None:
    assert calm.text("#verdict-words") == "All 3 customers supplied."
    # The doubled hour: the outage begins at one o'clock, in the other zone.
    assert calm.text("#verdict-more") == "Outage announced from 01:00 GMT, in 60 min."
    assert calm.text("#clock") == "Sun 25 Oct, 01:00 BST"
    assert calm.text("#site") == "Docks & <b>Harbour</b>"
    assert calm.text("#attention-list") == "● No action needed."
    assert calm.text("#mode") == "Mode: auto"
    assert calm.text("#sources-table").endswith("scada 0 s ago ● 2 readings in time")
    assert calm.text("#events-list").startswith("Outage from 01:00 GMT, end unknown storm")
    assert calm.page.title() == "● All 3 customers supplied. tiny"


def test_figures_are_those_of_the_plan(calm: Watcher, watched: tuple[Runner, str]) -> None:
    plan = watched[0].last
    assert plan is not None
    figures = calm.text("#figures")
    assert figures.startswith(
        "Customers supplied 3 of 3 critical 1 of 1 · high 1 of 1 · low 1 of 1"
    )
    assert "80 kWh, 50%" in figures  # 100 and 60 kWh, half full
    assert "56 kWh above the lower limit" in figures  # at 0.15
    assert f"{plan['expected']['import_kw']:.0f} kW no limit" in figures
    assert f"{plan['expected']['v_min_pu']:.3f} pu" in figures
    calm.page.click("#outlook summary")
    rows = calm.page.locator("#chart-table tbody tr")
    assert rows.count() == 6  # three that were, three ahead
    assert rows.nth(2).inner_text().split("\t")[:2] == ["01:00", "ok"]
    assert rows.nth(3).inner_text().split("\t")[:2] == ["01:00 GMT", "planned"]
    assert rows.nth(3).inner_text().split("\t")[-1] == "0"
    axis = calm.page.locator("#chart text").all_text_contents()
    assert axis.count("01:00") == 1 and axis.count("01:00 GMT") == 1


def test_the_chart_is_read_and_drawn_out_as_in_a_report(calm: Watcher) -> None:
    page, panel = calm.page, calm.page.locator("#chart svg.time")

    def fourth_hour() -> tuple[float, float]:
        """A place in the fourth of six hours, while all are shown."""
        box = page.locator("#chart > svg").bounding_box()
        left, width = (float(panel.get_attribute(name)) for name in ("x", "width"))
        return box["x"] + left + width * 3.5 / 6, box["y"] + 60

    def shown() -> float:
        return float(panel.get_attribute("viewBox").split()[2])

    page.locator("#chart .zoom").scroll_into_view_if_needed()
    page.mouse.move(*fourth_hour())
    words = calm.text("#chart .readings")
    assert words.startswith("Sun 25 Oct 01:00 GMT"), words
    assert "planned" in words and "stored" in words
    whole = shown()
    page.locator("#chart .zoom button", has_text="Outage").press("Enter")
    assert shown() < 0.9 * whole
    page.mouse.dblclick(*fourth_hour())
    assert shown() == whole
    page.mouse.move(0, 0)


def test_a_button_that_is_pressed_while_news_come_does_what_it_says(calm: Watcher) -> None:
    page, panel = calm.page, calm.page.locator("#chart svg.time")

    def newer(route: Any) -> None:
        answer = route.fetch()
        overview = answer.json()
        overview["plan"]["ahead"]["import_kw"][0] = 4321.0
        overview["plan"]["ahead"]["served"]["high"][0] = 11 / 12
        route.fulfill(response=answer, json=overview)

    whole, off = panel.get_attribute("viewBox"), page.locator("#chart rect.off")
    before = off.count()
    page.locator("#chart .zoom button", has_text="Outage").hover()
    page.mouse.down()
    page.route("**/v1/overview", newer)
    page.locator("#chart-table", has_text="4,321").wait_for(state="attached")
    page.mouse.up()
    off.nth(before).wait_for(state="attached")
    heights = off.evaluate_all("all => all.map(one => Number(one.getAttribute('height')))")
    assert min(heights) == 5.0  # of the one of twelve
    assert panel.get_attribute("viewBox") != whole
    page.unroute("**/v1/overview")
    page.locator("#chart .zoom button", has_text="Whole").press("Enter")
    assert panel.get_attribute("viewBox") == whole
    page.mouse.move(0, 0)


CONTRAST = (Path(__file__).parents[1] / "support" / "contrast.js").read_text(encoding="utf-8")


@pytest.mark.parametrize(("size", "scheme"), [
    (DESKTOP, "light"),
    (PHONE, "dark"),
    pytest.param(DESKTOP, "dark", marks=pytest.mark.nightly),
    pytest.param(PHONE, "light", marks=pytest.mark.nightly),
])  # fmt: skip
def test_all_text_stands_out_and_everything_has_a_name(
    browser: Any, watched: tuple[Runner, str], size: dict[str, int], scheme: str
) -> None:
    """WCAG AA: 4.5 to 1 for text, 3 to 1 for large text; names for what is used."""
    with Watcher(browser, watched[1], size, scheme) as watcher:
        page = watcher.page
        page.wait_for_selector("#chart svg")
        for level in ("fine", "warning", "alarm"):
            page.evaluate(
                "level => { document.getElementById('verdict').className = level; }", level
            )
            assert page.evaluate(CONTRAST) == []
        assert page.evaluate("document.documentElement.scrollWidth") <= size["width"]
        page.check("input[value=manual]")
        page.focus("#mode-change")
        boxes = "all => all.map(one => one.getBoundingClientRect().height)"
        controls = "button:visible, select:visible, #mode-reason"
        assert min(page.locator(controls).evaluate_all(boxes)) >= 44
        unnamed = "all => all.filter(one => !one.labels?.length && !one.textContent.trim()).length"
        assert page.locator(f"{controls}, input:visible").evaluate_all(unnamed) == 0
        images = "all => all.filter(one => !one.getAttribute('aria-label')).length"
        assert page.locator("[role=img]").evaluate_all(images) == 0
        assert page.locator("h1").count() == 1


def test_the_mode_is_changed_by_keyboard_and_only_when_confirmed(
    browser: Any, watched: tuple[Runner, str]
) -> None:
    runner, address = watched
    with Watcher(browser, address) as watcher:
        page = watcher.page
        page.wait_for_selector("#modes input")
        page.keyboard.press("Tab")
        assert page.evaluate("document.activeElement.id") == "mode"
        page.keyboard.press("Enter")
        assert page.evaluate("document.activeElement.value") == "auto"
        page.keyboard.press("ArrowUp")  # from the first to the last: off
        assert page.evaluate("document.activeElement.value") == "off"
        for _ in range(2):
            page.keyboard.press("Tab")
        page.keyboard.type("work on the line")
        page.keyboard.press("Tab")
        page.keyboard.press("Enter")
        watcher.wait_for("#confirm-title", "Change the mode to off?")
        assert "devices use default set-points" in watcher.text("#confirm-words")
        page.keyboard.press("Enter")  # what has the focus changes nothing
        page.wait_for_selector("#confirm", state="hidden")
        page.wait_for_selector("input[value=auto]:checked")  # told after the question is gone
        assert runner.mode["mode"] == "auto"
        assert page.evaluate("document.activeElement.id") == "mode-change"

        def choose_off_again() -> None:
            for _ in range(3):
                page.keyboard.press("Shift+Tab")
            page.keyboard.press("ArrowUp")
            for _ in range(3):
                page.keyboard.press("Tab")
            page.keyboard.press("Enter")
            watcher.wait_for("#confirm-title", "Change the mode to off?")

        choose_off_again()
        page.keyboard.press("Escape")
        page.wait_for_selector("#confirm", state="hidden")
        page.wait_for_selector("input[value=auto]:checked")  # told after the question is gone
        assert runner.mode["mode"] == "auto"
        choose_off_again()
        page.keyboard.press("Tab")
        page.keyboard.press("Enter")
        watcher.wait_for("#mode-said", "The mode is off.")
        mode = runner.mode
        assert (mode["mode"], mode["until"], mode["reason"]) == ("off", None, "work on the line")
        watcher.wait_for("#mode", "Mode: off")
        watcher.wait_for("#verdict-words", "Switched off by the operator")
    runner.store.put_setting("mode", {"mode": "auto", "until": None, "reason": ""}, NIGHT, "test")


def test_nothing_fails_and_nothing_leaves_the_machine(calm: Watcher) -> None:
    assert calm.messages == []
    assert [one for one in calm.addresses if not one.startswith(calm.address)] == []
    assert f"{calm.address}v1/overview" in calm.addresses
    # The browser itself would stop what a stranger smuggles in.
    script = (
        "document.body.insertAdjacentHTML('beforeend', '<img src=x onerror=\"window.evil = 1\">')"
    )
    calm.page.evaluate(script)
    assert calm.page.evaluate("window.evil") is None
    calm.messages.clear()


def test_tokens_are_asked_for_and_kept_in_memory_alone(
    browser: Any, watched: tuple[Runner, str]
) -> None:
    secret, token = new_token("panel:read")
    with (
        listening(make_app(watched[0], Access([token]))) as address,
        Watcher(browser, address) as watcher,
    ):
        page = watcher.page
        watcher.wait_for("#token h2", "A token is needed")
        assert page.evaluate("document.activeElement.id") == "token-text"
        assert not page.locator("#watched").is_visible()
        page.keyboard.type("wrong")
        page.keyboard.press("Enter")
        watcher.wait_for("#token-words", "Give a token")
        page.fill("#token-text", secret)
        page.keyboard.press("Enter")
        watcher.wait_for("#verdict-words", "All 3 customers supplied.")
        page.check("input[value=off]")
        page.click("#mode-change")
        page.click("#confirm-yes")
        watcher.wait_for("#mode-said", "The mode was not changed. The token of panel has no scope")
        stored = "JSON.stringify([document.cookie, localStorage.length, sessionStorage.length])"
        assert json.loads(page.evaluate(stored)) == ["", 0, 0]
        assert not any(secret in one for one in watcher.addresses)
    assert watched[0].mode["mode"] == "auto"


def test_hold_must_have_an_end(browser: Any, watched: tuple[Runner, str]) -> None:
    runner, address = watched
    with Watcher(browser, address) as watcher:
        watcher.page.check("input[value=hold]")
        watcher.page.click("#mode-change")
        assert watcher.text("#confirm-words").endswith("For 1 hour, then auto.")
        watcher.page.click("#confirm-yes")
        watcher.wait_for("#mode-said", "The mode is hold.")
        assert runner.mode["until"] == "2026-10-25T01:00:00Z"
        watcher.wait_for("#attention-list", "Mode hold until 01:00 GMT.")
    runner.store.put_setting("mode", {"mode": "auto", "until": None, "reason": ""}, NIGHT, "test")


@pytest.mark.daily
def test_a_mode_that_another_set_since_is_not_replaced(
    browser: Any, watched: tuple[Runner, str]
) -> None:
    """The second of two operators is told so, and may ask again for what is shown then."""
    runner, address = watched
    auto = {"mode": "auto", "until": None, "reason": ""}
    with Watcher(browser, address) as watcher:
        for said in ("not changed. The mode has changed since.", "is off.", "is hold."):
            watcher.page.check("input[value=hold]" if "hold" in said else "input[value=off]")
            watcher.page.click("#mode-change")
            if "since" in said:
                runner.store.put_setting("mode", {**auto, "reason": "crew"}, NIGHT, "another")
            watcher.page.click("#confirm-yes")
            watcher.wait_for("#mode-said", said)
            assert runner.mode["mode"] == ("auto" if "since" in said else said[3:-1])
    runner.store.put_setting("mode", auto, NIGHT, "test")


def test_a_change_without_an_answer_may_have_been_made(
    browser: Any, watched: tuple[Runner, str]
) -> None:
    """The answer is lost on its way; the change was made, and the page shows it."""
    runner, address = watched
    with Watcher(browser, address) as watcher:

        def lose(route: Any) -> None:
            route.fetch()
            route.abort()

        watcher.page.route("**/v1/mode", lose)
        watcher.page.check("input[value=off]")
        watcher.page.click("#mode-change")
        watcher.page.click("#confirm-yes")
        watcher.wait_for("#mode-said", "no answer. The change may have been made")
        watcher.wait_for("#mode", "Mode: off")
        assert watcher.page.is_checked("input[value=off]")
    runner.store.put_setting("mode", {"mode": "auto", "until": None, "reason": ""}, NIGHT, "test")


@pytest.mark.nightly
def test_set_points_are_given_by_hand(browser: Any, watched: tuple[Runner, str]) -> None:
    runner, address = watched
    with Watcher(browser, address, PHONE) as watcher:
        page = watcher.page
        page.check("input[value=manual]")
        page.click("#mode-change")
        watcher.wait_for("#mode-said", "Add a set-point first.")
        page.select_option("#manual-device", label="hospital")
        page.click("#manual-add")
        page.select_option("#manual-device", label="big")
        page.fill("#manual-power", "-60")
        page.click("#manual-add")
        assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
        page.click("#mode-change")
        watcher.wait_for("#mode-said", "is beyond its rating of 50 kW")
        page.check("input[value=manual]")
        page.fill("#manual-power", "-20.5")
        page.click("#manual-add")
        page.click("#mode-change")
        page.wait_for_selector("#confirm[open]")
        words = "set-points are used. hospital disconnected; big -20.5 kW. For 1 hour, then auto."
        assert watcher.text("#confirm-words").endswith(words)
        page.click("#confirm-yes")
        watcher.wait_for("#mode-said", "The mode is manual.")
        asked = [(one["asset"], one["p_kw"], one["served"]) for one in runner.mode["setpoints"]]
        assert asked == [("hospital", None, False), ("big", -20.5, None)]
    runner.store.put_setting("mode", {"mode": "auto", "until": None, "reason": ""}, NIGHT, "test")


def test_an_outage_that_is_believed_is_told_before_a_plan_knows_of_it(
    browser: Any, tmp_path: Path
) -> None:
    onset = {"start": "2026-10-25T02:00:00Z", "resolution": "PT3600S", "probabilities": [1.0]}
    believed = {"type": "outage_belief", "source": "op", "probability": 0.6, "onset": onset}
    options = RunOptions(horizon_h=3.0, isolate=False, outages="belief")
    with opened(Service(site(), options), tmp_path, SetClock(NIGHT)) as runner:
        decide(runner, NIGHT)
        runner.store.put_events({"storm": believed}, NIGHT, "test")
        with (
            listening(make_app(runner, Access())) as address,
            Watcher(browser, address) as watcher,
        ):
            watcher.wait_for("#verdict-words", "All 3 customers supplied.")
            assert watcher.text("#verdict-more") == "Outage possible: 60%, from 02:00 GMT."


def test_an_outage_and_what_goes_wrong_in_it(
    browser: Any, watched: tuple[Runner, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The last test: it goes on to the next hour, and ends with a service that is gone."""
    runner, _ = watched
    said = []
    made = threading.Event()

    def explained_here(asked: bytes) -> subprocess.CompletedProcess[bytes]:
        """The explanation without the start of a process for it."""
        said.append(explained(pickle.loads(asked)))
        made.set()
        return subprocess.CompletedProcess([], 0, json.dumps(said[-1]).encode())

    monkeypatch.setattr(explainer, "_asked", explained_here)
    decide(runner, NIGHT + 2 * HOUR, soc=0.17)
    assert runner.last
    off = [one["asset"] for one in runner.last["setpoints"] if one.get("served") is False]
    runner.last["solve"]["shorter"] = "shop waits while homes have 5.0 kW, enough for 7 of 60 min"
    with listening(make_app(runner, Access())) as address:
        watcher = Watcher(browser, address, PHONE, "dark")
        page = watcher.page
        page.clock.install()
        page.goto(address)
        watcher.wait_for("#verdict-words", "Outage, end unknown")
        for name in off:
            assert name in watcher.text("#off-list")
        # Why, in the service's own words, as soon as they are worked out.
        assert made.wait(100.0)
        words = {r["words"] for r in said[0]["reasons"] if r["asset"] in off}
        for sentence in words:
            shown = sentence.removeprefix("Not supplied: ").split("; ")[0].rstrip(".")
            row = page.locator("#off-list", has_text=shown[1:])
            row.wait_for(timeout=100_000)
        assert words and "planned:" not in watcher.text("#off-list")
        assert said[0]["step"]["words"] in watcher.text("#off-list")
        assert "a higher one waits: shop waits while homes have 5.0 kW" in watcher.text("#off-list")
        attention = watcher.text("#attention-list")
        assert "Less than 10% of the usable energy is left, and there is no grid." in attention
        assert "missed" in watcher.text("#steps-list")
        page.click("text=Acknowledge >> nth=0")
        watcher.wait_for("#attention-list", "by anybody here")
        assert page.locator("#chart .bad").count() == 1
        assert page.locator("#chart .outage").count() >= 2
        assert page.evaluate(CONTRAST) == []
    page.clock.fast_forward(30_000)
    watcher.wait_for("#verdict-words", "No contact with the service since 02:00.")
    assert watcher.text("#verdict-more").startswith("Data below are from that time. Set-points")
    assert "Set-points hold until 03:06" in watcher.text("#verdict-more")
    page.clock.fast_forward("01:10:00")
    watcher.wait_for(
        "#verdict-more", "Set-points ended at 03:06. Devices keep their last state, and how long"
    )
    assert page.evaluate(CONTRAST) == []
    page.close()


@pytest.mark.daily
def test_an_operation_of_a_switch_is_confirmed_on_the_page(browser: Any, tmp_path: Path) -> None:
    """It is confirmed with a second click, and what it waits for is shown then."""
    noon = live_service.NOON
    service = Service(switching_service.switched(), live_service.HERE, paced=True)
    with opened(service, tmp_path, SetClock(noon)) as runner:
        decide(runner, noon)
        states = {"t": 0.0, "s": 1.0}.items()
        read = [Reading(one, "closed", seconds(noon), "scada", 60, state) for one, state in states]
        runner.store.write_readings(read, noon)
        with listening(make_app(runner, Access())) as address, Watcher(browser, address) as watcher:
            watcher.wait_for("#verdict-words", "supplied")
            assert not watcher.page.locator("#switching").is_visible()
            asked = {"closed": {"t": True, "s": False}}
            runner.store.put_setting("switching", asked, noon, "test")
            watcher.wait_for("#switching-next", "Confirm: close t")
            assert watcher.text("#switching-list").startswith("close t: ")
            # The order is put anew before the page has seen it, with the same next operation.
            overview = "**/v1/overview"
            old = watcher.page.evaluate("fetch('v1/overview').then((answer) => answer.text())")
            watcher.page.route(overview, lambda route: route.fulfill(body=old))
            runner.store.put_setting("switching", {**asked, "reason": "agreed"}, noon, "another")
            watcher.page.click("#switching-next")
            watcher.page.click("#switching-yes")
            watcher.wait_for("#switching-said", "The switching has changed since.")
            assert not runner.store.setting("switching")[0].get("issued")
            watcher.page.unroute(overview)
            watcher.page.reload()
            watcher.wait_for("#switching-next", "Confirm: close t")
            watcher.page.click("#switching-next")
            watcher.page.click("#switching-yes")
            watcher.wait_for("#switching-words", "t has not yet read closed.")
            assert not watcher.page.locator("#switching-confirm").is_visible()
            assert runner.store.setting("switching")[0]["issued"]["switch"] == "t"
