"""The figure of a loop: Bode, Nyquist, sensitivity, its margins marked, and its step response."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from deadtime.base.figure_style import COLOURS, LINES, STYLE, WIDTH, plain
from deadtime.base.wording import inwards
from deadtime.margins.loop_view import LoopView, ModeView
from deadtime.margins.step_response import StepResponse

MOST = 5  # modes in one figure
_REACH = 3.0  # of the Nyquist panel, around −1 … 1
_TURNS = 800.0  # degrees of phase that are shown: a delay turns on and on


def plot_loop(
    view: LoopView,
    title: str | None = None,
    modes: Sequence[str] | None = None,
    steps: Sequence[StepResponse] = (),
    answer: str | None = None,
    pushed: str = "the input",
) -> Figure:
    """Gain, phase, Nyquist and sensitivity, a line for each of the first five modes.

    Of several channels the lines are the eigenvalues of L, which margins are about that all
    channels share; sensitivities are largest singular values. Circles mark gain margins, squares
    the phase margin, dotted lines where a delay longer or shorter by so much loses the loop. The
    shaded disk is what the disk margin keeps clear. All are of the mode that is lost first.

    With `steps`, one a mode, there is a panel of what does not grow of them; `answer` says of what,
    and `pushed` what is pushed where nothing is tracked.
    """
    names = modes or [f"mode {each.mode}" for each in view.modes]
    with rc_context(STYLE):
        figure = Figure(figsize=(1.55 * WIDTH, 7.2 if steps else 5.2))
        panels = figure.subplot_mosaic("gn;ps;tt" if steps else "gn;ps")
        gain, nyquist, phase, sensitivity = (panels[letter] for letter in "gnps")
        for each in view.modes[:MOST]:
            _add_mode(view.omega, each, gain, phase, nyquist, sensitivity)
        _mark_margins(view, gain, phase, nyquist)
        _label(view, gain, phase, nyquist, sensitivity)
        if steps:
            _add_steps(panels["t"], steps[:MOST], answer, pushed)
        keys = [
            Line2D([], [], color=COLOURS[i], linestyle=LINES[i % len(LINES)], label=plain(name))
            for i, name in enumerate(names[:MOST])
        ]
        keys += [
            Line2D(
                [], [], color=COLOURS[6], marker=shape, markersize=4.0, linestyle="", label=label
            )
            for shape, label in (("o", "gain margin"), ("s", "phase margin"))
        ]
        figure.legend(handles=keys, loc="outside lower center", ncols=4)
        if title:
            figure.suptitle(plain(title), fontsize=9.5, x=0.02, ha="left")
    return figure


def _add_mode(
    omega: np.ndarray, view: ModeView, gain: Axes, phase: Axes, nyquist: Axes, sensitivity: Axes
) -> None:
    look: Any = {"color": COLOURS[view.mode], "linestyle": LINES[view.mode % len(LINES)]}
    for locus in view.loci.T:
        gain.loglog(omega, np.abs(locus), **look)
        phase.semilogx(omega, np.degrees(np.unwrap(np.angle(locus))), **look)
        near = np.where(np.abs(locus) < 2.0 * _REACH, locus, np.nan)
        nyquist.plot(np.real(near), np.imag(near), **look)
    sensitivity.loglog(omega, view.sensitivity, **look)
    sensitivity.loglog(omega, view.complementary, **look, alpha=0.4)


def _add_steps(panel: Axes, steps: Sequence[StepResponse], answer: str | None, pushed: str) -> None:
    """Those that settle; a line at what is to be reached: 1 of a reference, 0 of a push."""
    for each in steps:
        if each.growth < 0.0:
            look: Any = {"color": COLOURS[each.mode], "linestyle": LINES[each.mode % len(LINES)]}
            panel.plot(each.time, each.response, **look)
    settled = [
        2.0 * each.info["SettlingTime"]
        for each in steps
        if each.info and each.info["SettlingTime"] > 0.0
    ]
    longest = min(max(settled, default=1.0), max(each.time[-1] for each in steps))
    panel.axhline(1.0 if steps[0].tracks else 0.0, color=COLOURS[6], linewidth=0.8)
    panel.set_xlim(0.0, longest)
    what = "a step of its reference" if steps[0].tracks else f"a constant 1 at {plain(pushed)}"
    panel.set_title(f"{plain(answer or 'output')} after {what}")
    panel.set_xlabel("time (s)")


def _mark_margins(view: LoopView, gain: Axes, phase: Axes, nyquist: Axes) -> None:
    mark: Any = {"color": COLOURS[6], "linestyle": "", "markersize": 4.0, "zorder": 5.0}
    ends = (view.gain.lower, view.gain.lower_mode), (view.gain.upper, view.gain.upper_mode)
    for factor, mode in ends:
        if factor and math.isfinite(factor) and mode is not None and view.at == "input":
            # On the limit of stability some λ is −1/k; the nearest point of the loci is there.
            distance = np.abs(view.modes[mode].loci + 1.0 / factor).min(axis=1)
            gain.plot([view.omega[distance.argmin()]], [1.0 / factor], marker="o", **mark)
            nyquist.plot([-1.0 / factor], [0.0], marker="o", **mark)
    delay = view.delay
    ends = (delay.shorter, delay.lower_frequency, "−"), (delay.longer, delay.upper_frequency, "+")
    for shift, frequency, sign in ends if view.at == "input" else ():
        if shift is not None and frequency:
            phase.axvline(frequency, color=COLOURS[6], linewidth=0.8, linestyle=":")
            phase.annotate(
                f" {sign}{inwards(shift, 0.0)} s", (frequency, 0.02), va="bottom", fontsize=8.0,
                xycoords=phase.get_xaxis_transform(), ha="left" if sign == "+" else "right",
            )  # fmt: skip
    least = [
        (each.phase, each.phase_frequency)
        for each in view.modes
        if each.phase is not None and each.phase_frequency is not None
    ]
    if least:
        lag, frequency = min(least)
        angle = math.radians(180.0 + lag)
        gain.plot([frequency], [1.0], marker="s", **mark)
        nyquist.plot([math.cos(angle)], [math.sin(angle)], marker="s", **mark)
    disks = [each.disk for each in view.modes if each.disk is not None]
    if disks and len(disks) == len(view.modes):
        _shade_disk(nyquist, min(disks))


def _shade_disk(nyquist: Axes, disk: float) -> None:
    """What −1 times every factor of the disk covers: L keeps out of it."""
    angle = np.linspace(0.0, 2.0 * math.pi, 181)
    delta = min(disk, 1.99) * np.exp(1j * angle)
    edge = -(2.0 + delta) / (2.0 - delta)
    nyquist.fill(np.real(edge), np.imag(edge), color=COLOURS[1], alpha=0.18, linewidth=0.0)


def _label(view: LoopView, gain: Axes, phase: Axes, nyquist: Axes, sensitivity: Axes) -> None:
    several = view.modes[0].loci.shape[1] > 1
    gain.set_title("gain of the eigenvalues of L" if several else "gain |L|")
    phase.set_title("their phase (degrees)" if several else "phase of L (degrees)")
    nyquist.set_title("Nyquist")
    sensitivity.set_title("|S|, and paler |T|")
    gain.axhline(1.0, color=COLOURS[6], linewidth=0.8)
    low, high = phase.get_ylim()
    phase.set_ylim(max(low, high - _TURNS), high)
    for turn in range(math.ceil((low - 180.0) / 360.0), math.floor((high - 180.0) / 360.0) + 1):
        phase.axhline(180.0 + 360.0 * turn, color=COLOURS[6], linewidth=0.8)
    for panel in (phase, sensitivity):
        panel.set_xlabel("frequency (rad/s)")
    for panel in (gain, phase, sensitivity):
        panel.set_xlim(view.omega[0], view.omega[-1])
    circle = np.exp(1j * np.linspace(0.0, 2.0 * math.pi, 181))
    nyquist.plot(np.real(circle), np.imag(circle), color="#bbbbbb", linewidth=0.8)
    nyquist.plot([-1.0], [0.0], "+", color=COLOURS[1], markersize=8.0, markeredgewidth=1.6)
    nyquist.set_xlim(-_REACH, 0.6 * _REACH)
    nyquist.set_ylim(-0.8 * _REACH, 0.8 * _REACH)
    nyquist.set_aspect("equal", adjustable="box")
