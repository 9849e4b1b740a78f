"""Units of a problem file: names with their units, as axes, tables and comments show them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from deadtime.base.errors import ArgumentError


def require_units(units: Mapping[str, str], names: Sequence[str]) -> None:
    """Refuse a unit of something that has no such name, that is empty, or that the name has.

    Examples
    --------
    >>> require_units({"speed": "m/s"}, ["position (m)", "speed"])
    >>> require_units({"sped": "m/s"}, ["position (m)", "speed"])
    Traceback (most recent call last):
    deadtime.ArgumentError: units must be of states, inputs or outputs, 'position (m)', 'speed', \
got 'sped': give that a name first, or correct it.
    """
    for name, unit in units.items():
        if name not in names:
            known = ", ".join(map(repr, dict.fromkeys(names))) or "of which none has a name"
            raise ArgumentError(
                f"units must be of states, inputs or outputs, {known}, got {name!r}: give that a "
                "name first, or correct it."
            )
        if not unit.strip():
            raise ArgumentError(f"units of {name!r} must not be empty: leave it out, or say 1.")
        if name.endswith(")"):
            raise ArgumentError(
                f"units of {name!r} must not be given twice, got {unit!r}, too: take what is in "
                "brackets out of the name."
            )


def labels(names: Sequence[str], units: Mapping[str, str]) -> tuple[str, ...]:
    """Names with their units in brackets, where they have some.

    Examples
    --------
    >>> labels(["position", "gear"], {"position": "m"})
    ('position (m)', 'gear')
    """
    return tuple(f"{name} ({units[name].strip()})" if name in units else name for name in names)
