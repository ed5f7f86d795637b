"""A log is the same whatever wrote it; what was assumed or left out is said; what cannot be read says what to do."""

import datetime
import io
import itertools
import os
import re
import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from support.bags import write_bag

from fuzzyarm.cli import main
from fuzzyarm.identification.log import Log
from fuzzyarm.identification.reading import held_mean, read_log

COUNT = 600
TIME = 2e-3 * np.arange(COUNT)
ANGLE = np.stack([np.sin(3.0 * TIME) + 0.1, 0.7 * np.cos(5.0 * TIME)], axis=1)
SPEED = np.gradient(ANGLE, TIME, axis=0)
TORQUE = np.stack([2.0 * np.cos(4.0 * TIME), np.sign(np.sin(9.0 * TIME))], axis=1)


def table(heading="time,q1,q2,tau1,tau2", delimiter=",", columns=None, mark=".", end="\n"):
    """The text of the log, by default as evenly stamped seconds, radians and N m."""
    rows = np.column_stack([TIME, ANGLE, TORQUE] if columns is None else columns)
    lines = [delimiter.join(f"{x:.10g}" for x in row).replace(".", mark) for row in rows]
    return heading + "\n" * bool(heading) + end.join(lines) + end


def written(tmp_path, text, name="log.csv"):
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


FIVE = "time,q1,q2,tau1,tau2"
ROWS = table().splitlines()


def each(change, heading=FIVE):
    """The text of the log with a change of each row, which is given its number and what is written in it."""
    return "\n".join([heading, *(change(k, row) for k, row in enumerate(ROWS[1:]))])


def stamped(stamp):
    """The text of the log with other times, which are given for the numbers of the rows."""
    return each(lambda k, row: f"{stamp(k)},{row.split(',', 1)[1]}")


def iso(k):
    begin = datetime.datetime(2025, 3, 12, 23, 59, 59, tzinfo=datetime.UTC)
    return (begin + datetime.timedelta(seconds=TIME[k])).isoformat()


def own_time(_, row):
    """A row in which the second joint has a time of its own, 1 ms later."""
    time, q1, q2, *torque = row.split(",")
    return f"{time},{q1},{torque[0]},{float(time) + 1e-3},{q2},{torque[1]}"


