"""Stimuli as numbers: the drawing of one model, and pure functions that make loadings from loadings.

Input and output are arrays and models; the verbs read and write files.
"""
