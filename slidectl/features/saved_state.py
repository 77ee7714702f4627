"""The state of objects as plain data: saved from all objects below a root, and restored.

There is one rule for each kind of value. Of an object the attributes are saved that its class declares (see
control/saved_classes.py), else all. Not saved is what other code creates: a state is restored into objects that were
created in the same way. A value without a rule is an error that names the attribute. Several references to one object
stay references to one object. No class is looked up by a name from a file, except those in `RECREATED` and those of
loaded user modules.
"""

from __future__ import annotations

import random
import reprlib
import sys
from array import array
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import is_dataclass
from enum import Enum
from functools import cache, partial
from types import BuiltinFunctionType, FunctionType, MethodType, ModuleType
from typing import Any, NamedTuple

import numpy as np

from slidectl.control import user_modules
from slidectl.control.saved_classes import RECREATED
from slidectl.control.user_classes import is_of_a_user, watched_for
from slidectl.errors import Refused, SlidectlError, listing
from slidectl.simulation.clock import NEVER, Timer, Timers
from slidectl.simulation.topics import TopicPublisher

_STRUCTURE = (ModuleType, type)
"""Objects of these are not saved where an attribute refers to them."""

NUMBER_TYPES: dict[str, np.dtype[Any]] = {
    kind.str: kind for code in "?bBhHiIlLqQefdgFDG" for kind in (np.dtype(code), np.dtype(code).newbyteorder())
}
"""The types of numbers in arrays, by NumPy's name. NumPy's own reader of names takes far more than names."""
_SCALARS = frozenset((bool, int, float, str, bytes, type(None)))
_FUNCTIONS = (FunctionType, BuiltinFunctionType, partial)
_HINT = "leave it out of the class, or give the class save_state and load_state"


class Ref(NamedTuple):
    """An object of the state, as its index in the entries."""

    number: int


class Method(NamedTuple):
    """A method of an object of the state."""

    owner: Ref
    name: str


class Named(NamedTuple):
    """A member of an enumeration or a tuple of a class, by the name of the class; or a function, by its own name."""

    name: str
    value: Any


class SavedObject(NamedTuple):
    """One object: the name of its class, and its content."""

    kind: str
    content: Any


_RESERVED = SavedObject("", None)
"""The entry of an object while its content is being saved."""


class NotSaved:
    """The class of NOT_SAVED, the saved form of other values."""


NOT_SAVED = NotSaved()


class CannotSave(Refused):
    """The value at `path` is of a kind that a snapshot cannot hold."""

    def __init__(self, what: str, path: str = "") -> None:
        super().__init__(f"cannot save {path}: it is {what}", _HINT)
        self._what = what
        self._path = path

    def below(self, owner: str) -> CannotSave:
        """The same error, with `owner` put before the path."""
        return CannotSave(self._what, f"{owner}.{self._path}" if self._path else owner)


# -- saving ------------------------------------------------------------------------------------------------------------


_NOT_CLASSES = ("frozenset", "numpy")
"""Names of Named values that are no named tuples."""


class Saving:
    """Saves values with `value`; the objects that they refer to are in `entries`."""

    def __init__(self) -> None:
        self.entries: list[SavedObject] = []
        self._numbers: dict[int, Ref] = {}
        self._alive: list[Any] = []
        """Keeps the objects alive: otherwise a new object could get the id() of a dead one."""

    def value(self, value: Any, of_user: bool = False) -> Any:
        """The saved form. `of_user`: the value belongs to an object of a user's class. Raises CannotSave."""
        kind = type(value)
        return value if kind in _SCALARS else rule_of(kind).save(self, value, of_user)

    def values(self, values: Mapping[Any, Any], of_user: bool) -> dict[Any, Any]:
        """The saved form of attributes, or of a mapping."""
        saved = {}
        for name, value in values.items():
            try:
                key = name if type(name) in _SCALARS else self.element(name, of_user)
                saved[key] = value if type(value) in _SCALARS else self.value(value, of_user)
            except CannotSave as error:
                raise error.below(str(name)) from None
        return saved

    def element(self, value: Any, of_user: bool) -> Any:
        """The saved form of a key or of a set's element. It must be saved: nothing else tells which ones exist."""
        saved = self.value(value, of_user)
        if saved is NOT_SAVED:
            raise CannotSave(f"a {type(value).__qualname__} that is a key, or in a set")
        return saved

    def object(self, value: Any, content: Callable[[], Any]) -> Ref:
        """The number of the object's entry, which is created at the first reference."""
        ref = self._numbers.get(id(value))
        if ref is None:
            ref = self._numbers[id(value)] = Ref(len(self.entries))
            self._alive.append(value)
            self.entries.append(_RESERVED)
            self.entries[ref.number] = SavedObject(type(value).__qualname__, content())
        return ref


