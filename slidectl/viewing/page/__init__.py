"""The page: the world in a browser, served by a process of its own that is a client of the daemon.

viser is the library (extra `view`). Everything that concerns the daemon happens on one thread, that of `Page.run`.
"""
