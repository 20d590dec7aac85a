"""Figures that are drawn in processes of their own while the day is still being explained.

Nothing here loads matplotlib in the process that asks: the others load it while the day runs, and
have it when the day is done. They run this module: ``python -m vppres.report.drawing``. They end
with the process that asks.
"""

from __future__ import annotations

import os
import pickle
import shutil
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

from vppres.core.parent import command
from vppres.io.atomic import scratch_folder

if TYPE_CHECKING:
    from vppres.day.trajectory import Trajectory

PROCESSES = 2
"""While the day runs one processor is free; when it is explained, two figures can be drawn."""

CLAIM = ".claimed"


class DrawingProcesses:
    """Processes that wait for a finished day, draw its figures and end.

    Use it as a context: whatever ends the block ends the processes, and takes away what they drew
    unless :meth:`save` has taken it.

    Parameters
    ----------
    count : int
        How many; with none the figures are drawn where they are asked for.
    """

    def __init__(self, count: int = PROCESSES) -> None:
        # With its own session a process does not hear the Ctrl-C that the asking one answers.
        self._processes = [
            subprocess.Popen(
                command("vppres.report.drawing"),
                stdin=subprocess.PIPE,
                stderr=subprocess.PIPE,
                start_new_session=True,
            )
            for _ in range(count)
        ]
        self._aside = ExitStack()
        self._folder = self._aside.enter_context(scratch_folder())

    @classmethod
    def where_they_help(cls) -> DrawingProcesses:
        """Two processes, or none where matplotlib is loaded already or there is one processor."""
        alone = "matplotlib" in sys.modules or (os.cpu_count() or 1) < 2
        return cls(0 if alone else PROCESSES)

    def __enter__(self) -> DrawingProcesses:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        for process in self._processes:
            process.kill()
            process.wait()
            for pipe in (process.stdin, process.stderr):
                if pipe is not None:
                    pipe.close()
        self._aside.close()

    def begin(self, trajectory: Trajectory) -> None:
        """Let the processes draw the figures of a day; returns before they have."""
        work = pickle.dumps((trajectory, self._folder))
        for process in self._processes:
            assert process.stdin is not None
            process.stdin.write(work)
            process.stdin.close()
            process.stdin = None  # or communicate would flush what is closed

    def save(self, trajectory: Trajectory, folder: Path) -> None:
        """Put the figures of the day that was begun into a folder, which is made if missing.

        Raises
        ------
        RuntimeError
            If a process failed; its last line is in the message.
        """
        if not self._processes:
            from vppres.report.plots import save_figures

            save_figures(trajectory, folder)
            return
        for process in self._processes:
            _, errors = process.communicate()
            if process.returncode:
                lines = errors.decode(errors="replace").strip().splitlines() or ["no message"]
                raise RuntimeError(f"the figures could not be drawn: {lines[-1]}")
        folder.mkdir(parents=True, exist_ok=True)
        for file in sorted(self._folder.iterdir()):
            if file.suffix != CLAIM:
                shutil.move(file, folder / file.name)


def _draw_what_is_asked() -> None:
    """Draw the figures of the day on standard input that no other process has begun."""
    # Loaded before the day is there.
    from vppres.report.plots import draw_figure, figure_names

    trajectory, folder = pickle.load(sys.stdin.buffer)
    for name in figure_names(trajectory):
        if _claimed(folder / f"{name}{CLAIM}"):
            draw_figure(trajectory, name, folder)


def _claimed(mark: Path) -> bool:
    """Whether this process is the first to make the file."""
    try:
        mark.touch(exist_ok=False)
    except FileExistsError:
        return False
    return True


if __name__ == "__main__":
    _draw_what_is_asked()
