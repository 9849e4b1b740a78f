"""The exported C on a Cortex-M, emulated: the same vectors, with the target's own compiler."""

import re
import shutil
import subprocess

import numpy as np
import pytest

import deadtime as dt
import observed_laws
import plants
from deadtime.controller.export.compiler import WARNINGS
from shares import mostly_long

GCC, QEMU = "arm-none-eabi-gcc", "qemu-system-arm"
MISSING = [command for command in (GCC, QEMU) if shutil.which(command) is None]
pytestmark = pytest.mark.skipif(
    bool(MISSING),
    reason=f"needs {' and '.join(MISSING)} (Debian: gcc-arm-none-eabi, libnewlib-arm-none-eabi, "
    "qemu-system-arm)",
)

# Boards of Arm's Cortex-M prototyping system: their memory from 0 on is RAM, so that a program lies
# where it is loaded. The library's _start asks the emulator for a stack, and calls main.
BOARDS = {
    "cortex-m3": ("mps2-an385", ["-mfloat-abi=soft"]),
    "cortex-m4": ("mps2-an386", ["-mfloat-abi=hard", "-mfpu=fpv4-sp-d16"]),
}
STARTUP = """
extern void _start(void);
static void reset(void)
{
    *(volatile unsigned long *)0xE000ED88 |= 0xFul << 20; /* the floating-point unit, if any */
    __asm volatile("dsb\\n isb");
    _start();
}
static void fault(void) { for (;;) { } }
__attribute__((section(".vectors"), used)) static void (*const vectors[16])(void) = {
    (void (*)(void))0x20010000, reset, fault, fault, fault, fault, fault,
};
"""


# Calls of a controller, written into a program that prints its answers, every digit (the
# target's library has no hexadecimal ones).
PROGRAM = """
#include "controller.h"
#include <stdio.h>
static const double outputs[][CONTROLLER_OUTPUTS] = {@outputs};
static const double reported[][CONTROLLER_INPUTS] = {@reported};
static const double times[] = {@times};
@references
static const int modes[] = {@modes}, given[] = {@given};
int main(void)
{
    static controller_controller c;
    unsigned k;
    int i;
    controller_reset(&c, 0, 0);
    for (k = 0; k < sizeof modes / sizeof *modes; k++) {
        controller_real y[CONTROLLER_OUTPUTS], u[CONTROLLER_INPUTS], told[CONTROLLER_INPUTS];
        for (i = 0; i < CONTROLLER_OUTPUTS; i++) y[i] = (controller_real)outputs[k][i];
        for (i = 0; i < CONTROLLER_INPUTS; i++) told[i] = (controller_real)reported[k][i];
@copied
        printf("%d", (int)controller_update(&c, y, modes[k], given[k] & 1 ? told : 0,@asked
                                            given[k] & 2 ? &times[k] : 0, u));
        for (i = 0; i < CONTROLLER_INPUTS; i++) printf(" %.17g", (double)u[i]);
        printf("\\n");
    }
    return 0;
}
"""
REFERENCES = "static const double asked[][CONTROLLER_TRACKED] = {@};"
COPIED = """        controller_real r[CONTROLLER_TRACKED];
        for (i = 0; i < CONTROLLER_TRACKED; i++) r[i] = (controller_real)asked[k][i];"""


def answer_of(folder, core, program="controller_check.c"):
    """What a program prints on an emulated board; the self-check reads its vectors on this machine.

    The board ends with the program.
    """
    board, flags = BOARDS[core]
    (folder / "startup.c").write_text(STARTUP, encoding="utf-8")
    target = [GCC, f"-mcpu={core}", "-mthumb", *flags, "--specs=rdimon.specs", "-O2"]
    sources = ["startup.c", "controller.o", program.replace(".c", ".o")]
    ours = [*target, *WARNINGS, "-c", "controller.c", program]
    whole = [*target, "-Wl,--section-start=.vectors=0", *sources, "-o", "check.elf"]
    for command in (ours, whole):
        subprocess.run(command, cwd=folder, check=True)
    emulator = [QEMU, "-M", board, "-nographic", "-semihosting-config", "enable=on,target=native"]
    done = subprocess.run(
        [*emulator, "-kernel", "check.elf"],
        cwd=folder,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=300,
    )
    return done.stdout


