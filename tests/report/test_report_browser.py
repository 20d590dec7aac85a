"""The report in a real browser: nothing fails, nothing is fetched, diagram and figures work."""

from __future__ import annotations

import itertools
import json
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.support.made_up_runs import SECTIONS_OF_A_DAY, day_run, day_scenario
from vppres.report.run_folder import write_run
from vppres.studies.compare import read_runs, render_comparison

LOCAL = ("file:", "data:", "blob:")
WORST = 17  # of the made-up day: the last step of the outage serves the least
DRAWINGS = "figure.plot .wide > svg"
DESKTOP = {"width": 1280, "height": 900}


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("browser") / "run"
    write_run(day_run(day_scenario()), folder)
    return folder / "report.html"


@pytest.fixture(scope="module")
def opened(browser: Any, report: Path) -> Iterator[tuple[Any, list[str], list[str]]]:
    """The page with its charts drawn, what the console said, and every address asked for."""
    page = browser.new_page(viewport=DESKTOP)
    messages: list[str] = []
    addresses: list[str] = []
    page.on("console", lambda message: messages.append(f"{message.type}: {message.text}"))
    page.on("pageerror", lambda error: messages.append(f"error: {error}"))
    page.on("request", lambda request: addresses.append(request.url))
    page.goto(report.as_uri())
    page.wait_for_selector("html[data-charts=drawn]", timeout=60_000)
    yield page, messages, addresses
    page.close()


def show(page: Any, step: int) -> None:
    page.locator("#step-slider").evaluate(
        "(slider, step) => { slider.value = step; slider.dispatchEvent(new Event('input')); }", step
    )


def test_all_sections_are_seen(opened: tuple[Any, list[str], list[str]]) -> None:
    page = opened[0]
    assert (
        page.locator("section").evaluate_all("all => all.map(one => one.id)") == SECTIONS_OF_A_DAY
    )
    heights = page.locator("section").evaluate_all("all => all.map(one => one.offsetHeight)")
    assert min(heights) > 100
    assert page.evaluate("document.documentElement.scrollWidth") <= DESKTOP["width"]


def test_every_figure_is_drawn(opened: tuple[Any, list[str], list[str]]) -> None:
    page = opened[0]
    figures = page.locator(DRAWINGS)
    assert figures.count() == 8
    heights = figures.evaluate_all("all => all.map(one => one.getBoundingClientRect().height)")
    assert min(heights) > 100


def test_the_pointer_reads_values(opened: tuple[Any, list[str], list[str]]) -> None:
    page = opened[0]
    show(page, 0)
    point_at(page, 10)
    words = page.locator("#energy .readings").first.inner_text()
    assert words.startswith("19 Jul 10:00 UTC")
    assert "Stored energy (kWh) " in words
    assert "Price (GBP/kWh) " in words
    page.mouse.move(0, 0)
    page.wait_for_function(
        "document.querySelector('#energy .readings').innerText.startsWith('19 Jul 00:00')"
    )


def point_at(page: Any, step: float, section: str = "#energy", height: float = 0.5) -> None:
    """Put the pointer on a step of a section's first panel, which shows the whole day."""
    page.mouse.move(*place_in(page.locator(f"{section} svg.time").first, (step + 0.5) / 24, height))


def place_in(panel: Any, across: float, down: float) -> tuple[float, float]:
    """A place of a panel in the window, which is scrolled to it."""
    panel.scroll_into_view_if_needed()
    box = panel.evaluate("it => it.ownerSVGElement.getBoundingClientRect().toJSON()")
    x, y, width, height = (
        float(panel.get_attribute(name)) for name in ("x", "y", "width", "height")
    )
    return box["x"] + x + across * width, box["y"] + y + 2 + down * (height - 6)


def times_of(page: Any) -> list[str]:
    """Times that the axis of the first chart of energy names."""
    ticks = page.locator("#energy figure.plot").first.locator(".wide > svg > g:not([class]) > text")
    return list(ticks.all_text_contents())


def test_a_part_of_the_day_is_drawn_out_and_shown_whole_again(
    opened: tuple[Any, list[str], list[str]],
) -> None:
    page = opened[0]
    whole = times_of(page)
    assert whole[0] == "00:00"
    point_at(page, 9.0)
    page.mouse.down()
    point_at(page, 13.0)
    page.mouse.up()
    assert (times_of(page)[0], times_of(page)[-1]) == ("09:00", "14:00")
    point_at(page, 11.5)  # in the middle of the panel, of 09:00 to 14:00
    assert page.locator("#energy .readings").first.inner_text().startswith("19 Jul 11:00")
    page.mouse.dblclick(*place_in(page.locator("#energy svg.time").first, 0.5, 0.5))
    assert times_of(page) == whole
    page.locator("#service .zoom button", has_text="Outage").first.click()
    assert (times_of(page)[0], times_of(page)[-1]) == ("10:00", "20:00")
    page.locator("#service .zoom button", has_text="Whole").first.click()
    assert times_of(page) == whole


