"""The report in a real browser: nothing fails, nothing is fetched, the diagram and charts work."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.support.made_up_runs import SECTIONS_OF_A_DAY, day_run, day_scenario
from vppres.report.run_folder import write_run

sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

BROWSER = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)
pytestmark = pytest.mark.skipif(BROWSER is None, reason="no chromium or chrome on the path")

LOCAL = ("file:", "data:", "blob:")
WORST = 17  # of the made-up day: the last step of the outage serves the least
DESKTOP = {"width": 1280, "height": 900}


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=BROWSER, args=["--no-sandbox"])
        yield browser
        browser.close()


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


def test_charts_take_the_place_of_static_figures(opened: tuple[Any, list[str], list[str]]) -> None:
    page = opened[0]
    assert page.locator(".plot .main-svg").count() >= 3
    replaced = page.locator("figure.replaced")
    assert replaced.count() == 4
    assert not any(replaced.nth(i).is_visible() for i in range(4))


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
    cursors = "all => all.map(one => one.layout.shapes[0].x0)"
    assert set(page.locator(".plot").evaluate_all(cursors)) == {"2022-07-19T03:00:00"}
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
    chart = page.locator("#chart-energy")
    chart.scroll_into_view_if_needed()
    box = chart.locator(".nsewdrag").first.bounding_box()
    page.mouse.move(box["x"] + box["width"] * 10.02 / 24, box["y"] + box["height"] / 2)
    page.wait_for_timeout(200)
    page.mouse.down()
    page.mouse.up()
    page.wait_for_function("document.getElementById('step-slider').value === '10'")


def test_zooms_are_tied(opened: tuple[Any, list[str], list[str]]) -> None:
    page = opened[0]
    page.evaluate(
        "Plotly.relayout('chart-energy', {'xaxis.range[0]': '2022-07-19T06:00:00',"
        " 'xaxis.range[1]': '2022-07-19T12:00:00'})"
    )
    page.wait_for_function(
        "document.getElementById('chart-grid').layout.xaxis.range[0].startsWith('2022-07-19T06:00')"
    )
    page.evaluate("Plotly.relayout('chart-grid', {'xaxis.autorange': true})")
    page.wait_for_function(
        "document.getElementById('chart-energy').layout.xaxis.range[0]"
        ".startsWith('2022-07-19T00:00')"
    )


def test_paper_shows_static_figures_and_the_worst_step(
    opened: tuple[Any, list[str], list[str]],
) -> None:
    page = opened[0]
    show(page, 2)
    page.evaluate("window.dispatchEvent(new Event('beforeprint'))")
    page.emulate_media(media="print")
    assert page.locator("#step-words").inner_text().startswith(f"19 Jul {WORST}:00 UTC")
    assert not page.locator(".plot").first.is_visible()
    assert page.locator("figure.replaced").first.is_visible()
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
    assert page.locator("figure.replaced").first.is_visible()
    assert page.locator("#step-words").inner_text().startswith(f"19 Jul {WORST}:00 UTC: outage;")
    assert page.locator("#one-line .tile.s2").count() > 0
    context.close()


@pytest.mark.parametrize("width", [390, 1280])
def test_toolbars_cover_no_legend_and_no_name(browser: Any, report: Path, width: int) -> None:
    page = browser.new_page(viewport={"width": width, "height": 844})
    page.goto(report.as_uri())
    page.wait_for_selector("html[data-charts=drawn]", timeout=60_000)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    boxes = page.locator(".plot").evaluate_all(
        """all => all.map(plot => Object.fromEntries(["modebar", "legend", "xtitle", "nsewdrag"]
           .map(name => [name, plot.querySelector("." + name).getBoundingClientRect()])))"""
    )
    for box in boxes:
        assert box["modebar"]["bottom"] <= box["nsewdrag"]["top"]
        assert box["xtitle"]["bottom"] <= box["legend"]["top"]
    page.close()