IN_DEGREES = [1e3 * TIME, np.degrees(ANGLE), TORQUE]
IN_TURNS = [1e6 * TIME, ANGLE / (2.0 * np.pi), 1e3 * TORQUE]
JOINTS = "/joint_states/joint"
LABVIEW = "LabVIEW Measurement\nChannels\t4\nSamples\t1\t1\t1\t1\n***End***\ntime\tq1\tq2\ttau1\ttau2\tComment"
MEASURED = "time,pos_meas1,pos_meas2,vel_meas1,vel_meas2,pos_filt1,pos_filt2,vel_filt1,vel_filt2"
OF_TORQUES = "tau_con1,tau_con2,tau_fric1,tau_fric2,tau_meas1,tau_meas2"
FILTERED = [TIME, ANGLE, SPEED, 0.9 * ANGLE, 0.9 * SPEED]
TORQUES = [3.0 * TORQUE, 0.1 * TORQUE, TORQUE]
TEXTS = {
    "package": Log(2e-3, ANGLE, TORQUE, SPEED).to_csv(),
    "byte order mark": b"\xef\xbb\xbf" + table().encode(),
    "UTF-16": table().encode("utf-16"),
    "tab": table("time\tpos 1\tpos 2\ttau 1\ttau 2", "\t"),
    "semicolon and decimal comma": table("Zeit;q1;q2;tau1;tau2", ";", mark=","),
    "space and comment": table("# recorded on Monday\n# time q1 q2 tau1 tau2", " "),
    "delimiter at each end": table(FIVE + ",", end=",\n"),
    "units in brackets, Latin-1": table(
        "time [ms];q1 [°];q2 [°];tau1 [N·m];tau2 [N·m]", ";", columns=IN_DEGREES
    ).encode("latin-1"),
    "units in parentheses": table("t (us), q_1 (rev), q_2 (rev), tau_1 (mNm), tau_2 (mNm)", columns=IN_TURNS),
    "units in a second line": table("time\tq1\tq2\ttau1\ttau2\nms\tdeg\tdeg\tN m\tN m", "\t", columns=IN_DEGREES),
    "ISO 8601": stamped(iso),
    "quoted decimal comma": each(lambda _, row: ",".join(f'"{cell.replace(".", ",")}"' for cell in row.split(","))),
    "LabVIEW": each(lambda _, row: row.replace(",", "\t"), LABVIEW),
    "nanoseconds since 1970": stamped(lambda k: 1_700_000_000_000_000_000 + 2_000_000 * k),
    "joints from 0, velocities, demands": table(
        "timestamp,pos_meas0,pos_meas1,vel_meas0,vel_meas1,tau_meas0,tau_meas1,pos_des0,pos_des1",
        columns=[TIME, ANGLE, SPEED, TORQUE, 9.0 * ANGLE],
    ),
    # The headings of the 37 recorded logs of the double pendulum, and one of an older version of them.
    "DFKI, velocities": table("time,pos1,pos2,vel1,vel2,tau1,tau2", columns=[TIME, ANGLE, SPEED, TORQUE]),
    "DFKI, velocities, spaces": table("time, pos1, pos2, vel1, vel2, tau1, tau2", columns=[TIME, ANGLE, SPEED, TORQUE]),
    "DFKI, velocities, 15 columns": table(f"{MEASURED},{OF_TORQUES}", columns=[*FILTERED, *TORQUES]),
    "DFKI, velocities, 21 columns": table(
        f"{MEASURED},pos_des1,pos_des2,vel_des1,vel_des2,{OF_TORQUES},tau_des1,tau_des2",
        columns=[*FILTERED, 1.1 * ANGLE, 1.1 * SPEED, *TORQUES, 2.0 * TORQUE],
    ),
    "joints by name": table("time,shoulder_position,elbow_position,shoulder_effort,elbow_effort"),
    "joints by letter": table("time,q_a,q_v,tau_a,tau_v"),
    "as PlotJuggler": table(
        "__time," + ",".join(f"{JOINTS}{joint}/{field}" for field in ("position", "effort") for joint in (1, 2))
    ),
    "rows with numbers but no name, as in R": each(
        lambda k, row: f'"{k + 1}" ' + row.replace(",", " "), '"time" "q1" "q2" "tau1" "tau2"'
    ),
    "words and blanks in other columns": each(lambda k, row: f"{row},RUN,{'ok' * (k % 2)}", FIVE + ",mode,note"),
    "heading twice, and cut off": "\n".join([*ROWS[:300], ROWS[0], *ROWS[300:], "1.2,0.3"]),
}


@pytest.mark.parametrize("name", TEXTS)
def test_a_text_gives_the_log_that_was_written(name, tmp_path):
    (log,) = read_log(written(tmp_path, TEXTS[name]))
    assert log.period == pytest.approx(2e-3, rel=1e-5)
    np.testing.assert_allclose(log.angle, ANGLE, atol=1e-8)
    np.testing.assert_allclose(log.torque, TORQUE, atol=1e-8)
    assert (log.velocity is not None) == ("velocities" in name or name == "package")


