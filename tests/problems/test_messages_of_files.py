"""Messages name tables, modes and laws as the file's writer knows them."""

import dataclasses

import pytest

import deadtime as dt
from deadtime.cli import options
from deadtime.problems.file import load_problem
from deadtime.reports.verdict import held_in_words

FILE = """
[plant]
A = [[[-0.5, 1.0], [0.0, -1.0]], [[-0.4, 1.0], [0.0, -1.0]]]
B = [[[0.0], [1.0]], [[0.0], [1.0]]]
delay = 0.2
modes = ["throttle", "brake"]
[gains]
poles = [-1.0, -2.0]
[switching]
kind = "semi-markov"
sojourn = { distribution = "expon", loc = 60.0, scale = 10.0 }
[signal]
kind = "model"
[[law]]
kind = "single"
mode = "brake"
[[law]]
kind = "exact"
[[offset]]
mode = "brake"
force = [0.0, 2.0]
[run]
x0 = [1.0, 0.0]
horizon = 4.0
step = 0.1
"""


@pytest.fixture
def loaded(tmp_path):
    def load(*changes):
        path, text = tmp_path / "p.toml", FILE
        for old, new in zip(changes[::2], changes[1::2], strict=True):
            text = text.replace(old, new)
        path.write_text(text, encoding="utf-8")
        return load_problem(path)

    return load


def test_mode_names_stand_for_mode_numbers(loaded):
    by_name, by_number = loaded(), loaded('mode = "brake"', "mode = 1")
    assert list(by_name.laws) == list(by_number.laws) == ["brake only", "oracle"]
    assert by_name.imperfections == by_number.imperfections
    with pytest.raises(dt.ArgumentError, match=r"mode must be .* 'throttle', 'brake', got 'break'"):
        loaded('mode = "brake"', 'mode = "break"')


REGIONS = """[signal]
kind = "polyhedra"
[[signal.regions]]
H = [[1.0, 0.0]]
h = [0.0]
mode = "brake"
[[signal.regions]]
H = [[-1.0, 0.0]]
h = [0.0]
mode = "throttle\""""
SIGNAL = '[signal]\nkind = "model"'
SECTIONS = {
    "constant": '[signal]\nkind = "constant"\nmode = "brake"',
    "periodic": '[signal]\nkind = "periodic"\nsojourns = [1.0, 2.0]\nmodes = ["brake", 0]',
    "switches": '[signal]\nkind = "switches"\ntimes = [0.0, 0.7]\nmodes = ["throttle", "brake"]',
    "log": '[signal]\nkind = "log"\nfile = "log.csv"\nlabels = { go = "throttle", stop = "brake" }',
    "polyhedra": REGIONS,
    "observer": SIGNAL
    + '\n[observer]\nkind = "luenberger"\nC = [[1.0, 0.0]]\npoles = [-3.0, -4.0]\nmodel = "brake"',
}


@pytest.mark.parametrize("section", SECTIONS.values(), ids=SECTIONS)
def test_every_section_takes_modes_by_name(loaded, tmp_path, section):
    (tmp_path / "log.csv").write_text("t,mode\n0,go\n1.5,stop\n", encoding="utf-8")
    numbers = section.replace('"throttle"', "0").replace('"brake"', "1")
    causal = 'kind = "exact"', 'kind = "averaged"'  # a rule leaves no law to know the future
    by_name, by_number = (loaded(SIGNAL, text, *causal) for text in (section, numbers))
    assert repr(by_name.signal) == repr(by_number.signal)
    runs = [one.simulate("brake only").states for one in (by_name, by_number)]
    assert (runs[0] == runs[1]).all()
    key = "labels.stop" if "log" in section else r"mod\w*"
    with pytest.raises(dt.ProblemFileError, match=rf"{key}.* 'throttle', 'brake', got 'break'\."):
        loaded(SIGNAL, section.replace('"brake"', '"break"'), *causal)


def test_a_wrong_name_of_a_mode_is_found_by_its_line(loaded):
    message = r"line 15, \[signal\]: modes\[1\] must be the number of a mode or one of 'throttle'"
    with pytest.raises(dt.ProblemFileError, match=message):
        loaded(SIGNAL, SECTIONS["switches"].replace('"brake"', '"break"'))


