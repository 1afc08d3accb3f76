"""`python -m morphspace` is `morphspace`."""

from morphspace.cli import main

main(prog_name="morphspace")
