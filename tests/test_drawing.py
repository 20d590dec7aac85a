"""Figures drawn by other processes: the same files, and nothing is left behind."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.support.command_line import call
from tests.support.made_up_runs import small_run
from vppres.report import drawing
from vppres.report.drawing import DrawingProcesses
from vppres.report.plots import save_figures


@pytest.fixture
def aside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder in which the processes draw."""
    folder = tmp_path / "aside"

    @contextmanager
    def made() -> Iterator[Path]:
        folder.mkdir()
        yield folder
        shutil.rmtree(folder)

    monkeypatch.setattr(drawing, "scratch_folder", made)
    return folder


def test_processes_draw_what_one_would_alone(aside: Path, tmp_path: Path) -> None:
    run = small_run()
    with DrawingProcesses(2) as processes:
        processes.begin(run)
        processes.save(run, tmp_path / "figures")
    assert not aside.exists()
    # In a fresh process: pandapower, if loaded, changes how matplotlib ends lines.
    code = (
        "import pickle, sys; from pathlib import Path\n"
        "from vppres.report.plots import save_figures\n"
        "save_figures(pickle.load(sys.stdin.buffer), Path(sys.argv[1]))"
    )
    subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "alone")],
        check=True,
        input=drawing.pickle.dumps(run),
    )
    alone = {file.name: file.read_bytes() for file in (tmp_path / "alone").iterdir()}
    drawn = {file.name: file.read_bytes() for file in (tmp_path / "figures").iterdir()}
    assert len(alone) == 16
    assert drawn == alone


def test_processes_end_with_the_block(aside: Path) -> None:
    with pytest.raises(KeyboardInterrupt), DrawingProcesses(1) as processes:
        raise KeyboardInterrupt
    assert [process.poll() is not None for process in processes._processes] == [True]
    assert not aside.exists()


def test_failure_is_told(aside: Path, tmp_path: Path) -> None:
    with DrawingProcesses(1) as processes:
        processes.begin("not a day")  # type: ignore[arg-type]
        with pytest.raises(RuntimeError, match=r"the figures could not be drawn: \w+Error: "):
            processes.save(small_run(), tmp_path / "figures")


def test_no_process_where_matplotlib_is_loaded(tmp_path: Path) -> None:
    assert save_figures is not None  # which has loaded it
    with DrawingProcesses.where_they_help() as processes:
        assert processes._processes == []
        processes.begin(small_run())
        processes.save(small_run(), tmp_path / "figures")
    assert len(list((tmp_path / "figures").iterdir())) == 16


def test_run_without_figures(tiny_folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    result = call("run", tiny_folder, "--horizon", 0, "--no-figures", "--out", out)
    assert (result.exit_code, result.stderr) == (0, "")
    names = {file.name for file in out.iterdir()}
    assert {"summary.json", "steps.parquet", "explanations.parquet"} <= names
    assert names.isdisjoint({"figures", "report.html"})
    # The page can be had later.
    assert call("report", out).exit_code == 0
    assert (out / "report.html").is_file()
