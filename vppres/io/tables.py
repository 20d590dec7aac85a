"""Tables of a scenario folder: CSV or Parquet in, checked rows out."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from io import StringIO
from pathlib import Path
from typing import TypeVar

import pandas as pd
import pyarrow as pa
from pydantic import BaseModel, ValidationError

from vppres.core.arrays import Wholes
from vppres.core.errors import Problem
from vppres.core.text import flaw_of_name
from vppres.io import schema
from vppres.io.messages import Suggestions, few, problems_of, shown

R = TypeVar("R", bound=BaseModel)

# A year of hours for a thousand customers has 9 million cells; one takes about a microsecond to
# check and some 100 bytes of memory until it is a number.
MAX_CELLS = 10_000_000
MAX_ROWS = schema.MAX_STEPS + 1  # and the header
MAX_COLUMNS = schema.MAX_ITEMS + 1  # and the time
MAX_FILE_BYTES = 100_000_000
SPREADSHEETS = (b"PK\x03\x04", b"\xd0\xcf\x11\xe0")
"""Beginnings of spreadsheets: of .xlsx and .ods, and of .xls."""

_NAMELESS = re.compile(r"__index_level_\d+__")  # the numbers of the rows, as pandas writes them


@dataclass(frozen=True, eq=False)
class Table:
    """A file as it was read: cells of a CSV file are stripped text."""

    file: str  #: file name inside the folder
    frame: pd.DataFrame  #: cells; the index is the line in the file (the header is line 1)
    #: False of a file that is missing or broken, which counts as a table without columns.
    is_read: bool = True

    def __bool__(self) -> bool:
        return self.is_read

    def texts(self, name: str) -> pd.Series[str]:
        """The cells of a column as stripped text; a missing cell is empty."""
        return self.frame[name].map(cell_text).astype(object)

    def column(self, name: str) -> dict[int, str]:
        """Text of each cell by line, without empty ones; nothing if there is no such column."""
        if name not in self.frame.columns:
            return {}
        return {int(str(line)): text for line, text in self.texts(name).items() if text}

    def problem(
        self, row: int, field: str, message: str, cure: str, value: object = None
    ) -> Problem:
        """Problem of a cell in a line of the file."""
        return Problem(self.file, message, cure, row=row, field=field, value=value)

    def problems(
        self, positions: Sequence[int] | Wholes, field: str, message: str, cure: str
    ) -> list[Problem]:
        """Problems of the first of some cells, by their position; the last one counts the others.

        An empty cell is called empty.
        """

        def problem(i: int) -> Problem:
            text = shown(cell_text(self.frame[field].iloc[i]))
            line = int(self.frame.index[i])
            return self.problem(line, field, message if text else "is empty", cure, text)

        return few(positions, problem)

    @cached_property
    def names(self) -> list[str]:
        """Names of the columns."""
        return [str(name) for name in self.frame.columns]


NAME_ANOTHER = "Add it, or name another file under [files] in scenario.toml."
CHECK_PATH = "Check the path that was given."
"""Cures of a missing file: of a scenario's, and of one that an option names."""


def no_table(file: str, model: type[BaseModel]) -> Table:
    """The table of assets that the scenario does not have: a header without rows."""
    required = [
        name
        for name, field in model.model_fields.items()
        if field.is_required() and field.alias is None
    ]
    return Table(file, pd.DataFrame(columns=required))


def unread(file: str) -> Table:
    """The table of a file that is missing or broken."""
    return Table(file, pd.DataFrame(), is_read=False)


def read_table(path: Path, cure_if_missing: str = NAME_ANOTHER) -> tuple[Table, list[Problem]]:
    """A table, or the problems that keep the file from being one."""
    if not path.is_file():
        return unread(path.name), [no_file(path, cure_if_missing)]
    frame, problems = _read_parquet(path) if path.suffix == ".parquet" else _read_csv(path)
    problems += [
        Problem(path.name, f"the name of column {i} {flaw[0]}", flaw[1], row=1)
        for i, name in enumerate(map(str, frame.columns), start=1)
        if (flaw := flaw_of_name(name, schema.MAX_NAME_LENGTH))
    ]
    return unread(path.name) if problems else Table(path.name, frame), problems


def no_file(path: Path, cure_if_missing: str) -> Problem:
    """Problem of a path that is missing, or is not a file."""
    if not path.exists():
        return Problem(path.name, "the file is missing", cure_if_missing)
    kind = "folder" if path.is_dir() else "pipe or a device"
    return Problem(path.name, f"is a {kind}, not a file", "Put a file in its place.")


