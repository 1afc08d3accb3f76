"""Read and write files: images, video, clips, tables, recipes and their sidecars.

These modules know neither faces nor models. Input is checked here, and messages name the file. Output files are
written completely or not at all. `data_spec/` describes the formats.
"""
