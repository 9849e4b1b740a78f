"""A second method for certificates that shares no code with the package.

Times are exact fractions of the decimals; a loop's matrix comes from SciPy's exponential, or from
mpmath's with 50 digits; inequalities are judged by the pivots of elimination, or by eigenvalues.
Which step may follow which is worked out from the instants of the switches.
"""

from __future__ import annotations

import base64
import hashlib
import itertools
import json
import math
from fractions import Fraction
from functools import cache

import mpmath
import numpy as np
from scipy.linalg import expm

DIGITS = 50


def decimal(value) -> Fraction:
    """The decimal that prints as a float."""
    return value if isinstance(value, Fraction) else Fraction(repr(float(value)))


def precise(value):
    """A float or a fraction as an mpmath number."""
    if isinstance(value, Fraction):
        return mpmath.mpf(value.numerator) / value.denominator
    return mpmath.mpf(value)


def many_digits(array) -> np.ndarray:
    """Floats as an array of mpmath numbers."""
    array = np.asarray(array)
    return np.array([precise(v) for v in array.ravel()], object).reshape(array.shape)


def exponential(X: np.ndarray) -> np.ndarray:
    """e^X, in the arithmetic of X."""
    if X.dtype != object:
        return expm(X)
    return np.array(mpmath.expm(mpmath.matrix(X.tolist())).tolist(), object).reshape(X.shape)


def is_positive(X: np.ndarray) -> bool:
    """Whether a symmetric matrix of fractions or mpmath numbers is ≻ 0, by its pivots."""
    X = X.copy()
    for k in range(len(X)):
        if not X[k, k] > 0:
            return False
        rest = X[k + 1 :, k]
        X[k + 1 :, k + 1 :] -= np.outer(rest, rest) / X[k, k]
    return True


def least_eigenvalue(X: np.ndarray) -> float:
    """Of a symmetric matrix of floats, scaled to a diagonal of 1; −1 if that has a sign wrong."""
    if (np.diag(X) <= 0.0).any():
        return -1.0
    unit = np.sqrt(np.diag(X))
    return float(np.linalg.eigvalsh(0.5 * (X + X.T) / unit / unit[:, None])[0])


# -- the loop that runs --------------------------------------------------------------------


class Plant:
    """A plant's period: x⁺ = E (x, u_{k−N}, u_{k−N+1}), in floats or with 50 digits."""

    def __init__(self, A, B, delay, step, digits=False) -> None:
        self.A, self.B = (many_digits(X) if digits else np.asarray(X) for X in (A, B))
        self.h, self.digits = decimal(step), digits
        self.count = max(1, math.ceil(decimal(delay) / self.h))
        self.phase = decimal(delay) - (self.count - 1) * self.h
        self.modes, self.n, self.m = self.B.shape
        self.rows = cache(self._rows)

    def _rows(self, mode: int, after: int | None = None, s=1) -> np.ndarray:
        """E of a period in `mode`, and from the fraction `s` of it on in `after`."""
        n, m, s = self.n, self.m, Fraction(s) * self.h
        E = np.eye(n, n + 2 * m).astype(self.A.dtype)
        for a, b in itertools.pairwise(sorted({Fraction(0), self.phase, s, self.h})):
            i = mode if a < s or after is None else after
            tau = precise(b - a) if self.digits else float(b - a)
            block = np.zeros((n + m, n + m)).astype(E.dtype)
            block[:n, :n], block[:n, n:] = self.A[i] * tau, self.B[i] * tau
            whole = exponential(block)[:n]
            E = whole[:, :n] @ E
            at = n if a < self.phase else n + m
            E[:, at : at + m] += whole[:, n:]
        return E


def at_point(A, B, delays, step, cell_order, u, f, weights, reading=None) -> np.ndarray:
    """E at a point of a polytope, with A and B read as binary numbers or as decimals."""
    if reading == "decimal":
        A, B = (np.vectorize(decimal, otypes=[object])(X) for X in (A, B))
    mixed = (np.tensordot(many_digits(weights), many_digits(X), 1) for X in (A, B))
    low, high = (decimal(d) for d in delays)
    plant = Plant(*mixed, low + (high - low) * Fraction(f), step, digits=True)
    h, phase, u = plant.h, plant.phase, Fraction(u)
    s = u * phase if cell_order[0].share != "all" else phase + u * (h - phase)
    return plant.rows(cell_order[0].mode, cell_order[-1].mode, s / h)


