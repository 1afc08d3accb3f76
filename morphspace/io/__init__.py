"""Files in and out: stills, video, clips and tables.

Nothing here knows faces or models. What comes in is checked at this border and named when it is unfit; what
goes out appears whole under its name or not at all. The formats are written down in `data_spec/`.
"""
