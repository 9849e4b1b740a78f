"""What goes round a loop: python-control, dense matrices by definition, and other margins."""

import control
import numpy as np
import pytest
from scipy.linalg import expm

import deadtime as dt
from deadtime.controller import law_to_control, plant_to_control
from deadtime.margins.loop_view import loop_view
from deadtime.reports import plot_loop

H = 0.1


def random_plant(seed, delay, modes=2):
    rng = np.random.default_rng(seed)
    n, m = int(rng.integers(2, 5)), 2
    A = rng.normal(size=(modes, n, n)) / np.sqrt(n)
    return dt.SwitchedSystem(A, rng.normal(size=(modes, n, m)), delay(rng, modes, m))


def fractional(rng, modes, m):
    return rng.uniform(0.05, 0.45, (modes, m))


def law_of(plant, make=dt.AveragedPredictor):
    return make(plant, dt.lqr(plant, np.eye(plant.states), np.eye(plant.inputs)))


def closed_by_definition(plant, law, mode, z):
    """d → v = u + d at the plant's input, from exponentials over the two parts of a period."""
    A, B, D = plant.A[mode], plant.B[mode], plant.delays[mode]
    table = law.digital(H)
    row = table.row(mode, table.ages, 0)
    F, G = table.state_gain[row], table.input_gain[row]
    n, m = B.shape
    W = max(len(G), int(np.ceil(D.max() / H)))
    M, E = np.zeros((n + W * m, n + W * m)), np.zeros((n + W * m, m))
    M[:n, :n] = expm(A * H)
    for j in range(m):
        N = int(np.ceil(D[j] / H - 1e-9))
        late = H - (D[j] - (N - 1) * H)  # for so long, at the end, the newer one acts
        block = np.zeros((n + 1, n + 1))
        block[:n, :n], block[:n, n] = A, B[:, j]
        newer, whole = expm(block * late)[:n, n], expm(block * H)[:n, n]
        M[:n, n + (N - 1) * m + j] += whole - newer
        if N == 1:
            E[:n, j] += newer
        else:
            M[:n, n + (N - 2) * m + j] += newer
    # v_k = u_k + d_k enters the line; the law remembers u_k, which is v_k − d_k: two lines.
    law_line = np.zeros((W * m, W * m))
    law_line[m:, :-m] = np.eye((W - 1) * m)
    size = n + 2 * W * m
    T, R, C = np.zeros((size, size)), np.zeros((size, m)), np.zeros((m, size))
    T[: n + W * m, : n + W * m] = M
    T[n + m : n + W * m, n : n + (W - 1) * m] = np.eye((W - 1) * m)
    T[n + W * m :, n + W * m :] = law_line
    C[:, :n] = F
    C[:, n + W * m : n + W * m + len(G) * m] = np.hstack(list(G))
    into_plant = E.copy()
    into_plant[n : n + m] = np.eye(m)
    R[: n + W * m] = into_plant
    T[: n + W * m] += into_plant @ C
    T[n + W * m : n + W * m + m] += C
    return np.stack([np.eye(m) + C @ np.linalg.solve(at * np.eye(size) - T, R) for at in z])


@pytest.mark.parametrize("seed", range(20))
def test_undelayed_feedback_is_python_control_s_loop(seed):
    plant = random_plant(seed, lambda rng, modes, m: H)
    law = law_of(plant, dt.DelayedStateFeedback)
    K, n, omega = law.gains[1], plant.states, np.geomspace(0.1, np.pi / H, 40)
    system = control.ss(plant.A[1], plant.B[1], np.eye(n), np.zeros((n, 2)))
    sampled = control.sample_system(system, H, "zoh")
    hold = control.ss(np.zeros((2, 2)), np.eye(2), np.eye(2), np.zeros((2, 2)), H)
    for at, expected in (("input", -K * (sampled * hold)), ("output", -((sampled * hold) * K))):
        found = dt.loop_transfer(plant, law, 1, H, at, frequencies=omega)
        there = control.frequency_response(expected, omega).frdata
        assert np.abs(found.frdata - there).max() <= 1e-10 * np.abs(there).max()


