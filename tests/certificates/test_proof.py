"""The check rejects whatever is no proof: perturbed, malformed, or for another question."""

import contextlib
import math
from dataclasses import replace
from operator import attrgetter

import numpy as np
import pytest

import certificate_reference as reference
import deadtime as dt
from deadtime.certificates.proof import check
from evidence import ALPHA, ARRAYS, PAPER, TIMES, made


def evidence_of(name):
    return made(name)[2].evidence


def assert_rejected(evidence, reason=""):
    outcome = check(evidence)
    assert not outcome.proven
    assert outcome.reason
    assert reason in outcome.reason


def assert_refused(evidence, part, value):
    """Such evidence is rejected, unless it cannot be made."""
    with contextlib.suppress(dt.ArgumentError):
        assert_rejected(with_part(evidence, part, value))
        return
    with pytest.raises(dt.ArgumentError, match=f"{part.rpartition('.')[2]} must be"):
        with_part(evidence, part, value)


def least(evidence, loop):
    """The least eigenvalue of all inequalities of the evidence, by the second method."""
    return reference.Inequalities(evidence, loop).least(np.linspace(0.0, 1.0, 21))


def with_part(evidence, part, value):
    """The evidence with a part of it, of its centre or of its setting replaced."""
    name, _, inner = part.partition(".")
    whole = with_part(getattr(evidence, name), inner, value) if inner else value
    return replace(evidence, **{name: whole})


@pytest.mark.few(1)
@pytest.mark.parametrize("name", ALPHA)
def test_the_evidence_itself_passes_both_methods(name):
    evidence, loop = evidence_of(name), made(name)[3]
    assert bool(evidence.S.size) == (name == "eigenvectors")
    assert evidence.setting.rows_differ == (name == "extended rows")
    outcome = check(evidence)
    assert (outcome.proven, outcome.reason) == (True, "")
    assert least(evidence, loop) > 0.0


@pytest.mark.few(2)
@pytest.mark.parametrize("part", ["P", "Pi", "S"])
@pytest.mark.parametrize("name", ALPHA)
def test_perturbed_evidence_is_rejected_wherever_the_second_method_refutes_it(name, part):
    evidence, loop = evidence_of(name), made(name)[3]
    whole = getattr(evidence, part)
    large = 0.1 if (name, part) == ("extended rows", "Pi") else 1e-3  # it has room for 1e-3
    sizes = [large] * (6 if part == "P" else 20) + [1e-5, 1e-7, 1e-10]
    for seed, size in enumerate(sizes if whole.size else ()):
        rng = np.random.default_rng(seed)
        changed = whole.copy()
        for block in changed.reshape(-1, *changed.shape[-2:]):
            unit = np.sqrt(np.abs(np.diag(block)))
            noise = rng.choice([-size, 0.0, 0.0, size], size=block.shape)
            block += (np.triu(noise) + np.triu(noise, 1).T) * unit * unit[:, None]
        mutant = replace(evidence, **{part: changed})
        violated = least(mutant, loop) < 0.0
        assert violated or size < large
        if violated:
            assert_rejected(mutant)


def test_evidence_is_rejected_for_another_plant():
    evidence, table = evidence_of("common"), made("common")[3].table
    for alpha in (0.64, 0.66):
        other = PAPER.apart(alpha)
        mutant = with_part(evidence, "setting.plants.A", other.A[None])
        mutant = with_part(mutant, "setting.plants.B", other.B[None])
        assert least(mutant, reference.Loop(other.A, other.B, 1.0, table)) < 0.0
        assert_rejected(mutant, "the inequality of the step")


