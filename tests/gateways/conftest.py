"""Its place makes the modules beside it importable by the tests of all gateways."""
