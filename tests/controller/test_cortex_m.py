"""The exported C on a Cortex-M, emulated: the same vectors, with the target's own compiler."""

import re
import shutil
import subprocess

import pytest

import deadtime as dt
import plants
from deadtime.controller.export.compiler import WARNINGS

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


def answer_of(folder, core):
    """What the self-check prints on an emulated board; it reads its vectors on this machine."""
    board, flags = BOARDS[core]
    (folder / "startup.c").write_text(STARTUP, encoding="utf-8")
    target = [GCC, f"-mcpu={core}", "-mthumb", *flags, "--specs=rdimon.specs", "-O2"]
    sources = ["startup.c", "controller.o", "controller_check.o"]
    ours = [*target, *WARNINGS, "-c", "controller.c", "controller_check.c"]
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


# Off the grid and on it, one input and two, every form of the table, one row and many.
GENERIC, PAPER = plants.generic(), plants.paper(0.5)
CASES = [
    ("averaged", GENERIC, 0.1, "double", "cortex-m3"),
    ("averaged", PAPER, 0.01, "float", "cortex-m4"),
    ("averaged, dwell-aware", GENERIC, 0.1, "float", "cortex-m3"),
    ("expected", GENERIC, 0.05, "double", "cortex-m4"),
    ("mean", PAPER, 0.3, "double", "cortex-m4"),
]


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