@pytest.mark.parametrize(
    "kind", ["matrices", "group", "rows", "record", "array", "matlab", "SQLITE3", "MCAP", "mcap file", "no stamps"]
)
def test_arrays_and_bags_give_the_log_that_was_written(kind, tmp_path):
    path, columns = tmp_path / "log.npz", {}
    match kind:
        case "group":
            np.savez(path, **{"log/time": TIME, "log/q": ANGLE, "log/tau": TORQUE})
        case "matrices":
            np.savez(path, time=TIME, q=ANGLE, tau=TORQUE)
        case "rows":
            np.savez(path, time=TIME, q=ANGLE.T, tau=TORQUE.T)
        case "record":
            path, record = tmp_path / "log.npy", np.empty(COUNT, [("t", float), ("q", float, 2), ("effort", float, 2)])
            record["t"], record["q"], record["effort"] = TIME, ANGLE, TORQUE
            np.save(path, record)
        case "array":
            path, columns = tmp_path / "log.npy", {"time": "1", "q1": "2", "q2": "3", "tau1": "4", "tau2": "5"}
            np.save(path, np.column_stack([TIME, ANGLE, TORQUE]))
        case "matlab":
            path = tmp_path / "log.mat"
            scipy.io.savemat(path, {"t": TIME, "q": ANGLE, "tau": TORQUE, "note": "text", "rate": 500.0})
        case _:
            pytest.importorskip("rosbags")
            path = tmp_path / "bag"
            write_bag(path, kind if kind == "SQLITE3" else "MCAP", ANGLE, SPEED, TORQUE, stamped=kind != "no stamps")
            path = next(path.glob("*.mcap")) if kind == "mcap file" else path
    (log,) = read_log(path, columns=columns)
    assert log.period == pytest.approx(2e-3, rel=1e-6)
    np.testing.assert_allclose(log.angle, ANGLE, atol=1e-12)
    np.testing.assert_allclose(log.torque, TORQUE, atol=1e-12)
    assert any("times at which they were recorded" in remark for remark in log.remarks) == (kind == "no stamps")


def test_the_mean_of_a_held_torque_keeps_its_integral():
    rng = np.random.default_rng(0)
    stamps = np.cumsum(rng.uniform(0.5e-3, 2e-3, size=400))
    torque = rng.normal(size=(400, 2))
    period = 1.7e-3
    at = stamps[3] + period * np.arange(200)
    held = held_mean(stamps, torque, at, period)
    fine = np.linspace(at[0], at[-1] + period, 400_001)
    value = torque[np.searchsorted(stamps, 0.5 * (fine[1:] + fine[:-1]), side="right") - 1]
    np.testing.assert_allclose(held.sum(axis=0) * period, (value * np.diff(fine)[:, np.newaxis]).sum(axis=0), atol=1e-5)
    even = 1e-3 * np.arange(400)
    np.testing.assert_allclose(held_mean(even, torque, even, 1e-3), torque, atol=1e-10)


def test_what_a_robot_does_to_a_log_is_undone_and_said(tmp_path):
    """Stamps that jitter, coarse encoders, a gap, stamps twice and backwards, idle ends."""
    rng = np.random.default_rng(1)
    time = 2e-3 * np.arange(4000)
    moving = np.clip(time - 2.0, 0.0, 4.0)
    angle = np.stack([1.0 - np.cos(2.0 * moving), np.sin(3.0 * moving)], axis=1)
    torque = np.repeat(rng.normal(size=(400, 2)), 10, axis=0)
    stamps = time + rng.uniform(-2e-4, 2e-4, size=len(time))
    stamps[1500], stamps[1510] = stamps[1499], stamps[1508]
    rows = np.column_stack([stamps, np.round(angle / 4e-4) * 4e-4, torque])
    text = table(columns=[np.delete(rows, slice(2000, 2100), axis=0)])
    first, second = read_log(written(tmp_path, text))
    for phrase in ("2 time stamp(s) do not increase", "1 gap(s) in time of more than 20 ms; 2 part(s)", "resampled",
                   "idle ends are cut off: 1.", "idle ends are cut off: 0 s at the beginning and 1."):  # fmt: skip
        assert any(phrase in remark for remark in first.remarks), (phrase, first.remarks)
    assert (first.name, second.name, second.remarks) == ("log.csv", "log.csv, part 2", ())
    for log in (first, second):
        begins = np.arange(0.0, time[-1] - log.duration, 1e-4)[:, np.newaxis]
        at = begins + log.period * np.arange(0, len(log.angle), 50)
        errors = [np.interp(at, time, one) - read for one, read in zip(angle.T, log.angle[::50].T, strict=True)]
        assert np.abs(errors).max(axis=(0, 2)).min() < 4e-3


GEARED = table(columns=[TIME, 60.0 * ANGLE / 2 / np.pi, TORQUE / 60.0 / 0.12])
TORQUES_IN = "time,q1,q2,tau1 [{0}],tau2 [{0}]"
MOVING = "time,q1,q2,dq1,dq2,tau1,tau2"
STAMPED = each(lambda k, row: f"{1.3 * TIME[k]},{row}", "%time,stamp,q1,q2,tau1,tau2")