class Loop:
    """The lifted loop ξ⁺ = M ξ of a plant under a table.

    ξ = (x_k, w_k, u_{k−1}, …, u_{k−W}), w what the law remembers, if it does.
    """

    def __init__(self, A, B, delay, table, digits=False) -> None:
        self.plant, self.table = Plant(A, B, delay, table.step, digits), table
        self.silent = not (np.any(table.state_gain) or np.any(table.input_gain))
        self.held = 0 if self.silent else max(self.plant.count, table.taps)
        self.memory = getattr(table, "memory", 0)
        self.order = self.plant.n + self.memory + self.held * self.plant.m

    def row(self, mode: int, age: int) -> int:
        """The table's row."""
        ages = self.table.ages
        places = {"none": 0, "mode": mode, "mode_age": mode * ages + min(age, ages - 1)}
        return places[self.table.context]

    def outputs(self, row: int) -> tuple[np.ndarray, np.ndarray]:
        """w_{k+1}, and u_k, u_{k−1}, …, u_{k−W}, as functions of ξ."""
        n, m, q = self.plant.n, self.plant.m, self.memory
        u = np.zeros((self.held + 1, m, self.order))
        for j in range(1, self.held + 1):
            u[j, :, n + q + (j - 1) * m : n + q + j * m] = np.eye(m)
        now = np.zeros((q + m, self.order))
        now[:, :n] = self.table.state_gain[row]
        now[:, n : n + q] = self.table.input_gain[row][0, :, :q]
        for j, G in enumerate(self.table.input_gain[row]):
            now[:, n + q + j * m : n + q + (j + 1) * m] = G[:, q:]
        u[0] = now[q:]
        return (many_digits(now[:q]), many_digits(u)) if self.plant.digits else (now[:q], u)

    def step(self, mode: int, age: int, after: int | None = None, s=1) -> np.ndarray:
        """M of a period that begins in `mode` at an age; a switch at the fraction `s` of it."""
        if self.silent:  # no input is ever on its way
            return self.plant.rows(mode, after, s)[:, : self.plant.n]
        (w, u), N = self.outputs(self.row(mode, age)), self.plant.count
        state = np.eye(self.plant.n, self.order).astype(u.dtype)
        x = self.plant.rows(mode, after, s) @ np.concatenate((state, u[N], u[N - 1]))
        return np.concatenate((x, w, *u[: self.held]))


def decreases(before, after, M, rho) -> bool:
    """before ≻ 0 and before − Mᵀ after M/ρ² ≻ 0; beyond doubt where M has 50 digits."""
    if M.dtype == object:
        before, after = many_digits(before), many_digits(after)
        return is_positive(before) and is_positive(before - M.T @ after @ M / precise(rho) ** 2)
    return least_eigenvalue(before) > 0 and least_eigenvalue(before - M.T @ after @ M / rho**2) > 0


# -- admissible signals --------------------------------------------------------------------


CLOCK = Fraction(1, 10**5)  # by how much it may be off


def may_leave(age: int, dwell_time, step) -> bool:
    """Whether a mode seen `age` times before may be left in the coming period: it began less than
    a period before it was first seen, and lasts to the end of the coming one at most."""
    return (age + 2) * decimal(step) > (1 - CLOCK) * decimal(dwell_time)


def may_stay(age: int, maximum, step) -> bool:
    """Whether it may last for the coming period."""
    return maximum is None or (age + 1) * decimal(step) < (1 + CLOCK) * decimal(maximum)


def instants(age: int, dwell_time, step, maximum=None) -> tuple[float, float]:
    """The first and the last fraction of the period at which it may be left: with as much as the
    whole period before it was first seen, and with nothing of it."""
    low = (1 - CLOCK) * decimal(dwell_time) / decimal(step) - age - 1
    high = Fraction(1) if maximum is None else (1 + CLOCK) * decimal(maximum) / decimal(step) - age
    return max(0.0, float(low)), min(1.0, float(high))


def steps(modes: int, dwell_time, step, last: int, maximum=None):
    """All (mode, age, after, next age) with ages up to `last`, where they stop counting."""
    for i, a in itertools.product(range(modes), range(last + 1)):
        if may_stay(a, maximum, step):
            yield i, a, i, min(a + 1, last)
        if may_leave(a, dwell_time, step) and instants(a, dwell_time, step, maximum)[1] > 0.0:
            yield from ((i, a, j, 0) for j in range(modes) if j != i)


