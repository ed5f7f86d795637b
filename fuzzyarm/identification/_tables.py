"""Tables of numbers from files that robots and their tools write: text, NumPy, MATLAB and ROS 2 bags.

`reading` interprets the names of the columns. No file is unpickled, and a bag's message definitions are not compiled.
"""

import contextlib
import csv
import dataclasses
import datetime
import io
import itertools
import math
import operator
import re
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from fuzzyarm.common.array_files import read_arrays
from fuzzyarm.common.checks import shown
from fuzzyarm.common.documents import open_regular, read_bytes

__all__ = ["LogTable", "listing", "read_table", "unit_of"]

_LARGEST_FILE, _LARGEST_BAG, _LARGEST_METADATA = 64 * 2**20, 8 * 2**30, 2**20  # bytes
_MOST_STATES, _MOST_COLUMNS = 400_000, 1000
_MOST_NUMBERS = 32_000_000
_FEWEST_COLUMNS = 3  # time, an angle and a torque
_PROBED = 50  # lines in the middle of the file from which delimiter and decimal mark are found
_STEADY = 3  # the table begins with this many lines of numbers in a row
_AGREE = 0.8  # share of the probed lines that must agree
_FORMATS = "CSV or other delimited text, .npz, .npy, .mat, .mcap, .db3 or the folder of a ROS 2 bag"
_BAG = (".mcap", ".db3")
_SAVED = ". In MATLAB: time = ...; q = [...]; tau = [...]; save('log.mat', 'time', 'q', 'tau'), one column per joint"
_EMPTY = frozenset(("", "-", "na", "n/a", "null", "none"))
_COMMENT = "#%/; \t"
_MARKUP = {"JSON": r"\s*(\{|\[\s*[\[{])", "XML": r"\s*<", "YAML": r"(---|[\w ]+:)\s*\n"}  # beginnings of such files
_UNIT = re.compile(r"[\[(].*[\])]|-|[mkuµ]?(s|rad|deg|°|rev|turn|rpm|Nm|N ?[*·]? ?m|A|V|W|N)(/s|/min|\^?-1)*")
_CLOCK = re.compile(r"(?:.*[\sT])?(\d\d?):(\d\d):(\d\d(?:[.,]\d+)?)\s*([AP]M)?(?:Z|[+-]\d\d:?\d\d)?", re.IGNORECASE)
_JOINT_STATE = "sensor_msgs/msg/JointState"
_FIELDS = ("position", "velocity", "effort")


@dataclasses.dataclass
class LogTable:
    """The columns of numbers in a file, with their names and units."""

    names: list[str]  # as in the file, without units; "1", "2", ... if the file has no names
    units: dict[str, str]  # of columns by name, as in the file
    values: np.ndarray  # (rows, columns), NaN where there is no number
    remarks: list[str] = dataclasses.field(default_factory=list)  # what was left out or assumed, a sentence each
    headed: bool = True  # whether the file names its columns
    texts: dict[int, str] = dataclasses.field(default_factory=dict)  # first cell that is not a number, by column


def listing(names: Iterable[str], most: int = 12) -> str:
    """Return the first `most` names, separated by commas, and the count of further names; "none" without names."""
    every = list(names)
    return ", ".join(map(shown, every[:most])) + f" and {len(every) - most} more" * (len(every) > most) or "none"


def read_table(path: Path, topic: str | None = None) -> LogTable:
    """Return the table in a file or a bag's folder; `topic` selects one of several topics with joint states.

    ValueError: the file has no known format, is too large, or is damaged; OSError: it cannot be read.
    """
    if path.suffix in _BAG or (path.is_dir() and (path / "metadata.yaml").is_file()):
        return _bag(path, topic)
    if path.is_dir():
        raise ValueError("it is a folder without metadata.yaml, so it is not a ROS 2 bag; give a log file")
    content = read_bytes(path, largest=_LARGEST_FILE)
    if content[:4] == b"PK\x03\x04" and path.suffix != ".npz":
        raise ValueError("it is a zip archive or a spreadsheet: unpack it, or save the sheet as CSV")
    if content[:2] == b"\x1f\x8b":
        raise ValueError("it is compressed with gzip: unpack it")
    if content[:4] == b"PK\x03\x04" or content[:6] == b"\x93NUMPY":
        return _of_arrays(read_arrays(path, largest=8 * _MOST_NUMBERS))
    if content[:6] == b"MATLAB" or path.suffix == ".mat":
        return _of_arrays(_matlab(content))
    return _text(content)