@pytest.mark.parametrize(
    ("given", "options", "angle", "torque"),
    [
        (table(), {"units": {"tau1": 0.5, "tau2": "mNm", "q": "deg"}}, np.radians(ANGLE), TORQUE * [0.5, 1e-3]),
        (GEARED, {"units": {"q": "rev", "tau": 0.12}, "gear": (60.0,)}, ANGLE, TORQUE),
        (GEARED, {"units": {"q": "rev", "tau": "0.12"}, "gear": (60.0, 60.0), "delay": 0.01}, ANGLE[:-5], TORQUE[5:]),
        (table(TORQUES_IN.format("%")), {"units": {"tau1": 1.5, "tau2": 0.6}}, ANGLE, TORQUE * [1.5, 0.6]),
        (table(TORQUES_IN.format("N-m")), {}, ANGLE, TORQUE),
        (table(TORQUES_IN.format("lbf-in")), {}, ANGLE, 0.1129848 * TORQUE),
    ],
)
def test_a_gear_a_delay_and_units_are_those_that_are_given(given, options, angle, torque, tmp_path):
    """A unit of torques may be unknown if each joint has its own."""
    (log,) = read_log(written(tmp_path, given), **options)
    np.testing.assert_allclose(log.angle[: len(angle)], angle, atol=1e-9)
    np.testing.assert_allclose(log.torque[: len(torque)], torque, atol=1e-9)


@pytest.mark.parametrize(
    ("text", "remark"),
    [
        (table(MOVING, columns=[TIME, ANGLE, SPEED * [1.0, -1.0], TORQUE]), "velocities of joint 2 are -1 times the"),
        (STAMPED, "time is read from column stamp"),
        ("\n".join([FIVE, *ROWS[:0:-1]]), "time decreases throughout, so it is read from the last row to the first"),
    ],
)
def test_what_is_chosen_of_a_text_is_said(text, remark, tmp_path):
    """Velocities that are no slopes are not used, the stamp of a header is the time, the newest row may come first."""
    (log,) = read_log(written(tmp_path, text))
    assert log.velocity is None and len(log.remarks) == 1 and remark in log.remarks[0].replace("'", "")
    assert log.period == pytest.approx(2e-3)
    np.testing.assert_allclose(log.angle, ANGLE, atol=1e-8)
    np.testing.assert_allclose(log.torque, TORQUE, atol=1e-8)


def zipped(content):
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("time.npy", content)
    return file.getvalue()


def pickled():
    file = io.BytesIO()
    np.save(file, np.array([print, None], dtype=object), allow_pickle=True)
    return file.getvalue()


