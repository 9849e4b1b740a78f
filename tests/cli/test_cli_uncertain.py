"""`deadtime certify --uncertain` and `verify --uncertain`: all plants that a file leaves open."""

import numpy as np
import pytest

from certified_loops import MILD_FILE
from deadtime.cli.application import main


def run(capsys, *arguments):
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    captured = capsys.readouterr()
    return stopped.value.code, captured.out, captured.err


UNCERTAIN = MILD_FILE.replace("[gains]", "[uncertainty]\ncovariance = {covariance}\n[gains]")


def test_certify_proves_all_that_a_file_leaves_open_or_says_that_it_does_not(tmp_path, capsys):
    file, saved = tmp_path / "p.toml", tmp_path / "c.json"
    errors = np.diag([0.02, 0.03, 0.02, 0.04, 0.001]) ** 2
    file.write_text(UNCERTAIN.format(covariance=errors.tolist()), encoding="utf-8")
    asked = str(file), "--law", "averaged"
    code, out, _ = run(capsys, "certify", *asked)
    assert code == 0
    assert "For the estimated plant alone" in out
    code, out, _ = run(capsys, "certify", *asked, "--uncertain", "--explain", "--out", str(saved))
    assert code == 0
    assert "Every plant of [uncertainty]" in out
    assert "any plant in the ellipsoid" in " ".join(out.split())
    assert "in their intervals of 95 %" in " ".join(out.split())
    code, out, _ = run(capsys, "certify", *asked, "--uncertain", "--delays", "0.233", "0.235")
    assert code == 0
    assert "in their ranges of --delays" in " ".join(out.split())
    problem = "verify", str(saved), "--problem", *asked
    assert run(capsys, *problem, "--uncertain")[0] == 0
    file.write_text(UNCERTAIN.format(covariance=(4.0 * errors).tolist()), encoding="utf-8")
    code, out, _ = run(capsys, *problem, "--uncertain")
    assert code == 1
    assert "another ellipsoid" in out
    assert run(capsys, *problem)[0] == 0


def test_uncertain_needs_an_uncertainty_and_is_of_one_question(tmp_path, capsys):
    for arguments, why in (
        (("certify", "paper", "--uncertain"), "has no [uncertainty]"),
        (("certify", "paper", "--uncertain", "--least-dwell-time"), "leave out"),
        (("certify", "paper", "--uncertain", "--longest-mode-lag"), "leave out"),
        (("verify", str(tmp_path / "c.json"), "--uncertain"), "--uncertain needs --problem"),
    ):
        code, _, err = run(capsys, *arguments)
        assert code == 2
        assert why in " ".join(err.split())
