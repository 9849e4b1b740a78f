"""M(s)ᵀ V₊ M(s) ≤ ρ² V at sampled instants, from certificates' files alone, in floats.

Nothing here is a proof, and nothing is shared with one: matrices come from SciPy's exponential,
the steps that may follow each other from the instants of the switches.
"""

import itertools
import json
from types import SimpleNamespace

import numpy as np
import pytest

import certificate_forgeries as forgeries
import certificate_reference as reference
import deadtime as dt
import delayed_loops
from certificate_corpus import CORPUS

# Of modes that are told at once; of late ones runs are tried (tests/certificates/test_mode_lag.py).
FILES = sorted(
    path.stem for path in CORPUS.glob("*.json") if "mode_lag" not in path.read_text("utf-8")
)


class Sampled:
    """A file's loops, at points of its ranges, and its V at every age."""

    def __init__(self, content, rng) -> None:
        self.law, self.signals = content["law"], content["signals"]
        V, plant = content["lyapunov"], content["plant"]
        self.at_samples = self.signals.get("at") == "samples"
        self.knots, self.linear = V["knots"], V["kind"] == "linear"
        self.rho, self.mu = content["rho"], V.get("mu")
        self.P = forgeries.unpacked(V["P"])
        if self.linear:
            self.Psi, self.S = (forgeries.unpacked(V[name]) for name in ("Psi", "S"))
        F, G = (forgeries.unpacked(self.law[name]) for name in "FG")
        table = SimpleNamespace(state_gain=F, input_gain=G, taps=G.shape[1], **self.law)
        A, B = (np.array(plant[name]) for name in "AB")
        weights = [*np.eye(len(A)), *rng.dirichlet(np.ones(len(A)), 2 * (len(A) > 1))]
        self.modes, self.travels = A.shape[1], F.any() or G.any()
        plants = [tuple(np.tensordot(w, X, 1) for X in (A, B)) for w in weights]
        if isinstance(plant["delays"][0], list):
            own = np.array(plant["delays"])
            if own.ndim == 3:  # a range each: its ends and two points of the box
                low, high = own[0] + 1e-9 * (own[0] < own[1]), own[1]
                own = [low, high, *rng.uniform(low, high, (2, *low.shape))]
            else:
                own = [own]
            self.loops = [
                delayed_loops.Loop(dt.SwitchedSystem(*pair, delays), table)
                for pair, delays in itertools.product(plants, own)
            ]
            return
        low, high = plant["delays"]
        delays = {low + 1e-9 * (low < high), high, *rng.uniform(low, high, 2 * (low < high))}
        self.loops = [
            reference.Loop(*pair, float(D), table) for pair, D in itertools.product(plants, delays)
        ]

    def V(self, mode, age):
        if not self.linear:
            return self.P[mode][self.knots.index(age)]
        S = self.S[mode]
        flat = [np.interp(age, self.knots, x) for x in S.reshape(len(self.knots), -1).T]
        return self.P + self.Psi.T @ np.reshape(flat, S.shape[1:]) @ self.Psi

    def step(self, loop, *arguments):
        M = loop.step(*arguments)
        return M if self.travels else M[: loop.plant.n, : loop.plant.n]

    def times(self, mode):
        """The shortest and the longest sojourn in a mode, seconds; None where none is longest."""
        both = (self.signals[name] for name in ("dwell_time", "maximum_dwell"))
        return [one[mode] if isinstance(one, list) else one for one in both]

    def after(self, mode):
        """The modes that may follow one."""
        ways = self.signals.get("transitions")
        return [j for j in range(self.modes) if j != mode and (ways is None or ways[mode][j])]

    def instants(self, mode, age, count, rng):
        """Fractions of a period at which the mode may be left, the ends among them."""
        if self.at_samples:
            return [1.0]
        h, (shortest, longest) = self.law["step"], self.times(mode)
        low, high, tolerance = 0.0, 1.0, self.signals["clock_tolerance"]
        if self.signals["chatter"] == 1:
            low = max(0.0, (1.0 - tolerance) * shortest / h - age - 1)
            if longest is not None:
                high = min(1.0, (1.0 + tolerance) * longest / h - age)
        low = min(low + 1e-12, 1.0)
        return [low, high, *rng.uniform(low, high, count)] if low <= high else []

    def ages(self, mode):
        """The shortest sojourn in periods, rounded down, and the last age that is told apart."""
        h, (shortest, longest) = self.law["step"], self.times(mode)
        tolerance = self.signals["clock_tolerance"]
        least = int(shortest / h * (1.0 - tolerance))
        if self.signals["chatter"] > 1:
            return least, max(least, self.knots[-1])
        if self.at_samples:
            least = max(1, int(np.ceil(shortest / h * (1.0 - tolerance))))
            own = max(least, self.law["ages"] + self.law.get("lost_samples", 0))
            return least, (own if longest is None else int(longest / h * (1.0 + tolerance))) - 1
        if longest is not None:
            return least, int(np.ceil(longest / h * (1.0 + tolerance))) - 1
        if not self.linear:
            return least, self.knots[-1]
        return least, max(self.knots[-1], self.law["ages"], least) + 1

    def walks(self, count, rng):
        """(before, after, M, periods): steps, or for few knots the stretches between them."""
        if self.mu is not None:
            yield from self.jumps(count, rng)
            return
        once = self.signals["chatter"] == 1
        first = self.knots[0] if not self.linear else 0
        starts = [(i, a) for i in range(self.modes) for a in range(self.ages(i)[1] + 1)]
        for loop, (i, start) in itertools.product(self.loops, starts):
            if not self.linear and start not in self.knots:
                continue
            (least, last), longest = self.ages(i), self.times(i)[1]
            M = np.eye(loop.order if self.travels else loop.plant.n)
            for age in range(start, last + 1):
                for j in self.after(i):
                    if age + 1 < least:
                        continue
                    after = first if once else age + 1 - least
                    for s in self.instants(i, age, count, rng):
                        X = self.step(loop, i, age, j, s) @ M
                        for a in range(first):
                            X = self.step(loop, j, a) @ X
                        yield (i, start), (j, after), X, age - start + 1 + first
                if longest is not None and age == last:
                    break
                M = self.step(loop, i, age) @ M
                following = min(age + 1, last)
                if self.linear or following in self.knots:
                    yield (i, start), (i, following), M, age - start + 1
                    break

    def jumps(self, count, rng):
        """Steps of one V per mode, with what it may rise by at a switch taken from the matrix."""
        per_switch = self.signals["dwell_time"] * (1.0 - self.signals["clock_tolerance"])
        lasting = self.mu ** (0.5 * self.law["step"] / per_switch)
        for loop, i, age in itertools.product(
            self.loops, range(self.modes), range(self.law["ages"])
        ):
            yield (i, 0), (i, 0), self.step(loop, i, age) * lasting, 1
            for j, s in itertools.product(self.after(i), self.instants(i, age, count, rng)):
                M = self.step(loop, i, age, j, s) * lasting / self.mu**0.5
                yield (i, 0), (j, 0), M, 1

    def least(self, count=1, seed=0):
        """The least eigenvalue of V − MᵀV₊M/ρ^(2L) along them all, scaled to a diagonal of 1."""
        rng, found = np.random.default_rng(seed), []
        for before, after, M, periods in self.walks(count, rng):
            V = self.V(*before)
            change = M.T @ self.V(*after) @ M / self.rho ** (2 * periods)
            found += [reference.least_eigenvalue(V), reference.least_eigenvalue(V - change)]
        return min(found)


