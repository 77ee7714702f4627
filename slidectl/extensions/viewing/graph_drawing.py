"""The graph of nodes, topics and services of a daemon, as data, text, DOT, Mermaid and SVG (rqt_graph).

Nodes are ellipses, topics are boxes, services are boxes with round corners. The same graph gives the same bytes.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from html import escape
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

from slidectl import names
from slidectl.errors import UsageError
from slidectl.writing import file_kind

if TYPE_CHECKING:
    from slidectl.client import Client

_SWEEPS = 8
_CHARACTER, _ROW, _GAP, _MARGIN = 7.3, 36.0, 70.0, 16.0
"""SVG sizes in pixels: character width, row height, gap between columns, outer margin."""


class TopicUse(NamedTuple):
    """The type of a topic, with its publishers and subscribers."""

    type: str
    publishers: list[str]
    subscribers: list[str]


class NodeGraph(NamedTuple):
    """Node names; topic -> its use; service -> its node."""

    nodes: list[str]
    topics: dict[str, TopicUse]
    services: dict[str, str]

    def about(self, words: Iterable[str], namespace: str = "/") -> NodeGraph:
        """The part of the graph with these names, everything below them, and their direct neighbours.

        Each word is the name of a node, a topic, a service, or a namespace such as a robot's, or its unique end.

        Raises:
            UnknownName, AmbiguousName.
        """
        every = {*self.nodes, *self.topics, *self.services}
        known = every | {name[:end] for name in every for end in range(1, len(name)) if name[end] == "/"}
        chosen = [names.resolve(word, known, kind="node, topic or namespace", namespace=namespace) for word in words]

        def is_meant(name: str) -> bool:
            return any(names.is_under(name, one) for one in chosen)

        topics = {}
        for name, use in self.topics.items():
            ends = [[node for node in nodes if is_meant(name) or is_meant(node)] for nodes in use[1:]]
            if is_meant(name) or any(ends):
                topics[name] = TopicUse(use.type, *ends)
        services = {name: node for name, node in self.services.items() if is_meant(name) or is_meant(node)}
        return _of_users(topics, services)

    def without_services(self) -> NodeGraph:
        """The graph with topics and their nodes only."""
        return _of_users(self.topics, {})

    def as_data(self) -> dict[str, Any]:
        """`nodes`, `topics` (topic, type, publishers, subscribers) and `services` (service, node), each a list."""
        topics = [{"topic": name, **use._asdict()} for name, use in self.topics.items()]
        services = [{"service": name, "node": node} for name, node in self.services.items()]
        return {"nodes": self.nodes, "topics": topics, "services": services}

    def vertices(self) -> dict[str, _Vertex]:
        """Key -> vertex. The keys distinguish a node from a topic of the same name."""
        found = {f"n{name}": _Vertex(name, "node", "") for name in self.nodes}
        found |= {f"t{name}": _Vertex(name, "topic", use.type) for name, use in self.topics.items()}
        return found | {f"s{name}": _Vertex(name, "service", "") for name in self.services}

    def edges(self) -> Iterator[tuple[str, str]]:
        """Edges from publisher to topic, topic to subscriber, and node to service, as keys of the vertices."""
        for name, use in self.topics.items():
            yield from ((f"n{node}", f"t{name}") for node in use.publishers)
            yield from ((f"t{name}", f"n{node}") for node in use.subscribers)
        yield from ((f"n{node}", f"s{name}") for name, node in self.services.items())


class _Vertex(NamedTuple):
    label: str
    kind: str
    about: str


def read_graph(client: Client, *, timeout: float | None = None) -> NodeGraph:
    """Read the daemon's present graph; `timeout` limits each answer, in wall seconds. Raises NoDaemon, TimedOut."""
    listed = client.call("/rosapi/nodes", timeout=timeout)["nodes"]
    calls = {node: client.call_async("/rosapi/node_details", {"node": node}) for node in listed}
    details = {node: client.answer(call, timeout=timeout) for node, call in calls.items()}
    types = client.topics(timeout=timeout)

    def users(topic: str, key: str) -> list[str]:
        return [node for node, detail in details.items() if topic in detail[key]]

    topics = {
        name: TopicUse(kind, users(name, "publishing"), users(name, "subscribing"))
        for name, kind in sorted(types.items())
    }
    services = sorted((name, node) for node, detail in details.items() for name in detail["services"])
    return _of_users(topics, dict(services))


def _of_users(topics: dict[str, TopicUse], services: dict[str, str]) -> NodeGraph:
    nodes = {*services.values(), *(node for use in topics.values() for node in (*use.publishers, *use.subscribers))}
    return NodeGraph(sorted(nodes), topics, services)