@pytest.mark.parametrize(
    ("section", "wrong", "place"),
    [
        ("polyhedra", 'mode = "throttle"', r"line 21, \[\[signal\.regions\]\] 2: mode must"),
        ("polyhedra", 'mode = "brake"', r"line 17, \[\[signal\.regions\]\] 1: mode must"),
        ("log", 'stop = "brake"', r"line 15, \[signal\]: labels\.stop must"),
    ],
)
def test_a_wrong_name_in_a_nested_table_is_found_by_its_line(loaded, section, wrong, place):
    text = SECTIONS[section].replace(wrong, wrong.split("=")[0] + '= "break"')
    with pytest.raises(dt.ProblemFileError, match=place):
        loaded(SIGNAL, text, 'kind = "exact"', 'kind = "averaged"')


def test_names_of_modes_must_be_unambiguous(loaded):
    with pytest.raises(dt.ProblemFileError, match=r"line 6, .*different, got 'brake' twice"):
        loaded('"throttle"', '"brake"')
    observer = SECTIONS["observer"].replace('"brake"', '"mean"')
    loaded(SIGNAL, observer)
    with pytest.raises(
        dt.ProblemFileError, match=r"\[observer\]: model = 'mean' is .* a mode, too"
    ):
        loaded('"throttle"', '"mean"', SIGNAL, observer)
    without = observer.replace('\nmodel = "mean"', "")
    assert loaded('"throttle"', '"modes"', SIGNAL, without).modes == ("modes", "brake")


def test_a_mode_of_the_command_line_is_a_name_before_it_is_a_number(loaded):
    problem = loaded('["throttle", "brake"]', '["1", "2"]', '"brake"', "1")
    assert [options.mode_of(problem, mode) for mode in ("1", "2", "0", None)] == [0, 1, 0, None]
    with pytest.raises(dt.ArgumentError, match="mode must be"):
        options.mode_of(problem, "3")


@pytest.mark.parametrize(
    ("section", "change", "message"),
    [
        ("constant", ('mode = "brake"', "mode = 1.5"),
         r"mode must be the number of a mode, or its name in \[plant\], such as mode = 0, got 1.5"),
        ("observer", ('model = "brake"', "model = 1.5"), 'must be "modes", "mean", or a mode'),
        ("log", ('{ go = "throttle", stop = "brake" }', "3"), "labels: input should be a table"),
    ],
)  # fmt: skip
def test_what_cannot_be_a_mode_is_answered_with_what_can(loaded, section, change, message):
    with pytest.raises(dt.ProblemFileError, match=message):
        loaded(SIGNAL, SECTIONS[section].replace(*change))


def test_the_kind_of_a_law_is_answered_with_its_name(loaded):
    with pytest.raises(dt.ArgumentError, match=r"The law of kind 'exact' has the name 'oracle'\."):
        loaded().law("exact")
    with pytest.raises(dt.ArgumentError, match=r"got 'nothing'\.$"):
        loaded().law("nothing")


def test_sojourns_that_begin_above_zero_suggest_their_dwell_time(loaded):
    with pytest.raises(dt.ArgumentError, match=r"write dwell_time = 60 in \[switching\]"):
        options.signals_and_step(loaded(), None, None, None)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('kind = "exact"', 'kind = "exat"', r"\[\[law\]\] 2, kind must be one of"),
        ('kind = "exact"', "", r"\[\[law\]\] 2, kind is missing: add it"),
        ("force = [0.0, 2.0]", "", r"\[\[offset\]\] 1, force is missing"),
        ('kind = "model"', 'kind = "model"\nsojourns = [1.0]', "belongs to kind = .periodic. only"),
    ],
)
def test_tables_of_a_list_are_counted_from_one(loaded, old, new, message):
    with pytest.raises(dt.ArgumentError, match=message):
        loaded(old, new)


def test_a_loop_without_growth_rates_is_not_judged():
    judged, why = held_in_words(dataclasses.replace(dt.problems.paper()), ())
    assert (judged, "no growth rates" in why) == ("not judged", True)
