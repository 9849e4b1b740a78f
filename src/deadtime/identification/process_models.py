r"""Gain, time constants and dead time: process models to ask for, and those of any plant.

.. math::

    y(s) = e^{-D s} \frac{N(s)}{p(s)} u(s), \quad N(s) = C \operatorname{adj}(s I - A)\, b, \quad
    p(s) = \det(s I - A) = s^n + p_1 s^{n-1} + \dots + p_n

Coefficients of N and p are polynomials of the entries of A and b (Faddeev and LeVerrier), and about
as normal as these; gain N(0)/p(0) and time constants −1/λ are not. So every interval is the set of
values that a test of a linear combination of coefficients does not reject at 95 %, with their
covariance V and Student's quantile q: N(0) − K p(0) = 0 for a gain K (Fieller, J. Royal Statistical
Society B 16(2), 1954), p(λ) = 0 for a real pole, in one interval for poles that the log does not
separate. Derivations: docs/theory/identification.md.

An integrating process has a pole fixed at 0: N/(p/s) is a process without it, and its gain is the
velocity gain, in output units per second and input unit.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from deadtime.base.checks import brief, python_control
from deadtime.base.errors import ArgumentError
from deadtime.base.frozen import Frozen
from deadtime.identification.estimate import Estimate
from deadtime.identification.log.read_tables import quoted
from deadtime.identification.log.recording import Recording
from deadtime.identification.parameters import SensorMatrix, Square

ORDERS = {"fopdt": 1, "sopdt": 2, "integrating": 1}
_MOST = 4  # states of a plant that is described as a process
_REAL = 1e-7  # relative imaginary part of a root that is real but for round-off
_TINY = 1e-30  # step of a derivative by a complex number
_TIMES = ("s", "rad/s")


def order_of_model(model: object, order: Any, zeros: bool | None, C: object) -> int:
    """The number of states of a process model, whose other arguments are checked."""
    if not isinstance(model, str) or model not in ORDERS:
        listed = '"fopdt", "sopdt" or "integrating" (--model fopdt|sopdt|integrating)'
        raise ArgumentError(f"model must be {listed}, or None, got {brief(model)}.")
    given = f"model={model!r}, --model {model}"
    if C is not None or zeros:
        name = "zeros" if C is None else "C"
        raise ArgumentError(f"{name} must be left out with {given}: its output is the state.")
    whole = isinstance(order, int | np.integer) and not isinstance(order, bool)
    if model == "integrating" and whole and order in (1, 2):
        return int(order)
    if order is not None:
        which = "1, or 2 for one with a lag, with" if model == "integrating" else "left out with"
        raise ArgumentError(
            f"order must be {which} {given}, got {brief(order)}: other orders need no model."
        )
    return ORDERS[model]


def require_one_output(model: str | None, outputs: tuple[str, ...]) -> None:
    if model is not None and len(outputs) > 1:
        raise ArgumentError(
            f"model={model!r} is of one output, got {len(outputs)} ({', '.join(outputs)}): choose "
            f"one at a time by outputs=[{outputs[0]!r}], --outputs {quoted(outputs[0])}."
        )


class Quantity(NamedTuple):
    """An estimate with the ends of its 95 % interval, and its unit, "" where not known.

    An end is infinite where the log does not bound the quantity on that side.

    Examples
    --------
    >>> str(Quantity(2.0131, 1.9787, 2.0476, "°C/%")), str(Quantity(61.21, 58.1, 64.3, "s"))
    ('2.01 (1.98 … 2.05) °C/%', '61.2 s (58.1 … 64.3)')
    >>> str(Quantity(float("inf"), 9032.1, float("inf"), "s"))
    'at least 9,030 s'
    """

    value: float
    low: float
    high: float
    unit: str = ""

    def __str__(self) -> str:
        if np.isinf(self.low) and np.isinf(self.high):
            return "not determined"
        unit = f" {self.unit}" if self.unit else ""
        if np.isinf(self.high):
            return f"at least {float(f'{self.low:.3g}'):,.6g}{unit}"
        if np.isinf(self.low):
            return f"at most {float(f'{self.high:.3g}'):,.6g}{unit}"
        value, low, high = _rounded(self.value, self.low, self.high)
        if self.unit in _TIMES:
            return f"{value}{unit} ({low} … {high})"
        return f"{value} ({low} … {high}){unit}"


def _rounded(value: float, low: float, high: float) -> list[str]:
    """Texts of an estimate and its ends, rounded by at most a seventh of the half width."""
    size, half = max(abs(low), abs(high)), 0.5 * (high - low)
    if not half > 1e-9 * size:
        return [f"{one:.6g}" for one in (value, low, high)]
    places = -int(np.floor(np.log10(half / 3.4)))
    if 1e-4 < size < 1e6:
        return [f"{round(one, places):.{max(places, 0)}f}" for one in (value, low, high)]
    digits = 1 + int(np.floor(np.log10(size))) + places
    return [f"{one:.{digits}g}" for one in (value, low, high)]


class Oscillation(NamedTuple):
    """A pair of poles: s² + 2 ζ ω s + ω², of natural frequency ω and damping ratio ζ."""

    frequency: Quantity
    damping: Quantity


@dataclass(frozen=True, eq=False, repr=False)
class Process(Frozen):
    """The transfer function from an input to an output in a mode, in an engineer's quantities.

    Poles that do not significantly act between the two are left out, unless none does.

    Attributes
    ----------
    mode, output, input : str
        Names of the log.
    gain : Quantity
        Of the steady state; the velocity gain if `integrating`.
    time_constants : tuple of Quantity
        −1/λ of every real pole λ, seconds, the longest first.
    oscillations : tuple of Oscillation
        Natural frequency, rad/s, and damping ratio of every pair of complex poles.
    dead_time : Quantity
        Seconds.
    integrating : bool
        Whether a pole is 0.
    numerator, denominator : arrays
        Coefficients of the transfer function without its dead time, highest power first.

    Examples
    --------
    See `identify`.
    """

    mode: str
    output: str
    input: str
    gain: Quantity
    time_constants: tuple[Quantity, ...]
    oscillations: tuple[Oscillation, ...]
    dead_time: Quantity
    integrating: bool
    numerator: Float[np.ndarray, " power"]
    denominator: Float[np.ndarray, " powers"]

    def transfer_function(self) -> Any:
        """A `control.TransferFunction` without the dead time, which is `dead_time.value`."""
        control = python_control("transfer functions of processes")
        return control.TransferFunction(self.numerator, self.denominator)

    @property
    def bounded(self) -> bool:
        """Whether the log excludes that another pole is 0."""
        return bool(np.isfinite([one.high for one in self.time_constants]).all()) and bool(
            np.isfinite(self.gain[:3]).all()
        )

    def label(self, modes: int) -> str:
        """Output, input and mode, of a plant of so many modes."""
        return f"{self.output} from {self.input}{f', mode {self.mode}' * (modes > 1)}"

    @property
    def cells(self) -> tuple[str, str, str]:
        """Gain, dynamics and dead time, for a table."""
        moves = [f"{time}" for time in self.time_constants]
        moves += [f"ω {one.frequency}, ζ {one.damping}" for one in self.oscillations]
        return f"{self.gain}", "; ".join(moves) or "none", f"{self.dead_time}"

    def __str__(self) -> str:
        several, distinct = len(self.time_constants) > 1, {str(one) for one in self.time_constants}
        times = " and ".join(map(str, self.time_constants))
        times = f"{times.partition(' and ')[0]} each" if several and len(distinct) == 1 else times
        parts = [f"{'velocity ' * self.integrating}gain {self.gain}"]
        parts += [f"time constant{'s' * several} {times}"] if times else []
        for one in self.oscillations:
            parts.append(f"natural frequency {one.frequency}, damping ratio {one.damping}")
        return ", ".join((*parts, f"dead time {self.dead_time}"))

    def __repr__(self) -> str:
        return f"Process({self.output!r} from {self.input!r}: {self})"


def processes_of(estimate: Estimate, recording: Recording, C: SensorMatrix) -> tuple[Process, ...]:
    """The processes of all stable modes, outputs and inputs whose delays the log tells.

    None of plants with more than four states, whose time constants are hardly ever all known.
    """
    layout, processes = estimate.log.layout, []
    if layout.n > _MOST:
        return ()
    D = np.column_stack((estimate.delays, estimate.intervals))
    determined = ~(estimate.missed | estimate.several | estimate.range_flags[1])
    covariance, reach = _covariance(estimate)
    for i, mode in enumerate(recording.modes):
        places = np.append(layout.of_A[i].ravel(), layout.of_B[i][:, : layout.m].ravel())
        own = covariance[np.ix_(places, places)]
        q = float(reach[places][np.diagonal(own) > 0.0].max())
        transfer = TransferMatrix.of(estimate.plant.A[i], estimate.plant.B[i], C, own, q)
        if transfer.unstable:
            continue
        for a, j in np.ndindex(len(C), layout.m):
            row = layout.of_delay[i, j] - layout.of_delay.min()
            if determined[row]:
                names = mode, recording.outputs[a], recording.inputs[j]
                value, low, high = D[row].tolist()
                processes.append(transfer.process(a, j, names, Quantity(value, low, high, "s")))
    return tuple(processes)


def _covariance(estimate: Estimate) -> tuple[np.ndarray, np.ndarray]:
    """The covariance of a plant's unknowns, and Student's quantiles.

    Where intervals cover several plausible delays, deviations grow to reach their farther ends.
    """
    size = estimate.log.layout.size
    covariance, reach = estimate.spread.covariance[:size, :size], estimate.spread.reach[:size]
    if estimate.ends is None:
        return covariance, reach
    half = np.abs(estimate.ends[:size] - estimate.best.theta[:size, None]).max(axis=1)
    own = reach * np.sqrt(np.diagonal(covariance))
    wider = np.maximum(np.divide(half, own, out=np.ones(size), where=own > 0.0), 1.0)
    return covariance * wider * wider[:, None], reach


class TransferMatrix(NamedTuple):
    """N and p of all outputs and inputs of a mode, without a pole that is fixed at 0.

    V : covariance of p₁ … p_n, and of all of N, power by power; q : Student's quantile
    """

    N: Float[np.ndarray, "power p m"]
    p: Float[np.ndarray, " powers"]
    V: Float[np.ndarray, "all all"]
    q: float
    integrating: bool

    @classmethod
    def of(
        cls,
        A: Square,
        B: Float[np.ndarray, "n m"],
        C: SensorMatrix,
        covariance: Float[np.ndarray, "entry entry"],
        q: float,
    ) -> TransferMatrix:
        """From matrices, and the covariance of the entries of A, then of B."""
        entries, n = np.append(A.ravel(), B.ravel()), len(A)
        slopes = []
        for a in range(entries.size):  # exact but for round-off, for coefficients are polynomials
            moved = entries.astype(complex)
            moved[a] += 1j * _TINY
            N, p = coefficients(moved[: n * n].reshape(A.shape), moved[n * n :].reshape(B.shape), C)
            slopes.append(np.imag(np.append(p[1:], N.ravel())) / _TINY)
        by_entry = np.array(slopes).T
        V = by_entry @ covariance @ by_entry.T
        N, p = coefficients(A, B, C)
        if p[-1] == V[n - 1, n - 1] == 0.0:
            kept = np.delete(np.arange(len(V)), n - 1)
            return cls(N, p[:-1], V[np.ix_(kept, kept)], q, integrating=True)
        return cls(N, p, V, q, integrating=False)

    @property
    def order(self) -> int:
        return self.p.size - 1

    @property
    def poles(self) -> Complex[np.ndarray, " pole"]:
        """Poles, one of each complex pair, the slowest first."""
        poles = np.asarray(np.roots(self.p), complex)
        real = np.abs(np.imag(poles)) <= _REAL * np.abs(poles)
        poles = np.where(real, np.real(poles), poles)
        return np.array(sorted(poles[np.imag(poles) >= 0.0], key=abs), complex)

    @property
    def unstable(self) -> bool:
        """Whether a pole lies to the right of 0, beyond its interval."""
        of_real = [self.ends(pole.real)[0] >= 0.0 for pole in self.poles if pole.imag == 0.0]
        pairs = [self.oscillation(pole) for pole in self.poles if pole.imag > 0.0]
        return any(of_real) or any(one.damping.high < 0.0 for one in pairs)

    def ends(self, pole: float) -> tuple[float, float]:
        """The interval of a real pole: see the module."""
        n, unit = self.order, max(abs(pole), float(np.abs(self.p[-1]) ** (1.0 / self.order)))
        scale = unit ** np.arange(n + 1)  # of s in this unit, coefficients are near 1
        p, V = self.p / scale, self.V[:n, :n] / scale[1:] / scale[1:, None]
        variance = np.zeros(2 * n - 1)
        np.add.at(variance, np.add.outer(np.arange(n), np.arange(n)), V)
        roots = np.asarray(np.roots(np.polysub(np.polymul(p, p), self.q**2 * variance)), complex)
        real = unit * np.real(roots)[np.abs(np.imag(roots)) <= _REAL * np.abs(roots)]
        below, above = real[real <= pole], real[real >= pole]
        return float(below.max(initial=-np.inf)), float(above.min(initial=np.inf))

    def time_constant(self, pole: float) -> Quantity:
        low, high = self.ends(pole)
        longest = -1.0 / high if high < 0.0 else np.inf
        value = -1.0 / pole if pole < 0.0 else np.inf
        return Quantity(value, -1.0 / low, longest, "s")

    def oscillation(self, pole: complex) -> Oscillation:
        n, by_p = self.order, self._by_p(pole)
        square, twice = abs(pole) ** 2, -2.0 * pole.real
        slopes = 2.0 * np.real([np.conj(pole) * by_p, -by_p])
        V = slopes @ self.V[:n, :n] @ slopes.T
        half, ω = self.q * float(np.sqrt(V[0, 0])), float(np.sqrt(square))
        low, high = float(np.sqrt(max(square - half, 0.0))), float(np.sqrt(square + half))
        unit = np.array([1.0 / ω, 1.0])  # of 2 ω by ω², and of 2 ζ ω
        ends = ratio_ends(twice, 2.0 * ω, (V * unit * unit[:, None])[::-1, ::-1], self.q)
        return Oscillation(Quantity(ω, low, high, "rad/s"), Quantity(twice / (2.0 * ω), *ends))

    def _by_p(self, pole: complex) -> np.ndarray:
        """The derivatives of a pole by p₁ … p_n: of p(λ) = 0 follows dλ = −m(λ)ᵀ dp/p'(λ)."""
        powers = np.arange(self.order - 1, -1, -1)
        return -(pole**powers) / np.polyval(np.polyder(self.p), pole)

    def shows(self, pole: complex, output: int, input: int) -> bool:
        """Whether the log shows a pole between an input and an output: N(λ) is not 0.

        Otherwise N cancels it, as that of a tank which does not feed the output's.
        """
        N = self.N[:, output, input]
        by = np.zeros(self.N.shape, complex)
        by[:, output, input] = pole ** np.arange(N.size - 1, -1, -1)
        by_all = np.append(self._by_p(pole) * np.polyval(np.polyder(N), pole), by.ravel())
        variance = float((by_all @ self.V @ by_all.conj()).real)
        return bool(abs(np.polyval(N, pole)) > self.q * np.sqrt(max(variance, 0.0)))

    def process(
        self, output: int, input: int, names: tuple[str, str, str], dead_time: Quantity
    ) -> Process:
        n, last, above = self.order, float(self.p[-1]), float(self.N[-1, output, input])
        place = n + int(np.ravel_multi_index((-1 % len(self.N), output, input), self.N.shape))
        places = [place, n - 1] if n else [place]
        V = np.zeros((2, 2))
        V[: len(places), : len(places)] = self.V[np.ix_(places, places)]
        value = above / last if last > 0.0 else np.copysign(np.inf, above)
        gain = Quantity(value, *ratio_ends(above, last, V, self.q), self._unit(*names[1:]))
        every = self.poles.tolist()
        shown = [pole for pole in every if self.shows(pole, output, input)] or every
        real = [pole.real for pole in shown if pole.imag == 0.0]
        pairs = [pole for pole in shown if pole.imag > 0.0]
        numerator = np.trim_zeros(self.N[:, output, input], "f")
        return Process(
            *names,
            gain=gain,
            time_constants=tuple(map(self.time_constant, real)),
            oscillations=tuple(map(self.oscillation, pairs)),
            dead_time=dead_time,
            integrating=self.integrating,
            numerator=numerator if numerator.size else np.zeros(1),
            denominator=np.append(self.p, 0.0) if self.integrating else self.p,
        )

    def _unit(self, output: str, input: str) -> str:
        y, u = unit_of(output), unit_of(input)
        rate = "/s" * self.integrating
        return f"{y}{rate}/{u}" if y and u else ""


