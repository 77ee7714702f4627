"""Short names in scripts, as the command line takes them: what a unique end of a name means to a daemon."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from slidectl import names
from slidectl.errors import UnknownName

if TYPE_CHECKING:
    from slidectl.client.client import Client


def topic(client: Client, name: str, role: str | None, namespace: str) -> str:
    """The topic that `name` means among those that have `role`. Raises UnknownName, AmbiguousName."""
    known = client.topics()
    near = [each for each in known if each.endswith("/" + name.strip("/"))]
    try:
        return names.resolve(name, _having(client, role, near), kind="topic", namespace=namespace)
    except UnknownName:
        return names.resolve(name, _having(client, role, known), kind="topic", namespace=namespace)


def _having(client: Client, role: str | None, topics: Iterable[str]) -> list[str]:
    if role is None:
        return list(topics)
    calls = {each: client.call_async(f"/rosapi/{role}", {"topic": each}) for each in topics}
    return [each for each, call_id in calls.items() if client.answer(call_id)[role]]


def service(client: Client, name: str, namespace: str) -> str:
    """The service that `name` means. Raises UnknownName, AmbiguousName."""
    known = client.call("/rosapi/services")["services"]
    return names.resolve(name, known, kind="service", namespace=namespace)
