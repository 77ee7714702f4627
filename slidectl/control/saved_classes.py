"""What a snapshot saves of an object: each class declares it, beside its attributes.

* `saved_attributes`: the names of the attributes that are saved; `saved_or_none`: of further ones, which may be None.
  The names of a class are added to those of its bases. What they do not name follows from the object's creation.
* `saved_attributes = None`: objects of the class are not saved where an attribute refers to them.
* `save_state()` and `load_state(state)`: the class defines its state itself.
* None of these: all attributes are saved.

features/saved_state.py reads these declarations. `recreated` is for classes whose objects come and go in a running
simulation.
"""

from __future__ import annotations

from typing import TypeVar

C = TypeVar("C", bound=type)

RECREATED: dict[str, type] = {}
"""Classes of objects that a restore creates again, by name."""


def recreated(cls: C) -> C:
    """Class decorator: objects of the class are created and dropped while a simulation runs. A restore creates them
    again, without a call of `__init__`."""
    RECREATED[cls.__qualname__] = cls
    return cls
