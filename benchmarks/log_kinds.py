"""Kinds of logs, assumptions kept and broken: does `dt.identify` miss the delay without a word?

    python benchmarks/log_kinds.py --draws 16 --kind "actuator lag 20 ms" "PI loop"

Logs are simulated here on a grid of 1/50 of a period, with matrix exponentials and noise of Van
Loan's form, and with no code of the package. Unless a kind says otherwise: 600 rows, a period of
50 ms, x″ = −2 x − x′ + u with both states logged, process noise of 0.03 √h a sample, an input that
is drawn anew every few rows, and a delay of 0.28 to 0.44 s looked for up to 2 s.

Of each kind: refused; the share of logs in which every delay lies inside its 95 % interval; misses
that come with a warning (a delay not found, a doubt, residuals that are not chance); silent ones,
without; good logs with a warning; the median error and width of the interval, in periods.
"""

import argparse
import time
from concurrent.futures import ProcessPoolExecutor
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.linalg import expm

import deadtime as dt

FINE = 50  # simulated steps of a sampling period
SLOW, FAST, THIRD = (
    [[0.0, 1.0], [-2.0, -1.0]],
    [[0.0, 1.0], [-3.0, -0.5]],
    [[0.0, 1.0], [-1.0, -1.5]],
)
PUSH = [[0.0], [1.0]]


class Made(NamedTuple):
    """A log or several, the delays (modes, m) in seconds, and options of `identify`."""

    log: Any
    delays: np.ndarray
    options: dict


class Plant:
    """dx/dt = A_i x + B_i v(t − D_i) + c + white noise of intensity s² I, on the fine grid."""

    def __init__(self, A, B, delays, h, s=0.0, constant=None):
        self.A, self.B, self.h, self.fine = np.array(A, float), np.array(B, float), h, h / FINE
        modes, n, m = self.B.shape
        delays = np.broadcast_to(np.asarray(delays, float), (modes, m))
        self.late = np.round(delays / self.fine).astype(int)
        self.delays = self.late * self.fine
        c = np.zeros(n) if constant is None else np.asarray(constant, float)
        self.maps = []
        for A_i, B_i in zip(self.A, self.B, strict=True):
            E = expm(self.fine * np.block([[A_i, B_i, c[:, None]], [np.zeros((m + 1, n + m + 1))]]))
            van_loan = np.block([[-A_i, s**2 * np.eye(n)], [np.zeros((n, n)), A_i.T]])
            V = expm(self.fine * van_loan)
            Q = V[n:, n:].T @ V[:n, n:]
            root = np.linalg.cholesky(Q + 1e-300 * np.eye(n)) if s else None
            self.maps.append((E[:n, :n], E[:n, n : n + m], E[:n, -1], root))

    def run(
        self, rows, rng, command, mode=None, actuator=None, sensor=0.0, load=None, late=None,
        stride=None,
    ):  # fmt: skip
        """States as measured, (rows, n), and commands, (rows, m).

        command : of a row and the measurement in it; actuator : of a fine step and the command,
        what acts; load : of a fine step, added to what acts; late : of a fine step, steps that
        the delay is longer; stride : fine steps from row to row, if rows are uneven
        """
        n, m = self.B.shape[1:]
        mode = np.zeros(rows, int) if mode is None else mode
        x, y, u = np.zeros(n), np.zeros((rows, n)), np.zeros((rows, m))
        first = np.concatenate(([0], np.cumsum(np.full(rows, FINE) if stride is None else stride)))
        acting = np.zeros((first[-1], m))
        for k in range(rows):
            y[k] = x + sensor * rng.standard_normal(n)
            u[k] = command(k, y[k])
            Phi, Gamma, constant, root = self.maps[mode[k]]
            for i in range(first[k], first[k + 1]):
                acting[i] = u[k] if actuator is None else actuator(i, u[k])
                if load is not None:
                    acting[i] += load(i)
                at = i - self.late[mode[k]] - (0 if late is None else late(i))
                v = np.where(at >= 0, acting[np.maximum(at, 0), np.arange(m)], 0.0)
                x = Phi @ x + Gamma @ v + constant
                if root is not None:
                    x = x + root @ rng.standard_normal(n)
        return y, u


def drawn_delay(rng):
    return rng.uniform(0.28, 0.44)


def levels(rows, rng, m=1, least=3, most=12):
    """Inputs of drawn sizes, each for a few rows."""
    u = np.zeros((rows, m))
    for j in range(m):
        k = 0
        while k < rows:
            stay = rng.integers(least, most + 1)
            u[k : k + stay, j] = rng.standard_normal()
            k += stay
    return u


