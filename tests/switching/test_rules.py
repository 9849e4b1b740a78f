"""Switching rules: which mode a state is in, and which rules are refused."""

import re
from itertools import pairwise

import numpy as np
import pytest

import deadtime as dt
import plants
from deadtime.numerics.polynomials import first_positive
from deadtime.switching import FunctionRule, HalfSpace, Polyhedra, QuadraticRegions
from deadtime.switching.rules.rule import as_rule

RNG = np.random.default_rng(2)


def sectors(count, angle=0.3):
    """`count` equal sectors of the plane, the first from `angle` on, counter-clockwise."""
    edges = angle + 2.0 * np.pi * np.arange(count + 1) / count
    normals = np.column_stack((-np.sin(edges), np.cos(edges)))
    return [(np.stack((-normals[i], normals[i + 1])), np.zeros(2)) for i in range(count)]


def box(low, high):
    n = len(low)
    return np.vstack((-np.eye(n), np.eye(n))), np.concatenate((-np.array(low), np.array(high)))


# -- which mode --------------------------------------------------------------------------------


def test_a_half_space_is_mode_1_where_normal_x_reaches_the_offset():
    rule = HalfSpace([2.0, -1.0], 0.5)
    x = RNG.normal(size=(1000, 2))
    assert np.array_equal(rule.modes_of(x), (x @ [2.0, -1.0] >= 0.5).astype(int))
    assert (rule([0.25, 0.0]), rule([0.2499, 0.0])) == (1, 0)
    assert repr(rule) == "HalfSpace(mode 1 where [2.0, -1.0]·x ≥ 0.5)"


def test_sectors_give_the_mode_of_the_angle():
    rule = Polyhedra(sectors(5))
    x = RNG.normal(size=(1000, 2)) * 10.0 ** RNG.uniform(-8, 8, size=(1000, 1))
    angle = (np.arctan2(x[:, 1], x[:, 0]) - 0.3) % (2.0 * np.pi)
    assert np.array_equal(rule.modes_of(x), (angle * 5 / (2.0 * np.pi)).astype(int))


def test_a_boundary_belongs_to_the_first_region_that_holds_it():
    left, right = ([[1.0]], [0.0]), ([[-1.0]], [0.0])
    assert Polyhedra([left, right])([0.0]) == 0
    assert Polyhedra([right, left])([0.0]) == 0
    assert Polyhedra([left, right], modes=[1, 0])([0.0]) == 1


def test_a_state_that_round_off_leaves_outside_all_regions_is_in_the_nearest():
    rule = Polyhedra([([[1.0]], [0.3]), ([[-1.0]], [-(0.1 + 0.2)])])
    between = 0.3 + 2e-17
    assert rule([between]) in (0, 1)
    assert rule([0.31]) == 1


def test_several_regions_may_share_a_mode_and_then_overlap():
    left, right = ([[1.0]], [0.5]), ([[-1.0]], [0.5])
    rule = Polyhedra([left, right], modes=[1, 1])
    assert rule([0.0]) == 1
    assert repr(rule) == "Polyhedra(regions=2, modes=1, states=1)"


def test_a_rule_is_immutable():
    rule = Polyhedra(sectors(3))
    for array in (rule.rows, rule.offsets, rule.first, rule.region_modes):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1
    with pytest.raises(AttributeError):
        rule.rows = rule.rows.copy()


def test_a_function_is_a_rule():
    def ball(x):
        return int(x @ x > 1.0)

    rule = as_rule("rule", ball)
    assert rule.modes_of(np.array([[0.1, 0.2], [1.0, 1.0]])).tolist() == [0, 1]
    assert repr(rule) == "FunctionRule(ball, samples=8)"
    assert as_rule("rule", rule) is rule


# -- partitions --------------------------------------------------------------------------------


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
@pytest.mark.parametrize("count", [2, 3, 7])
def test_regions_that_meet_to_round_off_are_a_partition_in_any_unit(unit, count):
    Polyhedra(sectors(count))
    cuts = unit * np.sort(RNG.normal(size=count - 1))
    edges = np.concatenate(([-np.inf], cuts, [np.inf]))
    Polyhedra(
        [
            (
                [row for row, edge in (([-3.0], a), ([7.0], b)) if np.isfinite(edge)],
                [h for h in (-3.0 * a, 7.0 * b) if np.isfinite(h)],
            )
            for a, b in pairwise(edges)
        ]
    )


