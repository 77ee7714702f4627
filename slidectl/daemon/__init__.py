"""The daemon: the one loop between sockets and cycles, the wire protocol, and the life cycle of its process.

Importing this package imports nothing; the command line uses `lifecycle`.
"""