def random_signal(rng, modes: int, dwell_time: float, end: float, longest: float):
    """Times and modes of a signal with sojourns between `dwell_time` and `longest`, many short."""
    times, sequence = [0.0], [int(rng.integers(modes))]
    while times[-1] < end:
        stay = dwell_time + (longest - dwell_time) * max(0.0, rng.uniform(-0.3, 1.0)) ** 3
        times.append(times[-1] + stay * (1.0 + 1e-12))
        sequence.append(int((sequence[-1] + rng.integers(1, modes)) % modes))
    return times, sequence


def bursts(rng, modes: int, average: float, chatter: int, end: float, step: float):
    """Times and modes with at most `chatter` + T/average switches in any T, one in a period."""
    times, sequence = [0.0], [0]
    while times[-1] < end:
        switches = times[1:]
        j = len(switches)
        soonest = [t + (j - i + 1 - chatter) * average for i, t in enumerate(switches)]
        soonest.append((math.floor(times[-1] / step) + 1.01) * step if j else 0.01 * step)
        wait = rng.choice([0.0, 0.3 * step, average, 4.0 * average]) * rng.random()
        times.append(max(soonest) + wait + 1e-9 * step)
        sequence.append(int((sequence[-1] + rng.integers(1, modes)) % modes))
    return times, sequence


def room(times, average: float, chatter: int) -> float:
    """How many more switches the fullest window allows; below 0 the signal is not admissible."""
    switches, number = np.array(times[1:]), np.arange(len(times) - 1)
    left = chatter + (switches - switches[:, None]) / average - (number - number[:, None] + 1)
    return float(left[np.triu_indices(len(switches), 1)].min())


def by_age(transitions) -> dict:
    """Age to next age of all transitions with the same modes and row."""
    found: dict = {}
    for t in transitions:
        found.setdefault((t.mode, t.row, t.after), {})[t.age] = t.next_age
    return found


def covered(transitions, knots, step, interpolation) -> bool:
    """Whether a step is among them, or between two that imply it, S being linear there."""
    i, a, row, j, b = step
    found = transitions[i, row, j]
    if a in found:
        return found[a] == b
    low, high = max(x for x in found if x < a), min(x for x in found if x > a)
    part = Fraction(high - a, high - low)

    def at(age):
        weights = dict(interpolation(knots, age))
        return np.array([weights.get(k, Fraction(0)) for k in range(len(knots))])

    ends = (low, high, a), (found[low], found[high], b)
    return all((part * at(x) + (1 - part) * at(y) == at(z)).all() for x, y, z in ends)


def ages(sampled) -> list[int]:
    """How often each sampled mode has been seen before without a break."""
    result = [0]
    for before, now in itertools.pairwise(sampled):
        result.append(result[-1] + 1 if now == before else 0)
    return result


def period(loop: Loop, sojourns: list[Fraction]) -> tuple[np.ndarray, int]:
    """The loop over a signal that repeats sojourns of modes 0, 1, …, in periods of the sampling.

    Their sum is whole. Returns the product of the steps and how many there are; the second cycle
    is taken, when the ages of the modes have settled.
    """
    modes, total = len(sojourns), sum(sojourns)
    starts = [sum(sojourns[:i], Fraction(0)) for i in range(modes)]
    times = [t + r * total for r in range(2) for t in starts]

    def mode(t):
        return (sum(time <= t for time in times) - 1) % modes

    sampled = [mode(k) for k in range(2 * int(total) + 1)]
    age, product = ages(sampled), np.eye(loop.order)
    for k in range(int(total), 2 * int(total)):
        inside = [t - k for t in times if k < t < k + 1]
        after = mode(k + inside[0]) if inside else sampled[k + 1]
        s = inside[0] if inside else 1
        product = loop.step(sampled[k], age[k], after, s) @ product
    return product, int(total)


def over(loop: Loop, modes, gaps, offset: float) -> tuple[np.ndarray, int]:
    """The loop over a cycle of sojourns in periods, the first `offset` after a sample.

    Returns the product of the steps and how many there are; ages have settled. Two switches within
    a period follow each other in it.
    """
    total = round(sum(gaps))
    begins = itertools.accumulate(map(Fraction, gaps[:-1]), initial=Fraction(0))
    starts = [Fraction(offset) + begin for begin in begins]
    times = [t - total for t in starts] + starts + [t + total for t in starts]
    sequence = list(modes) * 3
    near = [Fraction(round(t)) if abs(t - round(t)) < 1e-9 else t for t in times]

    def mode(t):
        return sequence[sum(time <= t for time in near) - 1]

    sampled = [mode(k) for k in range(2 * total)]
    age, product = ages(sampled), np.eye(loop.order)
    for k in range(total, 2 * total):
        back = k - total
        inside = [t for t in near if back < t < back + 1]
        assert len(inside) < 2
        s, after = (inside[0] - back, mode(inside[0])) if inside else (1, sampled[k])
        product = loop.step(sampled[back], age[k], after, s) @ product
    return product, total


