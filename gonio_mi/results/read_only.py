"""Dictionaries and lists, as JSON has them, that nobody can write into."""

from collections.abc import Mapping
from typing import Any, NoReturn

__all__ = ["ReadOnlyDict", "ReadOnlyList", "read_only"]


def _refuse(*_: object, **__: object) -> NoReturn:
    raise TypeError(
        "settings of a record cannot be changed: Record.with_settings returns another"
    )


_refused: Any = _refuse


class ReadOnlyDict(dict[str, Any]):
    """Dictionary that cannot change; equal to any dictionary of the same content."""

    __setitem__ = __delitem__ = __ior__ = _refused
    clear = pop = popitem = setdefault = update = _refused

    def __reduce__(self) -> tuple[Any, ...]:
        return ReadOnlyDict, (dict(self),)


class ReadOnlyList(list[Any]):
    """List that cannot change; equal to any list of the same content."""

    __setitem__ = __delitem__ = __iadd__ = __imul__ = _refused
    append = extend = insert = remove = pop = clear = sort = reverse = _refused

    def __reduce__(self) -> tuple[Any, ...]:
        return ReadOnlyList, (list(self),)


def read_only(value: Any) -> Any:
    """Copy of a value of JSON's types whose dictionaries and lists cannot change."""
    if isinstance(value, Mapping):
        return ReadOnlyDict({key: read_only(one) for key, one in value.items()})
    if isinstance(value, list):
        return ReadOnlyList(map(read_only, value))
    return value
