"""A folder of stimuli: planned, drawn, completed, replayed, and protected from being overwritten."""
