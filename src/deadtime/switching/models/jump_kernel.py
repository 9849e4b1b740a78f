"""The loops of `deadtime.switching.models.jump_loops` and its random numbers, compiled.

They release Python's lock. This module needs Numba, so it is imported where it is used.
"""

from __future__ import annotations

from numba import njit

from deadtime.numerics.philox import uniforms as uniforms
from deadtime.switching.models import jump_loops

walk = njit(cache=True, nogil=True)(jump_loops.walk)
lay = njit(cache=True, nogil=True)(jump_loops.lay)
place = njit(cache=True, nogil=True)(jump_loops.place)
