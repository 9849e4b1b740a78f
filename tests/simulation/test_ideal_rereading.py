"""The ideal loop where a prediction reads again what it has predicted, against its definition.

A sample of input j that is sent at t' is K_i,j x of where it is first read, at the first time that
is t' + D_i,j or later in a mode i. x is marched from there by SciPy's DOP853.
"""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import deadtime as dt
from shares import mostly_long

SAME = 1e-11


class Marched:
    """x from time t on, along believed (start, system) parts, and under what was sent before t."""

    def __init__(self, t, x, parts, system, K, sent, bends):
        self.t, self.parts, self.K, self.sent, self.bends = t, parts, K, sent, bends
        self.A, self.B, self.delays = system
        self.edges, self.pieces, self.x = [t], [], np.array(x, float)

    def first_read(self, sent, j):
        """When, and by which system, what is sent at a time is read first."""
        ends = [start for start, _ in self.parts[1:]] + [np.inf]
        found = []
        for (start, i), end in zip(self.parts, ends, strict=True):
            time = max(start, sent + self.delays[i, j], self.t)
            if time < end - SAME:
                found.append((time, i))
        return min(found)

    def at(self, time):
        if time >= self.edges[-1] - SAME:
            return self.x
        return self.pieces[max(np.searchsorted(self.edges, time, "right") - 1, 0)](time)

    def system(self, time):
        return [i for start, i in self.parts if start <= time + SAME][-1]

    def march(self, end):
        m = self.B.shape[2]
        apart = np.unique(self.delays[:, None] - self.delays)
        apart = apart[apart > SAME]
        while (s := self.edges[-1]) < end - SAME:
            i = self.system(s)
            marks = [[end, s + 0.02, *(s + apart)], [start for start, _ in self.parts]]
            for delay in np.unique(self.delays):
                marks += [self.bends + delay, [self.t + delay]]
                marks += [[start - delay, start + delay] for start, _ in self.parts]
            marks += [np.array(self.edges) + lag for lag in apart]
            marks += [start + lag - self.delays.ravel() for start, _ in self.parts for lag in apart]
            marks += [start + lag for start, _ in self.parts for lag in [apart]]
            marks = np.concatenate([np.ravel(each) for each in marks])
            stop = marks[marks > s + SAME].min()
            own, later = np.zeros(m, bool), {}
            for j in range(m):
                middle = 0.5 * (s + stop) - self.delays[i, j]
                if middle >= self.t:
                    time, reader = self.first_read(middle, j)
                    own[j] = time >= 0.5 * (s + stop) - SAME
                    overdue = time > middle + self.delays[reader, j] + SAME
                    later[j] = (reader, time if overdue else None)

            def slope(time, x, i=i, own=own, later=later):
                v = np.empty(m)
                for j in range(m):
                    then = time - self.delays[i, j]
                    if own[j]:
                        v[j] = self.K[i][j] @ x
                    elif j in later:
                        reader, held = later[j]
                        read = then + self.delays[reader, j] if held is None else held
                        v[j] = self.K[reader][j] @ self.at(read)
                    else:
                        v[j] = self.sent(then)[j]
                return self.A[i] @ x + self.B[i] @ v

            done = solve_ivp(
                slope, (s, stop), self.x, "DOP853", rtol=1e-13, atol=1e-14, dense_output=True
            )
            self.pieces.append(done.sol)
            self.edges.append(stop)
            self.x = done.y[:, -1]
        return self.x

    def feedback(self):
        """What is sent at t."""
        reads = [self.first_read(self.t, j) for j in range(self.B.shape[2])]
        answer = np.empty(len(reads))
        for j in np.argsort([time for time, _ in reads]):
            time, reader = reads[j]
            answer[j] = self.K[reader][j] @ self.march(time)
        return answer


CASES = [
    ([[0.1, 0.5], [0.3, 0.5], [0.2, 0.3]], [0.0, 0.35, 0.85, 1.05], [0, 1, 2, 0]),
    ([[0.1, 0.5], [0.4, 0.5]], [0.0, 0.3, 0.7, 1.0], [0, 1, 0, 1]),
    ([[0.45, 0.6], [0.2, 0.6], [0.4, 0.6]], [0.0, 0.3, 0.35], [0, 1, 2]),
    ([[0.1, 0.2, 0.5], [0.4, 0.3, 0.5]], [0.0, 0.4, 0.9], [0, 1, 0]),
]