def test_the_pointer_reads_a_customer_a_bus_and_a_line(
    opened: tuple[Any, list[str], list[str]],
) -> None:
    page = opened[0]
    data = json.loads(page.locator("#diagram-data").text_content())
    rows = json.loads(page.locator("#service script").first.text_content())["rows"][0]
    point_at(page, WORST, "#service", 0.01)
    (first,) = rows["each"][0]
    on = {"1": "supplied", "0": "off supply"}[data["served"][WORST][first]]
    words = f"{data['customers'][first]} {on}, {data['kw'][WORST][first]} kW"
    assert words in page.locator("#service .readings").first.inner_text()
    page.mouse.move(0, 0)
    figure = page.locator("#network figure.plot").last
    figure.scroll_into_view_if_needed()
    for panel, words in ((0, "Bus "), (1, " to ")):
        page.mouse.move(*place_in(figure.locator("svg.time").nth(panel), 0.5, 0.5))
        said = figure.locator(".readings span").first.inner_text()
        assert words in said, said


def test_the_diagram_is_moved_and_zoomed_and_its_symbols_keep_their_size(
    opened: tuple[Any, list[str], list[str]],
) -> None:
    page = opened[0]

    def places() -> list[dict[str, float]]:
        found = page.locator("#one-line circle[data-voltage]").evaluate_all(
            "all => all.slice(0, 2).map(one => one.getBoundingClientRect().toJSON())"
        )
        return list(found)

    page.click("#whole")
    before = places()
    for _ in range(4):
        page.click("#closer")
    near = places()
    apart = [two["x"] - one["x"] for one, two in (before, near)]
    assert apart[1] > 2.0 * apart[0]
    assert near[0]["width"] == pytest.approx(20.0, abs=2.5)
    box = page.locator("#one-line").bounding_box()
    page.mouse.move(box["x"] + 300, box["y"] + 40)
    page.mouse.down()
    page.mouse.move(box["x"] + 250, box["y"] + 40)
    page.mouse.up()
    assert places()[0]["x"] == pytest.approx(near[0]["x"] - 50, abs=1.0)
    page.click("#whole")
    assert places() == before
    page.mouse.move(0, 0)


def test_the_diagram_starts_with_the_worst_step(opened: tuple[Any, list[str], list[str]]) -> None:
    page = opened[0]
    page.click("#step-worst")
    assert page.locator("#step-words").inner_text().startswith(f"19 Jul {WORST}:00 UTC: outage;")
    assert page.locator("#one-line .tile.s2").count() > 0
    assert "dead-grid" in page.locator("#one-line").get_attribute("class")


def test_the_slider_moves_the_diagram_and_the_charts(
    opened: tuple[Any, list[str], list[str]],
) -> None:
    page = opened[0]
    show(page, 3)
    assert page.locator("#step-words").inner_text().startswith("19 Jul 03:00 UTC: import ")
    assert page.locator("#one-line .tile.s2").count() == 0
    assert "dead-grid" not in page.locator("#one-line").get_attribute("class")
    words = page.locator(".readings strong").all_inner_texts()
    assert set(words) == {"19 Jul 03:00 UTC"}
    page.click("#step-forward")
    page.click("#step-forward")
    page.click("#step-back")
    assert page.locator("#step-slider").input_value() == "4"
    title = page.locator("#one-line circle[data-voltage='1'] title").text_content()
    assert title.startswith("Bus 2: 0.99")
    assert "c2 (" in title


def test_buttons_stop_at_the_ends_of_the_day(opened: tuple[Any, list[str], list[str]]) -> None:
    page = opened[0]
    show(page, 23)
    page.click("#step-forward")
    assert page.locator("#step-slider").input_value() == "23"


def test_a_click_on_a_chart_moves_the_diagram(opened: tuple[Any, list[str], list[str]]) -> None:
    page = opened[0]
    show(page, 0)
    point_at(page, 10)
    page.mouse.down()
    page.mouse.up()
    page.wait_for_function("document.getElementById('step-slider').value === '10'")


