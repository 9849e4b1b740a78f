"""What cannot be exported is refused by name, and what cannot be checked is said."""

import re

import numpy as np
import pytest

import deadtime as dt
import plants
from c_code import needs_compiler
from deadtime.controller.export.forms import dense, low_ranks
from shares import mostly_long

GENERIC = plants.generic()


def controller(name="averaged", step=0.05, plant=GENERIC):
    return dt.Controller(plants.LAWS[name](plant), step)


@needs_compiler
def test_the_export_checks_itself_and_a_changed_table_is_found(tmp_path):
    exported = controller().export_c(tmp_path, name="law")
    assert exported.check.passed
    assert re.search(r"compiled with \S+: \d+ vectors, 0 differ, worst relative", str(exported))
    assert set(exported.files) == {path.name for path in tmp_path.iterdir()}
    from deadtime.controller.export.compiler import self_check

    tables = tmp_path / "law_tables.h"
    text = tables.read_text()
    F = re.search(r"F\[1\]\[2\]\[3\] =\n\{\n *\{\n *\{(-?\d\.\d+)", text)
    tables.write_text(text.replace(F.group(1), repr(float(F.group(1)) * (1.0 + 1e-9)), 1))
    check = self_check(tmp_path, "law")
    assert check.passed is False
    assert " 0 differ" not in check.message
    tables.write_text(text.replace("static", "statik", 1))
    assert "does not compile it" in self_check(tmp_path, "law").message


def spoilt(tmp_path, name, factor=1.01):
    """The self-check with the last number of a table changed."""
    from deadtime.controller.export.compiler import self_check

    tables = tmp_path / "controller_tables.h"
    text = tables.read_text()
    start = re.search(rf"controller_real \w*{name}[\[\d\]]+ =", text).end()
    end = text.index(";", start)
    number = re.findall(r"[-\d.e]+", text[start:end])[-1]
    at = text.rindex(number, start, end)
    changed = repr(float(number) * factor + (number == "0.0"))
    tables.write_text(text[:at] + changed + text[at + len(number) :])
    check = self_check(tmp_path, "controller")
    tables.write_text(text)
    return check


@needs_compiler
@pytest.mark.parametrize(
    ("ages", "tables"), mostly_long([(0, ["LAST", "WHOLE"]), (1, ["G"])], (0, ["LAST", "WHOLE"]))
)
def test_a_spoilt_number_is_found_however_long_the_window_and_whichever_row(tmp_path, ages, tables):
    """Of 1,000 past inputs the oldest; of the ages the last, within tight limits."""
    plant = plants.paper(0.5)
    law, step = dt.AveragedPredictor(plant, dt.place(plant, [-1.0, -2.0])), 0.0005
    if ages:
        law, step = plants.LAWS["averaged, dwell-aware"](GENERIC), 0.002
    run = dt.Controller(law, step, limits=(-0.1, 0.1))
    exported = run.export_c(tmp_path, accuracy=0.0)
    assert exported.check.passed
    rows, taps = len(run.table.state_gain), run.table.taps
    assert exported.check.message.endswith(f"{rows} of {rows} rows, all {taps} past inputs")
    assert int(re.search(r"(\d+) calls", exported.check.message).group(1)) > 2 * taps
    assert (tmp_path / "controller_vectors.csv").stat().st_size < 400_000
    for name in tables:
        assert spoilt(tmp_path, name).passed is False, name