VERSION_4 = struct.pack("<5i2s", 0, 40_000, 1000, 0, 2, b"q")  # the header of a variable q
FAR = [1e3 + 5e11 * np.arange(COUNT), ANGLE, TORQUE]
SENTINELS = np.where(np.arange(COUNT)[:, np.newaxis] % 15 == 7, -9999.0, TORQUE)
REFUSED = {
    "columns 1 and 4 both contain times, which differ by up to 0.001; write all signals at common instants": each(
        own_time, "time,q1,tau1,time,q2,tau2"
    ),
    "500 of 600 rows lack a number": each(lambda k, row: row if k < 100 else f"1'{row}"),
    "write one line per instant": table("time,q,tau", columns=[np.repeat(TIME[::2], 2), ANGLE[:, 0], TORQUE[:, 0]]),
    "no row has a number in every column that is read": each(
        lambda k, _: f"{TIME[k]},0.1,0.2,," if k % 2 else f"{TIME[k]},,,1,2"
    ),
    "it is empty; needed: a heading such as time,q1,q2,tau1,tau2": "",
    "it is empty": "\n" * 900,
    "its longest part without a gap in time of more than 20 ms has only 98 of the 100 samples needed": "\n".join(
        ROWS[:99]
    ),
    "neither comma, semicolon, tab nor space divides its lines into 3 or more columns": "1\n2\n3\n" * 200,
    "it is not text; a log must be CSV": bytes(range(256)) * 40,
    "its 5 columns have no heading, so no column is recognised as time, q1, tau1; give the columns names": table(""),
    "none of the columns time, q1, q2, tau1, current2 is recognised as tau2": table("time,q1,q2,tau1,current2"),
    "none of the columns a, b, c, d, e is recognised as time, q1, tau1": table("a,b,c,d,e"),
    "its lines have 5 cells, but its heading time,q1,q2,tau1 has 4": table("time,q1,q2,tau1"),
    "has 5; numbers with a decimal comma need": table(mark=","),
    "columns q1, q1 could each be q1; choose one with --columns q1=NAME": table("time,q1,q1,tau1,tau2"),
    "unknown unit furlong for q; give --units q=UNIT, where UNIT is one of": table(
        "time,q1 [furlong],q2 [furlong],tau1,tau2"
    ),
    "columns q1, q2 have different units": table("time,q1 [deg],q2 [rad],tau1,tau2"),
    "its time column never increases; choose": table(columns=[0.0 * TIME, ANGLE, TORQUE]),
    "the median time step 5e+11 fits no unit of time": table(columns=FAR),
    "column q1 contains no numbers; choose another column with": table(columns=[TIME, ANGLE * [np.nan, 1.0], TORQUE]),
    "angle contains a number of magnitude": table(columns=[TIME, 1e300 * ANGLE, TORQUE]),
    "such as the torque constant for a column in A: tau=0.12": table("time,q1,q2,tau1 [A],tau2 [A]"),
    "tau1 has outliers in 40 row(s), the first (-9999) at t = 0.014 s; allowed: at most 5 % of the rows": table(
        columns=[TIME, ANGLE, SENTINELS]
    ),
    "line 301 has columns in another order than before: split the file there": "\n".join(
        [*ROWS[:300], "time,tau1,tau2,q1,q2", *ROWS[300:]]
    ),
    "its heading rst:0x1 (POWERON_RESET) has 1; delete the lines before line 8, which seems to be the heading": (
        "\n".join(["rst:0x1 (POWERON_RESET)", *ROWS[500:504], "Brownout detector", "", *ROWS])
    ),
    "its heading @DATA has 1; write 5 names in the line above the numbers": "\n".join(
        ["@RELATION arm", "", "@ATTRIBUTE q1 NUMERIC", "@DATA", *ROWS[1:]]
    ),
}
NO_TEXT = [
    ("sheet.xlsx", b"PK\x03\x04 and more", "a zip archive or a spreadsheet: unpack it, or save the sheet as CSV"),
    ("log.csv.gz", b"\x1f\x8b and more", "it is compressed with gzip: unpack it"),
    ("log.npy", pickled(), "log.npy has the type object; save arrays of numbers"),
    ("log.npz", zipped(pickled()), "has the type object; save arrays of numbers"),
    ("log.npz", b"PK\x03\x04" + bytes(100), "is damaged"),
    ("log.mat", b"MATLAB 5.0 MAT-file" + bytes(range(200)), "it is not a MATLAB file, or it is damaged"),
    ("log.mat", VERSION_4, "log.mat: it has 40000000 numbers; allowed: at most 32000000. Remove unneeded variables"),
    ("log.mat", b"\x89HDF\r\n\x1a\n" + bytes(200), "a MATLAB file of version 7.3; save it with: save(log.mat, -v7,"),
    ("log.json", '{"time":{"0":0.0,"1":0.001}}', "it is JSON; write CSV with one line for each instant"),
    ("log.json", '[\n {"time": 0.0, "q1": 0.1}]', "it is JSON; write CSV"),
    ("log.xml", '<Rob Type="KUKA"><AIPos A1="5.2"/></Rob>\n' * 9, "it is XML; write CSV"),
    ("log.yaml", "header:\n  stamp:\n    sec: 1\n" * 9, "it is YAML; write CSV"),
    ("log.mcap", bytes(range(256)), "it is not a ROS 2 bag, or it is damaged"),
    ("log.db3", b"SQLite format 3\x00" + bytes(2000), "it is not a ROS 2 bag, or it is damaged"),
]


