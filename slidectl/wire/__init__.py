"""The protocol between the daemon and its clients, without input and output: lines, messages, peers, bounds.

The blocking client, the asyncio client, the client in a world's own process and the daemon's sessions use it, so that
each rule of docs/protocol.md stands once. Nothing here opens, reads or waits: no socket, no select, no asyncio.
"""