def problem(number):
    delays, times, path = CASES[number]
    rng, (modes, m) = np.random.default_rng(number), np.shape(delays)
    n = 1 + number % 2
    A, B = 0.6 * rng.normal(size=(modes, n, n)), rng.normal(size=(modes, n, m))
    plant = dt.SwitchedSystem(A, B, delays)
    K, x0 = 0.5 * rng.normal(size=(modes, m, n)), rng.normal(size=n)
    return plant, K, dt.SwitchingSignal(times, path), x0


@pytest.fixture
def rereadings(monkeypatch):
    """How many predictions read again."""
    import deadtime.simulation.ideal.branch_march as branch_march

    count, own = [0], branch_march.feedback_through_rereading

    def counted(*arguments):
        count[0] += 1
        return own(*arguments)

    monkeypatch.setattr(branch_march, "feedback_through_rereading", counted)
    return count


@pytest.mark.parametrize("number", mostly_long(range(4), 1))
def test_the_oracle_s_loop_is_the_delay_equation_of_its_plant(number, rereadings):
    plant, K, signal, x0 = problem(number)
    law = dt.ExactPredictor(plant, K, allow_unstable=True)
    run = dt.simulate(plant, law, signal, x0, 0.6, step=None)
    assert rereadings[0] > 0
    parts = list(zip(signal.times.tolist(), signal.modes.tolist(), strict=True))
    system = plant.A, plant.B, plant.delays
    none = np.zeros(plant.inputs)
    exact = Marched(0.0, x0, parts, system, K, lambda t: none, np.zeros(1))
    for t in np.linspace(0.05, 0.6, 12):
        x = exact.march(t)
        error = np.abs(run.record.states_at(np.array([t]))[0] - x).max()
        assert error <= 1e-10 * max(1.0, np.abs(x).max())
    assert run.mismatch is not None
    assert np.nanmax(np.abs(run.mismatch)) <= 1e-10 * np.abs(run.inputs).max()


def along(law, run, t):
    """What each branch of a law believes at t: parts, gains and weight."""
    model, mode = law.plant, int(run.signal(np.array([t]))[0])
    if isinstance(law, dt.ExactPredictor):
        times, modes = run.signal.times.tolist(), run.signal.modes.tolist()
        yield list(zip(times, modes, strict=True)), law.gains, 1.0
        return
    until = max(s for s in run.signal.times if s <= t) + law.dwell_time
    for after, weight in enumerate(law.weights):
        parts = [(-9.0, mode), (until, after)] if until > t else [(-9.0, after)]
        yield parts, [law.gains[after]] * model.modes, weight


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "number"),
    mostly_long(
        [*[("oracle", k) for k in range(4)], ("dwelling", 0), ("dwelling", 1), ("dwelling", 3)],
        ("dwelling", 1),
    ),
)
def test_a_law_of_another_model_sends_what_its_predictions_say(name, number, rereadings):
    plant, K, signal, x0 = problem(number)
    model = dt.SwitchedSystem(0.9 * plant.A, 1.1 * plant.B, plant.delays)
    law = dt.ExactPredictor(model, K, allow_unstable=True)
    if name == "dwelling":
        law = dt.AveragedPredictor(model, K, dwell_time=0.2, allow_unstable=True)
    u0 = np.arange(1.0, plant.inputs + 1.0)
    run = dt.simulate(plant, law, signal, x0, 0.5, step=None, u0=u0)
    assert rereadings[0] > 0

    def sent(t):
        return run.record.inputs_at(np.array([t]))[0]

    size = np.abs(run.inputs).max()
    for t in (0.0, 0.13, 0.21, 0.32):
        x, expected = run.record.states_at(np.array([t]))[0], 0.0
        for parts, gains, weight in along(law, run, t):
            system = model.A, model.B, model.delays
            own = Marched(t, x, parts, system, gains, sent, run.record.inputs.edges)
            expected = expected + weight * own.feedback()
        assert np.abs(sent(t) - expected).max() <= 1e-10 * size


def test_delays_that_differ_too_little_are_refused_by_name(monkeypatch):
    import deadtime.simulation.ideal.branch_march as rereading

    monkeypatch.setattr(rereading, "_MOST_PIECES", 3)
    plant, K, signal, x0 = problem(1)
    law = dt.ExactPredictor(plant, K, allow_unstable=True)
    with pytest.raises(dt.ArgumentError, match=r"step must be given: .*reads its own inputs again"):
        dt.simulate(plant, law, signal, x0, 0.6, step=None)
