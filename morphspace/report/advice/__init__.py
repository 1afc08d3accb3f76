"""What a person should know before using what a verb made, and what to do about it: one module for each page."""
