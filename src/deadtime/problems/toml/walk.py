"""From a place that pydantic reports to the key of the file and the field of the model there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from deadtime.problems.toml.lines import Path as Keys

_TYPES = {"float", "str", "int"}
Models = list[type[BaseModel]]


@dataclass(frozen=True)
class Place:
    """A key of a file (immutable).

    Attributes
    ----------
    path : tuple
        Keys, and numbers of tables in lists of tables.
    field : FieldInfo or None
        What the model says of the key; None of one that it does not know.
    siblings : tuple of str
        The keys that are known beside it.
    tables : bool
        Whether the key holds tables.
    listed : bool
        Whether it holds a list of them, and the path does not say which.
    item : tuple of int
        The number of an item, in a list of anything but tables.
    elsewhere : tuple of str
        The other kinds of the same section that know the key.
    """

    path: Keys
    field: FieldInfo | None
    siblings: tuple[str, ...]
    tables: bool
    listed: bool
    item: tuple[int, ...] = ()
    elsewhere: tuple[str, ...] = ()


def place_of(location: tuple[str | int, ...], model: type[BaseModel], known: bool = True) -> Place:
    """The key that a location of pydantic is about.

    Its names of types and of members of unions go, and so do numbers of items in a list of
    anything but tables: the key is what a reader looks for. Where the last part is a key that is
    not `known`, it stays, whatever it looks like.
    """
    path: list[str | int] = []
    models: Models = [model]
    others: Models = []
    around: Models = [model]
    field: FieldInfo | None = None
    item: list[int] = []
    for number, part in enumerate(location):
        if isinstance(part, int):
            (path if models else item).append(part)
            continue
        if (known or number < len(location) - 1) and _is_no_key(part, models):
            if chosen := _choose(part, models):
                models, others = chosen, [one for one in models if one not in chosen]
            continue
        fields = [one.model_fields[part] for one in models if part in one.model_fields]
        around, field = models or around, fields[0] if fields else None
        models = [inner for one in fields for inner in _models_in(one.annotation)]
        path.append(part)
    siblings = tuple(dict.fromkeys(name for one in around for name in one.model_fields))
    inside = bool(path) and isinstance(path[-1], int)
    listed = bool(models) and not inside and _is_list(field)
    elsewhere = [one for one in others if path and path[-1] in one.model_fields]
    kinds = tuple(kind for one in elsewhere for kind in _kinds_of(one))
    return Place(tuple(path), field, siblings, bool(models), listed, tuple(item), kinds)


def _kinds_of(model: type[BaseModel]) -> tuple[str, ...]:
    kind = model.model_fields.get("kind")
    return () if kind is None else getattr(kind.annotation, "__args__", ())


def _is_no_key(part: str, models: Models) -> bool:
    """Whether a part names a type or a member of a union."""
    return part in _TYPES or "[" in part or bool(_choose(part, models))


def _choose(part: str, models: Models) -> Models:
    """The models of a union that a part selects by their kind or their name, if it does."""
    named = [model for model in models if model.__name__ == part]
    if len(models) == 1:  # a kind was chosen before: the part is a key
        return named
    return named or [
        model
        for model in models
        if (kind := model.model_fields.get("kind")) is not None
        and part in getattr(kind.annotation, "__args__", ())
    ]


def _is_list(field: FieldInfo | None) -> bool:
    return field is not None and getattr(field.annotation, "__origin__", None) is list


def _models_in(annotation: Any) -> Models:
    """The models that a field may hold."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [m for part in getattr(annotation, "__args__", ()) for m in _models_in(part)]
