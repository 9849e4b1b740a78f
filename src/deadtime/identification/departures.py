"""Departures of a log from the model, each found by a score test and named, with what to do.

An alternative adds to the model what it may lack: a lag, a rate limit, a saturation, a dead zone or
backlash of an input, a delay of each mode, coloured noise, a drift of the level, or a load that
begins at one time. Its direction is the response of all predictions to that addition alone, by the
filter of the estimate (`innovations`), so that no alternative is fitted before it is significant.

    lag          u(t − D) ← ∫ u(t − D + τ − s) e^{−s/τ} ds/τ,    a delay of mean D and variance τ²
    input maps   u ← u + ε (f(u) − u),    f: clipped, less its dead zone, limited in rate, backlash
    modes        D ← D_i
    noise        e_k ← e_k + ρ e_{k−1} + … (Breusch and Godfrey)
    level        c ← c + ε_a(t) e_a,    a step at one time, or a random walk

A lag is a delay to first order, so that it is tested at several τ, each with the mean delay kept.
All tests have one level by Bonferroni's correction. Several alternatives may explain the same
residuals: the most significant one is reported, those that explain nearly as much are named with
it, and others only if they are significant beside it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple, Protocol, cast, runtime_checkable

import numpy as np
from jaxtyping import Float

from deadtime.identification.actuators import (
    delay_grid,
    lag_weights,
    rate_limited,
    with_backlash,
)
from deadtime.identification.estimate import Estimate
from deadtime.identification.likelihoods.innovations import Innovations
from deadtime.identification.likelihoods.likelihood import Likelihood, maximise
from deadtime.identification.log.read_tables import quoted
from deadtime.identification.log.recording import Part, Recording
from deadtime.identification.parameters import SHORTEST, Layout, Vector, Window
from deadtime.identification.residuals import CHANCE
from deadtime.identification.score_tests import (
    Regression,
    Score,
    best_of_path,
    random_walk,
    together,
)

_ROWS = 4_000  # of a long log that are tested
_LAGS = 0.25 * 1.5 ** np.arange(16)  # time constants tried, in periods, as far as the delay is long
_TAIL = 4.0  # lags after which the rest of a lag counts as one delay
_CLIMB = 10  # steps of the fit of a lag
_SETTLED = 1e-3  # fall of the sum of squares that ends it
_LIGHT = 1e-3  # weight of a delay whose slopes are left out
_CLIPPED = (0.05, 0.1, 0.2, 0.3)  # shares of an input beyond a limit
_DEAD = (0.1, 0.2, 0.35, 0.5)  # within a dead zone
# Periods in which an input of limited rate makes its largest step.
_RAMPS = 0.5 * 2.0 ** np.arange(0.0, 5.0, 0.5)
_SLACK = (0.05, 0.1, 0.2, 0.4)  # backlash in shares of the input's range
_STEPS = 24  # times at which a load may begin
_COSINES = 10  # of a random walk
# Of 2 log L, of slow signals where the plant's noise is estimated beside that of sensors: often it
# is underestimated, and then slow residuals are larger than it predicts.
_SLOW = 2.0
_NOISE_LAGS = 2  # of coloured noise
_SURE = 3.0  # standard errors that a departure of full size must make
# Factors of the rise of 2 log L in choosing: steps of one size do not tell a lag from a limited
# rate, a walk resembles a step and coloured noise, and any departure colours the noise.
_LAG, _LOAD, _DRIFT, _COLOUR = 1.25, 0.7, 0.6, 0.5
_SAME = 1e-6  # relative difference of steps of one size
_NEARLY = 0.7  # of the rise of 2 log L of the best alternative: another one explains nearly as much
_MORE = 0.2  # of it: a load or drift beside it is no remainder of it
_ONE_SIDED = 1.645  # standard errors
_PART = 0.25  # of a delay: a lag that may be longer is reported
_MOST = 2  # departures that are reported
_LEVELS = {"unlogged load", "drift"}
_FAR = 6.0  # deviations at which residuals are cut off: a wrong reading is no departure
_EXACT = 1e-7  # of a column's deviation: noise below is round-off


class Departure(NamedTuple):
    """Something that the log shows and the model lacks.

    name : "actuator lag", "rate limit", "saturation", "dead zone", "backlash", "delay per mode",
    "coloured noise", "unlogged load" or "drift"
    statistic : the rise of 2 log L, by its score test, less twice the number of coefficients
    chance : the probability of more in a log that lacks nothing, of this test alone
    sentence : the departure; advice : what to do
    others : names of departures that explain nearly as much
    """

    name: str
    statistic: float
    chance: float
    sentence: str
    advice: str
    others: tuple[str, ...] = ()

    @property
    def doubt(self) -> str:
        """Why intervals may not contain the delays, as the end of a sentence."""
        return f"the log departs from the model by {_DOUBT[self.name]}"

    @property
    def like_a_lag(self) -> bool:
        """Whether a lag of an actuator explains it, or nearly as much."""
        return "actuator lag" in {self.name, *self.others}


_DOUBT = {
    "actuator lag": "a lag of the actuator, which the delay includes",
    "rate limit": "a limited rate of the input",
    "saturation": "a saturation of the input",
    "dead zone": "a dead zone of the input",
    "backlash": "backlash",
    "delay per mode": "delays that differ between modes",
    "coloured noise": "coloured noise",
    "unlogged load": "a load that was not logged",
    "drift": "a drift of its level",
}


@runtime_checkable
class WithInnovations(Protocol):
    """A likelihood whose innovations are known."""

    def innovations_at(
        self, vector: Vector, window: Window, tested: Recording | None = None
    ) -> Innovations: ...


class Departures(NamedTuple):
    """The departures of a log, the most significant first, and sentences on what it leaves open."""

    found: tuple[Departure, ...] = ()
    open: tuple[str, ...] = ()


class Alternative(NamedTuple):
    """A departure, its test, and its sentence and advice where it is found.

    weight : factor of its rise of 2 log L where it is compared with others
    """

    name: str
    test: Callable[[Regression], Score | None]
    say: Callable[[Score], tuple[str, str]]
    weight: float = 1.0


def departures_of(estimate: Estimate, linear: bool = False) -> Departures:
    """The departures of a log with logged modes, from its estimate.

    linear : whether inputs taken as held change linearly between samples, as the log shows: then
        lags are not reported, for a linear input resembles one of h/√12
    """
    if estimate.missed.any() or estimate.outside or _is_exact(estimate):
        return Departures()
    probe = Probe.of(estimate)
    fit = Regression.of(probe.innovations.stacked(probe.white), probe.slopes)
    found = _found(fit, probe)
    if linear:
        return Departures(tuple(one for one in found if not one.like_a_lag))
    return Departures(found, () if found else tuple(probe.lags_left_open(fit, estimate)))


def _found(fit: Regression, probe: Probe) -> tuple[Departure, ...]:
    scores = _scores(fit, [*probe.alternatives()])
    level, found = np.log(CHANCE / max(len(scores), 1)), []
    while scores:
        if min(score.log_chance for _, score in scores) >= level:
            break
        likely = [one for one in scores if one[1].log_chance < np.log(CHANCE)]
        best, score = max(likely, key=lambda one: one[1].rise * one[0].weight)
        if found and score.rise < _MORE * found[0].statistic:
            break
        alike = {
            other.name: None
            for other, own in likely
            if other.name not in {best.name, "coloured noise"} and own.rise > _NEARLY * score.rise
        }
        found.append(_departure(best, score, tuple(alike)))
        # Until this one is dealt with, others of its kind may be a remainder of it.
        left = [other for other, _ in scores if (other.name in _LEVELS) != (best.name in _LEVELS)]
        fit = fit.beside(score.directions)
        scores = _scores(fit, left if len(found) < _MOST else [])
    return tuple(found)


def _is_exact(estimate: Estimate) -> bool:
    """Whether the noise of all outputs is round-off, which is no white noise."""
    recording, n = estimate.log.recording, estimate.disturbance.shape[1]
    every = np.vstack([part.output for part in recording.parts])
    if every.shape[1] != n:
        return False
    W = np.diagonal(estimate.disturbance, axis1=1, axis2=2).max(axis=0)
    added = np.sqrt(W * recording.step) + estimate.noise.max(initial=0.0)
    return bool((added < _EXACT * np.nanstd(every, axis=0)).all())


def _scores(fit: Regression, alternatives: list[Alternative]) -> list[tuple[Alternative, Score]]:
    each = [(one, one.test(fit)) for one in alternatives]
    return [(one, score) for one, score in each if score is not None]


def _departure(found: Alternative, score: Score, others: tuple[str, ...]) -> Departure:
    sentence, advice = found.say(score)
    if others:
        sentence += f" Nearly as well explains it: {', '.join(others)}."
    chance = float(np.exp(score.log_chance))
    return Departure(found.name, score.rise, chance, sentence, advice, others)


class Probe(NamedTuple):
    """An estimate's innovations at its maximum, and the alternatives to its model.

    whole : the likelihood of the log; log : that of the rows that are tested
    white : (rows, p), the innovations; slopes : (data, size)
    """

    whole: Likelihood
    log: Likelihood
    vector: Vector
    window: Window
    innovations: Innovations
    white: Float[np.ndarray, "row p"]
    slopes: Float[np.ndarray, "datum size"]

    @classmethod
    def of(cls, estimate: Estimate) -> Probe:
        whole, vector = estimate.log, estimate.best.theta
        some = whole.recording.stretches(_ROWS, whole.recording.lag(estimate.window[1]))
        log = replace(whole, recording=some)
        innovations = cast(WithInnovations, whole).innovations_at(vector, estimate.window, some)
        white = np.clip(innovations.residuals(vector), -_FAR, _FAR)
        slopes = innovations.slopes(vector)
        return cls(whole, log, vector, estimate.window, innovations, white, slopes)

    @property
    def parts(self) -> tuple[Part, ...]:
        return self.log.recording.parts

    @property
    def layout(self) -> Layout:
        return self.log.layout

    def alternatives(self) -> Iterator[Alternative]:
        for j in range(self.layout.m):
            yield from self._of_input(j)
        if self.layout.modes > 1 and not self.layout.per_mode:
            yield from self._delays_per_mode()
        yield self._coloured_noise()
        for a in range(self.layout.n):
            yield from self._of_level(a)

    def _of_input(self, j: int) -> Iterator[Alternative]:
        name, h = self.log.recording.inputs[j], self.log.recording.step
        linear = self.log.recording.hold == 1
        lags = self._lags(j)
        smeared = self.lagged(j, lags)
        steps = np.concatenate([np.abs(np.diff(part.input[:, j])) for part in self.parts])
        steps = steps[steps > 0.0]  # NaN is not
        largest = float(steps.max(initial=0.0))
        alike = bool((steps > (1.0 - _SAME) * largest).all())
        yield Alternative(
            "actuator lag",
            lambda fit: best_of_path(fit, smeared, True, _SURE),
            lambda score: self._say_lag(j, float(lags[score.place])),
            _LAG if alike else 1.0,
        )
        u = np.concatenate([part.input[:, j] for part in self.parts])
        u = u[np.isfinite(u)]
        if not u.size:  # of stretches in lost rows
            return
        low, high = np.quantile(u, _CLIPPED), np.quantile(u, 1.0 - np.array(_CLIPPED))
        nothing = np.full(len(low), np.inf)
        ends = np.hstack([(low, high), (-nothing, high), (low, nothing)]).T
        yield self._of_map(
            "saturation",
            j,
            [lambda u, _, own=own: np.clip(u, *own) for own in ends],
            lambda k: (
                f"{name} acts less beyond {_range(ends[k] + self._level(j))}: it saturates.",
                f"Log what the actuator delivers as {name}, or keep {name} within its limits.",
            ),
        )
        centre = -self._level(j)
        centre = centre if u.min() <= centre <= u.max() else float(np.median(u))
        half = np.quantile(np.abs(u - centre), _DEAD)
        yield self._of_map(
            "dead zone",
            j,
            [lambda u, _, w=w: u - np.clip(u - centre, -w, w) for w in half],
            lambda k: (
                f"{name} acts less within about {half[k]:.2g} of {centre + self._level(j):.4g}: "
                "it has a dead zone.",
                f"Log what the actuator delivers as {name}, or move {name} by more than that.",
            ),
        )
        rates = largest / (h * _RAMPS)
        if largest > 0.0:  # an input may differ between logs alone
            yield self._of_map(
                "rate limit",
                j,
                [lambda u, t, r=r: rate_limited(u, t, r, linear) for r in rates],
                lambda k: (
                    f"{name} moves no faster than about {rates[k]:.2g} per second: its rate is "
                    "limited, and the delay includes part of the ramps.",
                    f"Log what the actuator delivers as {name}, or test with smaller steps.",
                ),
            )
        slack = np.ptp(u) * np.array(_SLACK)
        yield self._of_map(
            "backlash",
            j,
            [lambda u, _, w=w: with_backlash(u, w) for w in slack],
            lambda k: (
                f"{name} acts only after it has moved by about {slack[k]:.2g} the other way: it "
                "has backlash.",
                f"Log what the actuator delivers as {name}, or test with steps much larger.",
            ),
        )

    def _of_map(
        self,
        name: str,
        j: int,
        maps: list[Callable[[np.ndarray, np.ndarray], np.ndarray]],
        say: Callable[[int], tuple[str, str]],
    ) -> Alternative:
        """An input j that acts as a function of itself, one of several."""
        changes = []
        for part in self.parts:
            u = part.input[:, j]
            own = np.zeros((len(maps), *part.input.shape))
            own[:, :, j] = [np.nan_to_num(f(u, part.time) - u) for f in maps]
            changes.append(own)
        d = self.innovations.responses(self.vector, changes)
        return Alternative(
            name, lambda fit: best_of_path(fit, d, True, _SURE), lambda score: say(score.place)
        )

    def _lags(self, j: int) -> Float[np.ndarray, " lag"]:
        """The time constants tried: up to the delay, and of the order of a period."""
        h, D = self.log.recording.step, float(self.vector[self.layout.of_delay[:, j]].min())
        return _LAGS[(_LAGS * h <= D) | (_LAGS <= 1.0)] * h

    def lags_left_open(self, fit: Regression, estimate: Estimate) -> Iterator[str]:
        """Sentences on lags that may take a large part of a delay, as far as the log shows.

        A lag is excluded if its coefficient is less than 1 by a one-sided test at 5 %.
        """
        h = self.log.recording.step
        wide = np.ptp(self.layout.spread(estimate.intervals), axis=2).max(axis=0)
        for j, name in enumerate(self.log.recording.inputs):
            lags = self._lags(j)
            own = fit.across(self.lagged(j, lags))
            length = np.linalg.norm(own, axis=0)
            excluded = own.T @ fit.residuals < length**2 - _ONE_SIDED * length
            most = float(lags[: int(np.append(excluded, True).argmax())].max(initial=0.0))
            D = float(self.vector[self.layout.of_delay[:, j]].min())
            if most > max(h, _PART * D, float(wide[j])):
                yield (
                    f"{name} may act through a lag of up to {most:.2g} s, of an actuator or a "
                    "filter, with a delay that much shorter: the log tells their sum, and not each "
                    "alone. Steps of it between denser rows would."
                )

    def _level(self, j: int) -> float:
        level = self.log.recording.level
        return 0.0 if level is None else float(level.input[j])

    def lagged(self, j: int, lags: Float[np.ndarray, " lag"]) -> Float[np.ndarray, "datum lag"]:
        """The responses to an input with lags and shorter delays, less that with its delay."""
        inputs = [np.zeros((1, *part.input.shape)) for part in self.parts]
        for own, part in zip(inputs, self.parts, strict=True):
            own[0, :, j] = np.nan_to_num(part.input[:, j])
        h, D = self.log.recording.step, self.vector[self.layout.of_delay[:, j]].mean()
        grid = delay_grid(D - lags.max(), D + _TAIL * lags.max(), D, h)
        vectors = [self.with_delay(j, delay - D) for delay in grid]
        each = [self.innovations.responses(vector, inputs)[:, 0] for vector in vectors]
        weights = np.column_stack([lag_weights(grid, D - lag, lag) for lag in lags])
        plain = lag_weights(grid, D, 1e-9 * h)
        return np.column_stack(each) @ (weights - plain[:, None])

    def with_delay(self, j: int, shift: float) -> Vector:
        """The unknowns with the delay of an input longer by a shift, but positive."""
        moved, place = self.vector.copy(), np.unique(self.layout.of_delay[:, j])
        moved[place] = np.maximum(moved[place] + shift, SHORTEST * self.log.recording.step)
        return moved

    def _say_lag(self, j: int, lag: float) -> tuple[str, str]:
        recording, n = self.log.recording, self.layout.n
        name, place = recording.inputs[j], np.unique(self.layout.of_delay[:, j])
        lag, error, alone = fit_lag(self, j, lag)
        D = float(self.vector[place].mean())
        sentence = (
            f"{name} acts through a lag of about {lag:.2g} s, of an actuator or a filter, that the "
            f"model lacks. The delay of {D:.4g} s includes it (effective delay): the delay alone "
            f"would be about {alone:.4g} s."
        )
        if error > 0.5 * lag:
            sentence += " The log tells their sum, but hardly each alone."
        first = recording.columns.outputs[0]
        return sentence, (
            "Log what the actuator delivers as one more state, or identify from outputs alone with "
            f"one more state (outputs=[{first!r}], order={n + 1}, --outputs {quoted(first)} "
            f"--order {n + 1}); a law for the effective delay must tolerate the lag."
        )

    def _delays_per_mode(self) -> Iterator[Alternative]:
        layout, own = self.layout, replace(self.layout, per_mode=True)
        A, B, delays = layout.split(self.vector[: layout.size])
        vector = np.concatenate((own.join(A, B, delays), self.vector[layout.size :]))
        log = replace(self.log, layout=own)
        whole = cast(WithInnovations, replace(self.whole, layout=own))
        slopes = whole.innovations_at(vector, self.window, self.log.recording).slopes(vector)

        def say(j: int) -> tuple[str, str]:
            best, _ = maximise(log, vector, gain=1e-4)
            each = zip(best.theta[own.of_delay[:, j]], self.log.recording.modes, strict=True)
            values = ", ".join(f"{D:.4g} s in mode {mode}" for D, mode in each)
            return (
                f"Delays of {self.log.recording.inputs[j]} differ between modes: about {values}.",
                "Repeat with per_mode=True, --per-mode.",
            )

        for j in range(layout.m):
            d = slopes[:, own.of_delay[:, j]]
            yield Alternative(
                "delay per mode", lambda fit, d=d: together(fit, d), lambda _, j=j: say(j)
            )

    def _coloured_noise(self) -> Alternative:
        """Residuals that depend on those of the last rows, each output on its own."""
        rows, p = self.white.shape
        d, first = np.zeros((rows, p, p * _NOISE_LAGS)), 0
        for part in self.parts:
            own = self.white[first : first + part.time.size]
            for lag in range(1, min(_NOISE_LAGS + 1, len(own))):
                for a in range(p):
                    place = p * (lag - 1) + a
                    d[first + lag : first + len(own), a, place] = own[:-lag, a]
            first += part.time.size
        flat = d.reshape(rows * p, -1)
        padded = np.vstack((flat, np.zeros((len(self.slopes) - len(flat), flat.shape[1]))))

        def say(score: Score) -> tuple[str, str]:
            r = [
                float((flat[:, a] @ self.white.ravel()) / max(flat[:, a] @ flat[:, a], 1e-300))
                for a in range(p)
            ]
            worst = int(np.argmax(np.abs(r)))
            of = f" of {self.log.recording.outputs[worst]}" if p > 1 else ""
            return (
                f"Residuals{of} depend on those one row before ({r[worst]:+.2f}) and on no input: "
                "noise is coloured, or a state is missing. Intervals are too narrow then.",
                "Say noise=True, --noise, if sensors were taken as exact; log what disturbs the "
                "plant as an input, or raise the order by the disturbance's states.",
            )

        return Alternative("coloured noise", lambda fit: together(fit, padded), say, _COLOUR)

    def _of_level(self, a: int) -> Iterator[Alternative]:
        # Signals are functions of the row, as several logs may have the same times.
        rows = self.log.recording.rows
        begins = ((np.arange(_STEPS) + 0.5) * rows / _STEPS).astype(int)
        steps = self._to_signals(a, (np.arange(rows) >= begins[:, None]) * 1.0)
        wave = np.pi * np.arange(1, _COSINES + 1)[:, None] * (np.arange(rows) + 0.5) / rows
        waves = self._to_signals(a, np.cos(wave))
        time, named = np.concatenate([p.time for p in self.parts]), self.log.recording.outputs
        state = named[a] if len(named) == self.layout.n else f"state {a + 1}"
        yield Alternative(
            "unlogged load",
            lambda fit: best_of_path(self._slow(fit), steps),
            lambda score: (
                f"From about t = {time[begins[score.place]]:.4g} s on something that is not logged "
                f"acts on {state}.",
                "Log it as an input, or identify from the rows before that time or after it alone.",
            ),
            _LOAD * self._doubled,
        )
        yield Alternative(
            "drift",
            lambda fit: random_walk(self._slow(fit), waves),
            lambda _: (
                f"The level of {state} drifts, as by a slow load that is not logged.",
                "Log what drives it as an input, identify from a stretch in which it is steady, or "
                "of one mode subtract moving means of the same length from all columns.",
            ),
            _DRIFT * self._doubled,
        )

    @property
    def _doubled(self) -> float:
        """The factor by which slow signals must explain more: see `_SLOW`."""
        return _SLOW if len(self.slopes) > self.white.size else 1.0

    def _slow(self, fit: Regression) -> Regression:
        return fit._replace(residuals=fit.residuals / np.sqrt(self._doubled))

    def _to_signals(
        self, a: int, signals: Float[np.ndarray, "many row"]
    ) -> Float[np.ndarray, "datum many"]:
        """The responses to signals added to dx_a/dt, each constant from row to row."""
        layout = self.layout
        A, B, delays = (one.copy() for one in layout.split(self.vector[: layout.size]))
        B[:], delays[:] = 0.0, SHORTEST * self.log.recording.step
        B[:, a, 0] = 1.0
        vector = np.concatenate((layout.join(A, B, delays), self.vector[layout.size :]))
        ends = np.cumsum([part.time.size for part in self.parts])[:-1]
        return self.innovations.to_signals(vector, np.split(signals, ends, axis=1))


class LagFit(NamedTuple):
    """The fit of an input's lag: its time constant and standard error, and the delay alone."""

    lag: float
    error: float
    delay: float