def test_evidence_is_rejected_for_another_delay_dwell_time_or_rate():
    evidence, (plant, _, _, loop) = evidence_of("extended rows"), made("extended rows")
    for delay in (0.21, 0.27):
        mutant = with_part(evidence, "setting.delays.ends", np.array([delay, delay]))
        assert least(mutant, reference.Loop(plant.A, plant.B, delay, loop.table)) < 0.0
        assert_rejected(mutant, "the inequality of the step")
    evidence = evidence_of("common")
    for delay, reason in ((0.9, "K ≻ 0 fails"), (0.98, "has the shape"), (1.1, "has the shape")):
        assert_rejected(with_part(evidence, "setting.delays.ends", np.full(2, delay)), reason)
    dwell = "setting.signals.dwell_time"
    assert check(with_part(evidence, dwell, 0.11)).proven  # P is for any dwell time
    assert_rejected(with_part(evidence, dwell, 0.1), "below one period")
    mutant = with_part(evidence_of("eigenvectors"), dwell, 0.11)
    assert least(mutant, made("eigenvectors")[3]) < 0.0
    assert_rejected(mutant, "the inequality of the step")
    for name in ALPHA:
        loop = made(name)[3]
        radii = [np.abs(np.linalg.eigvals(loop.step(mode, 10**6))).max() for mode in range(2)]
        assert_rejected(replace(evidence_of(name), rho=float(max(radii)) * (1.0 - 1e-9)))


def test_evidence_is_rejected_for_another_entry_of_the_table():
    for name, reason in (("common", "row is not the table's"), ("extended rows", "K ≻ 0 fails")):
        evidence = evidence_of(name)
        for part, index in (("F", (-1, 0, 0)), ("F", (0, 0, 1)), ("G", (-1, 0, 0, 0))):
            changed = getattr(evidence.setting, part).copy()
            changed[index] *= 1.001
            assert_rejected(with_part(evidence, f"setting.{part}", changed), reason)
    # An attacker changes the centre, too.
    evidence = evidence_of("common")
    F, row = evidence.setting.F * 1.001, evidence.centre.row.copy()
    row[:, :2] = F[0]
    mutant = with_part(with_part(evidence, "centre.row", row), "setting.F", F)
    assert least(mutant, made("common")[3]) < 0.0
    assert_rejected(mutant, "K ≻ 0 fails")


@pytest.mark.parametrize("value", [math.nan, math.inf, 1e300])
@pytest.mark.parametrize("name", ["eigenvectors", "extended rows"])
def test_numbers_that_are_none_are_rejected_wherever_they_stand(name, value):
    evidence = evidence_of(name)
    for part in ARRAYS:
        spoiled = attrgetter(part)(evidence).copy()
        if spoiled.size:
            spoiled.flat[-1] = value
            assert_rejected(with_part(evidence, part, spoiled))
    for part in ("rho", *(f"setting.{name}" for name in TIMES)):
        if (part, value) != ("setting.signals.maximum_dwell", math.inf):  # without end
            assert_refused(evidence, part, value)


def test_shapes_layout_knots_and_symmetry_are_checked():
    evidence, aged = evidence_of("eigenvectors"), evidence_of("extended rows")
    skew = evidence.P.copy()
    skew[0, 1] *= 1.0 + 1e-15
    assert_rejected(replace(evidence, P=skew), "P is not symmetric")
    for part in ("P", "Pi"):
        assert_rejected(with_part(evidence, part, getattr(evidence, part)[1:, 1:]), "has the shape")
    for cut in (evidence.S[:1], evidence.S[:, :1], evidence.S[:, :, 1:, 1:]):
        assert_rejected(replace(evidence, S=cut), "S has the shape")
    for part in ("centre.E", "centre.T", "centre.F"):
        less = attrgetter(part)(evidence)[..., 1:]
        assert_rejected(with_part(evidence, part, less), "has the shape")
    for knots in ((1, 0), (0, 0), (1, 2), (-1, 1)):
        assert_rejected(replace(evidence, knots=knots), "knots do not ascend")
    for rho in (0.0, -0.5, 1.0 + 1e-9):
        assert_rejected(replace(evidence, rho=rho), "rho is not in")
    for delays in ((-1.0, -1.0), (0.5, 1.0), (1.0, 0.95)):
        assert_rejected(with_part(evidence, "setting.delays.ends", np.array(delays)))
    for part, value in (("step", 0.0), ("step", -0.1), ("ages", 0), ("signals.chatter", 0)):
        assert_refused(evidence, f"setting.{part}", value)
    # Rows that no step would read, if what is said of the table's layout were believed.
    for part, value in (("ages", 1), ("context", "mode"), ("context", "none")):
        assert_rejected(with_part(aged, f"setting.{part}", value))
