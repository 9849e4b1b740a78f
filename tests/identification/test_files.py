"""Files as other programs write them: read as the plain file, or refused with advice."""

import numpy as np
import pandas as pd
import pytest

import deadtime as dt
from deadtime.cli.application import with_options
from deadtime.identification.log.read_options import ReadOptions
from deadtime.identification.log.read_recording import read_recording

COUNT, H = 60, 0.5
RNG = np.random.default_rng(5)
PLAIN = pd.DataFrame(
    {
        "t": H * np.arange(COUNT),
        "x1": RNG.standard_normal(COUNT).round(4),
        "x2": (1000.0 * RNG.standard_normal(COUNT)).round(3),
        "u1": np.repeat(RNG.choice([10.0, 2.5, 0.0], COUNT // 4), 4),
        "mode": np.where(np.arange(COUNT) // 20 % 2, "shut", "open"),
    }
)
STAMPS = pd.Timestamp("2026-03-12 23:59:50") + pd.to_timedelta(PLAIN["t"], unit="s")
NAMES = ["t", "x1", "x2", "u1", "mode"]


def options(time=None, step=None, sep=None, decimal=None, on_change=()):
    return ReadOptions.of(time, step, sep, decimal, on_change)


def read(path, modes="mode", states=None, inputs=None, **how):
    return read_recording(path, modes, states, inputs, options=options(**how))


def stamped(form):
    return PLAIN.assign(t=STAMPS.dt.strftime(form))


def csv(table=PLAIN, **how):
    return table.to_csv(index=False, **how)


def on_change(*columns):
    table = PLAIN.astype(object)
    for column in columns:
        table.loc[PLAIN[column] == PLAIN[column].shift(), column] = ""
    return csv(table)


def put(text, line, new):
    """A file with one line more after a line."""
    lines = text.splitlines()
    return "\n".join([*lines[:line], new, *lines[line:]]) + "\n"


GERMAN = csv(sep=";", decimal=",")
# A file, options of the reader, and a phrase on how it was read.
FILES = {
    "plain": (csv(), {}, None),
    "carriage returns": (csv(lineterminator="\r\n"), {}, None),
    "an index": (PLAIN.to_csv(), {}, None),
    "blank lines": (csv().replace("\n", "\n\n"), {}, None),
    "quoted": (csv(quoting=1), {}, None),
    "semicolons": (GERMAN, {}, "columns separated by semicolons, decimal commas"),
    "semicolons said": (GERMAN, {"sep": ";", "decimal": ","}, "semicolons, decimal commas"),
    "Excel": (f"sep=;\r\n{GERMAN}".encode("utf-8-sig"), {}, "semicolons, decimal commas"),
    "quoted decimal commas": (csv(decimal=",", quoting=1), {}, "decimal commas"),
    "tabs": (csv(sep="\t"), {}, "columns separated by tabs"),
    "bars": (csv(sep="|"), {}, "columns separated by bars"),
    "blanks": (PLAIN.to_string(index=False), {}, "columns separated by blanks"),
    "blanks and commas": (PLAIN.to_string(index=False, decimal=","), {}, "blanks, decimal commas"),
    "UTF-16": (csv(sep="\t").encode("utf-16"), {}, "separated by tabs; encoding UTF-16"),
    "UTF-16 without a mark": (csv().encode("utf-16-le"), {}, "encoding UTF-16"),
    "Latin-1": (
        put(csv(), 1, "s,°C,µm,%,-").encode("latin-1"),
        {},
        "encoding Windows-1252, as it is not UTF-8; line 2 (units) left out",
    ),
    "units": (put(csv(), 1, "s,cm,cm,%,"), {}, "line 2 (units) left out"),
    "two rows of texts": (
        put(put(csv(), 1, "s,cm,cm,%,"), 2, "clock,low,high,pump,valve"),
        {},
        "lines 2 to 3 (units) left out",
    ),
    "a historian's preamble": (
        "Report: trend;;;;\nServer;PI-1\n\n" + GERMAN,
        {},
        "lines 1 to 2 before the header left out",
    ),
    "comments": (f"# made by a logger\n# 12 bit\n{csv()}# end\n", {}, "lines 1 to 2 before the"),
    "NumPy": (f"# {csv()}", {}, None),
    "trailing separators": (
        csv().replace("\n", ",\n"),
        {},
        "separators at the ends of lines ignored",
    ),
    "trailing separators of rows": (
        csv().replace("\n", ",\n").replace("mode,", "mode"),
        {},
        "separators at the ends of lines ignored",
    ),
    "cut short": (f"{csv()}30.0,0.12", {}, "line 62, cut short, left out"),
    "ISO 8601": (stamped("%Y-%m-%dT%H:%M:%S.%fZ"), {}, "times yyyy-mm-dd hh:mm:ss from 2026-03-12"),
    "ISO 8601, zone": (stamped("%Y-%m-%d %H:%M:%S.%f+01:00"), {}, "from 2026-03-12 22:59:50 UTC"),
    "ISO 8601, compact": (stamped("%Y%m%dT%H%M%S.%f"), {}, "times yyyymmdd hh:mm:ss"),
    "German dates": (
        stamped("%d.%m.%Y %H:%M:%S,%f").to_csv(index=False, sep=";", decimal=","),
        {},
        "semicolons, decimal commas; times dd.mm.yyyy hh:mm:ss from 2026-03-12 23:59:50",
    ),
    "a day beyond 12": (stamped("%m/%d/%Y %I:%M:%S.%f %p"), {}, "times mm/dd/yyyy hh:mm:ss from"),
    "months by name": (stamped("%d-%b-%y %H:%M:%S.%f"), {}, "times dd-mon-yy hh:mm:ss from"),
    "times of day": (stamped("%H:%M:%S.%f"), {}, "times hh:mm:ss, midnight passed once"),
    "durations": (PLAIN.assign(t=pd.to_timedelta(PLAIN["t"], unit="s")), {}, "times hh:mm:ss"),
    "seconds since 1970": (
        PLAIN.assign(t=[f"{1_772_439_300 + t:.1f}" for t in PLAIN["t"]]),
        {},
        "times in s since 1970, from 2026-03-02 08:15:00",
    ),
    "milliseconds since 1970": (
        PLAIN.assign(t=[1_772_439_300_000 + round(1e3 * t) for t in PLAIN["t"]]),
        {},
        "times in ms since 1970, from 2026-03-02 08:15:00",
    ),
    "nanoseconds since 1970": (
        PLAIN.assign(t=[1_772_439_300 * 10**9 + round(1e9 * t) for t in PLAIN["t"]]),
        {},
        "times in ns since 1970",
    ),
    "no times": (PLAIN.drop(columns="t"), {"step": H}, "rows every 0.5 s"),
    "other names": (
        PLAIN.set_axis(["Time [s]", "Level, low", "Level 2", "Pump [%]", "Valve"], axis=1),
        {
            "time": "Time [s]",
            "states": ["Level, low", "Level 2"],
            "inputs": ["Pump [%]"],
            "modes": "Valve",
        },
        None,
    ),
    "inputs on change": (on_change("u1"), {"on_change": ["u1"]}, "u1 logged on change"),
    "modes on change": (on_change("mode"), {"on_change": ["mode"]}, "mode logged on change"),
    "repeated rows": (
        csv(pd.concat((PLAIN, PLAIN[9:12])).sort_index()),
        {},
        "3 repeated rows left",
    ),
    "stamps to the second": (
        PLAIN.assign(t=PLAIN["t"] // 1.0),
        {},
        "times rounded to 1 s put on an even grid of 0.5 s",
    ),
}


def written(tmp_path, content):
    path = tmp_path / "log.csv"
    content = csv(content) if isinstance(content, pd.DataFrame) else content
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


@pytest.mark.parametrize(("content", "how", "phrase"), FILES.values(), ids=FILES)
def test_a_file_is_read_bit_for_bit_as_the_plain_one_and_that_is_said(
    content, how, phrase, tmp_path
):
    record = read(written(tmp_path, content), **how)
    (part,) = record.parts
    np.testing.assert_array_equal(part.output, PLAIN[["x1", "x2"]].to_numpy())
    np.testing.assert_array_equal(part.input, PLAIN[["u1"]].to_numpy())
    np.testing.assert_allclose(part.time - part.time[0], PLAIN["t"], atol=1e-12)
    assert [record.modes[i] for i in part.mode] == PLAIN["mode"].to_list()
    if phrase is None:
        assert record.read_as == ()
    else:
        assert phrase in record.read_as[0]


# A file, options, what is said of it, and the options that read it, if any do.
REFUSED = {
    "other names": (
        FILES["other names"][0],
        {},
        '--time "Time [s]" --states "Level, low" --states "Level 2" --inputs "Pump [%]" --modes '
        "Valve",
    ),
    "no times": (
        PLAIN.drop(columns="t"),
        {},
        "or give the sampling period as step, --step. For this file",
    ),
    "no header": (csv(header=False), {}, "has no header: name the columns in its first line"),
    "dates of two readings": (
        csv(PLAIN.assign(t=[f"0{1 + k % 8}/0{2 + k % 8}/2026" for k in range(COUNT)])[:8]),
        {},
        "the dates of the log may be dd/mm/yyyy and mm/dd/yyyy: write them as yyyy-mm-dd",
    ),
    "a zone now and then": (
        csv(
            PLAIN.assign(t=stamped("%Y-%m-%dT%H:%M:%SZ")["t"].where(PLAIN.index != 7, "x"))
        ).replace("\nx,", "\n2026-03-12T23:59:59,"),
        {},
        "line 9: t must have a zone in all rows or in none",
    ),
    "a zone by name": (stamped("%d.%m.%Y %H:%M:%S CET"), {}, "a zone such as +01:00 or Z"),
    "clocks set back": (
        csv(stamped("%Y-%m-%d %H:%M:%S.%f")).replace("2026-03-13 00:00:1", "2026-03-12 23:00:1"),
        {},
        "of a clock set back from summer time write stamps with their zones",
    ),
    "a stamp that is none": (
        put(csv(), 9, "noon,1,2,0,open"),
        {},
        "line 10: t must be a number or",
    ),
    "points of thousands in times": (
        csv(PLAIN.assign(t=[f"{k // 8}.{k % 8}00,5" for k in range(COUNT)]), sep=";", decimal=","),
        {},
        "line 2: t must be a number or a stamp such as",
    ),
    "thousands": (
        csv(PLAIN.assign(x2=PLAIN["x2"].map("{:,.2f}".format)), sep=";"),
        {},
        "x2 must be a finite number, got '1,",
    ),
    "thousands or decimals": (
        csv(
            PLAIN.assign(
                x1=[f"{k + 1},{k + 100}" for k in range(COUNT)],
                u1=PLAIN["u1"].astype(int),
                x2=5 - PLAIN.index,
                t=PLAIN.index,
            ),
            sep=";",
        ),
        {},
        'say --decimal ",", if its comma is of decimals',
    ),
    "decimal commas between commas": (
        csv(decimal=",").replace('"', "").replace("t,x", "t,x", 1),
        {},
        "name every column",
    ),
    "points and commas": (
        csv(PLAIN.assign(x1=PLAIN["x1"].map(str).str.replace(".", ",")), sep=";"),
        {},
        'say --decimal ",", if its comma is of decimals, in all numbers alike',
    ),
    "inputs on change, few": (
        csv(PLAIN.assign(u1=[k if k % 4 == 0 else "" for k in range(COUNT)])),
        {},
        "if the value before holds there, say --on-change u1",
    ),
    "one instant twice": (put(csv(), 9, "3.5,1,2,0,open"), {}, "line 10: t must be later than in"),
    "twice x1": (csv().replace("x2", "x1", 1), {}, "must have columns x1, x2, …"),
    "a picture": (b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR" + bytes(40), {}, "is no text: save it as"),
    "half of UTF-16": (csv().encode("utf-16")[:-1], {}, "is not UTF-16 text: save it as UTF-8"),
    "a comma too many": (put(csv(), 9, "4.2,1,2,0,open,7"), {}, "line 10 has 6 cells, and the hea"),
    "words for a separator": (csv(), {"sep": "semicolon"}, "--sep, must be one character"),
    "words for a decimal": (csv(), {"decimal": "comma"}, '--decimal, must be "." or ","'),
    "a foreign column on change": (csv(), {"on_change": ["x1"]}, "must name inputs or the column"),
    "no such time": (csv(), {"time": "Time"}, "must have the column 'Time'"),
}


@pytest.mark.parametrize(("content", "how", "said"), REFUSED.values(), ids=REFUSED)
def test_a_file_that_cannot_be_read_is_refused_with_what_to_do(content, how, said, tmp_path):
    with pytest.raises(dt.ArgumentError) as refused:
        read(written(tmp_path, content), **how)
    message = with_options(str(refused.value)).replace(f"{tmp_path}/", "")
    assert said in message
    assert message.startswith(("log.csv", "decimal", "sep", "on_change", "--"))


def test_dates_of_two_readings_are_decided_by_a_day_without_a_gap(tmp_path):
    rows = [f"{7 + k // 24:02}/08/2026 {k % 24:02}:00:00" for k in range(COUNT)]
    record = read(written(tmp_path, csv(PLAIN.assign(t=rows))))
    assert "times dd/mm/yyyy hh:mm:ss from 2026-08-07" in record.read_as[0]
    np.testing.assert_array_equal(record.parts[0].time, 3600.0 * np.arange(COUNT))


def test_inputs_on_change_are_known_by_never_repeating_a_value(tmp_path):
    long = pd.concat([PLAIN] * 8, ignore_index=True).assign(t=lambda table: H * table.index)
    long["u1"] = np.repeat(np.resize([10.0, 0.0, 5.0], len(long) // 4), 4)
    change = long.astype(object)
    change.loc[long["u1"] == long["u1"].shift(), "u1"] = ""
    record = read(written(tmp_path, csv(change)))
    np.testing.assert_array_equal(record.parts[0].input[:, 0], long["u1"])
    assert "u1 logged on change, so that its value holds in empty cells" in record.read_as[0]
    change.loc[42, "u1"] = change.loc[40, "u1"]  # now a value is repeated
    with pytest.raises(dt.ArgumentError, match=r"if the value before holds there, say on_change="):
        read(written(tmp_path, csv(change)))


def test_cells_without_a_value_are_missing_and_counted(tmp_path):
    table = PLAIN.astype(object)
    table.loc[[3, 4, 8], "x1"] = "Bad"
    table.loc[5, "x2"] = "I/O Timeout"
    table.loc[[7], "u1"] = ""
    record = read(written(tmp_path, csv(table)))
    output = record.parts[0].output
    assert np.argwhere(np.isnan(output)).tolist() == [[3, 0], [4, 0], [5, 1], [8, 0]]
    assert np.flatnonzero(np.isnan(record.parts[0].input[:, 0])).tolist() == [7]
    assert "3 cells 'Bad' in x1 taken as missing" in record.read_as[0]
    assert "1 cell 'I/O Timeout' in x2 taken as missing" in record.read_as[0]


def test_no_column_of_the_mode_is_one_mode_and_that_is_said(tmp_path):
    record = read(written(tmp_path, csv(PLAIN.rename(columns={"mode": "Valve"}))))
    assert record.modes == ("mode 0",)
    assert record.read_as == (
        "No column mode: one mode. If Valve is the mode, say modes='Valve', --modes Valve.",
    )
    with pytest.raises(dt.ArgumentError, match="must have the column 'gear'"):
        read(written(tmp_path, csv()), modes="gear")


def test_tables_with_dates_and_durations_are_read(tmp_path):
    for times in (STAMPS, STAMPS.dt.tz_localize("Europe/Berlin"), pd.to_timedelta(PLAIN["t"], "s")):
        record = read(PLAIN.assign(t=times))
        np.testing.assert_array_equal(record.parts[0].time, PLAIN["t"])


def test_the_switching_of_a_file_is_read_by_the_same_reader(tmp_path):
    for name in ("semicolons", "UTF-16", "German dates", "milliseconds since 1970", "units"):
        path = written(tmp_path, FILES[name][0])
        signal = dt.SwitchingSignal.from_csv(path, labels={"open": 0, "shut": 1})
        assert signal.times.tolist() == [0.0, 10.0, 20.0]
        assert signal.end == 29.5
    path = written(tmp_path, FILES["other names"][0])
    how = {"time": "Time [s]", "mode": "Valve", "labels": {"open": 0, "shut": 1}}
    assert dt.SwitchingSignal.from_csv(path, **how).times.tolist() == [0.0, 10.0, 20.0]