def unit_of(text: str) -> str:
    """Return a unit in a uniform spelling: "deg/s" for "deg / s", "°/s" and "degree s^-1", "nm" for "N-m"."""
    short = re.sub(r"[\s*·⋅.]", "", text.strip().lower()).replace("μ", "µ").replace("µ", "u")
    short = re.sub(r"s\^?[-−]1$", "/s", short).replace("seconds", "s").replace("sec", "s")
    short = re.sub(r"(?<=[a-z])-(?=[a-z])", "", re.sub(r"degrees?|°", "deg", short))  # N-m
    return re.sub(r"(radian|turn|rev(olution)?)s?(?=/|$)", lambda found: found[1][:4].replace("radi", "rad"), short)


def _decoded(content: bytes) -> tuple[str, list[str]]:
    if content[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return content.decode("utf-16", errors="replace"), ["it is UTF-16 text"]
    try:
        return content.decode("utf-8-sig"), []
    except UnicodeDecodeError:
        return content.decode("latin-1"), ["it is not UTF-8, so it is read as Latin-1"]


@dataclasses.dataclass(frozen=True)
class _Style:
    """The delimiter of a text's cells (None: space), its decimal mark, and the number of cells in a line."""

    delimiter: str | None
    mark: str
    width: int = 0
    trailing: bool = False  # whether the delimiter also ends each line

    def cells(self, line: str) -> list[str]:
        """Return the cells of a line; a delimiter at the end of the line adds no cell."""
        parts = line.split(self.delimiter)
        if '"' in line and self.delimiter:
            with contextlib.suppress(csv.Error):  # a cell of more than 128 KiB
                parts = next(csv.reader([line], delimiter=self.delimiter, skipinitialspace=True))
        found = [cell.strip().strip("\"'").strip() for cell in parts]
        return found[:-1] if len(found) == self.width + 1 and not found[-1] else found

    def numbers(self, line: str) -> list[float]:
        """Return a line's numbers, NaN for text; [] if fewer than two, or if the line does not have `width` cells."""
        cells = self.cells(line)
        row = [number if (number := self.number(cell)) is not None else math.nan for cell in cells]
        return row if len(row) == self.width and sum(number == number for number in row) > 1 else []

    def is_worded(self, line: str) -> bool:
        """Return whether a line has the right number of cells, and each contains words, not a number."""
        cells = self.cells(line)
        return len(cells) == self.width and all(cell and self.number(cell) is None for cell in cells)

    def number(self, cell: str) -> float | None:
        """Return the number in a cell: NaN if it is empty, `_seconds` of a date or time of day, None for other text."""
        try:
            return float(cell.replace(",", ".") if self.mark == "," else cell)
        except ValueError:
            return math.nan if cell.lower() in _EMPTY else _seconds(cell)

    def score(self, lines: list[str]) -> tuple[int, int]:
        """Return how many columns contain numbers in most of the lines, and how many cells most lines have."""
        rows = [self.cells(line.strip("\r\n")) for line in lines]
        ((width, agreed),) = Counter(map(len, rows)).most_common(1)
        if agreed < _AGREE * len(lines) or width > _MOST_COLUMNS:
            return 0, width
        rows = [row for row in rows if len(row) == width]
        columns = [[self.number(row[k]) for row in rows] for k in range(width)]
        good = [sum(cell is not None for cell in column) >= _AGREE * len(rows) for column in columns]
        some = [any(cell == cell and cell is not None for cell in column) for column in columns]
        # With a delimiter at the end of each line the last column is empty.
        return sum(map(min, good, some)), width - all(not row[-1] for row in rows)


_STYLES = tuple(_Style(*pair) for pair in itertools.product(("\t", ";", ",", None), ".,"))


def _seconds(text: str) -> float | None:
    """Return the seconds since 1970 of a date and time in ISO 8601, or since midnight of a time of day; else None."""
    clock = _CLOCK.fullmatch(text)
    if not clock:
        return None
    try:
        date = datetime.datetime.fromisoformat(text)
    except ValueError:
        half = {"": int(clock[1]), "a": int(clock[1]) % 12, "p": int(clock[1]) % 12 + 12}[(clock[4] or "")[:1].lower()]
        return 3600.0 * half + 60.0 * int(clock[2]) + float(clock[3].replace(",", "."))
    return (date if date.tzinfo else date.replace(tzinfo=datetime.UTC)).timestamp()


def _text(content: bytes) -> LogTable:
    """Return the table in a delimited text."""
    text, remarks = _decoded(content)
    if not text.strip("\x00 \t\r\n"):
        raise ValueError("it is empty; needed: a heading such as time,q1,q2,tau1,tau2 and one line for each instant")
    if "\x00" in text[:4096]:
        raise ValueError(f"it is not text; a log must be {_FORMATS}")
    every = text.splitlines()
    lines = [line for line in every if line.strip()]
    middle = max(len(lines) // 2 - _PROBED // 2, min(1, len(lines) - 1))
    probed = lines[middle : middle + _PROBED]
    scores = [style.score(probed) for style in _STYLES]
    best = max(range(len(scores)), key=lambda k: scores[k][0])
    if scores[best][0] < _FEWEST_COLUMNS:
        for kind in (one for one, beginning in _MARKUP.items() if re.match(beginning, text)):
            raise ValueError(f"it is {kind}; write CSV with one line for each instant")
        raise ValueError(
            f"neither comma, semicolon, tab nor space divides its lines into {_FEWEST_COLUMNS} or more columns of "
            f"numbers; one of its lines is {shown(lines[len(lines) // 2])}. Write one line for each instant, with the "
            "same delimiter throughout"
        )
    style = dataclasses.replace(_STYLES[best], width=scores[best][1])
    if style.delimiter:
        ended = all(line.rstrip(" \r\n").endswith(style.delimiter) for line in probed)
        style = dataclasses.replace(style, trailing=ended)
    if style.mark == ",":
        remarks.append("its numbers have a decimal comma")
    rows = [style.numbers(line) for line in lines]
    # A line of a preamble may have as many numbers as a row.
    begins = (k for k, row in enumerate(rows) if all(rows[k : k + _STEADY]))
    first = next(begins, next((k for k, row in enumerate(rows) if row), len(rows)))
    kept = [row for row in rows[first:] if row]
    if not kept:
        raise ValueError(f"it begins with {shown(lines[0])} and has no line of numbers; write one for each instant")
    is_numbered = bool((np.diff([row[0] for row in kept]) == 1.0).all())
    later = [
        line for line in itertools.compress(lines[first:], map(operator.not_, rows[first:])) if style.is_worded(line)
    ]
    todo = f"delete the lines before line {every.index(later[0]) + 1}, which seems to be the heading" if later else ""
    names, units = _heading(lines[:first], style, is_numbered, todo)
    for line in later:
        again = _heading([line], style)[0]
        if again != names and sorted(again) == sorted(names):
            raise ValueError(
                f"line {every.index(line) + 1} has columns in another order than before: split the file there"
            )
    if len(kept) * style.width > _MOST_NUMBERS:
        raise ValueError(
            f"it has {len(kept) * style.width} numbers; allowed: at most {_MOST_NUMBERS}. Remove unneeded columns"
        )
    if len(kept) < len(rows) - first:
        remarks.append(f"{len(rows) - first - len(kept)} line(s) that are cut off or have no numbers are left out")
    places = [str(k + 1) for k in range(style.width)]
    table = LogTable(names or places, units, np.array(kept, dtype=float), remarks, headed=bool(names))
    written = list(itertools.compress(lines[first:], rows[first:]))
    for k in np.flatnonzero(np.isnan(table.values).any(axis=0)).tolist():
        for row in np.flatnonzero(np.isnan(table.values[:, k]))[:_PROBED].tolist():
            if style.number(cell := style.cells(written[row])[k]) is None:
                table.texts[k] = cell
                break
    return table


def _heading(
    lines: list[str], style: _Style, is_numbered: bool = False, todo: str = ""
) -> tuple[list[str], dict[str, str]]:
    """Return the columns' names, and units by name, from the `lines` above the numbers (empty without a heading).

    Units are in brackets or a second line. With `is_numbered`, the first column, of row numbers, needs no name.
    ValueError: names are missing; `todo` says what to do.
    """
    bare = [line.strip(_COMMENT if style.delimiter != ";" else "#%/ \t") for line in lines]
    if style.delimiter is None:
        bare = [re.sub(r"\s+(?=[\[(])", "", line) for line in bare]
    cut = list(map(style.cells, bare))
    cut = [cells[: style.width] if style.trailing or cells[-1].lower() == "comment" else cells for cells in cut]
    found = [cells for cells in cut if len(cells) == style.width and any(cells)]
    found = found or [["", *cells] for cells in cut if is_numbered and len(cells) == style.width - 1]
    if not found:
        worded = [line.strip() for line in lines if line.strip()[0] not in "#%" and re.search(r"[^\W\d]", line)]
        if worded:
            width = len(style.cells(worded[-1]))
            todo = todo or f"write {style.width} names in the line above the numbers"
            if style.delimiter == "," and style.width >= 2 * width - 1 > 1:
                todo = "numbers with a decimal comma need a delimiter other than the comma"
            text = f"its lines have {style.width} cells, but its heading {shown(worded[-1])} has {width}"
            raise ValueError(f"{text}; {todo}")
        return [], {}
    names, below = found[-1], [""] * style.width
    if len(found) > 1 and all(not cell or _UNIT.fullmatch(cell) for cell in names):
        names, below = found[-2], [cell.strip("[]() ") for cell in names]
    units = {}
    for k, name in enumerate(names):
        bracket = re.fullmatch(r"(.*?)\s*[\[(]\s*([^\])]*?)\s*[\])]", name)
        if bracket and bracket[1] and not bracket[2].isdigit():
            names[k], below[k] = bracket[1], bracket[2] or below[k]
        if below[k]:
            units[names[k]] = below[k]
    return names, units


def _of_arrays(arrays: dict[str, np.ndarray]) -> LogTable:
    """Return a table of arrays of equal length: vectors, matrices with a column (or row) per joint, and records."""
    flat: dict[str, np.ndarray] = {}
    for name, array in arrays.items():
        fields = [(f"{name} {field}".strip(), array[field]) for field in array.dtype.names or ()]
        for key, part in fields or [(name, array)]:
            if part.dtype.kind in "biuf" and part.size > 1:
                flat[key] = np.squeeze(part)
    count = Counter(max(part.shape) for part in flat.values() if part.ndim in (1, 2)).most_common(1)
    rows = count[0][0] if count else 0
    columns: dict[str, np.ndarray] = {}
    for name, part in flat.items():
        if part.shape == (rows,):
            columns[name] = part
        elif part.ndim == 2 and rows in part.shape and min(part.shape) <= _MOST_COLUMNS:
            across = part if len(part) == rows else part.T
            columns |= {f"{name} {k + 1}".strip(): across[:, k] for k in range(across.shape[1])}
    if len(columns) < _FEWEST_COLUMNS:
        found = f"its arrays ({listing(arrays)}) give {len(columns)} column(s) of numbers"
        raise ValueError(f"{found}; needed: time, angles and torques in arrays of equal length{_SAVED}")
    one_group = len({name.rpartition("/")[0] for name in columns}) == 1  # such as log/q and log/tau
    names = [name.rpartition("/")[2] if one_group else name for name in columns]
    headed = any(name and not name.isdigit() for name in names)
    return LogTable(names, {}, np.stack([part.astype(float) for part in columns.values()], axis=1), [], headed)


def _matlab(content: bytes) -> dict[str, np.ndarray]:
    """Return the arrays of numbers in a MATLAB file up to version 7."""
    from scipy.io import loadmat, whosmat

    if content[:128].startswith(b"MATLAB 7.3") or content[:4] == b"\x89HDF":
        raise ValueError("it is a MATLAB file of version 7.3; save it with: save('log.mat', '-v7', ...)")
    try:
        listed = whosmat(io.BytesIO(content))  # type: ignore[arg-type]
        plain = [one for one in listed if one[2] in ("double", "single", "logical") or "int" in one[2]]
        numbers = sum(int(np.prod([float(n) for n in shape])) for _, shape, _ in plain)
        names = [one[0] for one in plain if numbers <= _MOST_NUMBERS]
        found = loadmat(io.BytesIO(content), variable_names=names) if names else {}  # type: ignore[arg-type]
    except Exception as error:  # for a damaged file, scipy's reader may raise any exception
        raise ValueError(f"it is not a MATLAB file, or it is damaged ({' '.join(str(error).split())[:120]})") from None
    if numbers > _MOST_NUMBERS:
        raise ValueError(f"it has {numbers} numbers; allowed: at most {_MOST_NUMBERS}. Remove unneeded variables")
    if not plain:
        raise ValueError(f"it has no arrays of numbers; its variables: {listing(name for name, *_ in listed)}{_SAVED}")
    return {name: found[name] for name in names if isinstance(found.get(name), np.ndarray)}


def _bag(path: Path, topic: str | None) -> LogTable:
    """Return the joint states in a ROS 2 bag, at the times of their stamps or, if these are not set, of recording."""
    try:
        from rosbags.rosbag2 import Reader
        from rosbags.typesys import Stores, get_typestore
    except ModuleNotFoundError:
        raise ValueError(
            'ROS 2 bags are read by rosbags, which is not installed; install it with: pip install "fuzzyarm[logs]"'
        ) from None
    if path.is_dir():
        read_bytes(path / "metadata.yaml", largest=_LARGEST_METADATA)
    for file in [one for one in path.iterdir() if one.suffix in _BAG] if path.is_dir() else [path]:
        with open_regular(file) as stream:
            if stream.seek(0, 2) > _LARGEST_BAG:
                raise ValueError(f"{file.name} has more than {_LARGEST_BAG} bytes; split the bag")
    decode = get_typestore(Stores.LATEST).deserialize_cdr
    counts: Counter[str] = Counter()
    states: list[tuple[int, Any]] = []
    try:
        with Reader(path) as bag:
            found = [one for one in bag.connections if one.msgtype == _JOINT_STATE]
            for one in found:
                counts[one.topic] += one.msgcount
            chosen = topic or max(counts, key=counts.__getitem__, default="")
            if read := [one for one in found if one.topic == chosen]:
                messages = itertools.islice(bag.messages(read), _MOST_STATES + 1)
                states = [(received, decode(data, _JOINT_STATE)) for _, received, data in messages]
    except OSError:
        raise
    except Exception as error:  # for a damaged file, the library may raise any exception
        raise ValueError(f"it is not a ROS 2 bag, or it is damaged ({' '.join(str(error).split())[:120]})") from None
    if not states:
        where = f" on {topic}" if topic else ""
        raise ValueError(
            f"it contains no joint states ({_JOINT_STATE}){where}; topics with joint states: {listing(counts)}"
        )
    if len(states) > _MOST_STATES:
        raise ValueError(f"topic {chosen} has more than {_MOST_STATES} messages; split the bag")
    others = [one for one in counts if one != chosen]
    remark = f"topic {chosen} is read; to read another, give --columns topic=NAME: {listing(others)}"
    remarks = [remark] if others else []
    stamps = [message.header.stamp.sec * 10**9 + message.header.stamp.nanosec for _, message in states]
    if stamps[-1] <= stamps[0]:
        stamps = [received for received, _ in states]
        remarks.append("its messages have no time stamps, so the times at which they were recorded are used")
    names = list(dict.fromkeys(name for _, message in states for name in message.name))
    columns = ["time", *(f"{field} {name}" for field in _FIELDS for name in names)]
    place = {name: k for k, name in enumerate(columns)}
    values = np.full((len(states), len(columns)), np.nan)
    for row, stamp, (_, message) in zip(values, stamps, states, strict=True):
        row[0] = 1e-9 * (stamp - stamps[0])
        for field in _FIELDS:
            for name, number in zip(message.name, getattr(message, field), strict=False):
                row[place[f"{field} {name}"]] = number
    return LogTable(columns, {"time": "s"}, values, remarks)