@pytest.mark.parametrize(
    ("name", "content", "message"), [*(("log.csv", text, message) for message, text in REFUSED.items()), *NO_TEXT]
)
def test_what_cannot_be_read_says_why_and_what_to_do(name, content, message, tmp_path, capsys):
    path = written(tmp_path, content, name)
    assert main(["identify", str(path)]) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and err.startswith(f"fuzzyarm identify: {path}")
    assert message in err.replace("'", "")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"columns": {"q0": "q1"}}, "columns has the unknown role q0; allowed: time, q1, dq1"),
        ({"columns": {"q1": "hip"}}, "column hip for q1 does not exist; columns: time, q1"),
        ({"columns": {"q1": "tau1"}}, "q1 and tau1 refer to the same column tau1"),
        ({"units": {"angle": "deg"}}, "a key of units = angle is unknown; choose from: time, q, dq, tau"),
        ({"units": {"tau3": "Nm"}}, "unknown key tau3; allowed: time, q, dq, tau, or q1, dq1, tau1 and so on, up to"),
        ({"units": {"time1": "s"}}, "units has the unknown key time1"),
        ({"units": {"q": 0.0}}, "unit of q = 0.0 is out of range"),
        ({"columns": {"tau1": "tau1_counts"}}, "column tau1_counts for tau1 seems to be in counts"),
        ({"gear": (1.0, 2.0, 3.0)}, "gear has 3 ratios; allowed: one, or one for each of the 2 joints"),
        ({"delay": 2.0}, "delay = 2.0 s is out of range"),
    ],
)
def test_options_that_do_not_fit_are_refused(options, message, tmp_path):
    counts = "tau1_counts" in options.get("columns", {}).values()
    path = written(tmp_path, table("time,q1,q2,tau1_counts,tau2" if counts else FIVE))
    with pytest.raises(ValueError) as caught:
        read_log(path, **options)
    assert message in str(caught.value).replace("'", "")


FOLDER = os.environ.get("FUZZYARM_REAL_LOGS", "")


@pytest.mark.skipif(not FOLDER, reason="FUZZYARM_REAL_LOGS does not name the folder of the recorded logs")
def test_recorded_logs_of_a_robot_are_read():
    """Four excerpts of the logs of github.com/dfki-ric-underactuated-lab/double_pendulum."""
    found = [(path.stem, log) for path in sorted(Path(FOLDER).glob("design_*.csv")) for log in read_log(path)]
    names = ("design_A0_060329", "design_A0_061157", "design_C1_143601", "design_C1_154548")
    assert [(name, len(log.angle)) for name, log in found] == [*zip(names, (1998, 1201, 1750, 2682), strict=True)]


@pytest.mark.slow
@pytest.mark.skipif(not FOLDER, reason="FUZZYARM_REAL_LOGS does not name the folder of the recorded logs")
def test_recorded_logs_lead_to_a_proven_and_stable_controller_and_its_c(tmp_path, monkeypatch, capsys):
    """The commands of docs/tutorials/identify.md, from two logs of the double pendulum to C."""
    page = (Path(__file__).parents[2] / "docs/tutorials/identify.md").read_text(encoding="utf-8")
    section = page.split("## From a recorded log to C")[1].split("\n## ")[0]
    start, commands = re.findall(r"```\w+\n(.*?)```", section, re.DOTALL)
    monkeypatch.chdir(tmp_path)
    Path("start.toml").write_text(start)
    for path in Path(FOLDER).glob("design_A0_*.csv"):
        Path(path.name).write_bytes(path.read_bytes())
    for line in commands.strip().splitlines():
        words = [sorted(map(str, Path().glob(word))) if "*" in word else [word] for word in line.split()[1:]]
        assert main([*itertools.chain(*words)]) == 0, line
    text = capsys.readouterr().out
    assert "WARNING" not in text and "PROVEN" in text and Path("board/pendulum.c").is_file()