def test_paper_shows_the_same_figures_and_the_worst_step(
    opened: tuple[Any, list[str], list[str]],
) -> None:
    page = opened[0]
    show(page, 2)
    page.evaluate("window.dispatchEvent(new Event('beforeprint'))")
    page.emulate_media(media="print")
    assert page.locator("#step-words").inner_text().startswith(f"19 Jul {WORST}:00 UTC")
    assert page.locator(DRAWINGS).first.is_visible()
    assert not page.locator(".readings").first.is_visible()
    assert not page.locator(".cursor").first.is_visible()
    assert not page.locator("#step-slider").is_visible()
    page.emulate_media(media="screen")
    page.evaluate("window.dispatchEvent(new Event('afterprint'))")
    assert page.locator("#step-slider").input_value() == "2"


def test_it_prints_on_a4(opened: tuple[Any, list[str], list[str]]) -> None:
    pdf = opened[0].pdf(prefer_css_page_size=True)
    boxes = re.findall(rb"/MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", pdf)
    assert 4 <= len(boxes) <= 12
    for width, height in boxes:  # 210 x 297 mm in points
        assert (float(width), float(height)) == pytest.approx((595.3, 841.9), abs=1.0)


def test_nothing_fails_and_nothing_leaves_the_machine(
    opened: tuple[Any, list[str], list[str]],
) -> None:
    _, messages, addresses = opened
    assert messages == []
    assert [address for address in addresses if not address.startswith(LOCAL)] == []
    assert len([address for address in addresses if address.startswith("file:")]) == 1


def test_without_scripts_everything_is_still_there(browser: Any, report: Path) -> None:
    context = browser.new_context(java_script_enabled=False, viewport=DESKTOP)
    page = context.new_page()
    page.goto(report.as_uri())
    assert page.locator(DRAWINGS).first.is_visible()
    assert page.locator("#step-words").inner_text().startswith(f"19 Jul {WORST}:00 UTC: outage;")
    assert page.locator("#one-line .tile.s2").count() > 0
    context.close()


@pytest.mark.parametrize("width", [390, pytest.param(1280, marks=pytest.mark.nightly)])
def test_the_page_fits_the_window(browser: Any, report: Path, width: int) -> None:
    page = browser.new_page(viewport={"width": width, "height": 844})
    page.goto(report.as_uri())
    page.wait_for_selector("html[data-charts=drawn]")
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    page.close()


@pytest.mark.nightly
@pytest.mark.parametrize("width", [390, 1280])
def test_no_text_of_a_figure_leaves_it_or_covers_another(
    browser: Any, report: Path, width: int
) -> None:
    page = browser.new_page(viewport=DESKTOP | {"width": width})
    page.goto(report.as_uri())
    page.wait_for_selector("html[data-charts=drawn]")
    found = page.locator(DRAWINGS).evaluate_all(
        """all => all.map(svg => ({
             svg: svg.getBoundingClientRect(),
             texts: [...svg.querySelectorAll("text")].filter(text => text.checkVisibility()).map(text =>
               [text.textContent, text.getBoundingClientRect()])}))"""
    )
    for figure in found:
        assert figure["svg"]["right"] <= width
        for words, box in figure["texts"]:
            assert box["left"] >= figure["svg"]["left"], words
            assert box["right"] <= figure["svg"]["right"], words
        covered = [
            (one, other)
            for (one, a), (other, b) in itertools.combinations(figure["texts"], 2)
            if min(a["right"], b["right"]) - max(a["left"], b["left"]) > 1.0
            and min(a["bottom"], b["bottom"]) - max(a["top"], b["top"]) > 4.0
        ]
        assert covered == []
    page.close()


def test_charts_of_a_comparison_are_laid_out_for_a_phone(
    browser: Any, report: Path, tmp_path: Path
) -> None:
    """As wide as the window, with letters of their own size; nothing is said to the console."""
    shutil.copytree(report.parent, tmp_path / "other")
    runs = read_runs([report.parent, tmp_path / "other"])
    (tmp_path / "both.html").write_text(render_comparison(runs), encoding="utf-8")
    page = browser.new_page(viewport={"width": 390, "height": 844})
    messages: list[str] = []
    page.on("console", lambda message: messages.append(message.text))
    page.goto((tmp_path / "both.html").as_uri())
    sizes = page.locator(DRAWINGS).evaluate_all(
        "all => all.map(svg => [svg.viewBox.baseVal.width, svg.getBoundingClientRect().width])"
    )
    assert len(sizes) > 3
    assert all(drawn == shown and 300 < shown < 390 for drawn, shown in sizes)
    assert messages == []
    page.close()
