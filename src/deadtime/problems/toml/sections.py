"""Sections of a TOML file, the types of their keys, and registries of such sections."""

from __future__ import annotations

import pkgutil
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from importlib import import_module
from inspect import signature
from types import ModuleType
from typing import TYPE_CHECKING, Annotated, Any, NoReturn, TypeVar, get_args

import numpy as np
from pydantic import BaseModel, ConfigDict, FailFast, Field
from pydantic.fields import FieldInfo

from deadtime.base.errors import ArgumentError


class First(FailFast):
    """Stops at the first fault of a list; unlike `FailFast`, it may be inside a union."""

    __hash__ = object.__hash__  # pyright: ignore[reportAssignmentType]


Vector = Annotated[list[float], First()]
Matrix = Annotated[list[Vector], First()]
Matrices = Annotated[list[Matrix], First()]
Poles = Annotated[list[float | str], First()]
PolesPerMode = Annotated[list[Poles], First()]
Texts = Annotated[list[str], First()]
NotNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
Probability = Annotated[float, Field(ge=0.0, lt=1.0)]
Count = Annotated[int, Field(strict=True, ge=0)]


@dataclass(frozen=True)
class ModeKey:
    """A note on a key that takes modes by number or by name; `words` are names of no mode."""

    words: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Shape:
    """A note on a field whose value is a list (immutable).

    Attributes
    ----------
    form : str
        The shape in messages, such as ``(modes, n, n)``; or a description.
    example : list
        A value that fits.

    Examples
    --------
    >>> Shape("(n,)", [1.0, 0.0]).axes, Shape("a number or (n,)", [1.0]).is_array
    (1, False)
    """

    form: str
    example: Any

    @property
    def is_array(self) -> bool:
        """Whether the value must be an array of numbers."""
        return self.form.startswith("(") and self.form.endswith(")") and " or " not in self.form

    @property
    def axes(self) -> int:
        """Depth of its lists."""
        return np.ndim(self.example)


if TYPE_CHECKING:
    Mode = int  # a number once `with_mode_numbers` has been applied
else:
    Mode = Annotated[int | str, ModeKey(), Shape("the number of a mode, or its name in [plant]", 0)]


class Section(BaseModel):
    """A table that refuses keys it does not know."""

    model_config = ConfigDict(extra="forbid", strict=False, title=None)


class DistributionSection(Section):
    """A distribution of scipy.stats by its name there, with its parameters."""

    model_config = ConfigDict(extra="allow", strict=False, title=None)

    __pydantic_extra__: dict[str, float]  # pyright: ignore[reportIncompatibleVariableOverride]

    distribution: str = Field(description='Name in scipy.stats, such as "expon" or "gamma".')


def frozen(name: str, given: DistributionSection) -> Any:
    """The frozen scipy.stats distribution that a section names."""
    from scipy import stats

    kind = getattr(stats, given.distribution, None)
    if not isinstance(kind, stats.rv_continuous | stats.rv_discrete):
        raise ArgumentError(
            f"{name}: distribution must be the name of one in scipy.stats, such as expon, "
            f"gamma, weibull_min, uniform, got {given.distribution!r}."
        )
    try:
        return kind(**(given.model_extra or {}))
    except TypeError:
        shapes = kind.shapes.split(", ") if kind.shapes else []
        known = ", ".join([*shapes, "loc", "scale"])
        raise ArgumentError(
            f"{name}: {given.distribution} takes the parameters {known}, got "
            f"{sorted(given.model_extra or {})}."
        ) from None


N = TypeVar("N")


def note_of(field: FieldInfo, kind: type[N]) -> N | None:
    """The outermost note of a kind on a field, or on what its type contains."""
    parts: list[Any] = [*field.metadata, field.annotation]
    for part in parts:  # which grows: outer parts come first
        if isinstance(part, kind):
            return part
        parts += [*getattr(part, "__metadata__", ()), *get_args(part)]
    return None


S = TypeVar("S", bound=Section)


def modules_of(package: ModuleType) -> Iterator[ModuleType]:
    """The files of a package, in the order of their names."""
    for name in sorted(info.name for info in pkgutil.iter_modules(package.__path__)):
        yield import_module(f"{package.__name__}.{name}")


def kinds_of(entry: type[BaseModel]) -> tuple[str, ...]:
    """The allowed texts of an entry's `kind`: one, if it is complete."""
    kind = entry.model_fields.get("kind")
    return () if kind is None else get_args(kind.annotation)


def refuse(what: str, entry: type[Section], why: str) -> NoReturn:
    """An error that names the entry."""
    raise ArgumentError(f"{what} entry {entry.__name__} in {entry.__module__} {why}")


def collect(
    what: str,
    base: type[S],
    modules: Iterable[ModuleType],
    require_whole: Callable[[type[S]], None] = lambda entry: None,
    names_of: Callable[[type[S]], Iterable[str]] = lambda entry: (),
) -> tuple[type[S], ...]:
    """The subclasses of `base` that some modules define, in their order there.

    Parameters
    ----------
    what : str
        Noun of the entries, for messages.
    base : type
        A section; its entries need a `kind`, a docstring and its abstract methods.
    modules : iterable of modules
    require_whole : callable, optional
        Refuses an entry that lacks something else.
    names_of : callable, optional
        The names that no two entries may share.

    Raises
    ------
    ArgumentError
        If a module has no entry, or an entry is incomplete or repeats a name of another.
    """
    entries: list[type[S]] = []
    for module in modules:
        own = [one for one in vars(module).values() if _is_entry(one, base, module)]
        if not own:
            raise ArgumentError(
                f"{module.__name__} holds no entry of {what}s: write a subclass of {base.__name__}."
            )
        for entry in own:
            _require_kind(what, entry)
            for lacking in sorted(entry.__abstractmethods__):
                call = f"{lacking}({', '.join(signature(getattr(entry, lacking)).parameters)})"
                refuse(what, entry, f"lacks {call}: define it, as {base.__name__} says.")
            require_whole(entry)
            for other in entries:
                _require_apart(what, entry, other, names_of)
            entries.append(entry)
    return tuple(entries)


def _is_entry(one: object, base: type[Section], module: ModuleType) -> bool:
    own = isinstance(one, type) and issubclass(one, base)
    return own and one.__module__ == module.__name__


def _require_kind(what: str, entry: type[Section]) -> None:
    """Refuse an entry without a kind for files, or a docstring for editors."""
    kinds = kinds_of(entry)
    if len(kinds) != 1 or not isinstance(kinds[0], str):
        refuse(what, entry, 'lacks its kind: write kind: Literal["…"], what problem files call it.')
    if not vars(entry).get("__doc__"):
        refuse(what, entry, "lacks a docstring: write a line, which editors show beside the kind.")


def _require_apart(
    what: str, entry: type[S], other: type[S], names_of: Callable[[type[S]], Iterable[str]]
) -> None:
    """Refuse an entry with the kind or a name of another."""
    kind, names = kinds_of(entry)[0], set(names_of(other))
    theirs = f"which {other.__name__} has: choose another."
    if kind == kinds_of(other)[0]:
        refuse(what, entry, f"takes the kind {kind!r}, {theirs}")
    if entry.__name__ == other.__name__:
        refuse(what, entry, f"takes the class name of that in {other.__module__}: choose another.")
    for name in names_of(entry):
        if name in names:
            refuse(what, entry, f"takes the name {name!r}, {theirs}")