def grid(side):
    """A partition of the plane into side² boxes, the outer ones without end."""
    edges = [-np.inf, *range(side - 1), np.inf]
    regions = []
    for i in range(side):
        for j in range(side):
            H, h = box((edges[i], edges[j]), (edges[i + 1], edges[j + 1]))
            regions.append((H[np.isfinite(h)], h[np.isfinite(h)]))
    return regions


def test_a_grid_of_boxes_is_a_partition_and_without_any_one_of_them_is_not():
    regions = grid(4)
    rule = Polyhedra(regions)
    assert rule([0.5, 1.5]) == 6
    for i in range(16):
        with pytest.raises(dt.ArgumentError, match="regions leave a gap") as raised:
            Polyhedra(regions[:i] + regions[i + 1 :])
        point = np.array(eval(re.search(r"x = (\[.*?\])", str(raised.value))[1]))
        assert rule(point) == i


def test_an_overlap_is_refused_with_a_state_that_shows_it():
    half = ([[1.0, 0.0]], [0.2]), ([[-1.0, 0.0]], [0.1])
    with pytest.raises(dt.ArgumentError, match=re.escape(
        "regions[0] and regions[1] overlap in different modes, 0 and 1: both hold x = [0.05,"
    )):  # fmt: skip
        Polyhedra(half)


def test_a_thin_gap_and_a_thin_overlap_are_found():
    for gap in (1e-6, -1e-6):
        with pytest.raises(dt.ArgumentError, match="leave a gap" if gap > 0 else "overlap"):
            Polyhedra([([[1.0]], [1.0]), ([[-1.0]], [-1.0 - gap])])


def millimetres_and_pascals(left, right):
    """Two half-strips below 2 bar that should meet at 1 mm, and all above 2 bar."""
    below = [([[1, 0], [0, 1]], [left, 2e5]), ([[-1, 0], [0, 1]], [right, 2e5])]
    return Polyhedra([*below, ([[0, -1]], [-2e5])], modes=[0, 1, 0])


def test_states_in_different_units_have_tolerances_of_their_own():
    e, p = 1e-3, 2e5
    slab = [([[1, 0], [-1, 0], [0, s]], [e, e, s * p]) for s in (1, -1)]
    rule = Polyhedra([*slab, ([[1, 0]], [-e]), ([[-1, 0]], [-e])])
    assert rule.modes_of(np.array([[0, 1e5], [0, 3e5], [-2e-3, 0], [2e-3, 0]])).tolist() == [
        0,
        1,
        2,
        3,
    ]
    millimetres_and_pascals(e, -e)
    with pytest.raises(dt.ArgumentError, match="regions leave a gap"):
        millimetres_and_pascals(-0.9e-3, -0.9e-3)
    with pytest.raises(dt.ArgumentError, match=r"regions\[0\] and regions\[1\] overlap"):
        millimetres_and_pascals(1e-3, 0.8e-3)
    for thin in (1e-9, -1e-9):
        with pytest.raises(dt.ArgumentError, match="leave a gap" if thin > 0 else "overlap"):
            millimetres_and_pascals(e, -e - thin)


@pytest.mark.parametrize("unit", [1e-6, 1e6])
def test_a_partition_in_slanted_cells_stays_one_in_other_units(unit):
    # Voronoi cells: every region has more rows than it needs.
    centres = RNG.normal(size=(8, 2))
    cells = []
    for i, centre in enumerate(centres):
        others = np.delete(centres, i, axis=0)
        cells.append((2.0 * (others - centre), (others**2).sum(axis=1) - centre @ centre))
    scale = np.array([1.0, unit])
    rule = Polyhedra([(H / scale, h) for H, h in cells])
    x = RNG.normal(size=(200, 2))
    nearest = np.linalg.norm(x[:, None] - centres, axis=2).argmin(axis=1)
    assert np.array_equal(rule.modes_of(x * scale), nearest)
    with pytest.raises(dt.ArgumentError, match="leave a gap"):
        Polyhedra([(H / scale, h) for H, h in cells[1:]])


