"""The JAX engine: many scenarios to an array, on the device that JAX finds first.

Scenarios run in chunks of one size, the last filled up by repeating its last scenario, so that
one shape is compiled once. A chunk is as large as a budget of bytes allows: for each scenario it
takes 32 bytes per period (which map and row, and three squares), the maps of its cut periods, the
inputs in flight, and the row that it looks up.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from deadtime.base.checks import count as whole_number
from deadtime.feedback import Feedback
from deadtime.feedback.table import Context
from deadtime.scenarios.by_period import by_period, filled, most_maps, own_maps, rows_of
from deadtime.scenarios.figures import Figures, Path
from deadtime.scenarios.jax_arguments import Law, Run, Signals, Sizes
from deadtime.scenarios.jax_double import in_double, on_cpu
from deadtime.scenarios.jax_kernel import run_scenarios
from deadtime.scenarios.loop import Laid, Loop
from deadtime.scenarios.window_form import window_form

_BUDGET, _MOST = 1 << 30, 1 << 16  # bytes and scenarios of a chunk
_MOST_ON_CPU = 1 << 10  # a period's arrays then stay in its cache: two to three times as fast
_FEW_ROWS = 4  # all of so few are computed: cheaper than looking up one per scenario


class Table(NamedTuple):
    """A law as the compiled function reads it, and how a scenario's row follows from its modes."""

    law: Law
    context: Context
    ages: int
    taps: int
    window: int
    own: bool