# -- restoring ---------------------------------------------------------------------------------------------------------


def _kinds(entries: Sequence[SavedObject], state: Any) -> Counter[str]:
    """How many objects and named tuples of each class a saved state holds."""
    found: dict[int, str] = {}
    named: Counter[str] = Counter()
    left = [state]
    while left:
        one = left.pop()
        if type(one) is Ref:
            if one.number not in found:
                found[one.number], content = entries[one.number]
                left.append(content)
        elif isinstance(one, dict):
            left += [*one, *one.values()]
        elif isinstance(one, tuple | list):
            if type(one) is Named and isinstance(one.value, tuple) and one.name not in _NOT_CLASSES:
                named[one.name] += 1
            left += one
    return named + Counter(found.values())


class Restoring:
    """Restores saved values into the present objects with `value`; `finish` must follow."""

    def __init__(self, entries: list[SavedObject], timers: Timers, users: list[ModuleType]) -> None:
        """`users` are the modules in which classes of objects to create are looked up."""
        self._entries = entries
        self._timers = timers
        self._users = users
        self._found: list[Any] = [None] * len(entries)
        self._used: set[int] = set()
        self.set_timers: list[tuple[int, int, Timer]] = []
        """Timers to set: (the number that defines the order, due time in ns, timer)."""
        self.latched: list[TopicPublisher] = []
        """Publishers whose latched message has changed."""
        self.later: list[Callable[[], None]] = []
        """Called when all objects have their values."""

    def check_complete(self, saved: Any, live: Any) -> None:
        """Raise Refused when a state lacks an object that there is now, and that no later restore could make again."""
        saving = Saving()
        present = saving.value(live)
        lost = _kinds(saving.entries, present) - _kinds(self._entries, saved)
        if gone := [kind for kind in lost if kind not in _MAKERS and self._made_class(kind) is None]:
            raise Refused(f"the snapshot lacks what there is now: {listing(gone)}")

    def finish(self) -> None:
        """Set the timers in the saved order, and send latched messages to subscribers."""
        for load in self.later:
            load()
        for _, due_ns, timer in sorted(self.set_timers, key=lambda entry: entry[0]):
            self._timers.arm(timer, due_ns)
        for publisher in self.latched:
            if (last := publisher.last) is None:
                continue
            for callback in publisher.topic.callbacks:
                with suppress(SlidectlError):
                    callback(last)

    def value(self, saved: Any, live: Any) -> Any:
        """Restore a saved value into the present one. Raises Refused: no match."""
        kind = type(saved)
        if kind is Ref:
            return self._object(saved.number, live)
        if kind is tuple:
            lives = live if isinstance(live, tuple) and len(live) == len(saved) else [None] * len(saved)
            return tuple(map(self.value, saved, lives))
        if kind is NotSaved:
            return live
        if kind is Method:
            owner = self.value(saved.owner, getattr(live, "__self__", None))
            return live if getattr(live, "__name__", "") == saved.name else _method(owner, saved.name)
        if kind is Named:
            return self._named(saved, live)
        return saved

    def values(self, saved: Mapping[Any, Any], live: Mapping[Any, Any]) -> dict[Any, Any]:
        """The restored values of a mapping."""
        keys = self.in_order(list(saved), list(live))
        return {key: self.value(value, live.get(key)) for key, value in zip(keys, saved.values(), strict=True)}

    def in_order(self, saved: Sequence[Any], live: Sequence[Any]) -> list[Any]:
        """The restored elements of a sequence, in order. Live objects that were matched before are skipped."""
        rest = iter([one for one in live if id(one) not in self._used])
        return [
            self._found[one.number]
            if type(one) is Ref and self._found[one.number] is not None
            else self.value(one, next(rest, None))
            for one in saved
        ]

    def _object(self, number: int, live: Any) -> Any:
        found = self._found[number]
        if found is None:
            kind, content = self._entries[number]
            if type(live).__qualname__ != kind or id(live) in self._used or kind in RECREATED:
                if kind in _MAKERS:
                    live = _MAKERS[kind](content)
                else:
                    cls = self._class(kind)
                    live = cls.__new__(cls)
            rule = rule_of(type(live))
            found = self._found[number] = rule.fit(live, content)
            self._used.add(id(found))
            rule.fill(self, found, content)
        return found

    def _class(self, name: str) -> Any:
        """Find a class by name. Raises Refused."""
        cls = self._made_class(name)
        if cls is None:
            raise Refused(f"the snapshot has a {name} where there is none, and none can be created", _HINT)
        return cls

    def _made_class(self, name: str) -> type | None:
        """The class with this name, if objects of it can be created. Classes that a user module only imports are
        excluded: their constructor may do anything."""
        known = [RECREATED.get(name), *(vars(module).get(name) for module in self._users)]
        places = {*(module.__name__ for module in self._users)}
        for cls in known:
            if isinstance(cls, type) and (cls in RECREATED.values() or cls.__module__ in places):
                return cls
        return None

    def _named(self, saved: Named, live: Any) -> Any:
        name, value = saved
        if isinstance(live, _FUNCTIONS):
            if name != getattr(live, "__qualname__", ""):
                raise Refused(f"the snapshot has the function {name} where there is {live!r}", _HINT)
            return live
        if name == "frozenset":
            return frozenset(self.value(one, None) for one in value)
        if name == "numpy":
            return NUMBER_TYPES[value[0]].type(value[1])
        cls: Any = type(live) if type(live).__qualname__ == name else self._class(name)
        if issubclass(cls, Enum):
            return cls(value)
        lives = live if isinstance(live, cls) and len(live) == len(value) else [None] * len(value)
        return tuple.__new__(cls, map(self.value, value, lives))