@pytest.mark.parametrize("make", [dt.AveragedPredictor, dt.DelayedStateFeedback])
@pytest.mark.parametrize("seed", range(10))
def test_with_a_delay_per_input_and_mode_it_is_the_dense_loop_by_definition(seed, make):
    plant, model = random_plant(seed, fractional), random_plant(seed, lambda *_: 0.23)
    law = law_of(model, make)
    omega = np.geomspace(0.1, np.pi / H, 25)
    for mode in range(plant.modes):
        whole = closed_by_definition(plant, law, mode, np.exp(1j * omega * H))
        frd = dt.loop_transfer(plant, law, mode, H, frequencies=omega).frdata
        system = dt.loop_transfer(plant, law, mode, H)
        there = control.frequency_response(system, omega).frdata
        assert np.abs(frd - there).max() <= 1e-10 * np.abs(there).max()
        closed = np.linalg.inv(np.eye(2) + np.moveaxis(frd, 2, 0))
        assert np.abs(closed - whole).max() <= 1e-10 * np.abs(whole).max()


def observed():
    plant = random_plant(5, lambda *_: [[0.23, 0.11], [0.31, 0.2]])
    C = np.eye(plant.states)[:2]
    poles = -2.0 - 0.5 * np.arange(plant.states)
    return plant, dt.OutputFeedback(law_of(plant), dt.luenberger(plant, C, poles, step=H))


@pytest.mark.parametrize("at", ["input", "output"])
def test_closing_the_loop_of_an_observer_gives_its_growth_rate(at):
    plant, law = observed()
    truth = dt.SwitchedSystem(plant.A, 1.1 * plant.B, 1.07 * plant.delays)
    for mode in range(2):
        closed = control.feedback(dt.loop_transfer(truth, law, mode, H, at), np.eye(2))
        rate = np.log(np.abs(closed.poles()).max()) / H
        assert rate == pytest.approx(dt.growth_rate(truth, law, mode, H), abs=1e-8)


def test_observer_and_servo_have_one_characteristic_function_wherever_the_loop_is_cut():
    plant = dt.SwitchedSystem([[[0.0, 1.0], [0.0, -0.5]]], [[[0.0], [1.0]]], 0.34)
    servo = dt.Servo(plant, C=[[1.0, 0.0]])
    gains = servo.lqr(np.diag([1.0, 1.0, 0.5]), [[1.0]], step=H)
    law = dt.AveragedPredictor(servo.plant, gains, allow_unstable=True)
    observer = dt.luenberger(servo.model, servo.C, poles=[-3, -4], step=H)
    loop, omega = dt.OutputFeedback(law, observer, servo=servo), np.geomspace(0.01, 30.0, 60)
    one, other = (
        dt.loop_transfer(plant, loop, 0, H, at, frequencies=omega) for at in ("input", "output")
    )
    assert np.allclose(1.0 + one.frdata[0, 0], 1.0 + other.frdata[0, 0], rtol=1e-10)
    # The sum of errors is an integral: the gain at low frequencies is that of 1/ω at least.
    assert abs(one.frdata[0, 0, 0]) * omega[0] > 0.5 * abs(one.frdata[0, 0, 5]) * omega[5]


def test_the_ideal_loop_is_its_formula_by_exponentials():
    plant = random_plant(3, lambda *_: 0.4)
    law, s = law_of(plant), 1j * np.geomspace(0.1, 40.0, 30)
    for at in ("input", "output"):
        L = dt.loop_transfer(plant, law, 0, None, at, frequencies=s.imag).frdata
        for i, point in enumerate(s):
            n = plant.states
            F, W = np.zeros((2, n), complex), np.zeros((2, 2), complex)
            for A, B, K in zip(plant.A, plant.B, law.gains, strict=True):
                block = np.zeros((n + 2, n + 2), complex)
                block[:n, :n], block[:n, n:] = A - point * np.eye(n), B
                F += 0.5 * K @ expm(0.4 * A)
                W += 0.5 * K @ expm(0.4 * block)[:n, n:]
            P = np.linalg.solve(point * np.eye(n) - plant.A[0], plant.B[0]) * np.exp(-0.4 * point)
            C = np.linalg.solve(np.eye(2) - W, F)
            expected = -C @ P if at == "input" else -P @ C
            assert np.abs(L[:, :, i] - expected).max() <= 1e-10 * np.abs(expected).max()


def single():
    plant = dt.SwitchedSystem([[[1.0]]], [[[1.0]]], delay=0.2)
    return plant, dt.SingleModePredictor(plant, dt.place(plant, [-1.0]), 0)


