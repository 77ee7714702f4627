"""`python -m slidectl` is the command `slidectl`."""

from slidectl.cli import entry

if __name__ == "__main__":
    entry()