@pytest.mark.few(11)
@pytest.mark.parametrize("name", FILES)
def test_the_inequality_of_every_step_holds_at_sampled_instants(name):
    content = json.loads((CORPUS / f"{name}.json").read_text(encoding="utf-8"))
    assert Sampled(content, np.random.default_rng(1)).least() > 0.0


@pytest.mark.parametrize(
    "forgery",
    [
        ("every-age", forgeries.put("signals.dwell_time", 0.41)),
        ("stretches-every-age", forgeries.put("signals.clock_tolerance", 0.5)),
        ("paper-far", forgeries.put("signals.clock_tolerance", 0.4)),
        ("rate", forgeries.put("rho", lambda rho: 0.97 * rho)),
        ("stretches-maximum-free", forgeries.put("signals.maximum_dwell", 6.0)),
        ("paper-far", forgeries.entries("law.F", forgeries.scaled((0, 0, 0), 1.02))),
        ("range", forgeries.put("rho", lambda rho: 0.97 * rho)),
        ("average-turning", forgeries.put("lyapunov.mu", lambda mu: 0.5 * mu)),
        ("average-turning", forgeries.put("signals.dwell_time", 4.0)),
        ("ways", forgeries.put("signals.dwell_time", [0.3, 0.31, 0.3])),
        ("samples-turning", forgeries.without_inside("signals.at")),
        ("samples-ring", forgeries.put("signals.maximum_dwell", [9.0, None, 1.2])),
        *(
            (name, forgeries.put("signals.transitions", forgeries.FREER))
            for name in ("ways", "ways-ring", "stretches-ways")
        ),
    ],
)
def test_it_is_violated_by_false_claims(forgery):
    content = json.loads(forgeries.forged(forgery))
    assert Sampled(content, np.random.default_rng(1)).least() < 0.0
