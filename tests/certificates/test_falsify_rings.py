"""Short rings: modes in turn at about their shortest sojourn, which falsify must not miss."""

import itertools
import math

import numpy as np
import pytest
from scipy.linalg import expm, logm

import deadtime as dt
from shares import mostly_long

STEP = 0.1
TOLERANCE = 1e-5  # of the clock, by default

# -- random loops of three modes -------------------------------------------------------------


def swinging(seed):
    """Three oscillators of different shapes under a weak feedback; dwell of 1.1 to 1.9 periods."""
    rng = np.random.default_rng(1000 + seed)
    dwell_time = float(rng.uniform(0.11, 0.19))
    rate, damping, shape = (rng.uniform(*ends, 3) for ends in ((3, 14), (0.01, 0.1), (0.3, 3)))
    A = [
        [[0.0, w * k], [-w / k, -2.0 * z * w]] for w, z, k in zip(rate, damping, shape, strict=True)
    ]
    B = rng.normal(size=(3, 2, 1))
    plant = dt.SwitchedSystem(A, B, float(rng.uniform(0.1, 0.4)))
    gains = 0.3 * rng.normal(size=(3, 1, 2))
    return plant, dt.DelayedStateFeedback(plant, gains, allow_unstable=True), dwell_time


class Products:
    """The lifted loop of ξ = (x, u_{k−1}, …, u_{k−N}), u = K_i x, by products of exponentials."""

    def __init__(self, plant, law) -> None:
        self.A, self.B, self.K = plant.A, plant.B, law.gains
        self.N = math.ceil(plant.delay / STEP - 1e-9)
        self.phase = plant.delay - (self.N - 1) * STEP
        self.n = self.A.shape[1]
        self.d = self.n + self.N
        self.known = {}

    def piece(self, mode, duration):
        key = mode, round(duration, 12)
        if key not in self.known:
            X = np.zeros((self.n + 1, self.n + 1))
            X[: self.n] = np.hstack((self.A[mode], self.B[mode])) * duration
            self.known[key] = expm(X)[: self.n]
        return self.known[key]

    def period(self, stays):
        """M of a period that goes through (until, mode), the first mode the one at the sample."""
        unit = np.eye(self.d)
        row = np.hstack((self.K[stays[0][1]], np.zeros((1, self.N))))
        at = self.n + self.N - 1
        late, soon = unit[[at]], row if self.N == 1 else unit[[at - 1]]
        x, now = unit[: self.n], 0.0
        for until, mode in stays:
            for end, u in ((min(until, self.phase), late), (until, soon)):
                if end - now > 1e-12:
                    E = self.piece(mode, end - now)
                    x, now = E[:, : self.n] @ x + E[:, self.n :] @ u, end
        return np.vstack((x, row, unit[self.n : self.d - 1]))

    def growth(self, modes, gap, offset, periods):
        """1/s, along modes in turn, each `gap` periods, over a whole number of periods."""
        starts = (offset + gap * np.arange(len(modes))) % periods
        order = np.argsort(starts)
        mode, M = modes[order[-1]], np.eye(self.d)
        events = [(float(starts[i]), modes[i]) for i in order]
        for k in range(periods):
            stays = []
            while events and events[0][0] < k + 1e-9:
                mode = events.pop(0)[1]
            while events and events[0][0] < k + 1 - 1e-9:
                start, after = events.pop(0)
                stays.append(((start - k) * STEP, mode))
                mode = after
            M = self.period([*stays, (STEP, mode)]) @ M
        return math.log(np.abs(np.linalg.eigvals(M)).max()) / (periods * STEP)


def words():
    """Two to four modes in turn, one of each rotation."""
    for size in (2, 3, 4):
        for word in itertools.product(range(3), repeat=size):
            turns = [word[i:] + word[:i] for i in range(size)]
            if word == min(turns) and all(
                a != b for a, b in zip(word, turns[1 % size], strict=True)
            ):
                yield word


