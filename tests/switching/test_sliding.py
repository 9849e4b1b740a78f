"""Sliding along boundaries at which both modes point, in closed form and by a second method."""

import numpy as np
import pytest
from scipy.special import lambertw

import deadtime as dt
import plants
import rule_reference as second
from deadtime.laws import StateDependentPredictor
from deadtime.switching import HalfSpace, Polyhedra, QuadraticRegions
from sectors import EDGES, PLANE, SECTORS, sector

H = 0.1


def drifting(fields, delay=0.25):
    """Modes with affine fields (2, 3) · (x₁, x₂, 1), the third state being 1."""
    A = np.zeros((len(fields), 3, 3))
    A[:, :2] = fields
    return dt.SwitchedSystem(A, np.zeros((len(fields), 3, 1)), delay)


def constant(*velocities):
    """Fields that do not depend on the state."""
    return [[[0.0, 0.0, v], [0.0, 0.0, w]] for v, w in velocities]


def idle(plant):
    gains = np.zeros((plant.modes, plant.inputs, plant.states))
    return dt.DelayedStateFeedback(plant, gains, allow_unstable=True)


def run(plant, rule, x0, horizon=2.0, step=H, times=None):
    return dt.simulate(plant, idle(plant), rule, [*x0, 1.0], horizon, step, times=times)


SIGN = HalfSpace([1.0, 0.0, 0.0])
ANY = np.sort(np.random.default_rng(1).uniform(0.0, 2.0, 40))

