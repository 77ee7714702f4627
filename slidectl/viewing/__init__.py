"""What people look at: plots, pictures, the graph, and the page in `page/`.

They are clients of the daemon, in processes of their own.
Libraries that draw are extras and imported late.
"""