def leads_out(folder: Path, file: str) -> list[Problem]:
    """The problem of a link that leads out of a folder, whose files belong together."""
    if (folder / file).resolve().is_relative_to(folder.resolve()):
        return []
    cure = "Put the file itself into the folder."
    return [Problem(file, "leads out of the scenario folder, and is not read", cure)]


def read_text(path: Path, most_bytes: int = MAX_FILE_BYTES) -> tuple[str, list[Problem]]:
    """Text of a UTF-8 file of bearable size, with or without byte order mark."""
    try:
        if path.stat().st_size > most_bytes:
            return "", [_too_large(path.name, f"more than {most_bytes / 1e6:g} MB")]
        content = path.read_bytes()
        if content.startswith(SPREADSHEETS):
            cure = f"Save its sheet as {path.stem}.csv: CSV, in UTF-8."
            return "", [Problem(path.name, "is a spreadsheet, not text", cure)]
        return content.decode("utf-8-sig"), []
    except UnicodeDecodeError as error:
        line = error.object[: error.start].count(b"\n") + 1
        byte = f"0x{error.object[error.start]:02x}"
        return "", [
            Problem(
                path.name,
                f"is not UTF-8 text (byte {byte})",
                "Save the file with UTF-8 encoding.",
                row=line,
            )
        ]
    except OSError as error:
        return "", [
            Problem(
                path.name,
                f"cannot be read ({error.strerror})",
                "Check the file and its permissions.",
            )
        ]


def too_many_rows(file: str, n_rows: int) -> list[Problem]:
    """The problem of a table of items that is too long."""
    most = schema.most_rows(file)
    if n_rows <= most:
        return []
    cure = "Reduce the feeder, or split it at its substation."
    return [Problem(file, f"has {n_rows} rows, more than {most}", cure)]


def read_rows(table: Table, model: type[R]) -> tuple[dict[int, R], list[Problem]]:
    """The sound rows of a table by line, and the problems of the others."""
    if not table:
        return {}, []
    if problems := too_many_rows(table.file, len(table.frame)):
        return {}, problems
    problems = check_columns(
        table,
        list(model.model_fields),
        [n for n, f in model.model_fields.items() if f.is_required()],
        {n: schema.cure(f) for n, f in model.model_fields.items()},
    )
    columns = {name: table.column(name) for name in table.names if name in model.model_fields}
    rows: dict[int, R] = {}
    for line in table.frame.index:
        given = {name: texts[line] for name, texts in columns.items() if line in texts}
        try:
            rows[int(line)] = model.model_validate(given)
        except ValidationError as error:
            # A missing column has been named once; it need not be named again in every row.
            problems += [
                p for p in problems_of(error, model, table.file, int(line)) if p.field in columns
            ]
    return rows, problems


def check_columns(
    table: Table, known: list[str], required: list[str], cures: dict[str, str]
) -> list[Problem]:
    """Columns that are missing or unknown."""
    given = set(table.names)
    missing = [name for name in required if name not in given]
    allowed = set(known)
    unknown = [name for name in table.names if name not in allowed]
    suggestions = Suggestions([name for name in known if name not in given], "Remove it.")
    return few(
        range(len(missing)),
        lambda i: Problem(table.file, "the column is missing", cures[missing[i]], field=missing[i]),
    ) + few(
        range(len(unknown)),
        lambda i: Problem(
            table.file, "is not a known column", suggestions.cure(unknown[i]), field=unknown[i]
        ),
    )


def _read_csv(path: Path) -> tuple[pd.DataFrame, list[Problem]]:
    text, problems = read_text(path)
    if problems:
        return pd.DataFrame(), problems
    reader = csv.reader(StringIO(text, newline=""), strict=True)
    lines = []
    rows = []
    n_cells = 0
    try:
        for cells in reader:
            if any(cell.strip() for cell in cells):
                lines.append(reader.line_num)
                rows.append([cell.strip() for cell in cells])
                n_cells += len(cells)
                if _beyond(len(rows), len(cells), n_cells):
                    return pd.DataFrame(), [_too_many(path.name)]
    except csv.Error as error:
        return pd.DataFrame(), [
            Problem(
                path.name,
                f"is not valid CSV ({error})",
                "Correct the quotes of this row.",
                row=reader.line_num,
            )
        ]
    if not rows:
        problem = Problem(path.name, "is empty", "Write a header row with column names.")
        return pd.DataFrame(), [problem]
    rows = _named_part(rows)
    problems = _check_header(path.name, rows[0])
    if not _is_separated_otherwise(rows[0]):
        problems += _check_ragged(path.name, rows, lines)
    if problems:
        return pd.DataFrame(), problems
    return pd.DataFrame(rows[1:], index=lines[1:], columns=rows[0], dtype=object), []


