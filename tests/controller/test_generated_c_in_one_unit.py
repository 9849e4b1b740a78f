"""Generated C beside other C, and in C++: strict standards, several controllers, exact numbers."""

import ctypes
import re
import shutil
import subprocess

import numpy as np
import pytest

import deadtime as dt
import plants
from belief_laws import LAWS as BELIEVING, from_outputs
from c_code import needs_compiler
from deadtime.controller.export import compiler as compiling
from deadtime.controller.export.c_text import exact
from deadtime.controller.export.compiler import compiler
from observed_laws import LAWS as OBSERVED

pytestmark = needs_compiler
STRICT = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror"]
CPP = shutil.which("g++")
STRICT_CPP = ["-std=c++11", "-pedantic", "-Werror"]


def laws():
    """One of every kind of code, with its period."""
    generic = plants.generic()
    yield "dense", plants.LAWS["averaged, dwell-aware"](generic), 0.05
    yield "factorised", plants.LAWS["averaged"](generic), 0.0066
    yield "belief", BELIEVING["ages"](), 0.05
    yield "bank", from_outputs(), 0.05
    yield "servo", OBSERVED["servo"](), 0.05
    yield "observed", OBSERVED["observed"](), 0.05


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """All of them in one folder, each under a name of its own."""
    place = tmp_path_factory.mktemp("c")
    with pytest.MonkeyPatch.context() as without:
        without.setattr(compiling, "compiler", lambda: None)
        for name, law, step in laws():
            dt.Controller(law, step, limits=(-2.0, 2.5)).export_c(place, name=name, prediction=True)
    return place


def compiles(command, folder, text, suffix):
    source = folder / f"unit{suffix}"
    source.write_text(text, encoding="utf-8")
    done = subprocess.run(
        [*command, "-c", str(source), "-o", str(folder / "unit.o")], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr


def units():
    """A file that calls all controllers, by their headers; and all of them in one file."""
    names = [name for name, _, _ in laws()]
    headers = "".join(f'#include "{name}.h"\n' for name in names)
    calls = "".join(
        f"""
#if {name.upper()}_READS_REFERENCE
#define ARGUMENTS 0, 0, 0
#else
#define ARGUMENTS 0, 0
#endif
{name}_status call_{name}({name}_controller *c, const {name}_real *y, {name}_real *u);
{name}_status call_{name}({name}_controller *c, const {name}_real *y, {name}_real *u)
{{
    return {name}_update(c, y, 0, ARGUMENTS, u);
}}
#undef ARGUMENTS
"""
        for name in names
    )
    whole = "".join(f'#include "{name}.c"\n' for name in names)
    return {"headers": headers + calls, "whole": whole + calls}


@pytest.mark.parametrize("unit", ["headers", "whole"])
def test_all_controllers_are_strict_c99_in_one_unit(folder, unit):
    compiles([*compiler(), *STRICT], folder, units()[unit], ".c")


@pytest.mark.skipif(CPP is None, reason="needs g++")
@pytest.mark.parametrize("unit", ["headers", "whole"])
def test_all_controllers_are_strict_cpp11_in_one_unit(folder, unit):
    compiles([CPP, *STRICT_CPP], folder, units()[unit], ".cpp")


def test_every_name_that_a_file_gives_begins_with_that_of_the_controller(folder):
    for name, _, _ in laws():
        for file in (f"{name}.h", f"{name}.c", f"{name}_tables.h"):
            text = re.sub(r"/\*.*?\*/", "", (folder / file).read_text(), flags=re.DOTALL)
            given = re.findall(r"#define (\w+)", text)
            given += re.findall(r"^(?:static )?(?:const )?\w+ \*?(\w+)[\[(]", text, re.MULTILINE)
            given += re.findall(r"^} (\w+);", text, re.MULTILINE)
            for body in re.findall(r"^(?:typedef )?enum \{(.*?)\}", text, re.MULTILINE | re.DOTALL):
                given += re.findall(r"(\w+) =", body)
            assert given
            assert not [one for one in given if not one.lower().startswith(f"{name}_")]


def test_numbers_written_whole_are_the_hexadecimal_ones_bit_for_bit(tmp_path):
    powers = [*range(-1022, 1024, 31), -66, -1, 0, 1, 40, 100, 200, 332]
    single = [power for power in powers if -126 <= power <= 127]
    source = (
        "#include <string.h>\n"
        f"static const double new[] = {{{', '.join(exact(2.0**k, 'double') for k in powers)}}};\n"
        f"static const double old[] = {{{', '.join(f'0x1p{k}' for k in powers)}}};\n"
        f"static const float newf[] = {{{', '.join(exact(2.0**k, 'float') for k in single)}}};\n"
        f"static const float oldf[] = {{{', '.join(f'0x1p{k}f' for k in single)}}};\n"
        "int same(void) { return memcmp(new, old, sizeof new) == 0\n"
        "                     && memcmp(newf, oldf, sizeof newf) == 0; }\n"
    )
    (tmp_path / "n.c").write_text(source, encoding="utf-8")
    target = str(tmp_path / "n.so")
    command = [*compiler(), "-std=c99", "-shared", "-fPIC", str(tmp_path / "n.c"), "-o", target]
    subprocess.run(command, check=True)
    assert ctypes.CDLL(target).same() == 1
    for power in powers:
        assert float(exact(2.0**power, "double")) == np.ldexp(1.0, power)
