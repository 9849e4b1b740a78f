"""The house: arrows point inwards, and importing the package stays light."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import deadtime as dt

SOURCE = Path(dt.__file__).parent

# Each ring may import from itself and from the rings before it.
RINGS = (
    ("errors", "checks", "frozen", "text_files", "wording", "version", "palette"),
    (
        *("plant", "switching", "steps", "lanes", "exponential", "covariance", "sampled"),
        *("sampled_plant", "cut_pieces"),
        *("feedback", "forecast"),
    ),
    ("imperfections",),
    (
        *("pole_placement", "gains", "observers", "tracking", "laws"),
        *("output_feedback", "spectrum", "lmi", "lyapunov", "stabilization"),
    ),
    ("simulation", "interop"),
    ("certificates", "backstepping", "controller", "export", "design"),
    ("monte_carlo", "robustness"),
    ("problems",),
    ("asked",),
    ("toml_file",),
    ("law_registry", "imperfection_registry"),
    (
        "comparison",
        "slips",
        "verdict",
        "plotting",
        "colours",
        "audit",
        "audit_plots",
        "constants_table",
    ),
    ("fit_plots", "fit_report", "certificate_table", "tightness"),
    (
        "margin_plots",
        "run_plots",
        "witness_plot",
        "robustness_plots",
        "design_plots",
        "design_table",
    ),
    ("monte_carlo_table", "monte_carlo_plots", "paired"),
    ("certificates_section",),
    ("report", "problem_file"),
    ("sweeps", "sweep_plots"),
    ("study",),
    ("app",),
    ("cli",),
    ("__main__",),
)
RING_OF = {name: level for level, ring in enumerate(RINGS) for name in ring}


def imports_of(path: Path) -> set[str]:
    """The parts of deadtime that a file imports, anywhere in it, but for type checking."""
    found = set()
    tree = ast.parse(path.read_text(encoding="utf-8"))
    hidden = {
        id(node)
        for block in ast.walk(tree)
        if isinstance(block, ast.If) and getattr(block.test, "id", "") == "TYPE_CHECKING"
        for node in ast.walk(block)
    }
    for node in ast.walk(tree):
        if id(node) in hidden:
            continue
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("deadtime"):
            parts = node.module.split(".")
            found |= {parts[1]} if len(parts) > 1 else {alias.name for alias in node.names}
    return found


def test_every_part_has_its_place_in_the_rings():
    parts = {p.stem if p.is_file() else p.name for p in SOURCE.iterdir()}
    assert parts - {"__init__", "__pycache__", "templates", "py"} <= set(RING_OF)


@pytest.mark.parametrize("path", sorted(SOURCE.rglob("*.py")), ids=lambda p: str(p.name))
def test_arrows_point_inwards(path):
    part = path.relative_to(SOURCE).parts[0].removesuffix(".py")
    if part == "__init__":
        return
    outward = {name for name in imports_of(path) if RING_OF.get(name, 0) > RING_OF[part]}
    # A trajectory draws itself on request: its `plot` method is the one arrow that goes out.
    allowed = {"plotting"} if path.name == "trajectory.py" else set()
    assert outward <= allowed


def test_import_loads_numpy_and_little_else():
    code = (
        "import sys, deadtime; "
        "heavy = {'scipy', 'numba', 'matplotlib', 'xarray', 'pandas', 'pydantic', 'rich', "
        "'cyclopts', 'control', 'jinja2', 'cvxpy', 'clarabel', 'flint', 'jax', "
        "'dask', 'distributed', 'zarr', 'panel', 'bokeh', 'tomlkit'}; "
        "print(sorted(heavy & set(sys.modules)))"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert result.stdout.strip() == "[]", result.stderr


def test_public_names_are_all_there():
    assert all(hasattr(dt, name) for name in dt.__all__)
    assert list(dt.__all__) == sorted(dt.__all__)
