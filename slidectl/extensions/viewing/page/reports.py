"""What the page shows that a command of slidectl makes too: the picture of the graph, and the file of gains."""

from __future__ import annotations

from typing import Any

import yaml

from slidectl import names
from slidectl.client import Client
from slidectl.description.parameter_trees import nest
from slidectl.extensions.viewing.graph_drawing import as_svg, read_graph

Message = dict[str, Any]


def graph_picture(client: Client, request: Message) -> Message:
    """The graph of nodes and topics as `svg`, around the names in `of` if there are some. Raises UnknownName."""
    graph = read_graph(client).without_services()
    words = str(request.get("of", "")).split()
    return {"svg": as_svg(graph.about(words) if words else graph)}


def gains_file(client: Client, request: Message) -> Message:
    """The parameters of the controllers in `namespace` as a `file` for `spawn --controllers`, with its `text`."""
    space = str(request["namespace"])
    manager = client.controllers(space)
    tree = {name: client.params[names.join(space, name)] for name in manager.configured()}
    text = yaml.safe_dump(nest(space, tree), sort_keys=False, allow_unicode=True)
    return {"file": f"{space.strip('/').replace('/', '_') or 'robot'}_control.yaml", "text": text}
