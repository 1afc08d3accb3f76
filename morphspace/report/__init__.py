"""The visible results of a verb: pages, plots, pictures, and advice on problems."""