def coefficients(A: np.ndarray, B: np.ndarray, C: SensorMatrix) -> tuple[np.ndarray, np.ndarray]:
    """N (n, p, m) and p (n + 1) of C (s I − A)⁻¹ B, highest power first, by Faddeev and LeVerrier.

    Examples
    --------
    >>> A, B = np.array([[0.0, 1.0], [-6.0, -5.0]]), np.array([[0.0], [12.0]])
    >>> N, p = coefficients(A, B, np.eye(1, 2))
    >>> N.ravel(), p
    (array([ 0., 12.]), array([1., 5., 6.]))
    """
    n = len(A)
    adjugate, p, N = np.eye(n), [1.0], [C @ B]
    for k in range(1, n + 1):
        product = A @ adjugate
        p.append(-np.trace(product) / k)
        adjugate = product + p[-1] * np.eye(n)
        N.append(C @ adjugate @ B)
    return np.array(N[:n]), np.array(p)


def ratio_ends(
    above: float, below: float, V: Float[np.ndarray, "2 2"], q: float
) -> tuple[float, float]:
    """Fieller's interval of the ratio of two normal numbers, the lower of which is positive.

    V : their covariance; q : the quantile

    Examples
    --------
    >>> [round(end, 3) for end in ratio_ends(2.0, 1.0, np.diag([0.01, 0.0]), 2.0)]
    [1.8, 2.2]
    >>> low, high = ratio_ends(2.0, 1.0, np.diag([0.01, 0.36]), 2.0)
    >>> round(low, 3), high
    (0.901, inf)
    """
    square, product = below**2 - q**2 * V[1, 1], above * below - q**2 * V[0, 1]
    constant = above**2 - q**2 * V[0, 0]
    if square <= 0.0 and constant <= 0.0:
        return -np.inf, np.inf
    half = float(np.sqrt(max(product**2 - square * constant, 0.0)))
    if square > 0.0:
        return float((product - half) / square), float((product + half) / square)
    # The set is all but the gap around 0 between these roots; stable plants have the sign of N(0).
    side = -1.0 if above > 0.0 else 1.0
    end = constant / (product - side * half)
    return (float(end), np.inf) if above > 0.0 else (-np.inf, float(end))


