"""Mimicry: one person's model driven by another person's face (Nagle section 3)."""