def fastest_ring(plant, law, dwell_time, offsets, most):
    """The growth along the fastest of all rings at the least dwell time, up to `most` rounds."""
    products, least = Products(plant, law), dwell_time / STEP * (1.0 - TOLERANCE)
    found = []
    for word, rounds in itertools.product(words(), range(1, most + 1)):
        modes = word * rounds
        periods = math.ceil(len(modes) * least - 1e-9)
        gap = periods / len(modes)
        found += [products.growth(modes, gap, k / offsets, periods) for k in range(offsets)]
    return max(found)


@pytest.mark.parametrize("seed", mostly_long(range(15), 8, 10, 14))
def test_no_ring_at_the_least_dwell_time_grows_a_percent_faster_than_what_is_found(seed):
    plant, law, dwell_time = swinging(seed)
    worst = dt.falsify(plant, law, dwell_time, STEP)
    brute = fastest_ring(plant, law, dwell_time, 4, 4)
    assert worst.growth_rate > brute - 0.01 * abs(brute)
    assert worst.proven == (worst.growth_rate > 0.0)


# -- joint spectral radii ---------------------------------------------------------------------
# What is known of the largest growth of products; in brackets who says so.

GOLDEN = [[[1.0, 1.0], [0.0, 1.0]], [[1.0, 0.0], [1.0, 1.0]]]
STURMIAN = 0.749326546330367557943961948091344672
RADII = {
    "golden": (GOLDEN, 0.5 * (1.0 + math.sqrt(5.0))),
    # [Gripenberg, Linear Algebra Appl. 234 (1996), section 4]: between .6596789 and .6596924
    "Gripenberg": ([[[0.6, 0.0], [0.2, 0.6]], [[0.6, -0.6], [0.0, -0.2]]], 0.6596789),
    # [Parrilo and Jadbabaie, Linear Algebra Appl. 428 (2008), example 5.4]: 8.9149, of A_1 A_3
    "Parrilo and Jadbabaie": (
        [
            [[0, 1, 7, 4], [1, 6, -2, -3], [-1, -1, -2, -6], [3, 0, 9, 1]],
            [[-3, 3, 0, -2], [-2, 1, 4, 9], [4, -3, 1, 1], [1, -5, -1, -2]],
            [[1, 4, 5, 10], [0, 5, 1, -4], [0, -1, 4, 6], [-1, 5, 0, 1]],
        ],
        8.9149,
    ),
    # [Hare, Morris, Sidorov and Theys, Adv. Math. 226 (2011)]: no finite product attains it
    "Hare, Morris, Sidorov and Theys": ([GOLDEN[0], STURMIAN * np.array(GOLDEN[1])], None),
}


def largest(matrices, most=12):
    """The largest growth of products of up to so many matrices: below the joint spectral radius."""
    products, found = [np.eye(len(matrices[0]))], 0.0
    for length in range(1, most + 1):
        products = [np.asarray(M) @ X for X in products for M in matrices]
        found = max(found, np.abs(np.linalg.eigvals(np.array(products))).max() ** (1.0 / length))
    return float(found)


def as_plant(matrices, radius):
    """Modes whose period multiplies by 1.05 M/radius, twice where M has no real logarithm."""
    modes, turn = [], np.array([[0.0, -1.0], [1.0, 0.0]])
    for M in matrices:
        log = logm(1.05 / radius * np.asarray(M, float))
        modes.append(np.kron(log.real, np.eye(2)) + np.kron(log.imag, turn))
        assert np.allclose(expm(modes[-1]), np.kron(1.05 / radius * np.asarray(M), np.eye(2)))
    A = np.array(modes) / STEP
    plant = dt.SwitchedSystem(A, np.ones((*A.shape[:2], 1)), STEP)
    none = np.zeros((len(A), 1, A.shape[1]))
    return plant, dt.AveragedPredictor(plant, none, allow_unstable=True)


@pytest.mark.parametrize("name", RADII)
def test_joint_spectral_radii_of_the_literature_scaled_above_one_are_refuted(name):
    matrices, radius = RADII[name]
    short = largest(matrices, 6 if len(matrices) > 2 else 12)
    radius = short if radius is None else radius
    assert (1.0 - 5e-4) * radius < short < (1.0 + 1e-5) * radius  # both as printed
    worst = dt.falsify(*as_plant(matrices, radius), STEP, STEP)
    assert worst.proven
    assert worst.growth_rate * STEP > 0.98 * math.log(1.05)
