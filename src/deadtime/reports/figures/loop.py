"""The figure of a loop: Bode, Nyquist, sensitivity, its margins marked, and its step response."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from deadtime.base.figure_files import new_figure
from deadtime.base.figure_style import BLACK, COLOURS, GREY, LINES, STYLE, WIDTH, plain
from deadtime.base.wording import inwards
from deadtime.margins.loop_view import LoopView, ModeView
from deadtime.margins.step_response import StepResponse

MOST = 5  # modes in one figure
_REACH = 4.0  # of the Nyquist panel, around −1 … 1
_TURNS = 800.0  # degrees of phase that are shown: a delay turns on and on
_ABOVE = 30.0  # degrees of room above and below
_ROUND_OFF = 1e-10  # of the largest eigenvalue: smaller ones are 0, and their phase is chance
_MARK: dict[str, Any] = {"color": BLACK, "linestyle": "", "markersize": 4.0, "zorder": 5.0}
_POINT: dict[str, Any] = {
    "color": BLACK, "linestyle": "", "marker": "+", "markersize": 8.0, "markeredgewidth": 1.6,
    "zorder": 5.0,
}  # fmt: skip
_DOTTED: dict[str, Any] = {"color": BLACK, "linewidth": 0.9, "linestyle": ":"}
_BARE: dict[str, Any] = {"facecolor": "white", "edgecolor": "none", "pad": 0.3}
_CIRCLE: dict[str, Any] = {"color": GREY, "linewidth": 0.8, "zorder": 3.0}
_SHADE: dict[str, Any] = {"color": GREY, "alpha": 0.3, "linewidth": 0.0, "zorder": 0.5}


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
    channels share, but for those that are 0 (of two inputs and one output L has one);
    sensitivities are largest singular values. Circles mark gain margins, squares the phase
    margin, dotted lines the change of the delay that makes the loop unstable. The grey disk is
    the region that the disk margin keeps free. All are of the mode that is lost first, and
    black or grey, which no mode is.

    With `steps`, one per mode, there is a panel of those that do not grow; `answer` names their
    output, and `pushed` the input of the step where nothing is tracked.
    """
    names = modes or [f"mode {each.mode}" for each in view.modes]
    with rc_context(STYLE):
        figure = new_figure(1.55 * WIDTH, 7.4 if steps else 5.4)
        panels = figure.subplot_mosaic("gn;ps;tt" if steps else "gn;ps")
        gain, nyquist, phase, sensitivity = (panels[letter] for letter in "gnps")
        for each in view.modes[:MOST]:
            _add_mode(view.omega, each, gain, phase, nyquist, sensitivity)
        _label(view, gain, phase, nyquist, sensitivity)
        marks = _mark_margins(view, gain, phase, nyquist)
        if steps:
            _add_steps(panels["t"], steps[:MOST], answer, pushed)
        lines = [
            Line2D([], [], color=COLOURS[i], linestyle=LINES[i % len(LINES)], label=plain(name))
            for i, name in enumerate(names[:MOST])
        ]
        figure.legend(
            handles=[*lines, *marks], loc="outside lower center", ncols=4, handlelength=2.6
        )
        if title:
            figure.suptitle(plain(title), fontsize=9.5, x=0.02, ha="left")
    return figure


def _add_mode(
    omega: np.ndarray, view: ModeView, gain: Axes, phase: Axes, nyquist: Axes, sensitivity: Axes
) -> None:
    look: Any = {"color": COLOURS[view.mode], "linestyle": LINES[view.mode % len(LINES)]}
    largest = np.abs(view.loci).max(axis=1)
    for locus in view.loci.T:
        seen = np.abs(locus) > _ROUND_OFF * largest
        if not seen.any():
            continue
        gain.loglog(omega[seen], np.abs(locus[seen]), **look)
        phase.semilogx(omega[seen], np.degrees(np.unwrap(np.angle(locus[seen]))), **look)
        near = np.where(np.abs(locus) < 2.0 * _REACH, locus, np.nan)
        nyquist.plot(np.real(near), np.imag(near), **look)
    sensitivity.loglog(omega, view.sensitivity, **look)
    sensitivity.loglog(omega, view.complementary, **look, alpha=0.4)


def _add_steps(panel: Axes, steps: Sequence[StepResponse], answer: str | None, pushed: str) -> None:
    """The responses that settle, and their final value: 1 of a reference, 0 of a push."""
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
    panel.axhline(1.0 if steps[0].tracks else 0.0, color=BLACK, linewidth=0.8)
    panel.set_xlim(0.0, longest)
    what = "a step of its reference" if steps[0].tracks else f"a load step of 1 at {plain(pushed)}"
    panel.set_title(f"{plain(answer or 'output')} after {what}")
    panel.set_xlabel("time (s)")