# --- text -------------------------------------------------------------------------------------------------------------


def as_tree(graph: NodeGraph) -> str:
    """Each node with its topics, their types and the nodes at the other end, and its services."""
    lines = []
    for node in graph.nodes:
        lines.append(node)
        for title, own, sign, other in (
            ("publishes", "publishers", "->", "subscribers"),
            ("subscribes", "subscribers", "<-", "publishers"),
        ):
            used = {name: use for name, use in graph.topics.items() if node in getattr(use, own)}
            lines += [f"  {title}"] * bool(used)
            for name, use in used.items():
                ends = getattr(use, other)
                lines.append(f"    {name} [{use.type}]" + (f" {sign} {', '.join(ends)}" if ends else ""))
        provided = [name for name, provider in graph.services.items() if provider == node]
        lines += ["  provides"] * bool(provided) + [f"    {name}" for name in provided]
    return "\n".join(lines)


def as_dot(graph: NodeGraph) -> str:
    """The graph in Graphviz's DOT language."""
    shapes = {"node": "ellipse", "topic": "box", "service": 'box, style="rounded"'}
    return "\n".join(
        [
            "digraph graph_of_nodes {",
            "  rankdir=LR;",
            *(f'  "{key}" [label="{v.label}", shape={shapes[v.kind]}];' for key, v in graph.vertices().items()),
            *(f'  "{a}" -> "{b}"{" [style=dashed, dir=none]" * (b[0] == "s")};' for a, b in graph.edges()),
            "}\n",
        ]
    )


def as_mermaid(graph: NodeGraph) -> str:
    """The graph as a Mermaid flow chart."""
    shapes = {"node": '(["{}"])', "topic": '["{}"]', "service": '("{}")'}
    ids = {key: f"{key[0]}{number}" for number, key in enumerate(graph.vertices())}
    return "\n".join(
        [
            "flowchart LR",
            *(f"  {ids[key]}{shapes[v.kind].format(v.label)}" for key, v in graph.vertices().items()),
            *(f"  {ids[a]} {'-.-' if b[0] == 's' else '-->'} {ids[b]}" for a, b in graph.edges()),
            "",
        ]
    )


def as_markdown(graph: NodeGraph) -> str:
    """The Mermaid flow chart in a code block, as GitHub and GitLab render it."""
    return f"```mermaid\n{as_mermaid(graph)}```\n"


# --- SVG --------------------------------------------------------------------------------------------------------------

_Slot = str | tuple[str, str, int]
"""A vertex, or the position in a column that an edge between two vertices passes through."""


def as_svg(graph: NodeGraph) -> str:
    """An SVG with columns, publishers on the left and subscribers on the right."""
    vertices, edges = graph.vertices(), list(graph.edges())
    ranks = _ranks(list(vertices), edges)
    columns, ways = _columns(ranks, edges)
    _sort_columns(columns, ways)
    widths = [
        max(len(vertices[slot].label) for slot in column if isinstance(slot, str)) * _CHARACTER + 2 * _MARGIN
        for column in columns
    ]
    height = max(map(len, columns), default=0) * _ROW + 2 * _MARGIN
    places: dict[_Slot, tuple[float, float, float]] = {}
    left = _MARGIN
    for column, width in zip(columns, widths, strict=True):
        for slot, row in _rows(column).items():
            places[slot] = (left, left + width, height / 2 + row * _ROW)
        left += width + _GAP
    across, down = f"{max(left - _GAP, 0) + _MARGIN:.0f}", f"{height:.0f}"
    size = f'width="{across}" height="{down}" viewBox="0 0 {across} {down}"'
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" {size} font-family="monospace" font-size="12">',
        '<defs><marker id="arrow" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="8" markerHeight="8" orient="auto">'
        '<path d="M0 0L8 4L0 8z" fill="#666"/></marker></defs>',
        '<rect width="100%" height="100%" fill="#fff"/>',
    ]
    for (source, target), way in zip(edges, ways, strict=True):
        points = [(x, y) for slot in way for x0, x1, y in [places[slot]] for x in (x0, x1)][1:-1]
        if ranks[source] > ranks[target]:
            points.reverse()
        style = 'stroke-dasharray="4"' if target[0] == "s" else 'marker-end="url(#arrow)"'
        lines.append(f'<path d="{_curve(points)}" fill="none" stroke="#666" {style}/>')
    lines += (_drawn(vertex, *places[key]) for key, vertex in vertices.items())
    return "\n".join([*lines, "</svg>\n"])