def _method(owner: Any, name: str) -> Any:
    """The method. Raises Refused unless the owner is a user's object: only these keep methods in attributes."""
    if not is_of_a_user(type(owner)) or name.startswith("_"):
        raise Refused(f"the snapshot has the method {name} of {type(owner).__name__} where there is another")
    return getattr(owner, name)


# -- the rules ---------------------------------------------------------------------------------------------------------


class Rule:
    """Saves and restores values of one class. This base is for values that are not saved."""

    def save(self, saving: Saving, value: Any, of_user: bool) -> Any:  # noqa: ARG002
        """The saved form of a value; Ref for an object that has an entry."""
        return NOT_SAVED

    def fit(self, live: Any, content: Any) -> Any:  # noqa: ARG002
        """The object that receives the content: the present one, or a new one of the right size."""
        return live

    def fill(self, restoring: Restoring, live: Any, content: Any) -> None:
        """Restore the content of an entry into `live`."""


class _Unknown(Rule):
    def save(self, saving: Saving, value: Any, of_user: bool) -> Any:  # noqa: ARG002
        cls = type(value)
        raise CannotSave(f"a {cls.__module__}.{cls.__qualname__}")


class _Function(Rule):
    def save(self, saving: Saving, value: Any, of_user: bool) -> Any:  # noqa: ARG002
        if not of_user:
            return NOT_SAVED
        if getattr(value, "__closure__", None) or isinstance(value, partial):
            raise CannotSave("a function that holds values of its own")
        return Named(value.__qualname__, None)


class _BoundMethod(Rule):
    def save(self, saving: Saving, value: Any, of_user: bool) -> Any:
        owner = saving.value(value.__self__, of_user)
        return Method(owner, value.__name__) if isinstance(owner, Ref) else NOT_SAVED


class _Constant(Rule):
    """Enumeration members, numpy numbers and frozen sets."""

    def save(self, saving: Saving, value: Any, of_user: bool) -> Any:
        if isinstance(value, Enum):
            return Named(type(value).__qualname__, value.value)
        if isinstance(value, np.generic):
            return Named("numpy", (value.dtype.str, value.item()))
        return Named("frozenset", tuple(saving.value(one, of_user) for one in value))


class _Tuple(Rule):
    def save(self, saving: Saving, value: Any, of_user: bool) -> Any:
        saved = tuple(saving.value(one, of_user) for one in value)
        if saved and all(one is NOT_SAVED for one in saved):
            return NOT_SAVED
        return saved if type(value) is tuple else Named(type(value).__qualname__, saved)


class _List(Rule):
    def save(self, saving: Saving, value: Any, of_user: bool) -> Any:
        return saving.object(value, lambda: [saving.value(one, of_user) for one in value])

    def fill(self, restoring: Restoring, live: Any, content: Any) -> None:
        new = restoring.in_order(content, live)
        live.clear()
        live.extend(new)


class _Deque(_List):
    def save(self, saving: Saving, value: Any, of_user: bool) -> Any:
        return saving.object(value, lambda: [value.maxlen, *(saving.value(one, of_user) for one in value)])

    def fill(self, restoring: Restoring, live: Any, content: Any) -> None:
        super().fill(restoring, live, content[1:])


