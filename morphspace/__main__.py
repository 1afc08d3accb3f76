"""`python -m morphspace` is `morphspace`."""

import sys

from morphspace.errors import INTERRUPTED


def run() -> None:
    """Run the command line; Ctrl-C while it is imported ends in one line."""
    try:
        from morphspace.cli.main import main
    except KeyboardInterrupt:
        print("morphspace: stopped", file=sys.stderr)
        sys.exit(INTERRUPTED)
    main(prog_name="morphspace")


if __name__ == "__main__":
    run()
