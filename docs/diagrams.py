"""The documentation's diagrams, drawn from names in the code: ``python docs/diagrams.py``.

Plain SVG text, so that they render offline, can be searched, and differ only where a name differs.
A line of a box that begins with ``vppres.`` is the name of something in the code; tests resolve
each.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from html import escape
from pathlib import Path

FOLDER = Path(__file__).with_name("_static")

COLUMN_PX, ROW_PX = 300, 96
BOX_PX = (262, 62)
MARGIN_PX = (62, 24)
LINE_PX = 15
LABEL_PX = 110
CODE = "vppres."
FILLS = {"box": "#EAF2F8", "choice": "#FBEFE3", "end": "#F1F1F1"}

Point = tuple[float, float]


@dataclass(frozen=True)
class Node:
    """A box of a diagram.

    Parameters
    ----------
    column, row : float
        Place in the grid.
    lines : tuple of str
        Text; names of code begin with ``vppres.``; their last two parts are shown.
    kind : {"box", "choice", "end"}
        A step, a question, or a beginning or end.
    """

    column: float
    row: float
    lines: tuple[str, ...]
    kind: str = "box"

    @property
    def centre(self) -> Point:
        """Middle of the box in pixels."""
        return (
            MARGIN_PX[0] + COLUMN_PX * self.column + BOX_PX[0] / 2,
            MARGIN_PX[1] + ROW_PX * self.row + BOX_PX[1] / 2,
        )


@dataclass(frozen=True)
class Arrow:
    """An arrow between two nodes.

    Parameters
    ----------
    start, end : str
        Names of the nodes.
    label : str
        What it carries, or the answer to the question it leaves from.
    lane_px : float
        Other than zero: the arrow leaves at the side and runs at this distance from it.
    """

    start: str
    end: str
    label: str = ""
    lane_px: float = 0.0


@dataclass(frozen=True)
class Diagram:
    """Nodes by name, and arrows."""

    title: str
    nodes: Mapping[str, Node]
    arrows: tuple[Arrow, ...]

    def code_names(self) -> list[str]:
        """Every name of code in the diagram."""
        return [
            line for node in self.nodes.values() for line in node.lines if line.startswith(CODE)
        ]

    def svg(self) -> str:
        """The diagram as SVG text."""
        width = max(n.centre[0] for n in self.nodes.values()) + BOX_PX[0] / 2 + LABEL_PX
        height = max(n.centre[1] for n in self.nodes.values()) + BOX_PX[1] / 2 + MARGIN_PX[1]
        body = [
            *(_node(node) for node in self.nodes.values()),
            *(_arrow(arrow, self.nodes) for arrow in self.arrows),
        ]
        return "\n".join(
            [
                f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}" '
                f'width="{width:g}" height="{height:g}" font-family="sans-serif" font-size="12">',
                f"<title>{escape(self.title)}</title>",
                '<defs><marker id="tip" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="8" '
                'markerHeight="8" orient="auto"><path d="M0 0 L10 5 L0 10 z"/></marker></defs>',
                f'<rect width="{width:g}" height="{height:g}" fill="white"/>',
                *body,
                "</svg>",
                "",
            ]
        )


def _node(node: Node) -> str:
    """A box and its lines of text."""
    x, y = node.centre
    first = y - LINE_PX * (len(node.lines) - 1) / 2 + 4
    texts = (_text((x, first + LINE_PX * i), line) for i, line in enumerate(node.lines))
    half_width, half_height = BOX_PX[0] / 2, BOX_PX[1] / 2
    if node.kind == "choice":
        corners = [
            (x - half_width, y),
            (x, y - half_height - 8),
            (x + half_width, y),
            (x, y + half_height + 8),
        ]
        shape = f'<polygon points="{" ".join(f"{a:g},{b:g}" for a, b in corners)}"'
    else:
        radius = half_height if node.kind == "end" else 5
        shape = (
            f'<rect x="{x - half_width:g}" y="{y - half_height:g}" width="{BOX_PX[0]}" '
            f'height="{BOX_PX[1]}" rx="{radius:g}"'
        )
    return f'{shape} fill="{FILLS[node.kind]}" stroke="#333"/>' + "".join(texts)


def _text(at: Point, line: str) -> str:
    """A line of text, names of code in a fixed-width face."""
    face = ' font-family="monospace" font-size="11"' if line.startswith(CODE) else ""
    shown = escape(".".join(line.split(".")[-2:]) if line.startswith(CODE) else line)
    return f'<text x="{at[0]:g}" y="{at[1]:g}" text-anchor="middle"{face}>{shown}</text>'


def _arrow(arrow: Arrow, nodes: Mapping[str, Node]) -> str:
    """A line with a tip, and its label beside the middle."""
    start, end = nodes[arrow.start], nodes[arrow.end]
    points = _lane(start, end, arrow.lane_px) if arrow.lane_px else _straight(start, end)
    (x1, y1), (x2, y2) = points[len(points) // 2 - 1], points[len(points) // 2]
    path = " ".join(f"{x:g},{y:g}" for x, y in points)
    label = (
        ""
        if not arrow.label
        else (
            f'<text x="{(x1 + x2) / 2 + 6:g}" y="{(y1 + y2) / 2 - 5:g}" fill="#7A3B00" '
            f'font-size="11">{escape(arrow.label)}</text>'
        )
    )
    return f'<polyline points="{path}" fill="none" stroke="#333" marker-end="url(#tip)"/>' + label


def _straight(start: Node, end: Node) -> list[Point]:
    """From edge to edge: down or up within a column, sideways otherwise."""
    (x1, y1), (x2, y2) = start.centre, end.centre
    half = {"choice": BOX_PX[1] / 2 + 8}
    if abs(x1 - x2) < 1:
        down = 1 if y2 > y1 else -1
        return [
            (x1, y1 + down * half.get(start.kind, BOX_PX[1] / 2)),
            (x2, y2 - down * half.get(end.kind, BOX_PX[1] / 2)),
        ]
    right = 1 if x2 > x1 else -1
    return [(x1 + right * BOX_PX[0] / 2, y1), (x2 - right * BOX_PX[0] / 2, y2)]


def _lane(start: Node, end: Node, lane_px: float) -> list[Point]:
    """Out at one side, along a lane, and in again at the same side."""
    (x1, y1), (x2, y2) = start.centre, end.centre
    side = 1 if lane_px > 0 else -1
    edge1, edge2 = x1 + side * BOX_PX[0] / 2, x2 + side * BOX_PX[0] / 2
    lane = (max if side > 0 else min)(edge1, edge2) + lane_px
    return [(edge1, y1), (lane, y1), (lane, y2), (edge2, y2)]


ARCHITECTURE = Diagram(
    "One step of a run, and what surrounds it",
    {
        "scenario": Node(1, 0, ("Data of the day", "vppres.scenario.scenario.Scenario")),
        "forecast": Node(0, 1, ("What may be known", "vppres.contract.forecast.Forecaster.at")),
        "observe": Node(
            0, 2, ("Forecast and measurements", "vppres.contract.observation.Observation")
        ),
        "control": Node(
            0,
            3,
            (
                "Controllers",
                "vppres.control.mpc.MPCController",
                "vppres.control.full_horizon.FullHorizonController",
            ),
        ),
        "solve": Node(
            0,
            4,
            (
                "Window's problem, certified",
                "vppres.solve.ladder.WindowSolver.solve",
                "vppres.model.statement.Statement",
            ),
        ),
        "decision": Node(1, 3, ("Set-points of the step", "vppres.contract.decision.Decision")),
        "thermal": Node(
            2,
            1,
            (
                "Batteries' charge and heat",
                "vppres.plant.plant.Plant.advance",
                "vppres.physics.thermal.advance",
            ),
        ),
        "ac": Node(2, 2, ("AC power flow", "vppres.physics.powerflow.ACPowerFlow.solve")),
        "plant": Node(2, 3, ("What the day does with them", "vppres.plant.plant.Plant.apply")),
        "record": Node(2, 4, ("Record of the run", "vppres.day.recorder.Recorder.add")),
        "words": Node(
            1,
            4,
            (
                "Numbers, figures, report",
                "vppres.day.metrics.summarise",
                "vppres.report.run_folder.write_run",
            ),
        ),
    },
    (
        Arrow("scenario", "forecast", "forecast errors"),
        Arrow("scenario", "thermal", "actual day"),
        Arrow("forecast", "observe"),
        Arrow("observe", "control"),
        Arrow("control", "solve"),
        Arrow("control", "decision"),
        Arrow("decision", "plant"),
        Arrow("plant", "ac"),
        Arrow("plant", "thermal", "powers", 26),
        Arrow("plant", "record"),
        Arrow("record", "words"),
        Arrow("thermal", "observe", "measured state"),
        Arrow("ac", "observe", "operating point"),
    ),
)

MPC = Diagram(
    "Model predictive control",
    {
        "start": Node(0, 0, ("Step t0 of the day", "vppres.day.simulate.Day.step"), "end"),
        "observe": Node(
            0, 1, ("Forecast of t0 .. t0 + H, first step exact", "vppres.day.simulate.Day.observe")
        ),
        "solve": Node(0, 2, ("Solve the window", "vppres.control.mpc.MPCController.decide")),
        "apply": Node(0, 3, ("Carry out its first step only", "vppres.plant.plant.Plant.apply")),
        "verify": Node(
            0, 4, ("AC power flow: next linearisation centre", "vppres.plant.collapse.realise")
        ),
        "advance": Node(
            0, 5, ("Charge, temperature, efficiencies", "vppres.plant.plant.Plant.advance")
        ),
        "last": Node(0, 6, ("Last step?",), "choice"),
        "end": Node(0, 7, ("Finished run", "vppres.day.recorder.Recorder.finish"), "end"),
    },
    (
        Arrow("start", "observe"),
        Arrow("observe", "solve"),
        Arrow("solve", "apply"),
        Arrow("apply", "verify"),
        Arrow("verify", "advance"),
        Arrow("advance", "last"),
        Arrow("last", "end", "yes"),
        Arrow("last", "observe", "no: t0 + 1", 26),
    ),
)

FULL_HORIZON = Diagram(
    "Full-horizon optimisation",
    {
        "plan": Node(
            0,
            0,
            (
                "Forecast the day once, plan it once",
                "vppres.control.full_horizon.FullHorizonController.decide",
            ),
            "end",
        ),
        "observe": Node(0, 1, ("Measure step t", "vppres.day.simulate.Day.observe")),
        "check": Node(
            0,
            2,
            (
                "Battery, PV and grid checks of the plan",
                "vppres.control.full_horizon.FullHorizonController.violations",
            ),
        ),
        "fails": Node(0, 3, ("Does one fail?",), "choice"),
        "follow": Node(0, 4, ("Set-points of the plan", "vppres.contract.decision.Decision")),
        "correct": Node(
            1.15,
            3,
            ("One-step problem, H = 0, actual values", "vppres.solve.ladder.WindowSolver.solve"),
        ),
        "apply": Node(0, 5, ("Carry out", "vppres.plant.plant.Plant.apply")),
        "verify": Node(0, 6, ("AC power flow", "vppres.plant.collapse.realise")),
        "advance": Node(
            0, 7, ("Charge, temperature, efficiencies", "vppres.plant.plant.Plant.advance")
        ),
        "last": Node(0, 8, ("Last step?",), "choice"),
        "end": Node(
            0,
            9,
            ("Finished run, planned and actual", "vppres.day.recorder.Recorder.finish"),
            "end",
        ),
    },
    (
        Arrow("plan", "observe"),
        Arrow("observe", "check"),
        Arrow("check", "fails"),
        Arrow("fails", "follow", "no"),
        Arrow("fails", "correct", "yes"),
        Arrow("follow", "apply"),
        Arrow("correct", "apply", "", 30),
        Arrow("apply", "verify"),
        Arrow("verify", "advance"),
        Arrow("advance", "last"),
        Arrow("last", "end", "yes"),
        Arrow("last", "observe", "no: t + 1", -30),
    ),
)

DIAGRAMS = {"architecture": ARCHITECTURE, "mpc": MPC, "full_horizon": FULL_HORIZON}
"""By name of the file."""


def write(folder: Path = FOLDER, names: Iterable[str] = tuple(DIAGRAMS)) -> None:
    """Write the SVG files."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        (folder / f"{name}.svg").write_text(DIAGRAMS[name].svg(), encoding="utf-8", newline="\n")


if __name__ == "__main__":
    write()
