"""The lowest version of everything that deadtime needs, as constraints for pip; for `make lowest`.

What tests alone need (the extras docs, test and browser) is not held down.
"""

import re
import tomllib
from pathlib import Path

OF_USERS = ("app", "control", "fmi", "sweep")


def lowest(project: dict) -> list[str]:
    """name==version of every direct dependency, from name>=version."""
    extras = project["optional-dependencies"]
    needs = [*project["dependencies"], *(one for extra in OF_USERS for one in extras[extra])]
    found = {}
    for need in needs:
        match = re.fullmatch(r"([\w.-]+)>=([\w.]+)", need)
        if match is None:
            raise SystemExit(f"pyproject.toml: {need!r} must say name>=version.")
        found[match[1]] = match[2]
    return [f"{name}=={version}" for name, version in found.items()]


if __name__ == "__main__":
    text = (Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8")
    print("\n".join(lowest(tomllib.loads(text)["project"])))