class _Dict(Rule):
    def save(self, saving: Saving, value: Any, of_user: bool) -> Any:
        return saving.object(value, lambda: saving.values(value, of_user))

    def fill(self, restoring: Restoring, live: Any, content: Any) -> None:
        new = restoring.values(content, live)
        live.clear()
        live.update(new)


class _Set(Rule):
    def save(self, saving: Saving, value: Any, of_user: bool) -> Any:
        return saving.object(value, lambda: [saving.element(one, of_user) for one in value])

    def fill(self, restoring: Restoring, live: Any, content: Any) -> None:
        new = [restoring.value(one, None) for one in content]
        live.clear()
        live.update(new)


class _Numbers(Rule):
    """Arrays, and memory views of them. Of equal size they stay in place: other code may use that memory."""

    def save(self, saving: Saving, value: Any, of_user: bool) -> Any:  # noqa: ARG002
        numbers = np.asarray(value)
        if numbers.dtype.kind not in "?biufc":
            raise CannotSave(f"an array of {numbers.dtype}")
        return saving.object(value, numbers.copy)

    def fit(self, live: Any, content: Any) -> Any:
        there = np.asarray(live)
        if there.shape == content.shape and there.dtype == content.dtype and there.flags.writeable:
            return live
        if isinstance(live, array):
            return _MAKERS["array"](content)
        return _MAKERS["memoryview" if isinstance(live, memoryview) else "ndarray"](content)

    def fill(self, restoring: Restoring, live: Any, content: Any) -> None:  # noqa: ARG002
        np.asarray(live)[...] = content


class _RandomNumbers(Rule):
    def save(self, saving: Saving, value: Any, of_user: bool) -> Any:  # noqa: ARG002
        is_python = isinstance(value, random.Random)
        return saving.object(value, value.getstate if is_python else lambda: value.bit_generator.state)

    def fill(self, restoring: Restoring, live: Any, content: Any) -> None:  # noqa: ARG002
        if isinstance(live, random.Random):
            live.setstate(content)
        else:
            live.bit_generator.state = content


class _SetTimer(Rule):
    def save(self, saving: Saving, value: Any, of_user: bool) -> Any:  # noqa: ARG002
        return saving.object(value, lambda: (value.active, value.due_ns, value.number))

    def fill(self, restoring: Restoring, live: Any, content: Any) -> None:
        is_active, due_ns, number = content
        if not all(type(one) is int and -NEVER <= one <= NEVER for one in (due_ns, number)):
            raise Refused(f"a timer of the snapshot is due at {reprlib.repr(due_ns)}, as number {reprlib.repr(number)}")
        live.cancel()
        if is_active:
            restoring.set_timers.append((number, due_ns, live))


class _Publisher(Rule):
    """The number of a publisher's next message, and the latched message, which is never modified."""

    def save(self, saving: Saving, value: Any, of_user: bool) -> Any:  # noqa: ARG002
        return saving.object(value, lambda: (value.sequence, value.last))

    def fill(self, restoring: Restoring, live: Any, content: Any) -> None:
        sequence, last = content
        if type(sequence) is not int:
            raise Refused(f"the number of a message in the snapshot is {reprlib.repr(sequence)}")
        live.sequence = sequence
        if last is not live.last and last != live.last:
            live.last = last
            restoring.latched.append(live)


