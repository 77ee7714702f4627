"""Visualization: plots, pictures, the graph, and the web page in `page/`.

Each tool is a client of the daemon in a process of its own. Drawing libraries are extras and imported on use.
"""