def _mark_margins(view: LoopView, gain: Axes, phase: Axes, nyquist: Axes) -> list[Artist]:
    """All margins, in black and grey, which no mode has; the handles of their legend."""
    keys: list[Artist] = []
    if _mark_gain(view, gain, nyquist):
        keys.append(Line2D([], [], marker="o", label="gain margin", **_MARK))
    if _mark_phase(view, gain, nyquist):
        keys.append(Line2D([], [], marker="s", label="phase margin", **_MARK))
    if view.at == "input" and _mark_delay(view, phase):
        keys.append(Line2D([], [], label="delay margin", **_DOTTED))
    disks = [each for each in view.modes if each.disk is not None]
    if disks and len(disks) == len(view.modes):
        least = min(disks, key=lambda each: each.disk or math.inf)
        keys.append(_mark_disk(least, nyquist))
    keys.append(nyquist.plot([-1.0], [0.0], label="−1", **_POINT)[0])
    circle = np.exp(1j * np.linspace(0.0, 2.0 * math.pi, 181))
    keys += nyquist.plot(np.real(circle), np.imag(circle), label="|L| = 1", **_CIRCLE)
    return keys


def _mark_gain(view: LoopView, gain: Axes, nyquist: Axes) -> bool:
    """Where a factor 1/|λ| puts the loop on the limit of stability; of a loop cut at its input."""
    ends = (view.gain.lower, view.gain.lower_mode), (view.gain.upper, view.gain.upper_mode)
    marked = False
    for factor, mode in ends:
        if factor and math.isfinite(factor) and mode is not None and view.at == "input":
            # On the limit of stability some λ is −1/k; the nearest point of the loci is there.
            distance = np.abs(view.modes[mode].loci + 1.0 / factor).min(axis=1)
            gain.plot([view.omega[distance.argmin()]], [1.0 / factor], marker="o", **_MARK)
            nyquist.plot([-1.0 / factor], [0.0], marker="o", **_MARK)
            marked = True
    return marked


def _mark_phase(view: LoopView, gain: Axes, nyquist: Axes) -> bool:
    least = [
        (each.phase, each.phase_frequency)
        for each in view.modes
        if each.phase is not None and each.phase_frequency is not None
    ]
    if not least:
        return False
    lag, frequency = min(least)
    angle = math.radians(180.0 + lag)
    gain.plot([frequency], [1.0], marker="s", **_MARK)
    nyquist.plot([math.cos(angle)], [math.sin(angle)], marker="s", **_MARK)
    return True


def _mark_delay(view: LoopView, phase: Axes) -> bool:
    """A line at the frequency of either end; its label, seconds, is towards the middle."""
    delay = view.delay
    ends = (delay.longer, delay.upper_frequency, "+"), (delay.shorter, delay.lower_frequency, "−")
    low, high = np.log(phase.get_xlim())
    marked = False
    for row, (shift, frequency, sign) in enumerate(ends):
        if shift is None or not frequency:
            continue
        right = math.log(frequency) > 0.5 * (low + high)
        phase.axvline(frequency, **_DOTTED)
        phase.annotate(
            f" {sign}{inwards(shift, 0.0)} s ", (frequency, 0.02 + 0.1 * row), va="bottom",
            ha="right" if right else "left", fontsize=8.0,
            xycoords=phase.get_xaxis_transform(), bbox=_BARE,
        )  # fmt: skip
        marked = True
    return marked


def _mark_disk(least: ModeView, nyquist: Axes) -> Artist:
    """The disk of −1 times every factor of the disk margin, which L keeps out of."""
    angle = np.linspace(0.0, 2.0 * math.pi, 181)
    delta = min(least.disk or 0.0, 1.99) * np.exp(1j * angle)
    edge = -(2.0 + delta) / (2.0 - delta)
    (shaded,) = nyquist.fill(np.real(edge), np.imag(edge), label="disk margin", **_SHADE)
    return shaded


def _label(view: LoopView, gain: Axes, phase: Axes, nyquist: Axes, sensitivity: Axes) -> None:
    several = view.modes[0].loci.shape[1] > 1
    gain.set_title("gain of the eigenvalues of L" if several else "gain |L|")
    phase.set_title("their phase (degrees)" if several else "phase of L (degrees)")
    nyquist.set_title("Nyquist")
    sensitivity.set_title("|S|, and paler |T|")
    gain.axhline(1.0, color=BLACK, linewidth=0.8)
    heights = np.concatenate([line.get_ydata() for line in phase.get_lines()])
    low, high = float(heights.min()), float(heights.max()) + _ABOVE
    low = max(low, high - _TURNS)
    phase.set_ylim(low - _ABOVE, high)
    for turn in range(math.ceil((low - 180.0) / 360.0), math.floor((high - 180.0) / 360.0) + 1):
        phase.axhline(180.0 + 360.0 * turn, color=BLACK, linewidth=0.8)
    for panel in (phase, sensitivity):
        panel.set_xlabel("frequency (rad/s)")
    for panel in (gain, phase, sensitivity):
        panel.set_xlim(view.omega[0], view.omega[-1])
    nyquist.set_xlim(-_REACH, 0.5 * _REACH)
    nyquist.set_ylim(-0.4 * _REACH, 0.4 * _REACH)
    nyquist.set_aspect("equal", adjustable="box")