def test_margins_of_phase_and_disk_are_python_control_s_and_the_others_deadtime_s():
    plant, law = single()
    view = loop_view(plant, law, 0.01)
    mode, L = view.modes[0], dt.loop_transfer(plant, law, 0, 0.01)
    disk, gain, phase = control.disk_margins(L, view.omega)
    assert mode.disk == pytest.approx(disk, rel=1e-6)
    assert 20.0 * np.log10(mode.disk_gain) == pytest.approx(gain, rel=1e-6)
    assert mode.disk_phase == pytest.approx(phase, rel=1e-6)
    theirs = control.stability_margins(
        dt.loop_transfer(plant, law, 0, 0.01, frequencies=view.omega)
    )
    assert (mode.phase, mode.phase_frequency) == pytest.approx(theirs[1::3], rel=1e-6)
    assert view.gain.upper == pytest.approx(theirs[0], rel=1e-6)
    assert view.gain.upper == dt.gain_margin(plant, law).upper
    assert view.delay.longer == dt.delay_margin(plant, law).longer


@pytest.mark.few(2)
@pytest.mark.parametrize("seed", range(6))
def test_no_factor_within_the_disk_loses_the_loop_and_one_on_its_edge_does(seed):
    rng = np.random.default_rng(seed)
    plant = dt.SwitchedSystem(rng.normal(size=(1, 2, 2)), rng.normal(size=(1, 2, 1)), 0.17)
    law = law_of(plant)
    disk = loop_view(plant, law, H).modes[0].disk
    for size, lost in ((0.99, False), (1.01, True)):
        # A factor f turns L to −1 where f = −1/L; it is of the disk of δ = 2 (f − 1)/(f + 1).
        omega = np.linspace(1e-4, np.pi / H, 4000)
        L = dt.loop_transfer(plant, law, 0, H, frequencies=omega).frdata[0, 0]
        inside = np.abs(2.0 * (-1.0 / L - 1.0) / (-1.0 / L + 1.0)).min() < size * disk
        assert inside == lost


def test_a_loop_that_grows_has_curves_and_no_margins():
    problem = dt.problems.paper()
    law = dt.AveragedPredictor(problem.plant, problem.gains)
    for mode in loop_view(problem.plant, law, 0.05).modes:
        assert mode.phase is mode.disk is mode.disk_gain is mode.disk_phase is None
        assert np.isfinite(mode.sensitivity).all()


def test_python_control_linearises_the_loop_of_a_table():
    plant, law = single()
    loop, initial = dt.controller.loop_to_control(plant, law, 0.05)
    linear = control.linearize(loop, np.r_[np.zeros(loop.nstates - 2), 0.0, 5.0], [0.0])
    moduli = np.sort(np.abs(np.linalg.eigvals(linear.A)))
    expected = np.exp(0.05 * dt.growth_rate(plant, law, 0, 0.05))
    assert moduli[np.abs(moduli - expected).argmin()] == pytest.approx(expected, abs=1e-6)
    assert initial.size == loop.nstates
    assert (
        control.bode_plot(dt.loop_transfer(plant, law, 0, 0.05), display_margins=True) is not None
    )


@pytest.mark.parametrize("mode", [0, 1])
def test_plant_and_law_linearised_by_python_control_go_round_as_the_loop_does(mode):
    problem, h = dt.problems.paper(), 0.25
    law, omega = dt.AveragedPredictor(problem.plant, problem.gains), np.geomspace(0.1, 12.0, 30)
    plant, table = plant_to_control(problem.plant, h), law_to_control(law, h)
    P = control.linearize(plant, np.zeros(plant.nstates), [0.0, mode])[:2, 0]
    old = np.r_[np.zeros(table.nstates - 2), mode, 40.0]  # the mode has been held for long
    K = control.linearize(table, old, [0.0, 0.0, mode])[0, :2]
    there = control.frequency_response(-(K * P), omega).frdata
    here = dt.loop_transfer(problem.plant, law, mode, h, frequencies=omega).frdata
    assert np.abs(there - here).max() <= 1e-10 * np.abs(here).max()