def stays(rows, rng, modes, least=15, most=50):
    mode, k = np.zeros(rows, int), 0
    while k < rows:
        stay = rng.integers(least, most)
        others = [i for i in range(modes) if k == 0 or i != mode[k - 1]]
        mode[k : k + stay] = rng.choice(others)
        k += stay
    return mode


def table(h, y, u, mode=None, letter="x", t=None):
    columns = {"t": h * np.arange(len(y)) if t is None else t}
    columns |= {f"{letter}{a + 1}": y[:, a] for a in range(y.shape[1])}
    columns |= {f"u{j + 1}": u[:, j] for j in range(u.shape[1])}
    return pd.DataFrame(columns | ({} if mode is None else {"mode": mode}))


def usual(
    rng, *, A=(SLOW,), B=(PUSH,), D=None, h=0.05, rows=600, s=0.03, sensor=0.0, u=None,
    command=None, moded=None, before=None, after=None, letter="x", keep=None, constant=None,
    options=None, **run,
):  # fmt: skip
    """A log of the usual plant with some differences.

    before, after : make the actuator from the plant, and the log another one
    """
    D = drawn_delay(rng) if D is None else D
    plant = Plant(A, B, D, h, s, constant)
    mode = stays(rows, rng, len(A)) if len(A) > 1 else None
    if u is None:
        u = levels(rows, rng, plant.B.shape[2])
    if before is not None:
        run["actuator"] = before(plant)
    y, sent = plant.run(rows, rng, command or (lambda k, _: u[k]), mode, sensor=sensor, **run)
    log = table(h, y if keep is None else y[:, :keep], sent, mode, letter)
    if moded is not None:
        log["mode"] = moded(mode)
    log = log if after is None else after(log)
    own = {} if mode is not None else {"modes": None}
    return Made(log, plant.delays, own | (options or {}))


def lag(constant):
    """An actuator that follows with a time constant, seconds."""

    def of(plant):
        state, share = [np.zeros(plant.B.shape[2])], 1.0 - np.exp(-plant.fine / constant)

        def actuator(_, command):
            before = state[0]
            state[0] = before + share * (command - before)
            return before

        return actuator

    return of


def rate_limit(rate):
    def of(plant):
        state = [np.zeros(plant.B.shape[2])]

        def actuator(_, command):
            state[0] = state[0] + np.clip(command - state[0], -rate * plant.fine, rate * plant.fine)
            return state[0]

        return actuator

    return of


def backlash(gap):
    def of(plant):
        state = [np.zeros(plant.B.shape[2])]

        def actuator(_, command):
            state[0] = np.clip(state[0], command - gap, command + gap)
            return state[0]

        return actuator

    return of


def static(shape):
    return lambda _: lambda _, command: shape(command)


def deadband(u, width=0.4):
    return np.sign(u) * np.maximum(np.abs(u) - width, 0.0)


def analog(rng, rows, h):
    """A sum of sines, sampled for the log, that acts as it is."""
    w, phase = rng.uniform(0.5, 8.0, 12), rng.uniform(0.0, 2.0 * np.pi, 12)

    def value(t):
        return 0.4 * np.sin(np.multiply.outer(t, w) + phase).sum(axis=-1)

    def before(plant):
        return lambda i, _: np.array([value((i + 0.5) * plant.fine)])

    return {"u": value(h * np.arange(rows))[:, None], "before": before}


def coloured(rng, rows, size, corner):
    """An Ornstein–Uhlenbeck load on the fine grid; corner: fine steps of its time constant."""
    load, value, keep = np.zeros(rows * FINE), 0.0, np.exp(-1.0 / corner)
    for i in range(load.size):
        value = keep * value + size * np.sqrt(1.0 - keep**2) * rng.standard_normal()
        load[i] = value
    return lambda i: load[i]


def loop(rng, rows, gain, dither=0.0, setpoint=None, integral=0.0, derivative=None, h=0.05):
    """u = −gain (x₁ − r) − integral ∫(x₁ − r) − derivative x₂ + dither."""
    r = np.zeros(rows) if setpoint is None else setpoint
    extra, total = dither * levels(rows, rng)[:, 0], [0.0]

    def command(k, y):
        error = y[0] - r[k]
        total[0] += h * error
        u = -gain * error - integral * total[0] + extra[k]
        return np.array([u - (derivative * y[1] if derivative else 0.0)])

    return command


FIRST = {"A": ([[-1.0]],), "B": ([[1.0]],)}


