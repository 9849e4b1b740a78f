"""Files of another folder stand in the packages of deadtime, as if they had been added there.

Python imports this module as it starts, where its folder is on the path; so do workers.
"""

import os
import sys
from importlib.machinery import PathFinder
from pathlib import Path

ADDED = Path(os.environ.get("DEADTIME_ADDED", "."))  # has a folder deadtime/


class Overlay:
    """Packages of deadtime are looked for in two places."""

    @staticmethod
    def find_spec(name, path=None, target=None):
        if name.partition(".")[0] != "deadtime":
            return None
        spec = PathFinder.find_spec(name, path, target)
        if spec is not None and spec.submodule_search_locations is not None:
            spec.submodule_search_locations.append(str(ADDED.joinpath(*name.split("."))))
        return spec


if "DEADTIME_ADDED" in os.environ:
    sys.meta_path.insert(0, Overlay)
