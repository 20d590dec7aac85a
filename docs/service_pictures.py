"""Pictures of the page to watch: ``python -m docs.service_pictures``.

The packaged day, rehearsed up to an outage, at the size of a control room's screen and of a phone.
They need Chromium, and playwright, which drives it.
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

from PIL import Image
from playwright.sync_api import sync_playwright

import vppres
from tests.support.browser import FLAGS, chromium, listening
from vppres.service.access import Access
from vppres.service.http.app import make_app
from vppres.service.http.serve import opened
from vppres.service.operation.runner import Runner
from vppres.service.operation.site import Service
from vppres.service.storage.records import Reading, seconds

FOLDER = Path(__file__).with_name("_static")
COLOURS = 96
"""They are enough for letters and flat areas, and halve the files."""
PATIENCE_MS = 120_000
"""For the reasons, which the service works out at the first request."""

OPTIONS = vppres.RunOptions(horizon_h=5.0, isolate=False)


def rehearse(runner: Runner, last: int) -> None:
    """Decide the steps up to one, batteries doing as they were told."""
    day = runner.scenario
    soc = dict(zip(day.batteries.id, day.batteries.soc_initial, strict=True))
    for time in day.grid.times[: last + 1]:
        heard = [Reading(b, "soc", seconds(time), "scada", 3600, v) for b, v in soc.items()]
        runner.store.write_readings(heard, time)
        soc = runner.step(time)["expected"]["soc"]


def main() -> None:
    """Write the pictures."""
    day = vppres.load_scenario("uk-heatwave-2022")
    with (
        TemporaryDirectory() as folder,
        opened(Service(day, OPTIONS, rehearsal=True), Path(folder)) as runner,
        listening(make_app(runner, Access())) as address,
        sync_playwright() as playwright,
    ):
        browser = playwright.chromium.launch(executable_path=chromium(), args=FLAGS)
        rehearse(runner, 14)
        for name, size, scheme in (
            ("watch", {"width": 1440, "height": 900}, "light"),
            ("watch_phone", {"width": 390, "height": 844}, "dark"),
        ):
            page = browser.new_page(viewport=size, color_scheme=scheme)
            page.goto(address)
            page.wait_for_selector("#chart svg")
            page.locator("#off-list", has_not_text="the reason follows").wait_for(
                timeout=PATIENCE_MS
            )
            file = FOLDER / f"{name}.png"
            page.screenshot(path=file)
            Image.open(file).quantize(COLOURS).save(file, optimize=True)
        browser.close()


if __name__ == "__main__":
    main()
