"""The report of all experiments: figures, the table of R1 to R24, sensitivities, provenance."""

from __future__ import annotations

import os
import platform
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from jinja2 import Environment

from benchmarks.frame.pages import save_figure, template_environment
from experiments import sensitivities
from experiments.catalogue import ALL
from experiments.config import Config
from experiments.rows import Row, order
from experiments.runner import Results
from vppres.day.metrics import versions
from vppres.io.atomic import atomic_write_text

TEMPLATES = Path(__file__).with_name("templates")
HTML = "report.html"
MARKDOWN = "report.md"


@dataclass(frozen=True)
class Section:
    """One figure of the report."""

    name: str
    label: str
    title: str
    paper: str
    ours: str


@dataclass(frozen=True)
class Effort:
    """What the run took."""

    #: Simulated days in all, and those that were not in the cache.
    days: int
    computed: int
    wall_s: float  #: wall time of this run in s
    day_s: float  #: time for decisions of all days together in s, cached ones included
    processes: int  #: how many ran at a time

    def text(self) -> str:
        """The effort in a sentence."""
        return (
            f"{self.days} simulated days, {self.computed} of them computed in this run and the "
            f"others taken from the cache; {self.wall_s / 60:.1f} min of wall time with "
            f"{self.processes} processes. The decisions of all days took {self.day_s / 60:.1f} "
            "min of solve time."
        )


def write_report(
    configs: Mapping[str, Config], results: Results, effort: Effort, folder: Path
) -> list[Row]:
    """Write figures and both reports.

    Parameters
    ----------
    configs : mapping of str to Config
        The experiments to report, by name.
    results : mapping of Job to DayResult
        All their days.
    effort : Effort
        What the run took.
    folder : Path
        Where to; ``report.html``, ``report.md`` and ``figures/``.

    Returns
    -------
    list of Row
        The table, by number of the statement.
    """
    figures = folder / "figures"
    figures.mkdir(parents=True, exist_ok=True)
    sections = []
    rows = []
    for name, config in configs.items():
        experiment = ALL[name]
        save_figure(experiment.figure(config, results), figures / name)
        rows += experiment.rows(config, results)
        sections.append(
            Section(
                name,
                experiment.LABEL,
                experiment.TITLE,
                experiment.PAPER,
                experiment.ours(config, results),
            )
        )
    rows.sort(key=order)
    values = {
        "sections": sections,
        "rows": rows,
        "effort": effort.text(),
        "machine": machine(),
        "lines": _lines(configs, results),
        "configs": configs,
        "versions": versions(),
        "held": sum(row.holds for row in rows),
    }
    for file in (HTML, MARKDOWN):
        atomic_write_text(
            folder / file,
            _environment(figures, file == HTML).get_template(f"{file}.j2").render(values),
        )
    return rows


def machine() -> str:
    """Processor, cores and system."""
    return (
        f"{platform.machine()}, {os.cpu_count()} logical cores, {platform.system()}, "
        f"Python {platform.python_version()}"
    )


def _lines(configs: Mapping[str, Config], results: Results) -> list[sensitivities.Line]:
    config = configs.get("sensitivities")
    return [] if config is None else sensitivities.lines(config, results)


def _environment(figures: Path, escape: bool) -> Environment:
    environment = template_environment(TEMPLATES, figures, escape)
    environment.filters["cell"] = lambda text: str(text).replace("|", "\\|")
    return environment