def test_without_a_compiler_it_exports_and_says_that_nothing_was_checked(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    exported = controller().export_c(tmp_path / "c")
    assert exported.check.passed is None
    assert exported.check.message == "not checked: no C compiler was found (set CC)"
    assert (tmp_path / "c" / "controller.c").exists()


def test_the_rom_said_is_that_of_the_tables(tmp_path):
    for name, precision, size in (("averaged", "double", 8), ("expected", "float", 4)):
        exported = controller(name, 0.004).export_c(tmp_path, precision=precision)
        text = (tmp_path / "controller_tables.h").read_text()
        shapes = re.findall(r"static const controller_real \w+((?:\[\d+\])+)", text)
        numbers = sum(np.prod([int(n) for n in re.findall(r"\d+", shape)]) for shape in shapes)
        assert exported.rom == size * numbers


def slow_modes():
    """Rows that resemble each other: modes that differ little, over a long window."""
    plant = plants.scalar([0.3, 0.31, 0.32], delay=1.0)
    return dt.AveragedPredictor(plant, dt.place(plant, [-1.0]), None, 0.9)


def test_low_rank_is_as_exact_as_it_says_and_taken_where_it_is_smaller(tmp_path):
    table = slow_modes().digital(0.01)
    G = dense(table).arrays["G"][0].reshape(-1, 100)
    forms = list(low_ranks(table))
    for form in forms:
        L, R = (array for array, _ in form.arrays.values())
        product = L.reshape(-1, L.shape[-1]) @ R
        error = (np.abs(product - G).sum(axis=1) / np.abs(G).sum(axis=1)).max()
        assert error == pytest.approx(form.error, rel=1e-6, abs=1e-15)
        assert form.numbers < G.size
    exported = dt.Controller(slow_modes(), 0.01).export_c(tmp_path, accuracy=1e-4)
    assert exported.form.startswith("low rank")
    assert exported.error <= 1e-4
    assert exported.rom < 8 * G.size / 2


def test_beyond_the_budget_it_says_what_fits_and_that_does(tmp_path):
    run = dt.Controller(slow_modes(), 0.01)
    with pytest.raises(dt.ArgumentError) as refused:
        run.export_c(tmp_path, rom_budget=30_000)
    message = str(refused.value)
    assert message.startswith("rom_budget = 30000 bytes is too small: the tables take ")
    accuracy, rank, size = re.search(
        r"accuracy=(\S+) \(rank (\d+), (\d+) bytes\)", message
    ).groups()
    exported = run.export_c(tmp_path, rom_budget=30_000, accuracy=float(accuracy))
    assert f"low rank {rank}" in exported.form
    assert exported.rom == int(size) <= 30_000
    with pytest.raises(dt.ArgumentError, match=r'precision="float" \(848 bytes\)'):
        controller("averaged", 0.004).export_c(tmp_path, rom_budget=1000)
    with pytest.raises(dt.ArgumentError, match="nothing of this law fits"):
        controller("averaged", 0.004).export_c(tmp_path, rom_budget=10)


def test_a_longer_period_fits_as_promised(tmp_path, monkeypatch):
    """Of two inputs, whose taps are 2 x 2; and with rows by the age, which shrink with the taps."""
    monkeypatch.setenv("CC", "none")
    for name, budget in (("expected", 1200), ("mean, dwell-aware", 9000)):
        run = dt.Controller(plants.LAWS[name](GENERIC), 0.01)
        with pytest.raises(dt.ArgumentError) as refused:
            run.export_c(tmp_path, rom_budget=budget)
        found = re.search(r"(\d+) past inputs, a period of (\S+) s", str(refused.value))
        taps, period = int(found.group(1)), float(found.group(2))
        assert taps < run.table.taps
        longer = dt.Controller(plants.LAWS[name](GENERIC), period)
        exported = longer.export_c(tmp_path, rom_budget=budget)
        assert longer.table.taps == taps
        assert budget / 2 < exported.rom <= budget
    with pytest.raises(dt.ArgumentError) as refused:
        dt.Controller(slow_modes(), 0.01).export_c(tmp_path, rom_budget=900)
    assert "e-01" not in str(refused.value)


@pytest.mark.few(1)
@pytest.mark.parametrize("name", ["Makefile", "main.c", "controller_vectors.csv"])
def test_a_file_of_the_user_s_is_never_replaced(tmp_path, monkeypatch, name):
    monkeypatch.setenv("CC", "none")
    exported = controller().export_c(tmp_path)
    controller().export_c(tmp_path)
    for file in exported.files:
        assert "Written by deadtime" in (tmp_path / file).read_text(), file
    (tmp_path / name).write_text("mine")
    (tmp_path / "controller.h").write_text("Written by deadtime, old")
    with pytest.raises(dt.ArgumentError, match=f"has a {name} that deadtime did not write"):
        controller().export_c(tmp_path)
    assert (tmp_path / name).read_text() == "mine"
    assert (tmp_path / "controller.h").read_text() == "Written by deadtime, old"
    with pytest.raises(dt.ArgumentError, match=r"path must end in \.fmu, got"):
        controller().export_fmu(tmp_path / name)


@pytest.mark.parametrize("asked", ["gcc 'a", "no-such-compiler -O2"])
def test_a_compiler_that_is_none_is_named(tmp_path, monkeypatch, asked):
    monkeypatch.setenv("CC", asked)
    message = controller().export_c(tmp_path).check.message
    assert message == f"not checked: the compiler CC={asked!r} was not found"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"accuracy": -1.0}, "accuracy must be at least 0"),
        ({"accuracy": 1.0}, "accuracy must be at least 0 and below 1"),
        ({"rom_budget": 0}, "rom_budget must be an integer of at least 1"),
        ({"name": "main"}, "name must not be 'main'"),
        ({"name": "stdint"}, "name must not be 'stdint'"),
        ({"name": "My law"}, "name must be a C name of lower-case letters"),
        ({"folder": "/proc/c"}, "folder '/proc/c' cannot be written"),
    ],
)
def test_bad_arguments_are_refused_by_name(tmp_path, arguments, message):
    with pytest.raises(dt.ArgumentError, match=message):
        controller().export_c(**{"folder": tmp_path, **arguments})


def test_a_law_too_steep_for_single_precision_is_refused(tmp_path):
    plant = plants.scalar([40.0], delay=1.5)
    law = dt.AveragedPredictor(plant, dt.place(plant, [-1.0]))
    with pytest.raises(dt.ArgumentError, match='Use precision="double"'):
        dt.Controller(law, 0.01).export_c(tmp_path, precision="float")


@needs_compiler
def test_limits_beyond_the_bound_and_fast_mathematics_are_refused(tmp_path, monkeypatch):
    run = dt.Controller(plants.LAWS["averaged"](GENERIC), 0.05, limits=(1e20, 1e21))
    with pytest.raises(dt.ArgumentError, match="limits must leave inputs within"):
        run.export_c(tmp_path, precision="float")
    monkeypatch.setenv("CC", "gcc -ffast-math")
    assert "compile this file without it" in controller().export_c(tmp_path).check.message