def _named_part(rows: list[list[str]]) -> list[list[str]]:
    """The rows without the empty columns that spreadsheets write after the last one."""
    named = max((i for i, name in enumerate(rows[0], start=1) if name), default=0)
    if named == len(rows[0]) or any(any(cells[named:]) for cells in rows):
        return rows
    return [cells[:named] for cells in rows]


def _is_separated_otherwise(header: list[str]) -> bool:
    """Whether semicolons or tabs separate the cells; commas are then inside of numbers."""
    return len(header) == 1 and any(mark in header[0] for mark in ";\t")


def _check_header(file: str, header: list[str]) -> list[Problem]:
    if _is_separated_otherwise(header):
        return [
            Problem(
                file,
                "has a single column",
                "Separate the cells with commas, and write decimal points.",
                row=1,
            )
        ]
    nameless = [i for i, name in enumerate(header, start=1) if not name]
    problems = few(
        nameless, lambda i: Problem(file, f"column {i} has no name", "Name it or remove it.", row=1)
    )
    twice = sorted(name for name, count in Counter(header).items() if name and count > 1)
    return problems + few(
        range(len(twice)),
        lambda i: Problem(
            file, "the column appears twice", "Remove or rename one of them.", row=1, field=twice[i]
        ),
    )


def _check_ragged(file: str, rows: list[list[str]], lines: list[int]) -> list[Problem]:
    width = len(rows[0])
    ragged = [i for i, cells in enumerate(rows) if len(cells) != width]
    return few(
        ragged,
        lambda i: Problem(
            file,
            f"has {len(rows[i])} cells, but the header has {width}",
            "Give one cell per column; quote a cell that contains a comma.",
            row=lines[i],
        ),
    )


def _read_parquet(path: Path) -> tuple[pd.DataFrame, list[Problem]]:
    import pyarrow.parquet as pq  # slow to load, and most folders have none

    try:
        sizes = pq.ParquetFile(path).metadata
        # A small file can say that one value repeats without end: ask before reading.
        if path.stat().st_size > MAX_FILE_BYTES or _beyond(
            sizes.num_rows, sizes.num_columns, sizes.num_rows * sizes.num_columns
        ):
            return pd.DataFrame(), [_too_many(path.name)]
        content = pq.read_table(path)
        nested = [field.name for field in content.schema if pa.types.is_nested(field.type)]
        # What pandas noted in the file is of its author's hand, and not needed.
        frame = content.to_pandas(ignore_metadata=True)
    except (pa.ArrowException, OSError, ValueError) as error:
        return pd.DataFrame(), [
            Problem(
                path.name,
                f"is not a readable Parquet file ({shown(error)})",
                "Write the file again.",
            )
        ]
    frame = frame.loc[:, [not _NAMELESS.fullmatch(name) for name in frame.columns]]
    frame.columns = pd.Index([name.strip() for name in frame.columns])
    problems = _check_header(path.name, list(frame.columns)) + few(
        range(len(nested)),
        lambda i: Problem(
            path.name, "holds lists or tables", "Write one number a cell.", field=nested[i]
        ),
    )
    # Rows are counted as in a CSV file, whose header is line 1.
    frame.index = pd.RangeIndex(2, len(frame) + 2)
    return (pd.DataFrame() if problems else frame), problems


def _too_large(file: str, size: str) -> Problem:
    return Problem(file, f"is too large, {size}", "Give longer or fewer steps, or fewer columns.")


def _beyond(rows: int, columns: int, cells: int) -> bool:
    return rows > MAX_ROWS or columns > MAX_COLUMNS or cells > MAX_CELLS


def _too_many(file: str) -> Problem:
    return _too_large(
        file, f"more than {MAX_ROWS} rows, {MAX_COLUMNS} columns or {MAX_CELLS} cells"
    )


def cell_text(cell: object) -> str:
    """A cell as text; missing values of Parquet files become empty."""
    return (
        ""
        if cell is None or cell is pd.NA or cell is pd.NaT or cell != cell
        else (str(cell).strip())
    )
