"""`python -m morphspace` is `morphspace`."""

from morphspace.cli.main import main

main(prog_name="morphspace")
