"""Figures as files: fonts of Type 42, no date, the same bytes twice, a column's width, PGF."""

import re
import shutil
import subprocess

import matplotlib as mpl
import numpy as np
import pytest
import xarray as xr
from matplotlib.backends import backend_pgf
from matplotlib.figure import Figure

import deadtime as dt
from deadtime.base.figure_files import new_figure
from deadtime.base.latex import booktabs, latex
from deadtime.problems import compare
from deadtime.reports import (
    plot_bands,
    plot_laws,
    plot_monte_carlo,
    plot_norms,
    plot_signal,
    plot_verdict,
)

PAPER = dt.problems.paper()
LAWS = ("averaged", "mean", "oracle", "mode 0 only", "mode 1 only", "delay ignored")


@pytest.fixture(scope="module")
def runs():
    return {name: PAPER.simulate(name) for name in LAWS}


def costs():
    """A dataset as `monte_carlo` returns it, and as a sweep over two delays."""
    values = np.exp(np.random.default_rng(0).normal(size=(2, len(LAWS), 40)))
    dims = ("delay", "law", "scenario")
    metrics = {"cost": (dims, values), "ise": (dims, values), "diverged": (dims, values < 0.0)}
    return xr.Dataset(metrics, {"delay": [0.5, 1.0], "law": list(LAWS)})


FIGURES = {
    "run": lambda runs, width: runs["averaged"].plot("A run", width=width),
    "norms": lambda runs, width: plot_norms(runs, "Norms", width=width),
    "laws": lambda runs, width: plot_laws(dict(list(runs.items())[:3]), width=width),
    "signal": lambda _, width: plot_signal(PAPER.signal, 15.0, PAPER.modes, width),
    "verdict": lambda _, width: plot_verdict(compare(PAPER), width),
    "monte carlo": lambda _, width: plot_monte_carlo(costs().isel(delay=0), "Costs", width),
    "bands": lambda _, width: plot_bands(costs(), width=width),
}


@pytest.mark.parametrize("name", FIGURES)
@pytest.mark.parametrize(("width", "wide"), [("column", 3.5), ("page", 7.16), (4.25, 4.25)])
def test_a_figure_is_as_wide_as_asked_and_nothing_lies_beyond_its_edges(runs, name, width, wide):
    figure = FIGURES[name](runs, width)
    assert figure.get_figwidth() == wide
    figure.draw_without_rendering()
    box = figure.get_tightbbox()
    assert box.x0 > -0.02
    assert box.x1 < wide + 0.02


@pytest.mark.parametrize("width", [0.1, -3.0, 100.0, float("nan")])
def test_a_width_that_cannot_be_drawn_is_refused_with_those_that_can(runs, width):
    with pytest.raises(dt.ArgumentError, match=r'width must be "column" \(3.5 in\).* got'):
        runs["mean"].plot(width=width)


@pytest.mark.parametrize("ending", ["pdf", "svg", "png", "pgf"])
def test_the_same_figure_is_the_same_file(runs, tmp_path, ending):
    written = []
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        path = tmp_path / folder / f"run.{ending}"
        runs["averaged"].plot("∫|x|² falls").savefig(path)
        written.append(path.read_bytes())
    assert written[0] == written[1]
    assert len(written[0]) > 5000


@pytest.mark.parametrize("name", ["run", "norms", "monte carlo"])
def test_pdf_has_truetype_fonts_and_no_date_whatever_the_caller_s_settings(runs, tmp_path, name):
    with mpl.rc_context({"pdf.fonttype": 3}):
        FIGURES[name](runs, "column").savefig(tmp_path / "a.pdf")
        assert mpl.rcParams["pdf.fonttype"] == 3
    text = (tmp_path / "a.pdf").read_bytes()
    assert b"/Type3" not in text
    assert b"CIDFontType2" in text or b"/TrueType" in text
    assert b"CreationDate" not in text
    assert re.search(rb"/MediaBox \[ 0 0 252 ", text)
    # A plain figure has both: the test would see them.
    Figure().savefig(tmp_path / "b.pdf")
    assert b"CreationDate" in (tmp_path / "b.pdf").read_bytes()