def unit_of(column: str) -> str:
    """The unit at the end of a column's name, in brackets; "" without one.

    Examples
    --------
    >>> unit_of("Level 1 [cm]"), unit_of("flow (l/min)"), unit_of("position (2)"), unit_of("x1")
    ('cm', 'l/min', '', '')
    """
    match = re.search(r"[\[(]([^\[\]()]*[^\[\]()\d\s][^\[\]()]*)[\])]\s*$", column)
    return match[1].strip() if match else ""


def process_sentences(
    processes: tuple[Process, ...], recording: Recording, outputs: int
) -> list[str]:
    """Sentences on the processes of a plant with one output, and on integrators not excluded."""
    if outputs > 1:
        return []
    sentences = []
    for one in processes:
        where = [f"in mode {one.mode}"] if len(recording.modes) > 1 else []
        where += [f"from {one.input}"] if len(recording.inputs) > 1 else []
        text = f"{' '.join(where)}: {one}." if where else f"{one}."
        sentences.append(f"{text[0].upper()}{text[1:]}")
    loose = [one for one in processes if not one.bounded]
    if loose:
        order = loose[0].denominator.size - 1
        advice = ""
        if order <= 2 and not loose[0].integrating:
            also = ("", "") if order == 1 else (", order=2", " --order 2")
            python, command = f'model="integrating"{also[0]}', f"--model integrating{also[1]}"
            advice = f" If it is one, say {python}, or in a command {command}."
        sentences.append(
            "The log does not exclude an integrator, whose gain and time constant have no upper "
            f"end: a longer log or a larger step would decide.{advice}"
        )
    return sentences
