"""Generated C as a shared library, driven over arrays."""

import ctypes
import shutil
import subprocess

import numpy as np
import pytest

from deadtime.controller.export.compiler import WARNINGS, compiler

needs_compiler = pytest.mark.skipif(compiler() is None, reason="needs a C compiler")
needs_frama_c = pytest.mark.skipif(shutil.which("frama-c") is None, reason="needs frama-c")

_DRIVER = """
#include "NAME.h"
#include <stdlib.h>
int size(void) { return (int)sizeof(NAME_controller); }
#ifdef BIG_OUTPUTS
#define MEASURED BIG_OUTPUTS
#else
#define MEASURED BIG_STATES
#endif
#ifdef BIG_TRACKED
#define REFERENCE given[k] & 4 ? rs : 0,
#else
#define REFERENCE
#define BIG_TRACKED 0
#endif
/* Bit 0 of `given`: applied is reported; bit 1: a time is; bit 2: a reference is. */
void drive(NAME_controller *c, int count, const double *x, const int *mode, const double *applied,
           const double *r, const double *time, const unsigned char *given, double *u, int *status);
void drive(NAME_controller *c, int count, const double *x, const int *mode, const double *applied,
           const double *r, const double *time, const unsigned char *given, double *u, int *status)
{
    NAME_real xs[MEASURED], as[BIG_INPUTS], us[BIG_INPUTS], rs[BIG_TRACKED + 1];
    int k, i;
    (void)rs;
    for (k = 0; k < count; k++) {
        for (i = 0; i < MEASURED; i++) xs[i] = (NAME_real)x[k * MEASURED + i];
        for (i = 0; i < BIG_INPUTS; i++) as[i] = (NAME_real)applied[k * BIG_INPUTS + i];
        for (i = 0; i < BIG_TRACKED; i++) rs[i] = (NAME_real)r[k * BIG_TRACKED + i];
        status[k] = (int)NAME_update(c, xs, mode[k], given[k] & 1 ? as : 0, REFERENCE
                                     given[k] & 2 ? &time[k] : 0, us);
        for (i = 0; i < BIG_INPUTS; i++) u[k * BIG_INPUTS + i] = (double)us[i];
    }
}
"""


class Library:
    """A controller in C; every instance has a state of its own."""

    def __init__(self, folder, plant, name="controller", options=("-O1",), more=""):
        source = folder / "drive.c"
        text = (_DRIVER + more).replace("NAME", name).replace("BIG", name.upper())
        source.write_text(text, encoding="utf-8")
        target = folder / "library.so"
        files = [str(folder / f"{name}.c"), str(source)]
        flags = [*WARNINGS, *options, "-Wno-conversion", "-shared", "-fPIC"]  # the driver converts
        subprocess.run([*compiler(), *flags, *files, "-o", str(target)], check=True)
        self.library, self.name = ctypes.CDLL(str(target)), name
        self.n, self.m = plant.states, plant.inputs
        self.state = ctypes.create_string_buffer(self.library.size())

    def call(self, name, *arguments):
        """A function of the controller's."""
        return getattr(self.library, f"{self.name}_{name}")(self.state, *arguments)

    def reset(self, u0=None, mode_age=0, real=ctypes.c_double):
        """`u0`: (N, m), the oldest first."""
        if u0 is not None:
            u0 = (real * u0.size)(*u0.ravel())
        return self.call("reset", u0, mode_age)

    def run(self, x, modes, applied=None, times=None, references=None):
        """Inputs and statuses; what is None of `applied`, `times`, `references` is not given.

        `applied[k]` is reported at call k.
        """
        count = len(x)
        given = np.zeros(count, np.uint8)
        told, when = np.zeros((count, self.m)), np.zeros(count)
        for k in range(count):
            if applied is not None and applied[k] is not None:
                told[k], given[k] = applied[k], 1
            if times is not None and times[k] is not None:
                when[k], given[k] = times[k], given[k] | 2
        r = np.zeros((count, 1))
        if references is not None:
            given |= np.array([4 * (one is not None) for one in references], np.uint8)
            size = next((np.size(one) for one in references if one is not None), 1)
            r = np.array([np.zeros(size) if one is None else one for one in references], float)
        u, status = np.empty((count, self.m)), np.empty(count, np.int32)
        x, modes = np.ascontiguousarray(x, float), np.ascontiguousarray(modes, np.int32)
        arrays = (x, modes, told, r, when, given, u, status)
        pointers = [array.ctypes.data_as(ctypes.c_void_p) for array in arrays]
        self.library.drive(self.state, count, *pointers)
        return u, status