# -- the loop written around its centre ----------------------------------------------------


class Inequalities:
    """K and the small inequalities of a piece of evidence, from their definitions, in floats."""

    def __init__(self, evidence, loop: Loop) -> None:
        self.evidence, self.loop, centre = evidence, loop, evidence.centre
        plant, held, d = loop.plant, loop.held, loop.order
        n, m = plant.n, plant.m
        self.w = n + m * (len(loop.table.state_gain) > 1)
        u = np.zeros((held + 1, m, d + self.w))  # of (ξ, w)
        u[0, :, :d], u[0, :, d + n :] = centre.row, np.eye(m)[:, : self.w - n]
        for j in range(1, held + 1):
            u[j, :, n + (j - 1) * m : n + j * m] = np.eye(m)
        everything = np.eye(d + self.w)
        taps = [u[plant.count], u[plant.count - 1]][: 1 + (plant.phase < plant.h)]
        y = np.concatenate([everything[:n], *taps])
        self.moved = np.concatenate([centre.E @ y + everything[d : d + n], *u[:held]])
        functionals = np.concatenate((centre.R, centre.Psi)) @ everything[:d]
        self.wide, self.y = np.concatenate((y, functionals, everything[d:])), len(y)

    def large(self) -> float:
        """The least eigenvalue of K, scaled to a diagonal of 1."""
        P, d = self.evidence.P, self.loop.order
        K = -self.moved.T @ P @ self.moved / self.evidence.rho**2
        K -= self.wide.T @ self.evidence.Pi @ self.wide
        K[:d, :d] += P
        return least_eigenvalue(K)

    def S(self, mode: int, age: int) -> np.ndarray:
        """S, linear between the knots."""
        knots, S = self.evidence.knots, self.evidence.S[mode]
        flat = [np.interp(age, knots, entry) for entry in S.reshape(len(knots), -1).T]
        return np.array(flat).reshape(S.shape[1:])

    def small(self, mode, age, after, next_age, s=1) -> float:
        """The least eigenvalue of the small inequality of a step, scaled to a diagonal of 1."""
        e, n, v = self.evidence, self.loop.plant.n, len(self.wide) - self.w
        E, centre = self.loop.plant.rows(mode, after, s)[:, : self.y], e.centre
        Delta = np.zeros((self.w, v))
        Delta[:n, : self.y] = E - centre.E
        if self.w > n:
            Delta[n:, : self.y + len(centre.R)] = centre.T[self.loop.row(mode, age)]
        Theta = e.Pi - centre.F.T @ self.S(after, next_age) @ centre.F / e.rho**2
        at = slice(v - len(centre.Psi), v)
        Theta[at, at] += self.S(mode, age)
        tall = np.concatenate((np.eye(v), Delta))
        return least_eigenvalue(tall.T @ Theta @ tall)

    def least(self, parts) -> float:
        """The least of all: of K, and of every step with switches at these parts of their range."""
        setting = self.evidence.setting
        last = max(self.evidence.knots[-1], self.loop.table.ages - 1)
        dwell_time, maximum = setting.signals.dwell_time, longest_of(setting)
        h = self.loop.plant.h
        last = max(last, math.floor(decimal(dwell_time) / h))
        found = [self.large()]
        for step in steps(self.loop.plant.modes, dwell_time, h, last, maximum):
            low, high = instants(step[1], dwell_time, h, maximum)
            at = low + (high - low) * parts if step[0] != step[2] else [1]
            found += [self.small(*step, s) for s in at]
        return min(found)


def longest_of(setting) -> float | None:
    """The longest sojourn in every mode, seconds; None for those without end."""
    longest = setting.signals.maximum_dwell
    return None if math.isinf(longest) else longest


# -- files ---------------------------------------------------------------------------------


def rewritten(path, part: str = "", values=()):
    """Change entries of a certificate's file as an attacker who makes the digest fit again."""
    content = json.loads(path.read_text())
    owner = content
    for key in part.split("."):
        owner = owner[key] if key else owner
    owner.update(values)
    content.pop("sha256")
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    content["sha256"] = hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()
    path.write_text(json.dumps(content))
    return path


def packed(array) -> dict:
    """An array as a certificate's file holds it."""
    array = np.asarray(array, "<f8")
    return {"shape": array.shape, "data": base64.b64encode(array.tobytes()).decode()}
