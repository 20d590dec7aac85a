"""A report as PDF, printed by a browser that is installed on the machine."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

from vppres.core.errors import InputError, ReportError
from vppres.core.parent import command
from vppres.io.atomic import scratch_folder
from vppres.report.pages import write_page

BROWSERS = (
    "chromium",
    "chromium-browser",
    "google-chrome",
    "google-chrome-stable",
    "chrome",
    "microsoft-edge",
    "msedge",
)
"""Browsers that print without a screen, by the name of their program; the first that is there."""

PRINT_S = 180.0
_PDF = b"%PDF-"

# The page is ours and asks for nothing; neither shall the browser.
_QUIET = (
    "--headless",
    "--disable-gpu",
    "--disable-extensions",
    "--disable-sync",
    "--disable-quic",
    "--disable-background-networking",
    "--disable-component-update",
    "--no-first-run",
    "--no-default-browser-check",
    "--no-pdf-header-footer",
    "--host-resolver-rules=MAP * ~NOTFOUND",
)


def find_browser() -> str:
    """Path of a browser that can print."""
    found = next(filter(None, map(shutil.which, BROWSERS)), None)
    if not found:
        raise InputError.of(
            "report",
            "there is no browser that could print the PDF",
            f"Install Chromium or Chrome ({', '.join(BROWSERS[:3])} on the path), or open "
            "report.html and print it to a file.",
        )
    return found


def write_pdf(html: str, file: Path, browser: str) -> None:
    """Print a page that needs nothing beside it to a file, whole or not at all.

    A browser that fails or takes too long is a ReportError.
    """
    with scratch_folder() as aside:
        page = aside / "report.html"
        printed = aside / "report.pdf"
        page.write_text(html, encoding="utf-8")
        said = _print(browser, page, printed, aside / "profile")
        content = printed.read_bytes() if printed.is_file() else b""
    if not content.startswith(_PDF):
        raise ReportError(
            f"{file}: {Path(browser).name} did not print the report ({said}). Open report.html and "
            "print it to a file instead."
        )
    write_page(file, content)


def _print(browser: str, page: Path, printed: Path, profile: Path) -> str:
    """Let a browser print a page; what it said last."""
    # Chromium refuses its sandbox to root.
    as_root = ("--no-sandbox",) if hasattr(os, "geteuid") and os.geteuid() == 0 else ()
    printing = command(
        "--",
        browser,
        *_QUIET,
        *as_root,
        f"--user-data-dir={profile}",
        f"--print-to-pdf={printed}",
        page.as_uri(),
    )
    try:
        done = subprocess.run(
            printing, stdin=subprocess.DEVNULL, capture_output=True, timeout=PRINT_S, check=False
        )
    except subprocess.TimeoutExpired:
        return f"no answer in {PRINT_S:g} s"
    except OSError as error:
        return str(error.strerror)
    lines = done.stderr.decode(errors="replace").strip().splitlines()
    return lines[-1] if lines else f"status {done.returncode}"
