"""One verb, one file: a frozen request and a `run` that does it. The command line and scripts call the same ones.

A run is a generator of steps that returns an `Outcome`; see `morphspace.steps`.
"""