# The half-space x₁ ≥ 0 as polyhedra, one of them cut in two.
CUT = Polyhedra(
    [
        ([[1.0, 0.0, 0.0]], [0.0]),
        ([[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], [0.0, 1.0]),
        ([[-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]], [0.0, -1.0]),
    ],
    modes=[0, 1, 1],
)
# The same as the regions of forms in (x₁, x₂, 1): x₁·1 against −x₁·1.
FORM = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
SAME = {"half-space": SIGN, "polyhedra": CUT, "forms": QuadraticRegions([-FORM, FORM])}


# -- closed forms ------------------------------------------------------------------------------


@pytest.mark.parametrize("rule", SAME.values(), ids=SAME)
@pytest.mark.parametrize("step", [0.01, 0.37, 2.0])
def test_between_constant_fields_it_slides_at_their_mean_by_hand(rule, step):
    # f₀ = (1, 0.5), f₁ = (−2, 2): tangent is (2 f₀ + f₁)/3 = (0, 1).
    plant = drifting(constant((1.0, 0.5), (-2.0, 2.0)))
    one = run(plant, rule, [-0.5, 0.0], step=step, times=ANY)
    late = ANY > 0.5
    expected = np.where(late, [0.0 * ANY, 0.25 + (ANY - 0.5)], [ANY - 0.5, 0.5 * ANY])
    np.testing.assert_allclose(one.states[:2], expected, rtol=0, atol=2e-14)
    assert one.message == (
        "slid along the boundary between modes 0 and 1, once, for 1.5 s in all, first at t = 0.5 s."
    )
    assert (one.end, one.signal.modes.tolist(), one.diverged) == (2.0, [0], False)
    # ∫|x|² by hand: (t − ½)² + t²/4 + 1 up to ½, then (t − ¼)² + 1.
    ise = 0.5**3 / 3 + 0.5**3 / 12 + 2.0 + (1.75**3 - 0.25**3) / 3
    assert one.metrics()["ise"] == pytest.approx(ise, rel=1e-13)


@pytest.mark.parametrize("rule", SAME.values(), ids=SAME)
def test_a_sliding_motion_that_is_not_linear_follows_its_closed_form(rule):
    # f₀ = (1, 0), f₁ = (−x₂, −x₂): x₂' = −x₂/(1 + x₂), so ln x₂ + x₂ = ln 3 + 3 − t.
    plant = drifting([[[0, 0, 1], [0, 0, 0]], [[0, -1, 0], [0, -1, 0]]])
    one = run(plant, rule, [0.0, 3.0], times=ANY)
    expected = lambertw(3.0 * np.exp(3.0 - ANY)).real
    np.testing.assert_allclose(one.states[1], expected, rtol=2e-14)
    assert np.abs(one.states[0]).max() <= 1e-15
    log = np.log(expected[-1]) + expected[-1] + ANY[-1]
    assert log == pytest.approx(np.log(3.0) + 3.0, rel=1e-14)


@pytest.mark.parametrize("side", [0, 1])
@pytest.mark.parametrize("name", ["half-space", "forms"])
@pytest.mark.parametrize("step", [0.1, 0.37])
def test_it_leaves_the_boundary_where_a_field_becomes_tangent(name, side, step):
    # One field turns at x₂ = 1, which is t = 1: from there x₁ = ∓(t − 1)²/2.
    turning, other = [[0, -1, 1], [0, 0, 1]], [[0, 0, -1], [0, 0, 1]]
    if side:
        turning, other = [[0, 1, -1], [0, 0, 1]], [[0, 0, 1], [0, 0, 1]]
    plant = drifting([other, turning] if side else [turning, other])
    one = run(plant, SAME[name], [0.0, 0.0], times=ANY, step=step)
    away = np.where(ANY > 1.0, 0.5 * (ANY - 1.0) ** 2, 0.0)
    np.testing.assert_allclose(one.states[0], away if side else -away, rtol=0, atol=1e-13)
    np.testing.assert_allclose(one.states[1], ANY, rtol=1e-14)
    # It slid from the mode that the boundary belongs to, 1 of a half-space, the first of forms.
    first = int(name == "half-space")
    assert one.signal.modes.tolist() == ([first] if side == first else [first, side])
    if side != first:
        assert one.signal.times[1] == pytest.approx(1.0, abs=1e-13)
    assert "once, for 1 s in all, first at t = 0 s." in one.message


THREE = Polyhedra(
    [
        ([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], [0.0, 1.0]),
        ([[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], [0.0, 1.0]),
        ([[0.0, -1.0, 0.0]], [-1.0]),
    ]
)


def test_it_slides_up_to_a_third_mode_and_into_it():
    # Below x₂ = 1 x' = (±1, 1) meet on x₁ = 0 at t = 0.5; above it x' = (0.5, 2).
    plant = drifting(constant((1.0, 1.0), (-1.0, 1.0), (0.5, 2.0)))
    one = run(plant, THREE, [-0.5, 0.0], times=ANY)
    x1 = np.where(ANY < 0.5, ANY - 0.5, np.where(ANY < 1.0, 0.0, 0.5 * (ANY - 1.0)))
    np.testing.assert_allclose(one.states[0], x1, rtol=0, atol=1e-13)
    np.testing.assert_allclose(one.states[1], np.where(ANY < 1, ANY, 2 * ANY - 1), atol=1e-13)
    assert one.signal.modes.tolist() == [0, 2]
    assert one.signal.times[1] == pytest.approx(1.0, abs=1e-13)


def test_it_slides_on_where_another_mode_takes_over_one_side():
    # x₁ < 0 is mode 0; of x₁ > 0 mode 1 has x₂ < 1 and mode 2 the rest. Means by hand: x₂' = 2, 3.
    rule = Polyhedra(
        [
            ([[1.0, 0.0, 0.0]], [0.0]),
            ([[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], [0.0, 1.0]),
            ([[-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]], [0.0, -1.0]),
        ]
    )
    plant = drifting(constant((1.0, 1.0), (-1.0, 3.0), (-3.0, 9.0)))
    one = run(plant, rule, [-0.5, -0.5], times=ANY)
    later = np.where(ANY < 1.0, 2.0 * ANY - 1.0, 1.0 + 3.0 * (ANY - 1.0))
    np.testing.assert_allclose(
        one.states[1], np.where(ANY < 0.5, ANY - 0.5, later), rtol=0, atol=1e-12
    )
    assert one.message == (
        "slid along the boundary between modes 0 and 1, once, for 0.5 s in all, first at t = 0.5 s."
        " slid along the boundary between modes 0 and 2, once, for 1 s in all, first at t = 1 s."
    )


def test_modes_that_share_a_region_s_face_slide_as_one():
    plant = drifting(constant((1.0, 0.5), (-2.0, 2.0)))
    whole, cut = run(plant, SIGN, [-0.5, 0.0]), run(plant, CUT, [-0.5, 0.0])
    plants.close(cut.states, whole.states, 1e-13)
    assert cut.message == whole.message


def test_it_slides_round_a_circle_at_the_mean_speed_of_both_sides():
    # x₃ = 1. Inside r' = r at 0.7 rad/s, outside r' = −2r at 4 rad/s: (2·0.7 + 4)/3 = 1.8 on r = 1.
    plant = drifting([[[1, -0.7, 0], [0.7, 1, 0]], [[-2, -4, 0], [4, -2, 0]]])
    inside = np.diag([-1.0, -1.0, 1.0])
    rule = QuadraticRegions([inside, -inside])
    one = run(plant, rule, [np.exp(-0.5), 0.0], times=ANY, step=0.2)
    angle = 0.7 * 0.5 + 1.8 * (ANY - 0.5)
    late = ANY > 0.5
    expected = np.array([np.cos(angle), np.sin(angle)])[:, late]
    np.testing.assert_allclose(one.states[:2, late], expected, rtol=0, atol=1e-13)
    assert "once, for 1.5 s in all, first at t = 0.5 s." in one.message


# -- a second method ---------------------------------------------------------------------------


def forms(x):
    return int(np.argmax([x @ S @ x for S in FORMS]))


FORMS = np.array(
    [[[1.0, 0.4], [0.4, -1.0]], [[-1.0, 0.2], [0.2, 1.0]], [[-0.3, -2.0], [-2.0, 0.0]]]
)
BOUNDARIES = {
    "sectors": [lambda x, row=row: float(row @ x) for row in EDGES],
    "forms": [
        lambda x, Q=FORMS[i] - FORMS[j]: float(x @ Q @ x) for i, j in ((0, 1), (0, 2), (1, 2))
    ],
}


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("name", "seed", "slides"),
    [("sectors", 1, 1), ("sectors", 4, 1), ("forms", 0, 1), ("forms", 1, 1), ("forms", 2, 0)],
)
def test_the_loop_that_slides_equals_an_integration_of_the_mean_field(name, seed, slides):
    rule, mode = (SECTORS, sector) if name == "sectors" else (QuadraticRegions(FORMS), forms)
    gains = 0.8 * np.random.default_rng(seed).normal(size=(3, 1, 2))
    x0 = np.random.default_rng(seed + 20).normal(size=2)
    law = StateDependentPredictor(PLANE, gains, rule, allow_unstable=True)
    one = dt.simulate(PLANE, law, rule, x0, 2.5, H)
    other = second.Plant(PLANE.A, PLANE.B, PLANE.delay, mode, BOUNDARIES[name])
    control = second.predictor(other, gains, H)
    states, inputs, _ = second.run(other, control, x0, np.zeros((4, 1)), H, 26)
    assert (len(one.record.slides.slides(H, 2.5)) if slides else one.record.slides or 0) == slides
    plants.close(one.states.T, states, 1e-8)
    plants.close(one.inputs.T, inputs, 1e-8)
