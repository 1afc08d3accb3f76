"""Each file is one verb: a frozen request, and `run`, a generator of steps that returns an `Outcome`.

The command line and scripts use the same requests; see `morphspace.steps`.
"""