def fit_lag(probe: Probe, j: int, lag: float) -> LagFit:
    """The lag of an input by Gauss and Newton's method, with A and B and the noise as it is.

    The residuals with a lag are means of residuals over delays, with the weights of the lag.
    """
    place, h = np.unique(probe.layout.of_delay[:, j]), probe.log.recording.step
    D, own = float(probe.vector[place].mean()), probe.innovations
    grid = delay_grid(D - 4.0 * lag, D + 2.0 * _TAIL * lag, D, h)
    least = np.array([max(grid[0], 0.0), 0.02 * h])

    def at(theta: np.ndarray) -> list[np.ndarray]:
        return [probe._replace(vector=theta[:-2]).with_delay(j, node - D) for node in grid]

    def left(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        each = np.array([own.residuals(vector) for vector in at(theta)])
        return each, np.tensordot(lag_weights(grid, *theta[-2:]), each, 1).ravel()

    theta = np.concatenate((probe.vector, np.maximum((D - lag, lag), least)))
    (each, r), error = left(theta), np.inf
    for _ in range(_CLIMB):
        weights = lag_weights(grid, *theta[-2:])
        slopes = np.zeros((r.size, theta.size))
        for weight, vector in zip(weights, at(theta), strict=True):
            if weight > _LIGHT:
                slopes[:, :-2] += weight * own.slopes(vector)[: r.size]
        slopes[:, place] = 0.0
        slopes[:, probe.layout.size : -2] = 0.0
        for column, moved in enumerate(1e-4 * h * np.eye(2)):
            ahead, behind = theta[-2:] + moved, theta[-2:] - moved
            by = (lag_weights(grid, *ahead) - lag_weights(grid, *behind)) / (2e-4 * h)
            slopes[:, column - 2] = -np.tensordot(by, each, 1).ravel()
        unit = np.linalg.norm(slopes, axis=0)
        unit[unit == 0.0] = 1.0
        covariance = np.linalg.pinv((slopes / unit).T @ (slopes / unit), 1e-12, hermitian=True)
        error = float(np.sqrt(covariance[-1, -1]) / unit[-1])
        step = np.where(slopes.any(axis=0), covariance @ (slopes.T @ r / unit) / unit, 0.0)
        for share in (1.0, 0.5, 0.25, 0.1):
            trial = theta + share * step
            trial[-2:] = np.maximum(trial[-2:], least)
            after, after_r = left(trial)
            if after_r @ after_r < r @ r:
                break
        else:
            break
        fall = r @ r - after_r @ after_r
        theta, each, r = trial, after, after_r
        if fall < _SETTLED:
            break
    return LagFit(float(theta[-1]), error, float(theta[-2]))


def _range(ends: np.ndarray) -> str:
    low, high = ends
    if np.isfinite(ends).all():
        return f"about {low:.3g} … {high:.3g}"
    return f"about {high:.3g} upwards" if np.isfinite(high) else f"about {low:.3g} downwards"
