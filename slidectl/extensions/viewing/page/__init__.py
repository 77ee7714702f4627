"""The web page that shows the world. Its server is a process of its own and a client of the daemon.

It uses the library viser (extra `view`). All communication with the daemon is on one thread, that of `Page.run`.
"""