def test_every_mark_of_the_figure_is_the_margin_that_it_names():
    problem, h = dt.problems.follower(), 0.05
    law = dt.AveragedPredictor(problem.plant, problem.gains)
    view = loop_view(problem.plant, law, h)
    figure = plot_loop(view)
    gain, nyquist, phase, _ = (figure.axes[i] for i in (0, 1, 2, 3))
    circles, squares = (
        {mark: [one.get_xydata()[0] for one in panel.get_lines() if one.get_marker() == mark]
         for mark in "os"}
        for panel in (gain, nyquist)
    )  # fmt: skip
    upper = dt.gain_margin(problem.plant, law, h).upper
    assert circles["o"][0][1] == 1.0 / upper
    assert squares["o"][0] == pytest.approx([-1.0 / upper, 0.0])
    worst = min(view.modes, key=lambda mode: mode.phase)
    assert circles["s"][0] == pytest.approx([worst.phase_frequency, 1.0])
    turned = np.degrees(np.arctan2(*squares["s"][0][::-1]))
    assert (turned + 180.0) % 360.0 == pytest.approx(worst.phase)
    margin = dt.delay_margin(problem.plant, law, h)
    (line,) = [one for one in phase.get_lines() if one.get_linestyle() == ":"]
    assert line.get_xdata()[0] == margin.upper_frequency
    (text,) = [one.get_text() for one in phase.texts]
    assert float(text.strip(" +s")) == pytest.approx(margin.longer, rel=2e-3)
    (disk,) = nyquist.patches
    a = min(mode.disk for mode in view.modes)
    assert disk.get_xy()[:, 0].max() == pytest.approx(-(2.0 - a) / (2.0 + a))
    assert disk.get_xy()[:, 0].min() == pytest.approx(-(2.0 + a) / (2.0 - a))
    assert [one.get_text() for one in figure.legends[0].get_texts()] == [
        "mode 0", "mode 1", "gain margin", "phase margin", "delay margin", "disk margin", "−1",
        "|L| = 1",
    ]  # fmt: skip
    modes = {line.get_color() for line in gain.get_lines()[:2]}
    assert not modes & {line.get_color() for line in nyquist.get_lines()[2:]}


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"step": None}, "frequencies must be given for the ideal loop"),
        ({"at": "plant"}, 'at must be "input" or "output", got \'plant\''),
        ({"frequencies": [1.0, 400.0]}, r"at most π/step = 314.159 rad/s.*Hz"),
        ({"frequencies": [1.0, 1.0]}, "frequencies must be positive and increase"),
        ({"frequencies": [0.0, 1.0]}, "frequencies must be positive and increase"),
        ({"mode": 1}, "mode must be"),
    ],
)
def test_bad_requests_are_refused_by_name(changed, message):
    plant, law = single()
    with pytest.raises(dt.ArgumentError, match=message):
        dt.loop_transfer(plant, law, **({"mode": 0, "step": 0.01} | changed))


def test_without_python_control_it_says_how_to_get_it(monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "control", None)
    with pytest.raises(dt.ArgumentError, match=r'python-control.*pip install "\.\[control\]"'):
        dt.loop_transfer(*single(), 0)


def test_the_eigenvalue_of_a_loop_that_is_0_is_not_drawn():
    """Three modes, two inputs with a delay each, one output: L has rank 1, the rest is chance."""
    rng = np.random.default_rng(5)
    A = [[[-1.2, 2.0], [0.0, -4.0]], [[-0.6, 1.1], [0.0, -4.0]], [[-0.3, 0.6], [0.0, -4.0]]]
    plant = dt.SwitchedSystem(A, rng.normal(size=(3, 2, 2)), [0.17, 0.083])
    observer = dt.luenberger(plant, [[1.0, 0.0]], [-6.0, -8.0], step=0.05)
    view = loop_view(plant, dt.OutputFeedback(law_of(plant), observer), 0.05)
    assert all(np.abs(each.loci).min() < 1e-14 * np.abs(each.loci).max() for each in view.modes)
    gain, _, phase, _ = plot_loop(view).axes[:4]
    drawn = [line for line in gain.get_lines() if len(line.get_xdata()) == view.omega.size]
    assert len(drawn) == 3
    for line, each in zip(drawn, view.modes, strict=True):
        largest = np.abs(each.loci).max(axis=1)
        assert np.array_equal(line.get_ydata(), largest)
    turns = [line.get_ydata() for line in phase.get_lines() if line.get_xdata()[-1] > 1.0]
    assert max(np.abs(np.diff(turn)).max() for turn in turns if len(turn) > 2) < 90.0