def _ranks(vertices: Sequence[str], edges: Iterable[tuple[str, str]]) -> dict[str, int]:
    """The column of each vertex, so that edges point right. In each cycle at least one edge points left."""
    joined: defaultdict[str, list[str]] = defaultdict(list)
    for source, target in edges:
        joined[source].append(target)
        joined[target].append(source)
    waits_for = Counter(target for _, target in edges)
    left = dict.fromkeys(vertices, 0)
    ranks = {}
    while left:
        vertex = min(left, key=lambda one: waits_for[one])
        rank = ranks[vertex] = left.pop(vertex)
        for other in joined[vertex]:
            if other in left:
                waits_for[other] -= 1
                left[other] = max(left[other], rank + 1)
    return ranks


def _columns(ranks: dict[str, int], edges: Iterable[tuple[str, str]]) -> tuple[list[list[_Slot]], list[list[_Slot]]]:
    """The slots of each column, and the slots of each edge from left to right."""
    columns: list[list[_Slot]] = [[] for _ in range(max(ranks.values(), default=-1) + 1)]
    for vertex, rank in ranks.items():
        columns[rank].append(vertex)
    ways = []
    for edge in edges:
        first, last = sorted(edge, key=ranks.__getitem__)
        passes: list[_Slot] = [(first, last, rank) for rank in range(ranks[first] + 1, ranks[last])]
        for slot, rank in zip(passes, range(ranks[first] + 1, ranks[last]), strict=True):
            columns[rank].append(slot)
        ways.append([first, *passes, last])
    return columns, ways


def _sort_columns(columns: list[list[_Slot]], ways: Iterable[Sequence[_Slot]]) -> None:
    """Move each slot near the mean row of its neighbours, in both directions (barycentres, Sugiyama et al.)."""
    before: defaultdict[_Slot, list[_Slot]] = defaultdict(list)
    after: defaultdict[_Slot, list[_Slot]] = defaultdict(list)
    for way in ways:
        for one, other in pairwise(way):
            after[one].append(other)
            before[other].append(one)
    rows = {slot: row for column in columns for slot, row in _rows(column).items()}

    def middle(joined: dict[_Slot, list[_Slot]]) -> Callable[[_Slot], float]:
        return lambda slot: sum(rows[one] for one in joined[slot]) / len(joined[slot]) if joined[slot] else rows[slot]

    for sweep in range(_SWEEPS):
        for column in columns[1:] if sweep % 2 == 0 else columns[-2::-1]:
            column.sort(key=middle(before if sweep % 2 == 0 else after))
            rows |= _rows(column)


def _rows(column: Sequence[_Slot]) -> dict[_Slot, float]:
    """The row of each slot, 0 in the middle."""
    return {slot: index - (len(column) - 1) / 2 for index, slot in enumerate(column)}


def _curve(points: Sequence[tuple[float, float]]) -> str:
    """A path through the points, horizontal at each of them."""
    parts = [f"M{points[0][0]:.1f} {points[0][1]:.1f}"]
    for (x0, y0), (x1, y1) in pairwise(points):
        middle = (x0 + x1) / 2
        parts.append(f"C{middle:.1f} {y0:.1f} {middle:.1f} {y1:.1f} {x1:.1f} {y1:.1f}")
    return "".join(parts)


def _drawn(vertex: _Vertex, left: float, right: float, y: float) -> str:
    """The shape with its label, as wide as its column."""
    width, height = right - left, _ROW * 0.7
    if vertex.kind == "node":
        radii = f'rx="{width / 2:.1f}" ry="{height / 2:.1f}"'
        shape = f'<ellipse cx="{left + width / 2:.1f}" cy="{y:.1f}" {radii} fill="#dbe9f9" stroke="#36c"/>'
    else:
        corners, colour = ("0", "#eee") if vertex.kind == "topic" else ("8", "#fff")
        box = f'x="{left:.1f}" y="{y - height / 2:.1f}" width="{width:.1f}" height="{height:.1f}" rx="{corners}"'
        shape = f'<rect {box} fill="{colour}" stroke="#666"/>'
    text = f'<text x="{left + width / 2:.1f}" y="{y + 4:.1f}" text-anchor="middle">{escape(vertex.label)}</text>'
    return f"<g><title>{escape(vertex.about or vertex.kind)}</title>{shape}{text}</g>"


_WRITERS = {".svg": as_svg, ".dot": as_dot, ".md": as_markdown}


def writer_of(file: str) -> Callable[[NodeGraph], str]:
    """The function that makes the content of a file of that kind. Raises UsageError: unknown kind."""
    writer = _WRITERS.get(file_kind(file))
    if writer is None:
        raise UsageError(f"{file} is no kind of file that a graph is written to", f"kinds: {', '.join(_WRITERS)}")
    return writer