def program_of(calls, law):
    """The program of some calls, as `observed_laws.hostile` makes them."""
    y, modes, applied, times, references = calls
    m, r = law.plant.inputs, len(law.servo.tracked) if law.servo else 0
    given = [
        (one is not None) + 2 * (when is not None) + 4 * (asked is not None)
        for one, when, asked in zip(applied, times, references, strict=True)
    ]
    filled = {
        "references": REFERENCES.replace("@", rows(references, r)) if r else "",
        "copied": COPIED if r else "",
        "asked": " given[k] & 4 ? r : 0," if r else "",
        "outputs": rows(y, y.shape[1]),
        "reported": rows(applied, m),
        "times": ", ".join(number(0.0 if one is None else one) for one in times),
        "modes": ", ".join(map(str, modes.tolist())),
        "given": ", ".join(map(str, given)),
    }
    text = PROGRAM
    for name, value in filled.items():
        text = text.replace(f"@{name}", value)
    return text


def rows(values, size):
    """An initialiser, a row for each call; zeros where there is none."""
    given = [np.zeros(size) if one is None else np.asarray(one) for one in values]
    return ",\n".join("{" + ", ".join(map(number, one.tolist())) + "}" for one in given)


def number(value):
    """To the last bit; GCC folds the quotients."""
    if np.isfinite(value):
        return float(value).hex()
    return {"nan": "0.0 / 0.0", "inf": "1.0 / 0.0", "-inf": "-1.0 / 0.0"}[str(float(value))]


# Off the grid and on it, one input and two, every form of the table, one row and many.
GENERIC, PAPER = plants.generic(), plants.paper(0.5)
CASES = [
    ("averaged", GENERIC, 0.1, "double", "cortex-m3"),
    ("averaged", PAPER, 0.01, "float", "cortex-m4"),
    ("averaged, dwell-aware", GENERIC, 0.1, "float", "cortex-m3"),
    ("expected", GENERIC, 0.05, "double", "cortex-m4"),
    ("mean", PAPER, 0.3, "double", "cortex-m4"),
]


@pytest.mark.few(2)
@pytest.mark.parametrize(("law", "plant", "step", "precision", "core"), CASES)
def test_an_emulated_cortex_m_gives_the_answers_of_the_vectors(
    tmp_path, monkeypatch, law, plant, step, precision, core
):
    monkeypatch.setattr(
        "deadtime.controller.export.compiler.compiler", lambda: None
    )  # this machine's
    run = dt.Controller(plants.LAWS[law](plant), step, limits=(-25.0, 25.0))
    run.export_c(tmp_path, precision=precision)
    answer = answer_of(tmp_path, core)
    found = re.search(r"(\d+) vectors, (\d+) differ", answer)
    assert found is not None, answer
    assert int(found[1]) > 300
    assert int(found[2]) == 0, answer


OBSERVED = {
    "observed": (observed_laws.observed, "double", "cortex-m4"),
    "servo": (observed_laws.servo, "double", "cortex-m3"),
    "servo in single precision": (observed_laws.servo, "float", "cortex-m4"),
}


@pytest.fixture(scope="module")
def runs():
    """Every controller's own answers to hostile calls: made once, in double precision."""
    kept = {}

    def run_of(make):
        if make not in kept:
            law = make()
            limits = (-2.0, 2.5) if law.servo else (-0.05, 0.05)
            run = dt.Controller(law, law.observer.step, limits=limits)
            calls = observed_laws.hostile(law, 400)
            answers = [
                (run.update(y, int(mode), told, reference=r, time=when), int(run.status))
                for y, mode, told, when, r in zip(*calls, strict=True)
            ]
            run.reset()
            kept[make] = run, calls, answers
        return kept[make]

    return run_of


@pytest.mark.parametrize("name", mostly_long(OBSERVED, "servo in single precision"))
def test_an_observer_and_a_servo_on_an_emulated_cortex_m_answer_as_in_python(
    tmp_path, monkeypatch, runs, name
):
    """The self-check of its vectors; then calls, hostile ones among them, against `Controller`."""
    monkeypatch.setattr("deadtime.controller.export.compiler.compiler", lambda: None)
    make, precision, core = OBSERVED[name]
    run, calls, answers = runs(make)
    run.export_c(tmp_path, precision=precision)
    answer = answer_of(tmp_path, core)
    found = re.search(r"(\d+) vectors, (\d+) differ", answer)
    assert found is not None, answer
    assert int(found[1]) > 300
    assert int(found[2]) == 0, answer
    (tmp_path / "calls.c").write_text(program_of(calls, run.law), encoding="utf-8")
    lines = [line.split() for line in answer_of(tmp_path, core, "calls.c").splitlines()]
    assert len(lines) == len(answers)
    inputs = np.array([[float(one) for one in line[1:]] for line in lines])
    expected = np.array([u for u, _ in answers])
    assert [int(line[0]) for line in lines] == [status for _, status in answers]
    assert len({status for _, status in answers}) >= 6
    worst = np.abs(inputs - expected).max() / np.abs(expected).max()
    assert worst < (1e-11 if precision == "double" else 1e-4)