def fopdt(rng, after=None, moves=6, noise=0.02, level=0.0, **others):
    """K = 2, 60 s, 12 s in rows of 1 s: noise of the sensor alone."""
    rows, h = 600, 1.0
    edges = np.sort(rng.choice(np.arange(30, rows - 60), moves, replace=False))
    u = level + 10.0 * np.repeat(
        rng.standard_normal(moves + 1) * (np.arange(moves + 1) > 0),
        np.diff(np.concatenate(([0], edges, [rows]))),
    )
    given = {"A": ([[-1.0 / 60.0]],), "B": ([[2.0 / 60.0]],), "D": rng.uniform(10.0, 14.0)}
    given |= {"u": (u - level)[:, None], "s": 0.0, "sensor": noise * 10.0, "h": h}

    def about(log):
        log["u1"] += level
        return log if after is None else after(log)

    return usual(rng, **given, after=about, options={"delay": (0.0, 30.0)}, **others)


def setpoints(rng, rows):
    return levels(rows, rng, least=60, most=120)[:, 0]


def rounded(column, step):
    return lambda log: log.assign(**{column: np.round(log[column] / step) * step})


def bits(count):
    def after(log):
        for name in ("x1", "x2"):
            step = 1.2 * np.ptp(log[name]) / 2**count
            log[name] = np.round(log[name] / step) * step
        return log

    return after


def moved(column, rows):
    """A column written some rows late."""
    return lambda log: log.assign(**{column: log[column].shift(rows).bfill()})


def jittered(rng, stamps):
    """Even rows with wrong stamps; or rows at other times than their stamps say."""

    def after(log):
        h = log["t"][1]
        t = log["t"] + h * 0.1 * np.concatenate(([0.0], rng.uniform(-1, 1, len(log) - 1)))
        if stamps:
            return log.assign(t=t)
        return log.assign(**{x: np.interp(t, log["t"], log[x]) for x in ("x1", "x2")})

    return after


def filtered(log, constant=0.1):
    keep = np.exp(-log["t"][1] / constant)
    for name in ("x1", "x2"):
        values = log[name].to_numpy().copy()
        for k in range(1, values.size):
            values[k] = keep * values[k - 1] + (1.0 - keep) * values[k]
        log[name] = values
    return log


