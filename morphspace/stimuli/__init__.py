"""Stimuli as numbers: what to draw with one model, and the pure functions that make such numbers from others.

Arrays and models in, arrays out; files and folders are the verbs' business.
"""
