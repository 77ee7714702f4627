"""`slidectl graph`: show the graph of nodes, topics and services."""

from __future__ import annotations

import click

from slidectl.cli import completion, output
from slidectl.cli.commands import command
from slidectl.cli.context import Context
from slidectl.errors import UsageError
from slidectl.extensions.viewing import graph_drawing
from slidectl.writing import CannotWrite, write_whole


@command(
    examples=[
        "slidectl graph",
        "slidectl graph rrbot --mermaid",
        "slidectl graph -o graph.svg",
        "slidectl graph joint_states --json",
    ]
)
@click.argument("words", nargs=-1, metavar="[NAME...]", shell_complete=completion.topics)
@click.option("-a", "--all", "with_services", is_flag=True, help="Services too, and nodes that only provide those.")
@click.option("--dot", is_flag=True, help="For Graphviz.")
@click.option("--mermaid", is_flag=True, help="A flow chart of Mermaid.")
@click.option("-o", "--output", "file", metavar="FILE", shell_complete=completion.files,
              help="Into a file: .svg, .dot, or .md with Mermaid.")  # fmt: skip
@click.pass_obj
def graph(
    ctx: Context, words: tuple[str, ...], with_services: bool, dot: bool, mermaid: bool, file: str | None
) -> None:
    """Show the graph of nodes and topics.

    It is what rqt_graph draws. NAME is a node, a topic or a namespace, such as a robot's; then only these, what is
    below them, and what is joined to them are shown. JSON keys: nodes, topics (topic, type, publishers, subscribers),
    services (service, node; with --all).
    """
    if dot + mermaid + (file is not None) + (ctx.format != "text") > 1:
        raise UsageError("--dot, --mermaid, -o FILE and --json exclude each other")
    writer = None if file is None else graph_drawing.writer_of(file)
    found = graph_drawing.read_graph(ctx.client)
    found = found if with_services else found.without_services()
    if words:
        found = found.about(words, ctx.namespace)
    if dot or mermaid:
        output.write((graph_drawing.as_dot if dot else graph_drawing.as_mermaid)(found))
    elif file is None or writer is None:
        ctx.emit(found.as_data(), graph_drawing.as_tree(found))
    else:
        try:
            write_whole(file, writer(found))
        except OSError as error:
            raise CannotWrite(file, error) from None
        counts = [output.count(len(some), what) for what, some in (("node", found.nodes), ("topic", found.topics))]
        if with_services:
            counts.append(output.count(len(found.services), "service"))
        ctx.done({"file": file}, f"{file}: {', '.join(counts)}")