class _Attributes(Rule):
    """Objects of classes written in Python: the attributes that the class declares, or all."""

    def __init__(self, cls: type, is_declared: bool) -> None:
        self._has_all = not is_declared
        self._or_none = _named_by(cls, "saved_or_none")
        slots = _named_by(cls, "__slots__")
        self._names = [*_named_by(cls, "saved_attributes"), *self._or_none] if is_declared else slots
        self._of_user = is_of_a_user(cls)
        self._methods = {name for name in dir(cls) if name.startswith("__") or callable(getattr(cls, name, None))}

    def save(self, saving: Saving, value: Any, of_user: bool) -> Any:  # noqa: ARG002
        return saving.object(value, lambda: saving.values(self._attributes(value), self._of_user))

    def fill(self, restoring: Restoring, live: Any, content: Any) -> None:
        for name, saved in content.items():
            before = getattr(live, name, None)
            new = saved if type(saved) in _SCALARS else restoring.value(saved, before)
            if new is not before or before is None:
                if not self._of_user:
                    self._check(live, name, before, new)
                setattr(live, name, new)
        if self._has_all:
            for name in vars(live).keys() - content.keys() if hasattr(live, "__dict__") else ():
                delattr(live, name)

    def _check(self, live: Any, name: str, before: Any, new: Any) -> None:
        """Raise Refused when our own class cannot have this state. Compiled code relies on it: it checks no types."""
        if name in self._methods if self._has_all else name not in self._names:
            raise Refused(f"the snapshot has a state of {name} of {type(live).__name__}, which has none")
        kind = type(before)
        is_kind = isinstance(new, kind) or (kind in (bool, float) and type(new) is int)
        is_kind |= kind not in _SCALARS and type(new) not in _SCALARS  # a list becomes an array
        is_kind |= new is None and (self._has_all or name in self._or_none)
        if not is_kind and before is not None:
            raise Refused(f"{name} of {type(live).__name__} is no {kind.__name__}, but {reprlib.repr(new)}")
        if type(new) is int and not -NEVER <= new <= NEVER:
            raise Refused(f"{name} of {type(live).__name__} is too large: {new}")

    def _attributes(self, value: Any) -> dict[str, Any]:
        found = {name: getattr(value, name) for name in self._names if hasattr(value, name)}
        return found | getattr(value, "__dict__", {}) if self._has_all else found


def _named_by(cls: type, declaration: str) -> list[str]:
    """The names in a declaration of the class and its bases, those of the bases first."""
    return [name for base in reversed(cls.__mro__) for name in vars(base).get(declaration) or ()]


class _OwnState(Rule):
    """Objects that define their own state."""

    def save(self, saving: Saving, value: Any, of_user: bool) -> Any:  # noqa: ARG002
        return saving.object(value, lambda: saving.value(_state_of(value), is_of_a_user(type(value))))

    def fill(self, restoring: Restoring, live: Any, content: Any) -> None:
        # The present state shows which objects the values go into. `load_state` is called last, when all other objects
        # are restored.
        state = restoring.value(content, _state_of(live))

        def load() -> None:
            with watched_for("load_state of", type(live).__name__, user_modules.active):
                live.load_state(state)

        restoring.later.append(load)


def _state_of(value: Any) -> Any:
    with watched_for("save_state of", type(value).__name__, user_modules.active):
        return value.save_state()


_MAKERS: dict[str, Callable[[Any], Any]] = {
    "list": lambda _: [],
    "dict": lambda _: {},
    "set": lambda _: set(),
    "deque": lambda content: deque(maxlen=content[0]),
    "array": lambda content: array(content.dtype.char, content.tobytes()),
    "ndarray": lambda content: content.copy(),
    "memoryview": lambda content: content.copy().data,
    "Random": lambda _: random.Random(),
}
"""Creates missing objects of these classes."""
_RULES: tuple[tuple[type | tuple[type, ...], Rule], ...] = (
    (_STRUCTURE, Rule()),
    (Timer, _SetTimer()),
    (TopicPublisher, _Publisher()),
    ((Enum, np.generic, frozenset), _Constant()),
    (tuple, _Tuple()),
    (list, _List()),
    (deque, _Deque()),
    (dict, _Dict()),
    (set, _Set()),
    ((np.ndarray, array, memoryview), _Numbers()),
    ((random.Random, np.random.Generator), _RandomNumbers()),
    (_FUNCTIONS, _Function()),
    (MethodType, _BoundMethod()),
)


def _rule_of(cls: Any) -> Rule:
    """The rule for objects of the class."""
    for base in cls.__mro__:
        declared = vars(base)
        if "saved_attributes" in declared and base.saved_attributes is None:
            return Rule()
        if not declared.keys().isdisjoint(("saved_attributes", "saved_or_none")):
            return _Attributes(cls, is_declared=True)
        if "save_state" in declared:
            break
    for bases, rule in _RULES:
        if issubclass(cls, bases):
            return rule
    package, _, rest = cls.__module__.partition(".")
    is_frozen = is_dataclass(cls) and getattr(cls, "__dataclass_params__").frozen  # noqa: B009
    if package == "slidectl" and (rest.startswith("description") or is_frozen):
        return Rule()
    if hasattr(cls, "save_state") and hasattr(cls, "load_state"):
        return _OwnState()
    has_attributes = "__dict__" in dir(cls) or any("__slots__" in vars(base) for base in cls.__mro__)
    is_library = package in sys.stdlib_module_names and package != "__main__"
    return _Attributes(cls, is_declared=False) if has_attributes and not is_library else _Unknown()


rule_of: Callable[[Any], Rule] = cache(_rule_of)