def test_metadata_of_the_caller_is_kept(runs, tmp_path):
    runs["mean"].plot().savefig(tmp_path / "a.pdf", metadata={"Title": "Mine"})
    assert b"(Mine)" in (tmp_path / "a.pdf").read_bytes()


def test_pgf_needs_no_tex_and_escapes_what_tex_would_take_for_commands(runs, tmp_path, monkeypatch):
    def no_tex(*_):
        raise AssertionError("asked TeX")

    monkeypatch.setattr(backend_pgf.LatexManager, "_get_cached_or_new", no_tex)
    runs["averaged"].plot("50 % of $x_1 & 'ε'").savefig(tmp_path / "run.pgf")
    text = (tmp_path / "run.pgf").read_text(encoding="utf-8")
    assert r"50 \% of \$x\_1 \& '\ensuremath{\epsilon}'" in text
    assert r"x\ensuremath{_{1}}" in text
    assert "time (s)" in text
    assert text.count("{") == text.count("}")
    assert text.isascii()


def test_what_is_a_raster_lies_beside_the_pgf_file(tmp_path):
    figure = new_figure(3.0, 2.0)
    axes = figure.subplots()
    axes.pcolormesh(np.arange(12.0).reshape(3, 4), rasterized=True)
    figure.savefig(tmp_path / "map.pgf")
    pictures = sorted(path.name for path in tmp_path.glob("*.png"))
    assert pictures == ["map-0.png"]
    text = (tmp_path / "map.pgf").read_text(encoding="utf-8")
    assert len(re.findall(r"\\includegraphics\[[^]]*\]\{map-0.png\}", text)) == 1


@pytest.mark.skipif(not shutil.which("pdflatex"), reason="needs pdflatex with pgf and booktabs")
@pytest.mark.long
def test_latex_takes_figures_and_tables(runs, tmp_path):
    for name in ("run", "norms", "monte carlo", "bands"):
        FIGURES[name](runs, "column").savefig(tmp_path / f"{name.replace(' ', '-')}.pgf")
    hard = ["∫|x₁|² ≤ 5 % & $3 #1 {a} ~^\\ σ⁻¹ λΛ “q” – … ′ × ∞ √ ° ᵀ ℓ → ± <>", "1", "µ"]
    (tmp_path / "table.tex").write_text(booktabs(hard[:2], [hard[:2]], ["said"]), encoding="utf-8")
    inputs = "\n\n".join(f"\\input{{{p.name}}}" for p in sorted(tmp_path.glob("*.[pt][ge][fx]")))
    (tmp_path / "doc.tex").write_text(
        "\\documentclass{article}\\usepackage{pgf,graphicx,booktabs}\\begin{document}\n"
        + inputs
        + "\n\\end{document}\n"
    )
    command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "doc.tex"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:]


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("a_b & 5 % of $3 #1 {x}", r"a\_b \& 5 \% of \$3 \#1 \{x\}"),
        ("x₁² − 1", r"x\ensuremath{_{1}}\ensuremath{^{2}} \ensuremath{-} 1"),
        ("τ Λ λ", r"\ensuremath{\tau} \ensuremath{\Lambda} \ensuremath{\lambda}"),
        (r"C:\~^", r"C:\textbackslash{}\textasciitilde{}\textasciicircum{}"),
        ("Müller “q” – 1…", "Müller ``q'' -- 1\\ldots{}"),
        ("xᵀ s⁻¹", r"x\ensuremath{^{T}} s\ensuremath{^{-}}\ensuremath{^{1}}"),
    ],
)
def test_text_is_escaped_for_latex(text, wanted):
    assert latex(text) == wanted
