"""What a verb shows of its work: pages, plots, pictures, and advice where something is off."""