RATE = 3000 / (2.0 * np.pi)  # counts for a radian
TURNED = np.arctan2(np.sin(ANGLE + 2.6), np.cos(ANGLE + 2.6))
JUMPY = (ANGLE * [1.0, 0.0] + 1e-4 * (-1.0) ** (np.arange(COUNT)[:, np.newaxis] // 2)) % (2.0 * np.pi)
WRAPPED = {
    "a turn": (TURNED, {}, "a turn (6.2832) in 2 place(s)"),
    "degrees": (np.degrees(ANGLE) % 360.0, {"q": "deg"}, "a turn (360) in 2 place(s)"),
    "noise that wraps to and fro": (JUMPY, {}, "a turn (6.2832) in 299 place(s)"),
    "counts": (np.round(ANGLE * RATE) % 1024, {"q": 1.0 / RATE}, "1024 in 2 place(s)"),
}
OUTLIERS = {
    "sentinels": (1, [100, 104, 300], -9999.0, "q1 has outliers in 3 row(s), the first (-9999) at t = 0.2 s"),
    "a sentinel that lasts": (
        2,
        slice(200, 208),
        65535.0,
        "q2 has outliers in 8 row(s), the first (65535) at t = 0.4 s",
    ),
    "a sentinel at the end": (
        2,
        -1,
        -(2.0**31),
        "q2 has outliers in 1 row(s), the first (-2.14748e+09) at t = 1.198 s",
    ),
    "angles that drop to 0": ([[1], [2]], [250, 400], 0.0, "q2 has outliers in 2 row(s), the first (0) at t = 0.5 s"),
    "a spike of a torque": (3, 300, 1e9, "tau1 has outliers in 1 row(s), the first (1e+09) at t = 0.6 s"),
}


@pytest.mark.parametrize("name", WRAPPED)
def test_wrapped_angles_are_unwrapped(name, tmp_path):
    angle, units, jumps = WRAPPED[name]
    (log,) = read_log(written(tmp_path, table(columns=[TIME, angle, TORQUE])), units=units)
    assert f"q2 jumps by {jumps}, so it is unwrapped" in log.remarks
    truth = ANGLE * [1.0, 0.0] if "noise" in name else ANGLE
    np.testing.assert_allclose(log.angle - log.angle[0], truth - truth[0], atol=3e-3)
    np.testing.assert_allclose(log.torque, TORQUE, atol=1e-8)


@pytest.mark.parametrize("name", OUTLIERS)
def test_rows_that_jump_away_are_left_out(name, tmp_path):
    column, rows, value, outliers = OUTLIERS[name]
    spoiled = np.column_stack([TIME, ANGLE, TORQUE])
    spoiled[rows, column] = value
    (log,) = read_log(written(tmp_path, table(columns=[spoiled])))
    assert f"{outliers}; these rows are left out" in log.remarks
    count = len(log.angle)
    np.testing.assert_allclose(log.angle - log.angle[0], (ANGLE - ANGLE[0])[:count], atol=3e-3)
    np.testing.assert_allclose(log.torque[:, 0], TORQUE[:count, 0], atol=0.15)


def flick(time):
    """A fast motion to and fro in the middle of a long rest, at 50 samples a second."""
    return np.stack([np.exp(-(((time - 6.0) / 0.1) ** 2)), 0.0 * time + 0.3], axis=1)


SLOW = 0.02 * np.arange(COUNT)
NOISE = np.random.default_rng(2).normal(size=(COUNT, 2))
RIGHT = {
    "a coarse encoder, a joint that rests": (TIME, np.round((ANGLE * [1.0, 0.0] + 1e-3 * NOISE) / 2e-3) * 2e-3, TORQUE),
    "noise": (TIME, ANGLE + 0.05 * NOISE, TORQUE + NOISE),
    "an impact": (TIME, np.abs(ANGLE - 0.5), TORQUE),
    "angles held for some rows": (TIME, np.repeat(ANGLE[::6], 6, axis=0), TORQUE),
    "fast motion after rest": (SLOW, flick(SLOW), TORQUE),
    "fine counts": (TIME, np.round(ANGLE * 2.0**19), TORQUE),
    "torques that switch": (TIME, ANGLE, 20.0 * np.sign(np.sin(90.0 * TIME))[:, np.newaxis] * [1.0, 0.0] + 0.1 * NOISE),
}


@pytest.mark.parametrize("name", RIGHT)
def test_a_right_log_stays_untouched(name, tmp_path):
    time, angle, torque = RIGHT[name]
    (log,) = read_log(written(tmp_path, table(columns=[time, angle, torque])))
    assert not [remark for remark in log.remarks if "jumps" in remark]