LEFT, RIGHT = ([[1.0]], [0.0]), ([[-1.0]], [0.0])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: HalfSpace([0.0, 0.0]), "normal must not be zero: it points from mode 0"),
        (lambda: HalfSpace([[1.0, 0.0]]), "normal must have shape (n,), got (1, 2)"),
        (lambda: HalfSpace([1.0, np.nan]), "normal[1] must be finite, got nan."),
        (lambda: HalfSpace([1.0], np.inf), "offset must be finite, got inf."),
        (lambda: Polyhedra([]), "regions must hold at least one pair (H, h), got none."),
        (lambda: Polyhedra([LEFT, RIGHT], [0]), "modes must have one entry per region, 2, got 1."),
        (lambda: Polyhedra([LEFT, RIGHT], [0, -1]), "modes[1] must be an integer of at least 0"),
        (
            lambda: Polyhedra([([[1.0]], [1.0, 2.0])]),
            "regions[0][1] must have shape (rows,) = (1,)",
        ),
        (lambda: Polyhedra([([1.0], [1.0])]), "regions[0][0] must have shape (rows, n), got (1,)"),
        (
            lambda: Polyhedra([LEFT, ([[-1.0, 0.0]], [0.0])]),
            "regions[1][0] must have shape (rows, n) = (1, 1), got (1, 2)",
        ),
        (
            lambda: Polyhedra([LEFT, ([[-1.0], [0.0]], [0.0, 1.0])]),
            "regions[1][0][1] must not be a row of zeros.",
        ),
        (
            lambda: Polyhedra([LEFT, RIGHT, ([[1.0], [-1.0]], [-1.0, -1.0])]),
            "regions[2] is empty: no state meets H x ≤ h with room to spare, 1e-08 of the largest",
        ),
        (lambda: Polyhedra([LEFT, ([[-1.0]], [-1.0])]), "regions leave a gap: none of them holds"),
        (lambda: FunctionRule(lambda x: 0, samples=0), "samples must be an integer of at least 1"),
        (
            lambda: as_rule("rule", "left"),
            "rule must be a HalfSpace, Polyhedra, QuadraticRegions or a function from a state to a "
            "mode, got str.",
        ),
        (
            lambda: as_rule("rule", dt.SwitchingSignal.constant(0)),
            "rule must be a HalfSpace, Polyhedra, QuadraticRegions or a function from a state to a "
            "mode, got SwitchingSignal.",
        ),
        (
            lambda: HalfSpace([1.0, 0.0]).require(plants.generic()),
            "rule must be one of 3 states, as the plant's, got one of 2.",
        ),
        (
            lambda: Polyhedra(sectors(3)).require(plants.paper()),
            "rule names mode 2, but the plant's modes are 0..1",
        ),
    ],
)
def test_a_rule_that_makes_no_sense_is_refused_by_name(make, message):
    with pytest.raises(dt.ArgumentError, match=re.escape(message)):
        make()


def test_a_region_must_be_a_pair():
    with pytest.raises(dt.ArgumentError, match=r"regions\[0\] must be a pair \(H, h\), got"):
        Polyhedra([([[1.0]], [1.0], [1.0])])


# -- first crossings ---------------------------------------------------------------------------


@pytest.mark.parametrize("degree", range(1, 13))
def test_the_first_positive_point_of_a_polynomial_is_its_first_rising_root(degree):
    for _ in range(50):
        roots = np.sort(RNG.uniform(-0.5, 1.5, degree))
        if np.diff(roots).size and np.diff(roots).min() < 0.02:
            continue
        c = np.poly(roots)[::-1].copy()
        c *= -1.0 if np.polyval(c[::-1], 0.0) > 0.0 else 1.0
        inside = roots[roots > 0.0]
        found = first_positive(c)
        if inside.size and inside[0] < 1.0:
            slope = abs(np.polyval(np.polyder(c[::-1]), inside[0]))
            assert found == pytest.approx(inside[0], abs=1e-14 * np.abs(c).sum() / slope + 1e-14)
        else:
            assert found == -1.0


def test_a_hump_is_found_however_thin_and_a_touch_is_none():
    for height in (1e-2, 1e-6, 1e-12):  # height − (s − 0.3)²
        found = first_positive(np.array([height - 0.09, 0.6, -1.0]))
        assert found == pytest.approx(0.3 - np.sqrt(height), abs=1e-9)
        assert first_positive(np.array([-height - 0.09, 0.6, -1.0])) == -1.0
    assert first_positive(np.array([-0.25, 1.0, -1.0])) == -1.0  # touches 0 at 1/2, exactly
    assert first_positive(np.zeros(5)) == -1.0
    assert first_positive(np.array([0.0, np.nan, 1.0])) == -1.0


# -- quadratic forms ---------------------------------------------------------------------------