class JaxEngine:
    """Runs tables along signals that are laid on a loop; holds nothing that changes.

    Parameters
    ----------
    loop : Loop
    chunk : int, optional
        Scenarios at a time, ≥ 1; unless told, as many as a gigabyte holds, up to 65536, and
        up to 1024 where JAX computes on a CPU.

    Raises
    ------
    ArgumentError
        On import, if JAX is not installed; if `chunk` is no number of scenarios.

    Examples
    --------
    >>> import deadtime as dt
    >>> from deadtime.plant.steps import Window
    >>> from deadtime.switching import SignalBatch
    >>> problem = dt.problems.paper()
    >>> loop = Loop(problem.plant, Window.of(1.0, 0.1), np.array([-1.0, 1.0]), 3.0)
    >>> engine = JaxEngine(loop)
    >>> table = engine.table(problem.laws["averaged"].digital(0.1))
    >>> signals = SignalBatch.of([dt.SwitchingSignal([0, 0.34], [0, 1])])
    >>> engine.run(table, loop.lay(signals)).ise.shape
    (1,)
    """

    def __init__(self, loop: Loop, chunk: int | None = None) -> None:
        self._loop = loop
        self._chunk = None if chunk is None else whole_number("chunk", chunk)
        self._samples = loop.whole + 1
        with in_double():
            self._run = _on_device(Run(loop.x0, loop.rest / loop.window.step, *loop.limits))

    def table(self, feedback: Feedback) -> Table:
        """A law's rows as the compiled loop reads them."""
        form = window_form(feedback)
        if form is None or feedback.taps == 1 or not feedback.input_gain.any():
            return self._dense([feedback])
        parts = feedback.state_gain, form.out, form.last
        law = Law(np.concatenate(parts, axis=2), *form[1:3], form.ahead, form.behind)
        with in_double():
            law = _on_device(law)
        return Table(law, feedback.context, 1, feedback.taps, feedback.taps - 1, own=False)

    def tables(self, feedbacks: Sequence[Feedback]) -> Table:
        """Rows per sample, each scenario's own, of the scenarios that `run` then runs."""
        most = _power_of_two(len(feedbacks))
        return self._dense([*feedbacks, *[feedbacks[-1]] * (most - len(feedbacks))])

    def run(self, table: Table, laid: Laid, first: int = 0, count: int | None = None) -> Figures:
        """Run a table along the scenarios first, …, first + count − 1."""
        return self._all(table, laid, first, laid.scenarios - first if count is None else count)[0]

    def path(
        self, table: Table, laid: Laid, first: int, count: int, keep: int = 0
    ) -> tuple[Figures, Path]:
        """The same, with states and inputs from sample `keep` on."""
        figures, paths = self._all(table, laid, first, count, path=True)
        x, u = (np.concatenate(part, axis=2)[keep:] for part in zip(*paths, strict=True))
        return figures, Path(x[:, :, :count].transpose(2, 1, 0), u[:, :, :count].transpose(2, 1, 0))

    def _all(
        self, table: Table, laid: Laid, first: int, count: int, path: bool = False
    ) -> tuple[Figures, list[Any]]:
        loop = self._loop
        late, wide, back = loop.late, loop.maps.move.shape[2], loop.window.count
        sizes = Sizes(self._samples, late, wide, back, table.taps, table.window, table.own, path)
        results = []
        with in_double():
            for signals in self._chunks(table, laid, first, count, path):
                results.append(run_scenarios(sizes, table.law, signals, self._run))
                if len(results) > 1:
                    # Laying out the next chunk overlaps with this one's run, but no more than
                    # two of them take memory.
                    results[-2] = tuple(map(_fetched, results[-2]))
            figures, paths = zip(*[tuple(map(_fetched, one)) for one in results], strict=True)
        return Figures(*np.concatenate(figures, axis=1)[:, :count]), list(paths)

    def _chunks(
        self, table: Table, laid: Laid, first: int, count: int, path: bool
    ) -> Iterator[Signals]:
        """The signals of one chunk of scenarios after another."""
        size = min(self._chunk or self._fitting(table, laid, path), _power_of_two(count))
        room = _power_of_two(most_maps(laid, first, count, size, self._loop))
        for start in range(first, first + count, size):
            real = np.arange(start, min(start + size, first + count))
            mode, index = by_period(laid, real, self._samples)
            if table.context == "step":
                row = (real - first)[:, None] * self._samples + np.arange(self._samples)
            else:
                row = rows_of(mode, laid.age[real], table.context, table.ages)
            maps, index = own_maps(laid, index, self._loop, room)
            yield Signals(maps, filled(index, size), None if row is None else filled(row, size))

    def _dense(self, feedbacks: Sequence[Feedback]) -> Table:
        """Dense rows; what lies further back than the run is never asked for."""
        first = feedbacks[0]
        heard = any(feedback.input_gain.any() for feedback in feedbacks)
        taps, m = heard * min(first.taps, self._samples), first.state_gain.shape[1]
        table = np.concatenate(
            [
                np.concatenate((one.state_gain, one.latest_first[:, :, : taps * m]), axis=2)
                for one in feedbacks
            ]
        )
        own = first.context in ("mode_age", "step") or len(table) > _FEW_ROWS
        with in_double():
            law = _on_device(Law(table))
        return Table(law, first.context, first.ages, taps, 0, own)

    def _fitting(self, table: Table, laid: Laid, path: bool) -> int:
        """How many scenarios fit the budget, a power of two."""
        loop, rows = self._loop, table.law.table.shape
        n, m = loop.plant.states, loop.plant.inputs
        flight = min(max(loop.window.count, table.taps), self._samples)
        numbers = self._samples * (4 + path * (n + m)) + flight * m + loop.maps.energy[0].size
        numbers += 2 * laid.maps.size // laid.scenarios  # as many again for rounding up
        numbers += table.window * rows[0] * m + (1 + table.own) * m * rows[2]
        most = _MOST_ON_CPU if on_cpu() else _MOST
        return _power_of_two(min(most, max(1, _BUDGET // (8 * numbers))) + 1) // 2


def _power_of_two(number: int) -> int:
    """The smallest one that is at least as large."""
    return 1 << (number - 1).bit_length()


def _on_device(parts: Any) -> Any:
    """The arrays of a tuple where JAX computes, in double precision."""
    import jax

    return jax.tree.map(lambda part: jax.device_put(np.asarray(part, np.float64)), parts)


def _fetched(parts: Any) -> Any:
    """The arrays of a tuple as NumPy's."""
    import jax

    return jax.tree.map(np.asarray, parts)
