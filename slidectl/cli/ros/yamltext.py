"""YAML of a command line, a file or stdin, with PyYAML's own report where it is wrong, as the ROS tools print it.

Reading is done by cli.values; PyYAML is asked again only for the report.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, TextIO

from slidectl.cli import values
from slidectl.cli.values import bounded
from slidectl.errors import SlidectlError


class NotYaml(Exception):
    """Text that is no YAML, or holds what no message can. Its text is the report."""


def read(text: str) -> Any:
    """The value of one document. Raises NotYaml."""
    try:
        return values.read(text)
    except SlidectlError as error:
        raise NotYaml(_report(text.rstrip("\n")) or str(error)) from None


def read_file(file: TextIO) -> list[Any]:
    """The values of all documents of an open file. Raises NotYaml."""
    import yaml

    text = file.read()
    try:
        return list(values.read_documents(text, "file"))
    except SlidectlError as error:
        file.seek(0)
        try:
            list(yaml.safe_load_all(file))  # read as a file its reports name it
        except yaml.YAMLError as problem:
            raise NotYaml(str(problem)) from None
        raise NotYaml(str(error)) from None


def documents(file: TextIO) -> Iterator[Any]:
    """The values of documents that `---` ends, as they come; the last one needs none. Raises NotYaml, BadFile."""
    pending: list[str] = []
    for line in bounded(file, "stdin"):
        if line.rstrip() == "---":
            if any(line.strip() for line in pending):
                yield read("".join(pending))
            pending = []
        else:
            pending.append(line)
    if any(line.strip() for line in pending):
        yield read("".join(pending))


def _report(text: str) -> str:
    import yaml

    try:
        yaml.safe_load(text)
    except yaml.YAMLError as error:
        return str(error)
    except (ValueError, RecursionError) as error:
        return str(error)
    return ""