FORMS = np.array([[[1.0, 0.5], [0.5, -1.0]], [[-1.0, 0.2], [0.2, 2.0]], [[0.5, -2.0], [-2.0, 0]]])


def test_quadratic_regions_give_the_mode_of_the_largest_form():
    rule = QuadraticRegions(FORMS)
    x = RNG.normal(size=(1000, 2)) * 10.0 ** RNG.uniform(-8, 8, size=(1000, 1))
    largest = [max(range(3), key=lambda i, y=y: y @ FORMS[i] @ y) for y in x]
    assert rule.modes_of(x).tolist() == largest
    assert rule([0.0, 0.0]) == 0
    assert repr(rule) == "QuadraticRegions(modes=3, states=2)"
    assert as_rule("rule", rule) is rule
    with pytest.raises(ValueError, match="read-only"):
        rule.S[0, 0, 0] = 1.0


def test_a_rule_is_the_same_as_one_of_the_same_numbers_or_function():
    def ball(x):
        return int(x @ x > 1.0)

    rules = [
        (HalfSpace([1.0, 0.0], 0.5), HalfSpace([1.0, 0.0], 0.5), HalfSpace([1.0, 0.0])),
        (Polyhedra(sectors(3)), Polyhedra(sectors(3)), Polyhedra(sectors(4))),
        (QuadraticRegions(FORMS), QuadraticRegions(FORMS), QuadraticRegions(-FORMS)),
        (FunctionRule(ball), FunctionRule(ball), FunctionRule(ball, 9)),
    ]
    for one, same, other in rules:
        assert one.same(same)
        assert not one.same(other)
    assert not any(a[0].same(b[0]) for a in rules for b in rules if a is not b)


def turned(delay=0.25):
    """x turns at 1 rad/s in either mode."""
    return dt.SwitchedSystem([[[0.0, 1.0], [-1.0, 0.0]]] * 2, np.zeros((2, 2, 1)), delay)


@pytest.mark.parametrize("width", [1e-2, 1e-4, 1e-6])
def test_a_thin_quadratic_region_entered_and_left_within_one_step_is_found(width):
    # Mode 1 where x₂² ≥ x₁²/tan²(width): within `width` of the axis; the angle passes it once.
    form = np.diag([-1.0, np.tan(width) ** 2])
    rule = QuadraticRegions([-form, form])
    plant, angle = turned(), 0.5 * np.pi + 0.17
    law = dt.DelayedStateFeedback(plant, np.zeros((2, 1, 2)), allow_unstable=True)
    x0 = [np.cos(angle), np.sin(angle)]
    one = dt.simulate(plant, law, rule, x0, 2.0, 0.4)
    assert one.signal.modes.tolist() == [0, 1, 0]
    assert np.abs(one.signal.times[1:] - [0.17 - width, 0.17 + width]).max() <= 2e-15 / width


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: QuadraticRegions(np.eye(2)), "S must have shape (modes, n, n), got (2, 2)"),
        (
            lambda: QuadraticRegions(np.ones((2, 2, 3))),
            "S must have shape (modes, n, n), got (2, 2, 3): one square matrix per mode.",
        ),
        (
            lambda: QuadraticRegions([np.eye(2), [[1.0, 2.0], [0.0, 1.0]]]),
            "S[1] must be symmetric, got 2 at (0, 1) and 0 at (1, 0): (S + S.T) / 2 has the same",
        ),
        (
            lambda: QuadraticRegions([np.eye(2), np.diag([1.0, np.nan])]),
            "S[1, 1, 1] must be finite, got nan.",
        ),
        (
            lambda: QuadraticRegions([np.eye(2), 2 * np.eye(2), np.eye(2)]),
            "S[2] must differ from S[0]: where two forms are the same, the rule does not say",
        ),
        (lambda: QuadraticRegions([]), "S must have shape (modes, n, n), got (0,)"),
        (
            lambda: QuadraticRegions(FORMS).require(plants.paper()),
            "rule must have one form in 2 states for each of the plant's 2 modes, got 3 in 2.",
        ),
        (
            lambda: QuadraticRegions(FORMS).require(plants.generic()),
            "rule must have one form in 3 states for each of the plant's",
        ),
    ],
)
def test_quadratic_regions_that_make_no_sense_are_refused_by_name(make, message):
    with pytest.raises(dt.ArgumentError, match=re.escape(message)):
        make()
