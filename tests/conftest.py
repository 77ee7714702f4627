"""Nothing but its place: pytest makes the modules beside this file importable by all tests."""