def repeated(log, rows=3):
    own = (np.arange(len(log)) // rows) * rows
    return log.assign(**{x: log[x].to_numpy()[own] for x in ("x1", "x2")})


def lost(rng, share):
    def after(log):
        keep = rng.random(len(log)) >= share
        keep[:2] = True
        return log[keep].reset_index(drop=True)

    return after


def uneven(rng):
    stride = rng.integers(35, 66, 600)  # fine steps of each row: 0.7 to 1.3 periods
    t = 0.05 / FINE * np.concatenate(([0], np.cumsum(stride)))[:-1]
    return usual(rng, stride=stride, after=lambda log: log.assign(t=t))


def relay(rng):
    """A relay with hysteresis on x₁ about a level."""
    sign = [1.0]

    def command(_, y):
        if abs(y[0]) > 0.05:
            sign[0] = -np.sign(y[0])
        return np.array([sign[0]])

    return usual(rng, command=command)


def sine(rng):
    t = 0.05 * np.arange(600)
    return usual(rng, u=np.sin(2.3 * t)[:, None])


def modes_apart(rng, apart, **options):
    D = drawn_delay(rng)
    return usual(rng, A=(SLOW, FAST), B=(PUSH, PUSH), D=[[D], [D + apart]], options=options)


def outputs(rng, **others):
    return usual(rng, sensor=0.005, keep=1, letter="y", options={"order": 2}, **others)


def two_logs(rng):
    D = drawn_delay(rng)
    first, second = (usual(rng, D=D, rows=300) for _ in range(2))
    return Made([first.log, second.log], first.delays, first.options)


def wandering(rng):
    """A delay that wanders by ±2 periods."""
    return usual(rng, late=lambda i: round(2 * FINE * np.sin(2 * np.pi * i / (300 * FINE))))


def drifting(rng):
    path = 0.02 * np.cumsum(np.random.default_rng(rng.integers(1 << 30)).standard_normal(600))
    return usual(rng, sensor=0.01, after=lambda log: log.assign(x1=log["x1"] + path))


def outliers(rng):
    def after(log):
        at = rng.choice(len(log), 6, replace=False)
        log.loc[at, "x1"] += rng.choice([-1.0, 1.0], 6) * 2.0
        return log

    return usual(rng, sensor=0.01, after=after)


def student(rng):
    def after(log):
        return log.assign(**{x: log[x] + 0.01 * rng.standard_t(3, len(log)) for x in ("x1", "x2")})

    return usual(rng, after=after)


# Assumptions hold; a user gives the options that the documentation asks for.
KEPT = {
    "base": usual,
    "noisy sensors": lambda r: usual(r, sensor=0.02),
    "two modes": lambda r: usual(r, A=(SLOW, FAST), B=(PUSH, [[0.0], [1.2]])),
    "three modes": lambda r: usual(r, A=(SLOW, FAST, THIRD), B=(PUSH,) * 3),
    "hidden modes": lambda r: usual(
        r, A=(SLOW, [[0.0, 1.0], [-6.0, -0.5]]), B=(PUSH, [[0.0], [1.2]]), rows=1000,
        after=lambda log: log.drop(columns="mode"), options={"modes": 2},
    ),
    "delay per mode": lambda r: modes_apart(r, 0.13, per_mode=True),
    "two inputs": lambda r: usual(
        r, B=([[0.2, 1.0], [1.0, -0.5]],), D=[r.uniform(0.28, 0.44), r.uniform(0.1, 0.25)]
    ),
    "uneven rows": uneven,
    "P loop with set-point steps": lambda r: usual(
        r, **FIRST, command=loop(r, 600, 1.5, setpoint=setpoints(r, 600)), sensor=0.01
    ),
    "unstable with dither": lambda r: usual(
        r, A=([[0.5]],), B=([[1.0]],), D=r.uniform(0.18, 0.28), command=loop(r, 600, 1.2, 0.5)
    ),
    "integrator": lambda r: usual(r, A=([[0.0]],), B=([[1.0]],)),
    "double integrator": lambda r: usual(r, A=([[0.0, 1.0], [0.0, 0.0]],)),
    "delay 0": lambda r: usual(r, D=0.0),
    "delay of 6 periods": lambda r: usual(r, D=0.3),
    "delay 1.5 s, settling .3 s": lambda r: usual(
        r, A=([[-10.0]],), B=([[10.0]],), D=r.uniform(1.4, 1.6)
    ),
    "steps only": lambda r: usual(r, u=levels(600, r, least=80, most=120), sensor=0.01),
    "one step": lambda r: usual(r, u=(np.arange(600) >= 60)[:, None] * 1.0, sensor=0.005, s=0.005),
    "Student's t noise": student,
    "8 bit": lambda r: usual(r, after=bits(8)),
    "12 bit": lambda r: usual(r, after=bits(12)),
    "stiff": lambda r: usual(
        r, A=([[-0.5, 0.0], [1.0, -400.0]],), B=([[1.0], [0.0]],), options={"noise": None}
    ),
    "10 % of rows lost": lambda r: usual(r, after=lost(r, 0.1)),
    "P loop in regulation, noisy": lambda r: usual(
        r, **FIRST, command=loop(r, 600, 1.5), sensor=0.02, s=0.1
    ),
    "PD loop in regulation": lambda r: usual(
        r, command=loop(r, 600, 1.0, derivative=0.6), sensor=0.02, s=0.1
    ),
    "PI loop in regulation": lambda r: usual(
        r, **FIRST, command=loop(r, 600, 0.8, integral=0.6), sensor=0.02, s=0.1
    ),
    "FOPDT": fopdt,
    "FOPDT, u about 50": lambda r: fopdt(r, level=50.0),
    "FOPDT, sensor about 20": lambda r: fopdt(r, lambda log: log.assign(x1=log["x1"] + 20.0)),
    "FOPDT, one step": lambda r: fopdt(r, moves=1),
    "position alone": outputs,
    "two logs": two_logs,
    "relay": relay,
    "sine only": sine,
    "coarse rows": lambda r: usual(r, h=0.5, D=r.uniform(0.6, 1.4)),
    "constant load": lambda r: usual(r, constant=[0.0, 0.7]),
    "about levels": lambda r: usual(
        r, u=levels(600, r), after=lambda log: log.assign(x1=log["x1"] + 31, u1=log["u1"] + 45)
    ),
}  # fmt: skip
BROKEN = {
    "input not held": lambda r: usual(r, **analog(r, 600, 0.05)),
    "modes' delays 10 ms apart": lambda r: modes_apart(r, 0.01),
    "modes' delays .2 s apart": lambda r: modes_apart(r, 0.2),
    "actuator lag 20 ms": lambda r: usual(r, before=lag(0.02)),
    "actuator lag 100 ms": lambda r: usual(r, before=lag(0.1)),
    "actuator lag 80 ms, position": lambda r: outputs(r, before=lag(0.08)),
    "rate limit": lambda r: usual(r, before=rate_limit(6.0)),
    "backlash": lambda r: usual(r, before=backlash(0.3)),
    "saturation": lambda r: usual(r, before=static(lambda u: np.clip(u, -0.8, 0.8))),
    "deadband": lambda r: usual(r, before=static(deadband)),
    "tanh(u)": lambda r: usual(r, before=static(np.tanh)),
    "stamps rounded to 10 ms": lambda r: usual(r, h=1.0 / 30.0, after=rounded("t", 0.01)),
    "stamps jittered 10 %": lambda r: usual(r, after=jittered(r, True)),
    "rows jittered 10 %": lambda r: usual(r, after=jittered(r, False)),
    "coloured load": lambda r: usual(r, load=coloured(r, 600, 0.3, 10 * FINE)),
    "unlogged input": lambda r: usual(
        r, load=(lambda other: lambda i: 0.5 * other[i // FINE, 0])(levels(600, r, 1, 20, 60))
    ),
    "u a row late": lambda r: usual(r, after=moved("u1", 1)),
    "mode 1 row late": lambda r: usual(r, A=(SLOW, FAST), B=(PUSH,) * 2, after=moved("mode", 1)),
    "mode 5 rows late": lambda r: usual(r, A=(SLOW, FAST), B=(PUSH,) * 2, after=moved("mode", 5)),
    "x1 a row late": lambda r: usual(r, after=moved("x1", 1)),
    "sensor filter 100 ms": lambda r: usual(r, after=filtered),
    "sensor held for 3 rows": lambda r: usual(r, after=repeated),
    "delay beyond the range": lambda r: usual(r, D=r.uniform(2.1, 3.0)),
    "drift": drifting,
    "wandering delay": wandering,
    "outliers": outliers,
    "a level that moves": lambda r: usual(
        r, after=lambda log: log.assign(x1=log["x1"] + 3.0 * (np.arange(len(log)) > 250))
    ),
}
KINDS = KEPT | BROKEN


class Outcome(NamedTuple):
    refused: str
    inside: bool
    warned: bool
    error: float
    width: float
    seconds: float
    text: str


def outcome(kind, seed):
    """Identify one log of a kind."""
    made = KINDS[kind](np.random.default_rng([seed, *kind.encode()]))
    began = time.perf_counter()
    try:
        fit = dt.identify(made.log, **made.options)
    except dt.ArgumentError as error:
        return Outcome(str(error), False, True, np.nan, np.nan, time.perf_counter() - began, "")
    seconds, truth = time.perf_counter() - began, made.delays
    low, high = fit.delay_interval[..., 0], fit.delay_interval[..., 1]
    modes, least = min(len(low), len(truth)), 1e-5 * fit.step  # a delay of 0 counts as 0
    inside = (
        (low[:modes] <= truth[:modes] + least) & (truth[:modes] - least <= high[:modes])
    ).all()
    warned = bool(fit.delays_not_found or fit.doubts)
    warned |= not (fit.tests.white and fit.tests.unrelated)
    error = float((fit.delays[:modes] - truth[:modes])[0, 0] / fit.step)
    width = float((high - low)[0, 0] / fit.step)
    return Outcome("", bool(inside), warned, error, width, seconds, fit.message)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=8)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--kind", nargs="+", choices=KINDS, default=KINDS, metavar="KIND")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--each", action="store_true", help="print silent misses and refusals")
    given = parser.parse_args()
    print("| kind | logs | refused | inside | missed, warned | silent | inside, warned |", end="")
    print(" error | width | s |\n|---|---|---|---|---|---|---|---|---|---|")
    seeds = range(given.first, given.first + given.draws)
    with ProcessPoolExecutor(given.workers) as pool:
        pending = {kind: [pool.submit(outcome, kind, s) for s in seeds] for kind in given.kind}
        for kind, tasks in pending.items():
            every = [task.result() for task in tasks]
            fits = [one for one in every if not one.refused]
            missed = [one for one in fits if not one.inside]
            silent = [one for one in missed if not one.warned]
            good = sum(one.inside and one.warned for one in fits)
            error, width = (
                np.median([getattr(one, name) for one in fits]) if fits else np.nan
                for name in ("error", "width")
            )
            name = kind if kind in KEPT else f"*{kind}*"
            print(
                f"| {name} | {len(every)} | {len(every) - len(fits)} | "
                f"{len(fits) - len(missed)} | {len(missed) - len(silent)} | {len(silent)} | "
                f"{good} | {error:+.3f} | {width:.3f} | "
                f"{np.median([one.seconds for one in every]):.1f} |",
                flush=True,
            )
            if given.each:
                for one in every:
                    if one.refused or one in silent:
                        print(f"    {one.error:+.3f} {one.refused or one.text}"[:600], flush=True)


if __name__ == "__main__":
    main()
